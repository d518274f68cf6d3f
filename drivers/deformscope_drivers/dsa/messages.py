"""Messages between a DSACON32m and its host, and one table of each message's layout in its packet's payload.

Source: Schunk's libraries as protocols.md 1a cites them (SDHLibrary-CPP, sdh/dsa.h). Little-endian throughout. Only
messages whose payload is public are here: ids 00, 01, 02, 03, 0B, 0F, 12, 13 and 14."""

import struct
from dataclasses import astuple, dataclass
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

TexelArray = npt.NDArray[np.uint16]


class Id(IntEnum):
    """Packet ids. A reply has its request's."""

    FRAME = 0x00
    CONTROLLER = 0x01
    SENSOR = 0x02
    ACQUISITION = 0x03
    MATRIX = 0x0B
    SET_SENSITIVITY = 0x0F
    SENSITIVITY = 0x12
    SET_THRESHOLD = 0x13
    THRESHOLD = 0x14


class Acquisition(IntFlag):
    """Flags of `ConfigureAcquisition`. Bits 3 to 6 (single shot, triggers) are in no use that is public."""

    ON = 0x80
    RLE = 0x01


class Adjust(IntFlag):
    """Flags of `SetSensitivity` and `SetThreshold`.

    PERSISTENT survives power-off; it wears the memory (about 100 000 writes) and is not answered."""

    PERSISTENT = 0x80
    ALL = 0x02
    FACTORY = 0x01


FRAME_RLE = 0x01
"""Flag of a frame whose texels are run-length encoded. The meaning of the other seven bits is not public."""

ERRORS = (
    *("success", "not available", "no sensor", "not initialised", "already running", "feature not supported"),
    *("inconsistent data", "timeout", "read error", "write error", "insufficient resources", "checksum"),
    *("not enough parameters", "unknown command", "command format", "access denied", "already open", "command failed"),
    *("command aborted", "invalid handle", "device not found", "device not opened", "input/output"),
    *("wrong parameter", "index out of bounds", "pending", "overrun", "out of range"),
)
"""Error codes by number. `pending` means that another reply follows."""

SUCCESS = ERRORS.index("success")
CHECKSUM = ERRORS.index("checksum")
NOT_ENOUGH_PARAMETERS = ERRORS.index("not enough parameters")
UNKNOWN_COMMAND = ERRORS.index("unknown command")
COMMAND_FORMAT = ERRORS.index("command format")
WRONG_PARAMETER = ERRORS.index("wrong parameter")
INDEX = ERRORS.index("index out of bounds")
PENDING = ERRORS.index("pending")


def error_name(code: int) -> str:
    """Meaning of an error code."""
    return ERRORS[code] if code < len(ERRORS) else "unknown error"


# From the controller ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One full frame.

    timestamp_ms: the controller's clock, 32 bits (that it counts milliseconds is how Schunk's software takes it)
    flags: flags as sent; `FRAME_RLE` states how the texels were coded
    texels: (n,) uint16, 0 to 4095, read-only: the matrices one after the other, each row by row"""

    timestamp_ms: int
    flags: int
    texels: TexelArray

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Reading):
            return NotImplemented
        mine, others = (self.timestamp_ms, self.flags), (other.timestamp_ms, other.flags)
        return mine == others and np.array_equal(self.texels, other.texels)

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, slots=True)
class Ack:
    """The answer that holds an error code alone: to settings, and to a query that failed.

    command: the request's id"""

    command: int
    error: int = SUCCESS


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """Id 01. hardware_version: version as sent (perhaps binary-coded decimal); software_version: 268, say

    status: bit 7 operable, bit 6 acquiring; features: bit 6 USB, bit 5 CAN, bit 4 RS-232
    can_id: its low byte, all that is ever sent"""

    error: int
    serial_number: int
    hardware_version: int
    software_version: int
    status: int
    features: int
    sensor_controller_type: int
    active_interface: int
    can_baud: int
    can_id: int


@dataclass(frozen=True, slots=True)
class SensorInfo:
    """Id 02. features: bit 0 = a description is set."""

    error: int
    matrix_count: int
    generated_by: int
    hardware_revision: int
    serial_number: int
    features: int


@dataclass(frozen=True, slots=True)
class MatrixInfo:
    """Id 0B: one matrix's geometry.

    texel_width_mm, texel_height_mm: distance between texels along x and y; cells_x, cells_y: columns and rows
    uid: 6 bytes; reserved: 2 bytes
    center, theta: where the matrix sits, and how it is turned (3,); units are not public
    full_scale: read as a float as Schunk's C++ does (its Python reads an integer)"""

    error: int
    texel_width_mm: float
    texel_height_mm: float
    cells_x: int
    cells_y: int
    uid: bytes
    reserved: bytes
    hardware_revision: int
    center: tuple[float, float, float]
    theta: tuple[float, float, float]
    full_scale: float
    features: int

    @property
    def cells(self) -> int:
        """Number of texels of the matrix."""
        return self.cells_x * self.cells_y


@dataclass(frozen=True, slots=True)
class SensitivityInfo:
    """Id 12. flags: bit 1 = the user may change it; current, factory: 0 to 1."""

    error: int
    flags: int
    current: float
    factory: float


@dataclass(frozen=True, slots=True)
class ThresholdInfo:
    """Id 14. threshold: texels below it are sent as 0."""

    error: int
    threshold: int


Reply = Ack | ControllerInfo | SensorInfo | MatrixInfo | SensitivityInfo | ThresholdInfo


# From the host ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class QueryController:
    """Id 01: asks for `ControllerInfo`."""


