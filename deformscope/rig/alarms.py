"""Sensors that are stuck, or at the end of their range, as their readings show.

stuck: an axis of a force sensor, or texels that are pressed, give exactly the same count for longer than the rig allows
(`stuck_after_s`), and for longer than their own noise does. Such a stretch is less likely than CHANCE, given the share
of readings so far that were equal to the one before. Drivers find complete readings and pictures that do not change
(`Health.stuck`), which are passed on here.
saturated: an axis or a texel at its largest count, an overload that the sensor itself reports, most of an image at its
brightest or at black, a depth camera without any depth. The range of an arm is checked by its supervisor."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.frames import (
    ColorFrame,
    DepthFrame,
    HealthReport,
    Item,
    LinkChange,
    RawBytes,
    SessionNote,
    Stream,
    TactileFrame,
    WrenchFrame,
)

CHANCE = 1e-9
"""Probability of a stretch of equal readings by the sensor's noise, below which the sensor counts as stuck."""
CLEAR_S = 1.0
"""An alarm ends after this time of readings without its cause. Time without its cause after which an alarm ends, so
that one that comes and goes is a single alarm. It does not end if its sensor sends nothing."""
WRENCH_END, TEXEL_END = 32767, 4095
"""The largest count of an axis (16 bits with sign), and of a texel (12 bits)."""
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
PICTURE_ENDS = (("its brightest", 0.5), ("black", 0.98))
"""Share of a picture's pixels at one end of the range from which it counts as saturated: not a dark room, but a lens
with its cap on."""
PICTURE_STEP = 8
"""Step between the checked pixels of a picture, along both sides."""

Values = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


@dataclass(slots=True)
class _Stretches:
    """How long each of a sensor's values has been the same.

    last: (n,) newest; since_ns, run: when the present stretch began, and its number of readings after the first
    equal, seen: readings before it that were equal to the one before, and all that were compared"""

    last: Values
    since_ns: Values
    run: Values
    equal: Values
    seen: Values

    @classmethod
    def of(cls, first: Values, at_ns: int) -> "_Stretches":
        nothing = np.zeros(len(first), np.int64)
        return cls(first, nothing + at_ns, nothing, nothing, nothing)

    def add(self, times_ns: Values, values: Values) -> None:
        """(k,), (k, n): further readings."""
        same = np.vstack([self.last, values[:-1]]) == values
        after = np.argmax(~same[::-1], axis=0)  # readings after the last change
        whole = same.all(axis=0)
        count = len(values)
        new_run = np.where(whole, self.run + count, after)
        self.equal = self.equal + np.where(whole, 0, self.run + same.sum(axis=0) - after)
        self.seen = self.seen + np.where(whole, 0, self.run + count - after)
        self.since_ns = np.where(whole, self.since_ns, times_ns[count - 1 - after])
        self.last, self.run = values[-1], new_run

    def stuck(self, now_ns: int, after_s: float) -> Flags:
        """(n,) which have been the same for longer than allowed."""
        by_chance = (self.equal + 1.0) / (self.seen + 2.0)
        longest = math.log(CHANCE) / np.log(by_chance)
        found: Flags = (now_ns - self.since_ns >= after_s * 1e9) & (self.run > longest)
        return found


@dataclass(slots=True)
class _Watched:
    """A device. words: texts of its active alarms, by their subject; newest_ns: time of the last checked item, by its
    kind, because only items of its kind clear an alarm; seen_ns: when each cause was last seen, without silence"""

    stuck_after_s: float | None
    stretches: _Stretches | None = None
    words: dict[tuple[type, str], str] = field(default_factory=dict)
    newest_ns: dict[type, int] = field(default_factory=dict)
    seen_ns: dict[tuple[type, str], int] = field(default_factory=dict)


class SensorAlarms:
    """Alarms of sensors: `look` receives all items of devices in order, and returns notes on alarms that begin and end.

    stuck_after_s: times by device, as in the rig; None = its readings may stay the same for ever"""

    def __init__(self, streams: Sequence[Stream], stuck_after_s: Mapping[str, float | None]) -> None:
        self._streams = {stream.device: stream for stream in streams}
        self._watched = {name: _Watched(stuck_after_s.get(name)) for name in self._streams}

    def of(self, device: str) -> tuple[str, ...]:
        """The active alarms of a device, as text that begins with `stuck` or `saturated`."""
        return tuple(self._watched[device].words.values()) if device in self._watched else ()

    def look(self, items: Sequence[Item]) -> list[SessionNote]:
        """Alarms that begin or end with these items."""
        groups: dict[tuple[type, str], list[Any]] = {}
        notes = []
        for item in items:
            if isinstance(item, HealthReport):
                for name, health in item.devices:
                    causes = {"reading": "stuck: the sensor repeats the same reading"} if health.stuck else {}
                    notes += _changes(name, self._watched[name], HealthReport, causes, item.host_ns)
            elif not isinstance(item, RawBytes | LinkChange | SessionNote):
                groups.setdefault((type(item), item.device), []).append(item)
        for (kind, name), frames in groups.items():
            if kind in _CAUSES and name in self._watched:
                watched, now_ns = self._watched[name], frames[-1].stamp.host_ns
                first_ns = frames[0].stamp.host_ns
                silent_ns = first_ns - watched.newest_ns.get(kind, first_ns)
                if silent_ns > CLEAR_S * 1e9:  # nothing is cleared by time in which nothing came
                    for what in watched.seen_ns:
                        watched.seen_ns[what] += silent_ns * (what[0] is kind)
                causes = _CAUSES[kind](frames, self._streams[name], watched)
                notes += _changes(name, watched, kind, causes, now_ns)
        return notes


