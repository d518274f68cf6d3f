"""The drift of a force sensor since its tare, while nothing touches it.

A point of the line is the mean of a second, less that of the first second after the tare. A second in which the force
changes faster than a sensor drifts is a load: it gives no point."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from deformscope.frames import WrenchFrame

MEAN_NS = 10**9
POINTS = 120
"""Most points of the line: if there are more, every second one is removed."""
LOAD_SDS, LEAST_LOAD, FASTEST = 4.0, {"N": 0.05, "counts": 2.0}, 0.2
"""A second is loaded if its mean differs from the last unloaded one by this number of standard deviations of a reading,
at least by this force, and by this share of it for each second between the two. It is also loaded if its readings
scatter twice as much as without a load. A sensor that warms up drifts by some 0.002 N a second."""

Axes = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


class TareDrift:
    """Drift of one sensor, since `tare`, or since its first reading."""

    def __init__(self) -> None:
        self.tare()

    def tare(self) -> None:
        """Note a tare: later readings are compared with those of the following second."""
        self.unit = ""
        self.now: Axes = np.zeros(0)
        self.loaded = False
        self._zero: Axes | None = None
        self._quiet: Axes = np.zeros(0)
        self._quiet_ns, self._noise = 0, 0.0
        self._sum: Axes = np.zeros(0)
        self._squares: Axes = np.zeros(0)
        self._count = self._second_ns = self._since_ns = 0
        self._points: list[float] = []
        self._stride, self._seconds = 1, 0

    def add(self, frames: Iterable[WrenchFrame]) -> None:
        """Add further readings, in order."""
        for frame in frames:
            known = not np.isnan(frame.force_n).any()
            load = np.asarray(frame.force_n if known else frame.counts, float).ravel()
            at_ns = frame.stamp.host_ns
            if not self._count or len(load) != len(self._sum):
                self.unit = "N" if known else "counts"
                self._since_ns = self._since_ns or at_ns
                self._sum, self._squares, self._second_ns = np.zeros(len(load)), np.zeros(len(load)), at_ns
            self._sum = self._sum + load
            self._squares = self._squares + load**2
            self._count += 1
            if at_ns - self._second_ns >= MEAN_NS:
                self._end_second()

    def _end_second(self) -> None:
        count, self._count = self._count, 0
        mean = self._sum / count
        if self._zero is None or len(self._zero) != len(mean):
            self._zero, self._quiet, self._quiet_ns = mean, mean, self._second_ns
            self._noise = np.inf
        spread = float(np.sqrt(np.maximum(self._squares / count - mean**2, 0.0).sum()))
        least, elapsed_s = LEAST_LOAD[self.unit], (self._second_ns - self._quiet_ns) / 1e9
        allowed = max(LOAD_SDS * self._noise, least) + FASTEST * least * elapsed_s
        away = float(np.linalg.norm(mean - self._quiet))
        self.loaded = away > allowed or spread > 2.0 * max(self._noise, least)
        if not self.loaded:
            self._noise = min(self._noise, spread)
            self.now, self._quiet, self._quiet_ns = mean - self._zero, mean, self._second_ns
        if self._seconds % self._stride == 0:
            self._points.append(float(np.linalg.norm(self.now)))
        self._seconds += 1
        if len(self._points) > POINTS:
            self._points = self._points[::2]
            self._stride *= 2

    @property
    def line(self) -> tuple[float, ...]:
        """Size of the drift at equally spaced times, from 0 at the tare to now."""
        return tuple(self._points)

    @property
    def lasted_s(self) -> float:
        """Time from the first reading after the tare to the end of the newest second [s]."""
        return (self._second_ns - self._since_ns) / 1e9 if self._seconds else 0.0
