"""How far a force sensor has drifted since its tare, while nothing touches it; while something does, it is the load.

A point of the line is the mean of a second, less that of the first second after the tare.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from deformscope.frames import WrenchFrame

MEAN_NS = 10**9
POINTS = 120
"""Of the line at most: where it would have more, every second one goes."""

Axes = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


class TareDrift:
    """Of one sensor, since `tare`, or since its first reading."""

    def __init__(self) -> None:
        self.tare()

    def tare(self) -> None:
        """It was tared: what comes from now on is compared with the second that follows."""
        self.unit = ""
        self.now: Axes = np.zeros(0)
        self._zero: Axes | None = None
        self._sum: Axes = np.zeros(0)
        self._count = self._second_ns = self._since_ns = 0
        self._points: list[float] = []
        self._stride, self._seconds = 1, 0

    def add(self, frames: Iterable[WrenchFrame]) -> None:
        """Further readings, in order."""
        for frame in frames:
            known = not np.isnan(frame.force_n).any()
            load = np.asarray(frame.force_n if known else frame.counts, float).ravel()
            at_ns = frame.stamp.host_ns
            if not self._count or len(load) != len(self._sum):
                self.unit = "N" if known else "counts"
                self._since_ns = self._since_ns or at_ns
                self._sum, self._second_ns = np.zeros(len(load)), at_ns
            self._sum = self._sum + load
            self._count += 1
            if at_ns - self._second_ns >= MEAN_NS:
                self._end_second(self._sum / self._count)

    def _end_second(self, mean: Axes) -> None:
        self._count = 0
        if self._zero is None or len(self._zero) != len(mean):
            self._zero = mean
        self.now = mean - self._zero
        if self._seconds % self._stride == 0:
            self._points.append(float(np.linalg.norm(self.now)))
        self._seconds += 1
        if len(self._points) > POINTS:
            self._points = self._points[::2]
            self._stride *= 2

    @property
    def line(self) -> tuple[float, ...]:
        """Length of the drift at equal distances in time, from 0 at the tare to now."""
        return tuple(self._points)

    @property
    def lasted_s(self) -> float:
        """From the first reading after the tare to the end of the newest second [s]."""
        return (self._second_ns - self._since_ns) / 1e9 if self._seconds else 0.0