@dataclass(frozen=True, slots=True)
class QuerySensor:
    """Id 02: asks for `SensorInfo`."""


@dataclass(frozen=True, slots=True)
class ConfigureAcquisition:
    """Id 03. flags: flags of `Acquisition`; frame_rate_hz: 0 = one frame, more = stream as fast as it goes."""

    flags: int
    frame_rate_hz: int = 0


@dataclass(frozen=True, slots=True)
class QueryMatrix:
    """Id 0B: asks for `MatrixInfo`."""

    matrix: int


@dataclass(frozen=True, slots=True)
class SetSensitivity:
    """Id 0F. flags: flags of `Adjust`; sensitivity: 0 to 1."""

    flags: int
    matrix: int
    sensitivity: float


@dataclass(frozen=True, slots=True)
class QuerySensitivity:
    """Id 12: asks for `SensitivityInfo`."""

    matrix: int


@dataclass(frozen=True, slots=True)
class SetThreshold:
    """Id 13. flags: flags of `Adjust`; threshold: 0 to 4095."""

    flags: int
    matrix: int
    threshold: int


@dataclass(frozen=True, slots=True)
class QueryThreshold:
    """Id 14: asks for `ThresholdInfo`."""

    matrix: int


Command = (
    QueryController
    | QuerySensor
    | ConfigureAcquisition
    | QueryMatrix
    | SetSensitivity
    | QuerySensitivity
    | SetThreshold
    | QueryThreshold
)


# The table -------------------------------------------------------------------------------------------------------


class Layout(NamedTuple):
    """Layout of a message in its payload: its kind, and the `struct` of its fields, in their order."""

    id: Id
    kind: type[Any]
    fields: struct.Struct

    def unpack(self, payload: bytes) -> Any:
        """The message that a payload of the right length holds."""
        values = self.fields.unpack(payload)
        if self.kind is MatrixInfo:
            values = (*values[:8], values[8:11], values[11:14], *values[14:])
        return self.kind(*values)

    def pack(self, message: Command | Reply) -> bytes:
        """The payload that holds a message."""
        values = astuple(message)
        return self.fields.pack(*(one for value in values for one in (value if isinstance(value, tuple) else (value,))))


REPLIES = tuple(
    Layout(id, kind, struct.Struct("<" + fields))
    for id, kind, fields in (
        (Id.CONTROLLER, ControllerInfo, "HIBHBBBBIB"),
        (Id.SENSOR, SensorInfo, "HHHBIB"),
        (Id.MATRIX, MatrixInfo, "HffHH6s2sB3f3ffB"),
        (Id.SENSITIVITY, SensitivityInfo, "HBff"),
        (Id.THRESHOLD, ThresholdInfo, "HH"),
    )
)
"""Replies that hold more than an error code."""

COMMANDS = tuple(
    Layout(id, kind, struct.Struct("<" + fields))
    for id, kind, fields in (
        (Id.CONTROLLER, QueryController, ""),
        (Id.SENSOR, QuerySensor, ""),
        (Id.ACQUISITION, ConfigureAcquisition, "BH"),
        (Id.MATRIX, QueryMatrix, "B"),
        (Id.SET_SENSITIVITY, SetSensitivity, "BBf"),
        (Id.SENSITIVITY, QuerySensitivity, "B"),
        (Id.SET_THRESHOLD, SetThreshold, "BBH"),
        (Id.THRESHOLD, QueryThreshold, "B"),
    )
)

LAYOUT_OF: dict[type[Any], Layout] = {layout.kind: layout for layout in (*REPLIES, *COMMANDS)}
REPLY_TO: dict[int, Layout] = {layout.id: layout for layout in REPLIES}
COMMAND_WITH: dict[int, Layout] = {layout.id: layout for layout in COMMANDS}


# Texels: raw, or run-length encoded in words of 4 bits of run and 12 of value ----------------------------------------

TEXEL_MAX = 4095
"""Texels have 12 bits."""

LONGEST_RUN = 15

_WORD = np.dtype("<u2")


def decode_raw(coded: bytes) -> TexelArray | None:
    """(n,) texels of n little-endian words; None where one has more than 12 bits."""
    texels = np.frombuffer(coded, _WORD)
    return None if (texels > TEXEL_MAX).any() else _own(texels)


def decode_rle(coded: bytes, cells_max: int) -> TexelArray | None:
    """(n,) texels of run-length encoded words (a run of 0 gives none); None where there are more than `cells_max`."""
    words = np.frombuffer(coded, _WORD)
    runs = words >> 12
    return None if int(runs.sum(dtype=np.int64)) > cells_max else _own(np.repeat(words & TEXEL_MAX, runs))


def encode_raw(texels: TexelArray) -> bytes:
    """(n,) texels as n little-endian words."""
    return texels.astype(_WORD).tobytes()


def encode_rle(texels: TexelArray) -> bytes:
    """(n,) texels as words of run and value, with runs as long as can be; never longer than raw."""
    if not texels.size:
        return b""
    starts = np.flatnonzero(np.diff(texels, prepend=texels[0] ^ 1))
    lengths = np.diff(starts, append=texels.size)
    words = []
    for value, length in zip(texels[starts].tolist(), lengths.tolist(), strict=True):
        words += [LONGEST_RUN << 12 | value] * (length // LONGEST_RUN)
        if rest := length % LONGEST_RUN:
            words.append(rest << 12 | value)
    return np.array(words, _WORD).tobytes()


def _own(texels: TexelArray) -> TexelArray:
    """The same counts (n,) as uint16 in the machine's byte order, read-only."""
    texels = texels.astype(np.uint16)
    texels.flags.writeable = False
    return texels
