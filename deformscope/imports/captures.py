"""Recorded bytes of devices, decoded by the decoders of their drivers."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from deformscope.errors import InputError
from deformscope.frames import Frame, RawBytes, Stream
from deformscope.imports.import_map import MappedStream
from deformscope.imports.readers import Message, Reader, Topic
from deformscope.rig.decoded import redecoder_of
from deformscope.rig.measured import to_frame
from deformscope_drivers.clock import Unwrap
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.framing import Skipped
from deformscope_drivers.health import Health, Link
from deformscope_drivers.interface import DRIVERS, Redecoder

PIECE_BYTES = 16
"""Size of a piece: that of the shortest reading, so that one of a file without times completes at most one."""


def check_capture(stream: MappedStream, topics: Mapping[str, Topic]) -> None:
    """Raises InputError if a stream's driver, kind and topics do not belong together."""
    of_bytes = all(topics[name].type in ("bytes", "candump") for name in stream.topics)
    if of_bytes and not _is_fed(stream.driver):
        raise stream.missing("driver", f"one of {', '.join(filter(_is_fed, DRIVERS))}", stream.driver)
    if stream.driver and not of_bytes:
        raise stream.missing("driver", "none, its topics are not bytes of a device", stream.driver)
    if stream.driver and stream.kind != DRIVERS[stream.driver].kind:
        raise stream.missing("kind", f"{DRIVERS[stream.driver].kind}, as {stream.driver} gives", stream.kind)


def _is_fed(driver: str) -> bool:
    """Whether a driver's frames depend only on the bytes that the device sends."""
    try:
        again = DRIVERS[driver].redecoder
    except (KeyError, DeviceError):
        return False
    return again is not None and again.packet is not None


class Counted:
    """Counts of a stream's frames. lost: messages without a frame; gap_ns: longest time between two frames"""

    def __init__(self) -> None:
        self.count = self.lost = self.skipped = self.first_ns = self.last_ns = self.gap_ns = 0

    def add(self, ns: int) -> None:
        """Count one more."""
        self.first_ns, self.gap_ns = (self.first_ns, max(self.gap_ns, ns - self.last_ns)) if self.count else (ns, 0)
        self.last_ns, self.count = ns, self.count + 1

    @property
    def rate_hz(self) -> float:
        """Mean rate; 0 with a single reading."""
        span_ns = self.last_ns - self.first_ns
        return 1e9 * (self.count - 1) / span_ns if span_ns > 0 else 0.0

    def health(self) -> Health:
        return Health(Link.CLOSED, "", self.count, skipped_bytes=self.skipped, lost=self.lost, rate_hz=self.rate_hz)


class CaptureStream(Counted):
    """One device's bytes. config: config of its driver. Raises InputError for what the map must say"""

    def __init__(self, stream: MappedStream, config: object, reader: Reader) -> None:
        if stream.kind == "tactile" and not stream.pads:
            raise stream.missing("pads", "name, rows, columns, texel_m, index, finger and part of each", "")
        self.stream, self._config = stream, config
        self._known = Stream(stream.device, stream.kind, stream.driver, pads=stream.pads)
        first = next((one for one in self.frames(reader) if not isinstance(one, RawBytes)), None)
        force: Any = getattr(first, "force_n", None)
        if force is not None:
            if stream.nan == "refuse" and not np.isfinite(force).all():
                expected = 'counts at nominal and nominal forces, as its certificate has them, or nan = "keep"'
                raise stream.missing("config.sensitivity", expected, "")
            torques = len(first.counts) > force.size  # type: ignore[union-attr]
            self._known = Stream(stream.device, stream.kind, stream.driver, channels=len(force), torques=torques)

    def describe(self) -> Stream:
        return self._known

    def behind_s(self, reader: Reader) -> float | None:
        """None: bytes have only the time of their arrival."""
        return None

    def frames(self, reader: Reader) -> Iterator[Frame | RawBytes]:
        """All bytes, and the frames in them."""
        Counted.__init__(self)
        again = redecoder_of(self._known, self._config)
        assert again is not None
        decoder = again.begin()
        clock = _Clock(self.stream, again)
        for message in _pieces(reader, self.stream):
            sent = message.topic in self.stream.topics[1:]
            if sent:
                again.send(message.value)
                yield RawBytes(clock.at(message, None), message.value, True, self.stream.device)
                continue
            for event in decoder.feed(message.value):
                if isinstance(event, Skipped):
                    self.skipped += event.count
                    continue
                ns = clock.at(message, event)
                if (reading := again.measure(event, ns)) is not None:
                    yield to_frame(self.stream.kind, reading, self.count, self.stream.device, again.device())
                    self.add(ns)
            yield RawBytes(clock.at(message, None), message.value, False, self.stream.device)


class _Clock:
    """When pieces came: as they say, or by the controller's clock, or by the rate of readings."""

    def __init__(self, stream: MappedStream, again: Redecoder) -> None:
        self._stream, self._again, self._offset_ns = stream, again, stream.offset_ns
        self._readings, self._now_ns, self._first_ms = 0, self._offset_ns, -1
        self._unwrap = Unwrap(1 << 32)

    def at(self, message: Message, event: object) -> int:
        """The time of a piece [ns]. event: decoded from it, None = none"""
        if message.log_ns:
            if (ns := self._stream.moved_ns(message.log_ns)) < self._now_ns:
                came = f"one {(self._now_ns - ns) / 1e9:.4g} s before the last"
                raise InputError(f"stamps of {self._stream.device} that only rise", came, "a part of it")
            self._now_ns = ns
        elif (time_ms := self._again.time_ms(event)) is not None:
            ticks = self._unwrap(time_ms, 0)
            self._first_ms = ticks if self._first_ms < 0 else self._first_ms
            self._now_ns = self._offset_ns + (ticks - self._first_ms) * 10**6
        elif self._again.packet is not None and isinstance(event, self._again.packet):
            if not self._stream.rate_hz:
                raise self._stream.missing("rate_hz", "readings a second: bytes without times do not say it", "")
            self._now_ns = self._offset_ns + round(self._readings * 1e9 / self._stream.rate_hz)
            self._readings += 1
        return self._now_ns


def _pieces(reader: Reader, stream: MappedStream) -> Iterator[Message]:
    for message in reader.messages(stream.topics):
        step = PIECE_BYTES if not message.log_ns else len(message.value) or 1
        for start in range(0, len(message.value), step):
            yield Message(message.topic, message.log_ns, message.value[start : start + step])