def _changes(name: str, watched: _Watched, kind: type, causes: Mapping[str, str], now_ns: int) -> list[SessionNote]:
    """kind: kind of the readings that show them; causes: their causes as text, by subject"""
    notes = []
    watched.newest_ns[kind] = now_ns
    for what, words in causes.items():
        watched.seen_ns[kind, what] = now_ns
        if (kind, what) not in watched.words:
            watched.words[kind, what] = words
            notes.append(SessionNote(now_ns, "alarm", f"{name}: {words}"))
    for one in [one for one in watched.words if one[0] is kind and now_ns - watched.seen_ns[one] >= CLEAR_S * 1e9]:
        notes.append(SessionNote(now_ns, "alarm-over", f"{name}: {watched.words.pop(one)}"))
    return notes


def _wrench(frames: Sequence[WrenchFrame], stream: Stream, watched: _Watched) -> dict[str, str]:
    counts = np.array([frame.counts for frame in frames], np.int64)
    axes = AXES[: counts.shape[1] // stream.channels]
    channels = [f"channel {channel + 1} " for channel in range(stream.channels)] if stream.channels > 1 else [""]
    names = [channel + axis for channel in channels for axis in axes]
    causes = {}
    for name, stuck in zip(names, _stuck(frames, counts, watched), strict=True):
        if stuck:
            causes[f"stuck {name}"] = f"stuck at the same count: {name}"
    for place in np.flatnonzero((np.abs(counts) >= WRENCH_END).any(axis=0)):
        causes[f"end {names[place]}"] = f"saturated: {names[place]} at the end of its range"
    if any(frame.overload for frame in frames):
        causes["overload"] = "saturated: the sensor reports an overload"
    return causes


def _tactile(frames: Sequence[TactileFrame], stream: Stream, watched: _Watched) -> dict[str, str]:
    counts = np.array([frame.counts for frame in frames], np.int64)
    stuck: Flags = np.logical_and(
        _stuck(frames, counts, watched), counts[-1] > 0
    )  # below its threshold a texel gives 0
    ends: Flags = counts.max(axis=0) >= TEXEL_END
    causes, first = {}, 0
    for pad in stream.pads:
        texels = slice(first, first := first + pad.rows * pad.columns)
        if stuck[texels].any():
            causes[f"stuck {pad.name}"] = f"stuck at the same count: {stuck[texels].sum()} texels of {pad.name}"
        if ends[texels].any():
            causes[f"end {pad.name}"] = (
                f"saturated: {ends[texels].sum()} texels of {pad.name} at the end of their range"
            )
    return causes


def _color(frames: Sequence[ColorFrame], stream: Stream, watched: _Watched) -> dict[str, str]:
    image = frames[-1].image[::PICTURE_STEP, ::PICTURE_STEP]
    causes = {}
    for (what, most), end in zip(PICTURE_ENDS, (np.iinfo(image.dtype).max, 0), strict=True):
        share = float((image == end).mean())
        if share >= most:
            causes[what] = f"saturated: {100 * share:.0f} % of the picture at {what}"
    return causes


def _depth(frames: Sequence[DepthFrame], stream: Stream, watched: _Watched) -> dict[str, str]:
    if (frames[-1].depth[::PICTURE_STEP, ::PICTURE_STEP] == 0).all():
        return {"nothing": "saturated: no pixel within its range"}
    return {}


def _stuck(frames: Sequence[Any], counts: Values, watched: _Watched) -> Flags:
    """(n,) which values are stuck after these frames; none where the rig lets them be."""
    times_ns = np.array([frame.stamp.host_ns for frame in frames], np.int64)
    known = watched.stretches
    if known is None or len(known.last) != counts.shape[1]:
        watched.stretches = known = _Stretches.of(counts[0], int(times_ns[0]))
        times_ns, counts = times_ns[1:], counts[1:]
    if len(counts):
        known.add(times_ns, counts)
    after_s = math.inf if watched.stuck_after_s is None else watched.stuck_after_s
    return known.stuck(frames[-1].stamp.host_ns, after_s)


_CAUSES: dict[type, Callable[[Sequence[Any], Stream, _Watched], dict[str, str]]] = {
    WrenchFrame: _wrench,
    TactileFrame: _tactile,
    ColorFrame: _color,
    DepthFrame: _depth,
}


# The drift of a force sensor since its tare, while nothing touches it.
#
# A point of the line is the mean of a second, less that of the first second after the tare. A second in which the force
# changes faster than a sensor drifts is a load: it gives no point

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
