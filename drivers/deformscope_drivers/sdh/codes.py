"""The SDH hand's numbers: commands, error codes, axis states, grasps, controllers, limits, firmware releases.

Source: ipab-slmc/SDHLibrary-CPP (Schunk's library), sdh_codes.h, sdhbase.cpp, sdh.cpp, sdhserial.cpp; facts only."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

AXIS_COUNT: Final = 7
TEMPERATURE_COUNT: Final = 9


class AxisState(IntEnum):
    """The state of an axis as the hand reports it."""

    IDLE = 0
    POSITIONING = 1
    SPEED_MODE = 2
    NOT_INITIALIZED = 3
    CW_BLOCKED = 4
    CCW_BLOCKED = 5
    DISABLED = 6
    LIMITS_REACHED = 7


MOVING: Final = (AxisState.POSITIONING, AxisState.SPEED_MODE)
BLOCKED: Final = (AxisState.CW_BLOCKED, AxisState.CCW_BLOCKED)


class Controller(IntEnum):
    """How targets are followed. VELOCITY and VELOCITY_ACCELERATION need firmware 0.0.2.6."""

    POSE = 0
    VELOCITY = 1
    VELOCITY_ACCELERATION = 2


class VelocityProfile(IntEnum):
    """Speed of a pose move over its time."""

    SIN_SQUARE = 0
    RAMP = 1


# Binary command codes; the names in lower case are the commands of the ASCII protocol.
_IN_ORDER = """
    v vel rvel pos state p a m stop vp con tpap tvav vlim alim pos_save ref temp id sn ver ver_date soc soc_date
    numaxis p_min p_max p_offset get_duration igrip ihold selgrip grip pid kv ilim power demo user_errors
    terminal debug use_fixed_length change_rs232 change_channel
"""
CODES: Final = {name: code for code, name in enumerate(_IN_ORDER.split(), start=128)}
NAMES: Final = {code: name for name, code in CODES.items()}

# Those that Schunk's library sends in binary; it notes of the others that not all are implemented.
BINARY_COMMANDS: Final = frozenset(("v", "tvav", "a", "p", "tpap", "pos", "vel", "rvel", "state", "ilim", "power"))
TEXT_COMMANDS: Final = frozenset(("id", "sn", "ver", "ver_date", "soc", "soc_date"))
INTEGER_COMMANDS: Final = frozenset(("con", "vp", "selgrip", "demo", "user_errors", "terminal", "debug"))

# The replies that are measured; the others repeat a setting. TPAP and TVAV answer with what POS and VEL would.
MEASURED_COUNT: Final = dict.fromkeys(("pos", "vel", "rvel", "state", "tpap", "tvav"), AXIS_COUNT) | {
    "temp": TEMPERATURE_COUNT
}

ERRORS: Final = (
    ("SUCCESS", ""),
    ("NOT_AVAILABLE", "a request that this firmware has"),
    ("NOT_INITIALIZED", "wait until the hand has started (8 s), or switch it off and on"),
    ("ALREADY_RUNNING", "stop first"),
    ("FEATURE_NOT_SUPPORTED", "a newer firmware, or another command"),
    ("INCONSISTENT_DATA", "check the parameters that depend on each other"),
    ("TIMEOUT", "try again; then check the hand's supply and cable"),
    ("READ_ERROR", "try again; then switch the hand off and on"),
    ("WRITE_ERROR", "try again; then switch the hand off and on"),
    ("INSUFFICIENT_RESOURCES", "switch the hand off and on"),
    ("CHECKSUM_ERROR", "try again; then check the cable and its shield"),
    ("NOT_ENOUGH_PARAMS", "give a value for each axis"),
    ("NO_PARAMS_EXPECTED", "send the command without values"),
    ("CMD_UNKNOWN", "check the firmware's release: older ones lack commands"),
    ("CMD_FORMAT_ERROR", "try again: half a command may have arrived before it"),
    ("ACCESS_DENIED", "this command needs Schunk's password"),
    ("ALREADY_OPEN", "close the other connection"),
    ("CMD_FAILED", "check the axis states"),
    ("CMD_ABORTED", "find the reason for the stop"),
    ("INVALID_HANDLE", "open again"),
    ("DEVICE_NOT_FOUND", "switch the hand off and on"),
    ("DEVICE_NOT_OPENED", "switch the hand off and on"),
    ("IO_ERROR", "on CAN the bus may be off: check its terminators and bit rate"),
    ("INVALID_PARAMETER", "check the values"),
    ("RANGE_ERROR", "stay within the limits that `vlim`, `alim` and the range of the axes give"),
    ("NO_DATAPIPE", "switch the hand off and on"),
    ("INDEX_OUT_OF_BOUNDS", "axes are 0 to 6"),
    ("HOMING_ERROR", "reference the axis again"),
    ("AXIS_DISABLED", "switch the axis on"),
    ("OVER_TEMPERATURE", "switch the axes off and let the hand cool"),
    ("MAX_COMMANDS_EXCEEDED", "send fewer commands at a time"),
    ("INVALID_PASSWORD", "give the right password"),
    ("MAX_COMMANDLINE_EXCEEDED", "send a shorter line"),
    ("CRC_ERROR", "try again; then check the cable and its shield"),
    ("NO_COMMAND", "again"),
    ("INTERNAL", "switch the hand off and on"),
    ("UNKNOWN_ERROR", "switch the hand off and on"),
)
"""Name and what to try, by number: what `E<n>` lines and binary status bytes say. The hand's error codes, not those of
the tactile controller."""


def error_name(code: int) -> str:
    """Schunk's name of an error code; the number where no document names it."""
    return ERRORS[code][0] if 0 <= code < len(ERRORS) else f"code {code}, which no document names"


