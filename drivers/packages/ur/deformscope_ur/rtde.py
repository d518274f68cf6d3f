"""Packages of RTDE (Real-Time Data Exchange), version 2 of its protocol, over TCP port 30004, high byte first.

Source: Universal Robots' "Real-Time Data Exchange (RTDE) Guide", and their clients (RTDE_Python_Client_Library,
Universal_Robots_Client_Library). A package is its size (uint16, header included), its kind (uint8) and a payload."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from deformscope_drivers.framing import FrameDecoder, GoodFrame, Refused

PROTOCOL = 2
HEADER = struct.Struct(">HB")
MOST_BYTES = 4096
"""Longest package that is accepted; a recipe of all published outputs has about 2700."""
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"
"""In place of a type: the controller has no such variable; another client sets it already."""
_NAMES = "BOOL UINT8 UINT32 UINT64 INT32 DOUBLE VECTOR3D VECTOR6D VECTOR6INT32 VECTOR6UINT32"
FORMATS = dict(zip(_NAMES.split(), ["?", "B", "I", "Q", "i", "d", "3d", "6d", "6i", "6I"], strict=True))
"""Formats of `struct` by the names of types."""
Value = bool | int | float | tuple[int | float, ...]
Kind = IntEnum(
    "Kind",
    {"TEXT": 77, "VERSION": 86, "CONTROLLER": 118, "OUTPUTS": 79, "INPUTS": 73, "START": 83, "PAUSE": 80, "DATA": 85},
)
"""Kinds of packages, letters of ASCII; requests and their replies share one."""
KINDS = {int(kind): kind for kind in Kind}
LENGTHS = {Kind.VERSION: (1, 2), Kind.CONTROLLER: (0, 16), Kind.START: (0, 1), Kind.PAUSE: (0, 1)}
"""Possible lengths of a payload, of requests and replies, where they are fixed."""
Runtime = IntEnum("Runtime", "STOPPING STOPPED PLAYING PAUSING PAUSED RESUMING", start=0)
RUNTIMES = {int(state): state.name.lower() for state in Runtime}
"""`runtime_state`: what the controller's program does."""
IDLE, RUNNING = 5, 7
_MODES = "NO_CONTROLLER DISCONNECTED CONFIRM_SAFETY BOOTING POWER_OFF POWER_ON IDLE BACKDRIVE RUNNING"
ROBOT_MODES = dict(enumerate(_MODES.split(), start=-1))
"""`robot_mode`"""
NORMAL, PROTECTIVE = 1 << 0, 1 << 2
_STOPS = (
    "a protective stop, its recovery mode, a safeguard stop, an emergency stop of the system, an emergency stop, "
    "an emergency stop, a safety violation, a safety fault, a stop for safety, its three-position switch"
)
SAFETY = dict(enumerate(_STOPS.split(", "), start=2))
"""Bits of `safety_status_bits` with which it does not move; bits 0 and 1 are its normal and its reduced mode."""


@dataclass(frozen=True, slots=True)
class Package:
    """kind: its `Kind`; payload: the bytes behind its header"""

    kind: Kind
    payload: bytes = b""

    def encode(self) -> bytes:
        """Its bytes on the wire."""
        return HEADER.pack(HEADER.size + len(self.payload), self.kind) + self.payload

    @property
    def accepted(self) -> bool | None:
        """What a reply to VERSION, START or PAUSE says; None for another package."""
        return self.payload[0] != 0 if self.kind in LENGTHS and len(self.payload) == 1 else None

    @property
    def version(self) -> tuple[int, ...] | None:
        """(4,) version of the controller's software in a reply to CONTROLLER; None for another package."""
        return struct.unpack(">4I", self.payload) if self.kind is Kind.CONTROLLER and len(self.payload) == 16 else None

    @property
    def text(self) -> str:
        """Message and source of a TEXT; empty for another package, or one whose lengths do not fit."""
        data = self.payload
        if self.kind is not Kind.TEXT or not data:
            return ""
        message, rest = data[1 : 1 + data[0]], data[1 + data[0] :]
        if not rest or len(rest) != 2 + rest[0]:
            return ""
        return f"{rest[1:-1].decode('utf-8', 'replace')}: {message.decode('utf-8', 'replace')}"


