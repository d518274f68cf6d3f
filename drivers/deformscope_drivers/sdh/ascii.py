r"""The ASCII protocol, which every firmware speaks: lines of text, in both directions.

The host ends a command by \r\n; the hand ends a line by \n, with \r at either end or without.

    p=0.000000,-10.000000,...      set all           P=0.000,-10.000,...
    p(3)=       1.500              set one           P(3)=1.500
    pos                            ask               POS=0.00,-10.00,...
    m                              move              M=4.51
    (any)                          refused           E24
                                   not an answer     @max distance=45.06, T=4.51s, num_points: 451

Source: ipab-slmc/SDHLibrary-CPP, sdh/sdhserial.cpp.
"""

import math
import re

from deformscope_drivers.sdh import codes

LINE_MAX = 256  # of a line's text; the longest known is 85 bytes

BARE_REPLIES = ("m", "stop", "ref", "pos_save")
"""Answers that may have no `=`, in small letters or capitals. Firmware before 0.0.3.1 ends the answer to `m` by a bare,
small `m`; that others may look like it is an assumption."""

_LINE = re.compile(r"(?P<name>[A-Za-z]\w*)(?:\(\s*(?P<axis>\d)\s*\))?(?:\s*=\s*(?P<values>.*\S)?)?\s*")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_ERROR = re.compile(r"E(\d{1,3})")


class BadLine(ValueError):
    """A line that is not in the protocol; `reason` is a word or two."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def encode_command(command: codes.Command) -> bytes:
    """The line of a command. Raises ValueError for a command outside the protocol; limits are not checked."""
    name, values, axis = command.name, command.values, command.axis
    if name not in codes.CODES:
        raise ValueError(f"the hand has no command {name!r}")
    if axis is not None and not 0 <= axis < codes.AXIS_COUNT:
        raise ValueError(f"axes are 0 to {codes.AXIS_COUNT - 1}, not {axis}")
    if not all(math.isfinite(value) for value in values):
        raise ValueError(f"values must be finite: {values}")
    head = name if axis is None else f"{name}({axis})"
    if not values:
        return f"{head}\r\n".encode()
    if axis is not None and len(values) == 1:
        return f"{head}={values[0]:12.3f}\r\n".encode()
    if name in codes.INTEGER_COMMANDS:
        if len(values) != 1 or not float(values[0]).is_integer():
            raise ValueError(f"{name} takes one whole number, not {values}")
        return f"{head}={int(values[0])}\r\n".encode()
    return f"{head}={','.join(f'{value:f}' for value in values)}\r\n".encode()


def decode_command(line: str) -> codes.Command:
    """The host's command, decoded by the hand. Raises BadLine."""
    name, axis, text = _parts(line)
    return codes.Command(name, _numbers(text), axis)


def encode_reply(event: codes.Event) -> bytes:
    """The hand's line. Decimals of measured and set values are not documented; whole numbers are sent as such."""
    match event:
        case codes.ErrorReply(code=code):
            return f"E{code}\r\n".encode()
        case codes.DebugLine(text=text):
            return f"@{text}\r\n".encode()
        case codes.TextReply(name=name, text=text):
            return f"{name.upper()}={text}\r\n".encode()
    name = event.quantity if isinstance(event, codes.Reading) else event.name
    head = name.upper() if event.axis is None else f"{name.upper()}({event.axis})"
    if not event.values:
        return f"{name if name == 'm' else head}\r\n".encode()
    shown = (_shown(name, index, value) for index, value in enumerate(event.values))
    return f"{head}={','.join(shown)}\r\n".encode()


def _shown(name: str, index: int, value: float) -> str:
    """Settings from Schunk's examples: M=4.51, SELGRIP=0.0,1, GRIP=0.42,0.1, POWER=0,0,0,0,0,0,0."""
    if name in ("m", "get_duration", "grip") or (name == "selgrip" and index == 0):
        return str(round(value, 2))
    if name in codes.INTEGER_COMMANDS or name in ("state", "power", "ref", "pos_save", "numaxis"):
        return f"{value:.0f}"
    return f"{value:.2f}"


def decode_reply(line: str) -> codes.Event:
    r"""Content of a line of the hand's; without \r and \n. Raises BadLine."""
    if line.startswith("@"):
        return codes.DebugLine(line[1:])
    if error := _ERROR.fullmatch(line):
        if int(error[1]) >= len(codes.ERRORS):
            raise BadLine("status")
        return codes.ErrorReply(int(error[1]))
    name, axis, text = _parts(line)
    bare = "=" not in line
    if not bare and not line.startswith(name.upper()):
        raise BadLine("name")
    if bare and (name not in BARE_REPLIES or axis is not None):
        raise BadLine("line")
    if name in codes.TEXT_COMMANDS:
        if axis is not None:
            raise BadLine("axis")
        return codes.TextReply(name, text)
    values = _numbers(text)
    if not bare and not values:
        raise BadLine("number")
    expected = codes.MEASURED_COUNT.get(name)
    if expected is None:
        return codes.ValueReply(name, values, axis)
    if len(values) != (expected if axis is None else 1):
        raise BadLine("count")
    return codes.Reading(name, values, axis)


def _parts(line: str) -> tuple[str, int | None, str]:
    match = _LINE.fullmatch(line)
    if match is None:
        raise BadLine("line")
    name = match["name"].lower()
    if name not in codes.CODES or match["name"] not in (name, name.upper()):
        raise BadLine("name")
    axis = None if match["axis"] is None else int(match["axis"])
    if axis is not None and axis >= codes.AXIS_COUNT:
        raise BadLine("axis")
    return name, axis, match["values"] or ""


def _numbers(text: str) -> tuple[float, ...]:
    if not text:
        return ()
    values = []
    for part in text.split(","):
        number = part.strip().removesuffix("s")  # one of Schunk's examples has a duration as `4.51s`
        if not _NUMBER.fullmatch(number):
            raise BadLine("number")
        value = float(number)
        if not math.isfinite(value):
            raise BadLine("number")
        values.append(value)
    return tuple(values)
