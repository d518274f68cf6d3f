"""Time of a reading: one stamp, made once, on a clock that never jumps; and its relation to a device's clock."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

Clock = Callable[[], int]
"""The present moment [ns] on a clock that never jumps; a simulated laboratory has its own."""

monotonic_ns: Clock = time.monotonic_ns

STRETCH_NS, STRETCHES = 1e9, 120
"""Length of a stretch of a `ClockFit` [ns], and how many it keeps."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """Arrival time of an item.

    host_ns: monotonic host clock [ns]; for media without a clock (a video file), the media time since its start [ns]
    device_ticks: the device's own counter or clock, in its own unit; None where it has none
    late_ns: calibrated delay of the device, which was subtracted from host_ns [ns]; None = host_ns is the arrival"""

    host_ns: int
    device_ticks: int | None = None
    late_ns: int | None = None

    @property
    def arrived_ns(self) -> int:
        """When the reading arrived [ns]."""
        return self.host_ns + (self.late_ns or 0)

    def put_back(self, late_ns: int) -> "Stamp":
        """When a device that is late by this [ns] took the reading."""
        return Stamp(self.arrived_ns - late_ns, self.device_ticks, late_ns)


def now() -> Stamp:
    """The present moment on the host's monotonic clock."""
    return Stamp(time.monotonic_ns())


class Unwrap:
    """A counter that starts again at `modulus`, as one that never does.

    tick_ns: host time of a tick where it is known: it bridges a pause longer than half a round"""

    def __init__(self, modulus: int, tick_ns: float | None = None) -> None:
        self._modulus = modulus
        self._tick_ns = tick_ns
        self._last: tuple[int, int] | None = None

    def __call__(self, ticks: int, host_ns: int) -> int:
        """The count since the first call's round; small steps backwards stay backwards."""
        if self._last is None:
            self._last = ticks, host_ns
            return ticks
        before, then_ns = self._last
        expected = before if self._tick_ns is None else before + round((host_ns - then_ns) / self._tick_ns)
        half = self._modulus // 2
        count = expected + (ticks - expected + half) % self._modulus - half
        if count > before:
            self._last = count, host_ns
        return count


@dataclass(frozen=True, slots=True)
class ClockRelation:
    """Relation of a device's clock to the host's.

    tick_ns: host time of a device tick [ns]; drift_ppm: its deviation from the nominal tick, None where none is known
    offset_ns: host time at tick 0, as seen through the shortest delay; residual_ns: root mean square of the anchors'
    distances from the straight line [ns]; anchors: stretches of time that it rests on"""

    tick_ns: float
    offset_ns: float
    drift_ppm: float | None
    residual_ns: float
    anchors: int


class ClockFit:
    """Fits a device's clock to the host's, online and in bounded memory.

    A reading arrives late by a delay that is never negative and often small. Therefore the reading with the least delay
    in each stretch of time becomes an anchor, and a straight line is fitted to the anchors.
    tick_ns: nominal host time of a tick, where the device's documents name one"""

    def __init__(self, tick_ns: float | None = None) -> None:
        self._nominal_ns = tick_ns
        self._anchors: deque[tuple[int, int]] = deque(maxlen=STRETCHES)
        self._open: list[tuple[int, int]] = []
        self._started_ns = 0

    def add(self, ticks: int, host_ns: int) -> None:
        """Take one reading: the device's unwrapped ticks and the host's time of arrival."""
        if not self._open:
            self._started_ns = host_ns
        self._open.append((ticks, host_ns))
        if host_ns - self._started_ns >= STRETCH_NS or len(self._open) >= 4096:
            tick_ns = self._tick_ns()
            tick_0, host_0 = self._open[0]
            self._anchors.append(
                min(self._open, key=lambda reading: reading[1] - host_0 - tick_ns * (reading[0] - tick_0))
            )
            self._open.clear()

    def relation(self) -> ClockRelation | None:
        """The line through the anchors; None before there are two stretches of readings."""
        if len(self._anchors) < 2:
            return None
        (tick_0, host_0), count = self._anchors[0], len(self._anchors)
        xs = [float(tick - tick_0) for tick, _ in self._anchors]
        ys = [float(host - host_0) for _, host in self._anchors]
        x_mean, y_mean = math.fsum(xs) / count, math.fsum(ys) / count
        spread = math.fsum((x - x_mean) ** 2 for x in xs)
        if spread == 0:
            return None
        slope = math.fsum((x - x_mean) * (y - y_mean) for x, y in zip(xs, ys, strict=True)) / spread
        offset = y_mean - slope * x_mean
        residual = math.sqrt(math.fsum((y - offset - slope * x) ** 2 for x, y in zip(xs, ys, strict=True)) / count)
        drift = None if self._nominal_ns is None else (slope / self._nominal_ns - 1.0) * 1e6
        return ClockRelation(slope, host_0 + offset - slope * tick_0, drift, residual, count)

    def reset(self) -> None:
        """Forget all: the device was switched off, or lost."""
        self._anchors.clear()
        self._open.clear()

    def _tick_ns(self) -> float:
        """The tick as well as it is known by now, to compare delays within one stretch."""
        if self._nominal_ns is not None:
            return self._nominal_ns
        (first_tick, first_ns), (last_tick, last_ns) = (self._anchors or self._open)[0], self._open[-1]
        return (last_ns - first_ns) / (last_tick - first_tick) if last_tick != first_tick else 0.0
