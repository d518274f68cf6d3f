"""OptoForce's protocol, DAQ firmware since about 2014 ("1.4" and later): bytes to events and back.

The same bytes travel over USB, UART and CAN. Every packet is a header of 4 bytes, a body, and the sum of all bytes
before it as u16; numbers are big-endian. Facts from public drivers of the DAQ (shadow-robot/optoforce,
alknemeyer/optoforce, RCPRG-ros-pkg/optoforce_can, open-dynamic-robot-initiative/python_blmc,
jhu-saw/sawOptoforceSensor); the vendor's own manual was not to be had.

| packet            | header      | bytes | body                                          |
| ----------------- | ----------- | ----- | --------------------------------------------- |
| `Configure`       | AA 00 32 03 | 9     | speed u8, filter u8, zero u8                  |
| `ConfigReply`     | AA 00 50 01 | 7     | result u8                                     |
| `Reading`, 3 axes | AA 07 08 0A | 16    | counter u16, status u16, 3 x i16              |
| `Reading`, 4 x 3  | AA 07 08 1C | 34    | counter u16, status u16, 12 x i16             |
| `Reading`, 6 axes | AA 07 08 10 | 22    | counter u16, status u16, 6 x i16              |
| `SerialRequest`   | AB 00 12 08 | 6     |                                               |
| `SerialReply`     | AA 00 12 08 | 14    | 8 characters, ASCII                           |"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import lru_cache
from typing import Generic, TypeVar

from deformscope_drivers.framing import FrameDecoder, GoodFrame, Refused
from deformscope_drivers.framing import Skipped as Skipped

HEADER_SIZE = 4
CHECKSUM_SIZE = 2
CONFIGURE = bytes.fromhex("aa003203")
CONFIG_REPLY = bytes.fromhex("aa005001")
SERIAL_REQUEST = bytes.fromhex("ab001208")
SERIAL_REPLY = bytes.fromhex("aa001208")
SERIAL_SIZE = 8


class Speed(IntEnum):
    """Period with which the DAQ sends [ms], as on the wire."""

    STOP = 0
    HZ_1000 = 1
    HZ_333 = 3
    HZ_100 = 10
    HZ_30 = 33
    HZ_10 = 100

    @property
    def rate_hz(self) -> float:
        """Readings per second."""
        return 1000 / self if self else 0.0


class Filter(IntEnum):
    """The DAQ's low-pass filter, as on the wire."""

    NONE = 0
    HZ_500 = 1
    HZ_150 = 2
    HZ_50 = 3
    HZ_15 = 4
    HZ_5 = 5
    HZ_1_5 = 6

    @property
    def cutoff_hz(self) -> float | None:
        """Cut-off frequency [Hz]; None = no filter."""
        return {0: None, 1: 500.0, 2: 150.0, 3: 50.0, 4: 15.0, 5: 5.0, 6: 1.5}[self]


class Zero(IntEnum):
    """Effect of a `Configure` on the zero point, as on the wire."""

    CLEAR = 0
    SET = 255


class Kind(Enum):
    """Type of the sensors at the DAQ."""

    THREE_AXIS = "3-axis"
    FOUR_CHANNEL = "4-channel"
    SIX_AXIS = "6-axis"

    @property
    def channels(self) -> int:
        """Number of sensors."""
        return 4 if self is Kind.FOUR_CHANNEL else 1

    @property
    def axes(self) -> int:
        """Numbers per sensor: Fx Fy Fz, and Tx Ty Tz where there are 6."""
        return 6 if self is Kind.SIX_AXIS else 3


class DaqState(IntEnum):
    """Bits 15 to 13 of the status word."""

    OK = 0
    ERROR = 1
    COMMUNICATION_ERROR = 2


class SensorState(IntEnum):
    """Bits 12 to 10 of the status word."""

    OK = 0
    NOT_DETECTED = 1
    FAILURE = 2
    TEMPERATURE = 4


AXES = ("fx", "fy", "fz", "tx", "ty", "tz")