def error_advice(code: int) -> str:
    """Remedy for an error code."""
    return ERRORS[code][1] if 0 <= code < len(ERRORS) else "switch the hand off and on"


POSITION_MIN_DEG: Final = (0.0, -90.0, -90.0, -90.0, -90.0, -90.0, -90.0)
POSITION_MAX_DEG: Final = (90.0,) * AXIS_COUNT
POSITION_EPSILON_DEG: Final = 0.5
"""The precision of reported angles: near an end they may lie outside the range by this much."""

# What Schunk's library takes before it asks the hand, and where the firmware does not say.
VELOCITY_MAX_DEG_S: Final = (80.0, 100.0, 100.0, 100.0, 100.0, 100.0, 100.0)
VELOCITY_MAX_OLD_DEG_S: Final = (85.7, 200.0, 157.8, 200.0, 157.8, 200.0, 157.8)  # firmware before 0.0.2.1
ACCELERATION_MAX_DEG_S2: Final = (5000.0, 400.0, 1500.0, 400.0, 1500.0, 400.0, 1500.0)
CURRENT_MAX_A: Final = 1.0

DEFAULT_VELOCITY_DEG_S: Final = 40.0
DEFAULT_ACCELERATION_DEG_S2: Final = 100.0
MOVE_CURRENT_A: Final = (1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)  # while gripping, in a trace of old firmware
HOLD_CURRENT_A: Final = (0.1, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2)

Release = tuple[int, ...]

VELOCITY_LIMITS_SINCE: Final[Release] = (0, 0, 2, 1)
CONTROLLERS_SINCE: Final[Release] = (0, 0, 2, 6)  # and `rvel`
ACCELERATION_LIMITS_SINCE: Final[Release] = (0, 0, 2, 7)
BINARY_SINCE: Final[Release] = (0, 0, 2, 15)
DURATION_REPLIES_SINCE: Final[Release] = (0, 0, 3, 1)  # and TCP


def release(text: str) -> Release:
    """The numbers of a firmware release such as `0.0.2.10`, to be compared; () where the text has none."""
    numbers: list[int] = []
    for part in text.strip().split("."):
        digits = "".join(character for character in part if character.isdigit())
        if not digits:
            break
        numbers.append(int(digits))
        if digits != part:
            break
    return tuple(numbers)


# Messages between host and hand, apart from their bytes


@dataclass(frozen=True, slots=True)
class Command:
    """A message of the host.

    name: the ASCII protocol's name, lower case; also for binary requests, whose code it stands for
    values: values to set; none = a query; axis: 0 to 6 for a command to one axis; None = all"""

    name: str
    values: tuple[float, ...] = ()
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class Reading:
    """A measurement of the hand.

    quantity: `pos`, `tpap` [deg]; `vel`, `rvel`, `tvav` [deg/s]; `state` (AxisState); `temp` [deg C]. `tpap`, `tvav`:
    actual angles and velocities in answer to a target; `rvel` is the reference velocity; values: 7 values, by axis; 9
    temperatures (7 motors, the FPGA, the board); 1 value if one axis was requested; axis: None = all"""

    quantity: str
    values: tuple[float, ...]
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class ValueReply:
    """A command was done; the values are the new settings, or a duration [s].

    name: lower case"""

    name: str
    values: tuple[float, ...] = ()
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class TextReply:
    """The answer to `ver`, `id`, `sn`, `soc` and their dates."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class ErrorReply:
    """The hand refused a command; `name` is known in binary only."""

    code: int
    name: str | None = None


@dataclass(frozen=True, slots=True)
class DebugLine:
    """A line that starts with `@`, without it: not part of the answer."""

    text: str


Event = Reading | ValueReply | TextReply | ErrorReply | DebugLine
