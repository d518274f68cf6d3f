r"""The SDH hand's bytes: commands to bytes, bytes to events. This module uses no port or clock.

The hand uses two protocols on the same line, and answers each command in the protocol of the command. A binary reply
starts with a byte of 128 or more; a line of text holds none. Therefore one decoder accepts both, in any order:

    decoder = Decoder()
    for event in decoder.feed(b"POS=0.00,-10.00,20.00,-10.00,20.00,-10.00,20.00\r\n"):
        ...                                           # Reading(quantity="pos", values=(0.0, -10.0, ...))
"""

import re
from dataclasses import dataclass
from typing import Final

from deformscope_drivers.framing import NOISE, FrameDecoder, GoodFrame, Refused
from deformscope_drivers.framing import Skipped as Skipped
from deformscope_drivers.sdh import ascii as text
from deformscope_drivers.sdh import binary
from deformscope_drivers.sdh.codes import CODES
from deformscope_drivers.sdh.codes import Command as Command
from deformscope_drivers.sdh.codes import DebugLine as DebugLine
from deformscope_drivers.sdh.codes import ErrorReply as ErrorReply
from deformscope_drivers.sdh.codes import Event as Event
from deformscope_drivers.sdh.codes import Reading as Reading
from deformscope_drivers.sdh.codes import TextReply as TextReply
from deformscope_drivers.sdh.codes import ValueReply as ValueReply

END_OF_COMMAND: Final = b" \r\n"
"""Ends a command that came half; what a host sends first."""

_HEADS = tuple(sorted(f"{name.upper()}{mark}".encode() for name in CODES for mark in "=("))
_BARE = sorted((*text.BARE_REPLIES, *(name.upper() for name in text.BARE_REPLIES)))
_BARE_HEADS = tuple(f"{name}{end}".encode() for name in _BARE for end in ("\r", "\n"))


def _head_pattern(head: bytes) -> bytes:
    """A head that others end in (TEMP= in P=) must not follow their letter: a damaged line is not a shorter one."""
    heads = (*_HEADS, *_BARE_HEADS)
    before = sorted({chr(other[-len(head) - 1]) for other in heads if other != head and other.endswith(head)})
    return (f"(?<![{''.join(before)}])".encode() if before else b"") + re.escape(head)


_START = re.compile(rb"[@\r\n\x80-\xab]|E\d|" + b"|".join(map(_head_pattern, (*_HEADS, *_BARE_HEADS))))
_CUT_OFF_HEADS = frozenset(head[:length] for head in (*_HEADS, *_BARE_HEADS, b"E0") for length in range(1, len(head)))
_HEAD_MAX = max(map(len, _HEADS))
_BREAKS = re.compile(rb"[\r\n]{0,4}")
_PRINTABLE = re.compile(rb"[\t\x20-\x7e]*")


def encode(command: Command, *, binary_checksum: bool | None = None) -> bytes:
    """A command as a line of text; or in binary, with its checksum (True: RS-232) or without (False: CAN, TCP)."""
    if binary_checksum is None:
        return text.encode_command(command)
    return binary.encode_request(command, checksummed=binary_checksum)


def encode_reply(event: Event, *, binary_checksum: bool | None = None) -> bytes:
    """The hand's answer, in text or in binary, as `encode`."""
    if binary_checksum is None:
        return text.encode_reply(event)
    if isinstance(event, TextReply | DebugLine):
        raise ValueError(f"the binary protocol has no {event}")
    return binary.encode_reply(event, checksummed=binary_checksum)


class Decoder(FrameDecoder[Event]):
    """Messages of the hand.

    checksummed: whether binary replies must have their checksum (True: RS-232), must not (False: CAN, TCP), or may
    (None: by their length). A line with an unknown name is refused."""

    def __init__(self, *, checksummed: bool | None = None) -> None:
        super().__init__()
        self._checksummed = checksummed

    def _find(self, buffer: bytes, start: int) -> int:
        found = _START.search(buffer, start)
        end = len(buffer) if found is None else found.start()
        for at in range(max(start, len(buffer) - _HEAD_MAX), end):
            if buffer[at:] in _CUT_OFF_HEADS or (at == len(buffer) - 1 and buffer[at:].isalpha()):
                return at - 1 if at > start and buffer[at - 1 : at].isalpha() else at
        return end

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[Event] | Refused | None:
        if buffer[start] >= binary.FIRST_CODE:
            return binary.parse_reply(buffer, start, self._checksummed)
        line = _line(buffer, start)
        if not isinstance(line, GoodFrame):
            return line
        try:
            return GoodFrame(text.decode_reply(line.event), line.length)
        except text.BadLine as error:
            return Refused(error.reason)


@dataclass(frozen=True, slots=True)
class Received:
    """The host's message, decoded by the hand.

    command: None for a line without a command of the hand; then `reason` has the cause, "empty" for an empty line
    binary: whether it came in binary, and is answered in binary"""

    command: Command | None
    binary: bool = False
    reason: str = ""


class CommandDecoder(FrameDecoder[Received]):
    """Messages of the host. `checksummed` as in `Decoder`."""

    def __init__(self, *, checksummed: bool | None = None) -> None:
        super().__init__()
        self._checksummed = checksummed

    def _find(self, buffer: bytes, start: int) -> int:
        return start

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[Received] | Refused | None:
        if binary.FIRST_CODE <= buffer[start] <= binary.LAST_CODE:
            request = binary.parse_request(buffer, start, self._checksummed)
            return (
                GoodFrame(Received(request.event, True), request.length) if isinstance(request, GoodFrame) else request
            )
        line = _line(buffer, start)
        if not isinstance(line, GoodFrame):
            return line
        content = line.event.strip()
        try:
            received = Received(text.decode_command(content)) if content else Received(None, reason="empty")
        except text.BadLine as error:
            received = Received(None, reason=error.reason)
        return GoodFrame(received, line.length)


def _line(buffer: bytes, start: int) -> GoodFrame[str] | Refused | None:
    r"""The text of the line that starts there, with the breaks before it; None = its \n has not come."""
    begin = _end_of(_BREAKS, buffer, start, len(buffer))
    end = _end_of(_PRINTABLE, buffer, begin, begin + text.LINE_MAX + 1)
    if end - begin > text.LINE_MAX:
        return Refused("length")
    at = end + (buffer[end : end + 1] == b"\r")
    if at >= len(buffer):
        return None
    if end == begin:
        return Refused(NOISE)
    if buffer[at] != 0x0A:
        return Refused("line")
    return GoodFrame(buffer[begin:end].decode("ascii"), at + 1 - start)


def _end_of(pattern: re.Pattern[bytes], buffer: bytes, start: int, end: int) -> int:
    match = pattern.match(buffer, start, end)
    return match.end() if match else start