class Status(int):
    """The status word, which is a number, and the meaning of its bits."""

    @property
    def daq(self) -> DaqState | int:
        """The DAQ's state; a number if it is unknown."""
        return _named(DaqState, self >> 13)

    @property
    def sensor(self) -> SensorState | int:
        """The sensor's state; a number if it is unknown."""
        return _named(SensorState, self >> 10 & 7)

    @property
    def overload(self) -> tuple[str, ...]:
        """The overloaded axes, of `fx fy fz tx ty tz`."""
        return tuple(name for bit, name in enumerate(AXES) if self & 0x200 >> bit)

    @property
    def several_sensors(self) -> bool:
        """Whether the reported state is that of more than one sensor."""
        return bool(self & 8)

    @property
    def sensor_number(self) -> int:
        """Number of the sensor concerned, 1 to 4; 0 if not stated."""
        return self & 7

    @property
    def usable(self) -> bool:
        """Neither DAQ nor sensor report trouble; an overload does not count as such."""
        return not self & 0xFC00

    @classmethod
    def of(
        cls,
        daq: int = DaqState.OK,
        sensor: int = SensorState.OK,
        overload: tuple[str, ...] = (),
        several_sensors: bool = False,
        sensor_number: int = 0,
    ) -> "Status":
        """The status word with these fields."""
        bits = sum(0x200 >> AXES.index(name) for name in overload)
        return cls(daq << 13 | sensor << 10 | bits | several_sensors << 3 | sensor_number)

    def __str__(self) -> str:
        trouble = [_say("DAQ", self.daq)] if self.daq else []
        trouble += [_say("sensor", self.sensor)] if self.sensor else []
        trouble += [f"overload {' '.join(self.overload)}"] if self.overload else []
        return ", ".join(trouble) or "ok"


@dataclass(frozen=True, slots=True)
class Reading:
    """Readings of all channels at one moment, in the DAQ's units.

    counter: 0 to 65535, wraps; whether it counts readings or the DAQ's own samples is not documented
    status: status of the DAQ and its sensors
    counts: (channels, axes), Fx Fy Fz (Tx Ty Tz); a sensor's sensitivity report has a count's worth"""

    kind: Kind
    counter: int
    status: Status
    counts: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class Configure:
    """Sets speed, filter and zero point, always all three. The DAQ's settings, which cannot be read back.

    speed: a `Speed`; filter: a `Filter`; zero: a `Zero`. Bytes outside these may arrive on a wire."""

    speed: int
    filter: int
    zero: int


@dataclass(frozen=True, slots=True)
class ConfigReply:
    """The DAQ's reply to `Configure`: 0 = done. Some firmware does not report it."""

    result: int


@dataclass(frozen=True, slots=True)
class SerialRequest:
    """Asks for the serial number."""


@dataclass(frozen=True, slots=True)
class SerialReply:
    """The DAQ's or sensor's serial number, at most 8 characters."""

    serial: str


Reply = Reading | ConfigReply | SerialReply
Command = Configure | SerialRequest
EventT = TypeVar("EventT")


@dataclass(frozen=True, slots=True)
class _Packet(Generic[EventT]):
    """length: in bytes, header and sum included; read: the packet that starts there, its sum being right"""

    header: bytes
    length: int
    read: Callable[[bytes, int], EventT | None]


class _OptoforceDecoder(FrameDecoder[EventT]):
    def __init__(self, *packets: _Packet[EventT], fill_to: int = 1) -> None:
        super().__init__()
        self._fill_to = fill_to
        self._packets = {packet.header: packet for packet in packets}
        starts = b"|".join(_or_cut_off(packet.header) for packet in packets)
        self._search = re.compile(starts, re.DOTALL).search

    def _find(self, buffer: bytes, start: int) -> int:
        found = self._search(buffer, start)
        return found.start() if found else len(buffer)

    def _parse(self, buffer: bytes, start: int) -> GoodFrame[EventT] | Refused | None:
        packet = self._packets.get(buffer[start : start + HEADER_SIZE])
        if packet is None:
            return None
        end = start + packet.length
        if len(buffer) < end:
            return None
        if sum(buffer[start : end - 2]) != buffer[end - 2] << 8 | buffer[end - 1]:
            return Refused("checksum")
        event = packet.read(buffer, start + HEADER_SIZE)
        if event is None:
            return Refused("content")
        behind = buffer[end : end + -packet.length % self._fill_to]
        return GoodFrame(event, packet.length + len(behind) - len(behind.lstrip(b"\0")))


