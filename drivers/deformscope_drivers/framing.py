"""Finding frames in a byte stream that may hold anything: what every byte-stream decoder is made of.

This module uses no port, clock or thread. Bad bytes are events, never exceptions: counted and recorded."""

import struct
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Generic, TypeVar

NOISE = "noise"
CUT_OFF = "cut off"

EventT = TypeVar("EventT")


@dataclass(frozen=True, slots=True)
class Skipped:
    """Bytes that belong to no good frame.

    count: how many, 1 or more; reason: `noise` where nothing looked like a frame; else why the frame that seemed to
    start there was refused ("checksum", "length"...). However the bytes are divided, each refused frame has one event
    with a reason other than `noise`, and the counts of all events sum up to the refused bytes.
    """

    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class GoodFrame(Generic[EventT]):
    """A good frame: its content, and its length in bytes."""

    event: EventT
    length: int


@dataclass(frozen=True, slots=True)
class Refused:
    """A false start of a frame; `reason` is one word or two."""

    reason: str


class FrameDecoder(ABC, Generic[EventT]):
    """Decodes any slice of a stream into whole frames, and the bytes that belong to none.

    After a refused frame the search continues one byte after its start, so that a good frame inside a bad one is found.
    The buffer between calls is shorter than the longest frame."""

    def __init__(self) -> None:
        self._buffered = b""

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete frame."""
        return len(self._buffered)

    def feed(self, data: bytes) -> Iterator[EventT | Skipped]:
        """The events that these bytes complete, in the order of the stream. All of `data` is taken at once."""
        buffer = self._buffered + bytes(data)
        events, rest_from = self._scan(buffer, ended=False)
        self._buffered = buffer[rest_from:]
        return iter(events)

    def finish(self) -> Iterator[EventT | Skipped]:
        """The stream has ended: what waited for more is refused as `cut off`, and good frames behind it come out."""
        events, _ = self._scan(self._buffered, ended=True)
        self._buffered = b""
        return iter(events)

    @abstractmethod
    def _find(self, buffer: bytes, start: int) -> int:
        """The first place at or behind `start` where a frame may start, perhaps truncated by the end of the buffer; the
        buffer's length if there is none."""

    @abstractmethod
    def _parse(self, buffer: bytes, start: int) -> GoodFrame[EventT] | Refused | None:
        """The frame that starts there; None = more bytes are needed, of which there is a bound."""

    def _scan(self, buffer: bytes, *, ended: bool) -> tuple[list[EventT | Skipped], int]:
        events: list[EventT | Skipped] = []
        refused_from, reason = 0, NOISE
        at = 0
        while (start := self._find(buffer, at)) < len(buffer):
            frame = self._parse(buffer, start)
            if frame is None and not ended:
                break
            if start > refused_from:
                events.append(Skipped(start - refused_from, reason))
            if isinstance(frame, GoodFrame):
                events.append(frame.event)
                at = refused_from = start + frame.length
                reason = NOISE
            else:
                refused_from, reason = start, frame.reason if frame else CUT_OFF
                at = start + 1
        if start > refused_from:
            events.append(Skipped(start - refused_from, reason))
        return events, start


def find_start(buffer: bytes, start: int, header: bytes) -> int:
    """First position of `header`, or as much of it as fits before the buffer's end, at or behind `start`."""
    found = buffer.find(header, start)
    if found >= 0:
        return found
    for length in range(min(len(header) - 1, len(buffer) - start), 0, -1):
        if buffer.endswith(header[:length]):
            return len(buffer) - length
    return len(buffer)


# The checksum of the SDH's tactile controller (Weiss DSACON32m) and of the hand's binary protocol on RS-232.
#
# The checksum is no named standard: the table is that of CRC-16/CCITT (polynomial 0x1021, most significant bit first),
# and the update shifts the other way, as in reflected CRCs. For the ASCII digits "123456789" it is 0x6EB4, while
# CRC-16/CCITT-FALSE is 0x29B1 and CRC-16/MCRF4XX 0x6F91; CRC libraries do not have it. The code is not truly cyclic:
# every flipped bit changes it, but some pairs of flipped bits do not. Source: ipab-slmc/SDHLibrary-CPP, sdh/crc.h
# (facts, not code)

START = 0xFFFF

_POLYNOMIAL = 0x1021


def _table_entry(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1) ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE = tuple(_table_entry(byte) for byte in range(256))


# Two bytes at a time, which halves the time for a tactile frame: by the state with the next two bytes, low one first,
# put on it. The table is linear (its entry for a ^ b is the one for a, ^ the one for b), so the state after both is
# (T[x & 255] >> 8) ^ T[(x >> 8) ^ (T[x & 255] & 255)].
@cache
def _pairs() -> tuple[int, ...]:
    return tuple((low >> 8) ^ _TABLE[high ^ (low & 0xFF)] for high in range(256) for low in _TABLE)


def crc16(data: bytes, crc: int = START) -> int:
    """The checksum of `data`; `crc` is that of the bytes before it, to continue from. Sent low byte first."""
    pairs = _pairs()
    for pair in struct.unpack_from(f"<{len(data) // 2}H", data):
        crc = pairs[crc ^ pair]
    if len(data) % 2:
        crc = (crc >> 8) ^ _TABLE[(crc ^ data[-1]) & 0xFF]
    return crc