def output_request(frequency_hz: float, names: Sequence[str]) -> Package:
    """Asks for data packages with these outputs, at a rate."""
    return Package(Kind.OUTPUTS, struct.pack(">d", frequency_hz) + ",".join(names).encode())


def input_request(names: Sequence[str]) -> Package:
    """Announces data packages with these inputs."""
    return Package(Kind.INPUTS, ",".join(names).encode())


@dataclass(frozen=True, slots=True)
class Recipe:
    """Order of the variables in data packages. number: as the controller gave it, 0 = refused; types: those of `names`,
    or NOT_FOUND or IN_USE"""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]
    _format: struct.Struct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        known = [FORMATS[one] for one in self.types] if not self.refused else []
        object.__setattr__(self, "_format", struct.Struct(">B" + "".join(known)))

    @classmethod
    def of_reply(cls, package: Package, names: Sequence[str]) -> "Recipe | None":
        """The recipe in a reply to OUTPUTS or INPUTS; None where it does not fit the names that were asked for."""
        if package.kind not in (Kind.OUTPUTS, Kind.INPUTS) or len(package.payload) < 2:
            return None
        types = tuple(package.payload[1:].decode("latin-1").split(","))
        known = all(one in FORMATS or one in (NOT_FOUND, IN_USE) for one in types)
        return cls(package.payload[0], tuple(names), types) if known and len(types) == len(names) else None

    @property
    def refused(self) -> dict[str, str]:
        """The variables that the controller does not give or take, and why."""
        pairs = zip(self.names, self.types, strict=True)
        return {name: kind for name, kind in pairs if kind in (NOT_FOUND, IN_USE)}

    def reply(self, kind: Kind) -> Package:
        """What a controller answers."""
        return Package(kind, bytes([self.number]) + ",".join(self.types).encode())

    def pack(self, values: Mapping[str, Value]) -> Package:
        """A data package of these variables. Raises KeyError for a missing one, struct.error for a wrong type."""
        flat: list[int | float] = []
        for name in self.names:
            value = values[name]
            flat.extend(value if isinstance(value, tuple) else (value,))
        return Package(Kind.DATA, self._format.pack(self.number, *flat))

    def unpack(self, package: Package) -> dict[str, Value] | None:
        """The variables in a data package; None for one of another recipe or length."""
        payload = package.payload
        if package.kind is not Kind.DATA or self.refused or len(payload) != self._format.size:
            return None
        number, *flat = self._format.unpack(payload)
        if number != self.number:
            return None
        found: dict[str, Value] = {}
        at = 0
        for name, kind in zip(self.names, self.types, strict=True):
            count = int(FORMATS[kind][:-1] or 1)
            found[name] = tuple(flat[at : at + count]) if count > 1 else flat[at]
            at += count
        return found


class Decoder(FrameDecoder[Package]):
    """Packages of either direction. They have neither a mark at their start nor a checksum: size and kind decide."""

    def _find(self, buffer: bytes, start: int) -> int:
        return start

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[Package] | Refused | None:
        if len(buffer) - start < HEADER.size:
            return None
        size, number = HEADER.unpack_from(buffer, start)
        kind = KINDS.get(number)
        if kind is None:
            return Refused("kind")
        length = size - HEADER.size
        if not 0 <= length <= MOST_BYTES or length not in LENGTHS.get(kind, (length,)):
            return Refused("length")
        payload = buffer[start + HEADER.size : start + size]
        return GoodFrame(Package(kind, payload), size) if len(payload) == length else None