class Decoder(_OptoforceDecoder[Reply]):
    """Messages of a DAQ. A header within a packet is found if the packet is bad, and only then.

    fill_to: zeros that fill a packet up to a multiple of this belong to it (8 on CAN, where some DAQs may do so)"""

    def __init__(self, fill_to: int = 1) -> None:
        super().__init__(
            *(_data_packet(kind) for kind in Kind),
            _Packet(CONFIG_REPLY, 7, lambda buffer, at: ConfigReply(buffer[at])),
            _Packet(SERIAL_REPLY, 14, _read_serial),
            fill_to=fill_to,
        )


class CommandDecoder(_OptoforceDecoder[Command]):
    """Commands that a DAQ receives. Zeros with which some hosts fill up a CAN frame are skipped as noise."""

    def __init__(self) -> None:
        super().__init__(
            _Packet(CONFIGURE, 9, lambda buffer, at: Configure(*buffer[at : at + 3])),
            _Packet(SERIAL_REQUEST, 6, lambda buffer, at: SerialRequest()),
        )


def encode(message: Command | Reply) -> bytes:
    """The packet of this message. Raises ValueError for values that do not fit."""
    match message:
        case Reading(kind, counter, status, counts):
            values = [value for channel in counts for value in channel]
            if [len(channel) for channel in counts] != [kind.axes] * kind.channels:
                raise ValueError(f"expected {kind.channels} x {kind.axes} counts for {kind.value}; got {counts}")
            body = HEADERS[kind] + _pack(f">HH{len(values)}h", counter, status, *values)
        case Configure(speed, filter_, zero):
            body = CONFIGURE + _pack("3B", speed, filter_, zero)
        case ConfigReply(result):
            body = CONFIG_REPLY + _pack("B", result)
        case SerialRequest():
            body = SERIAL_REQUEST
        case SerialReply(serial):
            if not serial.isascii() or not 0 < len(serial) <= SERIAL_SIZE:
                raise ValueError(f"expected 1 to {SERIAL_SIZE} ASCII characters; got {serial!r}")
            body = SERIAL_REPLY + serial.encode("ascii").ljust(SERIAL_SIZE, b"\0")
        case _:
            raise TypeError(f"expected a message of this module; got {message!r}")
    return body + sum(body).to_bytes(CHECKSUM_SIZE, "big")


HEADERS = {
    Kind.THREE_AXIS: bytes.fromhex("aa07080a"),
    Kind.FOUR_CHANNEL: bytes.fromhex("aa07081c"),
    Kind.SIX_AXIS: bytes.fromhex("aa070810"),
}


def _data_packet(kind: Kind) -> _Packet[Reply]:
    channels, axes = kind.channels, kind.axes
    body = struct.Struct(f">HH{channels * axes}h")

    def read(buffer: bytes, at: int) -> Reading:
        counter, status, *values = body.unpack_from(buffer, at)
        counts = tuple(tuple(values[first : first + axes]) for first in range(0, channels * axes, axes))
        return Reading(kind, counter, _status(status), counts)

    def read_one_channel(buffer: bytes, at: int) -> Reading:
        words = body.unpack_from(buffer, at)
        return Reading(kind, words[0], _status(words[1]), (words[2:],))

    length = HEADER_SIZE + body.size + CHECKSUM_SIZE
    return _Packet(HEADERS[kind], length, read_one_channel if channels == 1 else read)


def _read_serial(buffer: bytes, at: int) -> SerialReply | None:
    text = buffer[at : at + SERIAL_SIZE].rstrip(b"\0 ")
    return SerialReply(text.decode("ascii")) if text and text.isascii() and b"\0" not in text else None


@lru_cache(maxsize=256)
def _status(word: int) -> Status:
    return Status(word)


def _or_cut_off(header: bytes) -> bytes:
    """A pattern for the header, or as much of it as the end has room for."""
    pattern = b""
    for value in reversed(header[1:]):
        pattern = rb"(?:\Z|" + re.escape(bytes([value])) + pattern + b")"
    return re.escape(header[:1]) + pattern


def _named(states: type[DaqState] | type[SensorState], code: int) -> DaqState | SensorState | int:
    try:
        return states(code)
    except ValueError:
        return code


def _say(what: str, state: DaqState | SensorState | int) -> str:
    return f"{what} {state.name.lower().replace('_', ' ') if isinstance(state, IntEnum) else f'state {state}'}"


def _pack(layout: str, *numbers: int) -> bytes:
    try:
        return struct.pack(layout, *numbers)
    except struct.error as error:
        raise ValueError(f"expected numbers that fit the packet; got {numbers}: {error}") from error
