"""Times of the fingers' first contact with the container, and of their rest (Thesis ch. 2: F_first and F_steady).

    rule = EventRule()
    found = squeeze_events(tactile_ns, sums, hand_ns, closing_deg, rule)

Both rules process one reading after another, so that they work in a live squeeze. `squeeze_events` applies them again
to the whole recording, in order of time.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError

PERIODS = 2.0
"""Accuracy of an event in sample periods."""
BASELINE_FRAMES = 6
"""The first frames, in the air, are the baseline."""
DEVIATIONS = 6.0
"""Deviations of the baseline: a sum that is farther above it is no noise, where that is more than `onset_counts`."""
DRIVEN_DEG, HELD, STARTS_S = 1.0, 0.25, 0.5
"""A finger is held if it turns by less than this share of the angle, at least this one, by which it is driven. Time
that a hand has to begin to turn."""
UNREAD_FRAMES, REPEATED_FRAMES, LIT_TEXELS = 3, 6, 3
"""Successive frames without contact of a finger that is held, and equal frames with contact: their number. An array is
not compared where fewer texels are in contact: noise may repeat these."""
AT_REST = 1.0 / 3.0
"""Share of `still_deg`: axes at rest came to rest when they were within this of their final angle. `still_deg` itself
is their rotation in a period or two while they still close."""


@dataclass(frozen=True, slots=True)
class EventRule:
    """onset_counts: contact is a sum of a fingertip's texels this far above its baseline in the air, in onset_frames
    successive frames; still_deg, still_s: all closing axes stay within still_deg for still_s"""

    onset_counts: float = 40.0
    onset_frames: int = 2
    still_deg: float = 0.15
    still_s: float = 0.3


@dataclass(frozen=True, slots=True)
class SqueezeEvents:
    """First contact and steady state, on the host's clock [ns], each with the interval in which it was.

    first_ns: time of first contact by any finger, midway between the last frame without contact and the first with it
    steady_ns: time of the first reading of the closing axes' rest; 0 = it did not happen
    finger_ns: (fingers,) first contact of each, 0 = none
    first_interval_ns, steady_interval_ns: (low, high), two sample periods wide at least
    tactile_period_s, hand_period_s: median of the sample periods; onset_counts: the sums' threshold over the baseline
    """

    first_ns: int
    first_interval_ns: tuple[int, int]
    steady_ns: int
    steady_interval_ns: tuple[int, int]
    finger_ns: IntArray
    tactile_period_s: float
    hand_period_s: float
    onset_counts: float


class OnsetDetector:
    """Feed each tactile frame's sums; `first_ns` is set once contact is certain, midway between the last frame without
    it and the first with it. rise: (fingers,) the last sums above the baseline [counts]"""

    def __init__(self, rule: EventRule) -> None:
        self._rule = rule
        self._air: list[FloatArray] = []
        self._last_ns = 0
        self._since: list[int] = []
        self._count: list[int] = []
        self.finger_ns: list[int] = []
        self.rise: FloatArray = np.zeros(0)
        self.threshold = rule.onset_counts

    @property
    def first_ns(self) -> int:
        """When the first finger came into contact [ns], 0 before."""
        return min((one for one in self.finger_ns if one), default=0)

    def feed(self, time_ns: int, sums: FloatArray) -> bool:
        """Whether there is contact. sums: (fingers,) sums of a frame's texels [counts]; baseline frames come first"""
        before_ns, self._last_ns = self._last_ns, time_ns
        if len(self._air) < BASELINE_FRAMES:
            self._air.append(np.asarray(sums, np.float64))
            self._since, self._count, self.finger_ns = ([0] * len(sums) for _ in range(3))
            return False
        air = np.stack(self._air)
        self.threshold = max(self._rule.onset_counts, DEVIATIONS * float(air.std(axis=0).max()))
        self.rise = np.asarray(sums) - np.median(air, axis=0)
        for finger, above in enumerate(self.rise > self.threshold):
            if not above:
                self._count[finger] = 0
                continue
            if self._count[finger] == 0:
                self._since[finger] = before_ns + (time_ns - before_ns) // 2
            self._count[finger] += 1
            if self._count[finger] >= self._rule.onset_frames and not self.finger_ns[finger]:
                self.finger_ns[finger] = self._since[finger]
        return self.first_ns > 0


class StillDetector:
    """Feed the closing axes' angles once they move. `steady_ns` is set after enough time at rest, to the first reading
    within `AT_REST` of the tolerance of their final angle."""

    def __init__(self, rule: EventRule) -> None:
        self._rule = rule
        self._window: deque[tuple[int, FloatArray]] = deque()
        self.steady_ns = 0

    def feed(self, time_ns: int, position_deg: FloatArray) -> bool:
        """Whether they are at rest. position_deg: (axes,)"""
        if self.steady_ns:
            return True
        now = np.asarray(position_deg, np.float64)
        while self._window and self._moved(now):
            self._window.popleft()
        self._window.append((time_ns, now))
        if time_ns - self._window[0][0] >= self._rule.still_s * 1e9:
            off = np.abs(np.stack([one for _, one in self._window]) - now).max(axis=1)
            moved = np.flatnonzero(off > AT_REST * self._rule.still_deg)
            self.steady_ns = self._window[int(moved[-1]) + 1 if len(moved) else 0][0]
        return self.steady_ns > 0

    def _moved(self, now: FloatArray) -> bool:
        """Whether an axis has moved within the window, of positions now (axes,) [deg]."""
        every = np.stack([now, *(one for _, one in self._window)])
        return bool((np.ptp(every, axis=0) > self._rule.still_deg).any())


class ArrayCheck:
    """Whether the fingertips' arrays contradict the fingers: what holds a finger presses its array, and an array that
    is pressed does not repeat itself. Feed the angles of the axes that are driven, and the frames."""

    def __init__(self, rule: EventRule, speed_deg_s: float) -> None:
        self._speed_deg_s = speed_deg_s
        self._window_ns = round(1e9 * max(rule.still_s, DRIVEN_DEG / speed_deg_s))
        self._angles: deque[tuple[int, FloatArray]] = deque()
        self._rise: FloatArray = np.zeros(2)
        self._texels, self._threshold = [np.zeros(0, int)] * 2, rule.onset_counts
        self._unread, self._equal = np.zeros(2, int), np.zeros(2, int)

    def drive(self, now_ns: int) -> None:
        """Note that the fingers begin to turn, or do so again after a pause in the commands."""
        self._from_ns = now_ns + round(1e9 * STARTS_S)
        self._angles.clear()

    def feed_hand(self, time_ns: int, position_deg: FloatArray) -> None:
        """position_deg: (2,) angles of the axes that close, in the order of the arrays"""
        if time_ns >= self._from_ns:
            self._angles.append((time_ns, np.asarray(position_deg, np.float64)))
        while len(self._angles) > 1 and time_ns - self._angles[1][0] >= self._window_ns:
            self._angles.popleft()

    def feed_frame(self, rise: FloatArray, threshold: float, texels: Sequence[IntArray]) -> None:
        """rise, threshold: (2,) sums above the baseline, and that of a contact [counts]; texels: (rows, columns)
        counts of each array"""
        contact = rise > threshold
        pairs = zip(texels, self._texels, strict=True)
        same = [np.count_nonzero(now) >= LIT_TEXELS and np.array_equal(now, before) for now, before in pairs]
        self._rise, self._texels, self._threshold = rise, list(texels), threshold
        self._unread = np.where(contact, 0, self._unread + 1)
        self._equal = np.where(contact & np.array(same), self._equal + 1, 0)

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """(2,) the fingers that are driven, and hardly turn."""
        since_s = (self._angles[-1][0] - self._angles[0][0]) / 1e9 if self._angles else 0.0
        if 1e9 * since_s < self._window_ns:
            return np.zeros(2, bool)
        turned_deg = self._angles[-1][1] - self._angles[0][1]
        return np.asarray(turned_deg < HELD * self._speed_deg_s * since_s)

    def contradictions(self, fingers: Sequence[int]) -> list[str]:
        """The contradictions now, in words. fingers: names of the two"""
        found = []
        for at, finger in enumerate(fingers):
            if self.held[at] and self._unread[at] >= UNREAD_FRAMES:
                driven = f"finger {finger} is driven, but stays at {self._angles[-1][1][at]:.1f} deg"
                reads = f"its array reads {self._rise[at]:.0f} counts, less than {self._threshold:.0f} of a contact"
                found.append(f"{driven}; {reads}")
            elif self._equal[at] >= REPEATED_FRAMES - 1:
                found.append(f"the array of finger {finger} repeats a frame of {self._rise[at]:.0f} counts")
        return found


def squeeze_events(
    tactile_ns: IntArray, sums: FloatArray, hand_ns: IntArray, closing_deg: FloatArray, rule: EventRule
) -> SqueezeEvents:
    """The events of a recorded squeeze.

    tactile_ns: (n,) times of frames from before the fingers closed; sums: (n, fingers) [counts]
    hand_ns: (m,) times of readings; closing_deg: (m, axes) angles of the axes that close.
    Raises InputError where there are too few frames for a baseline."""
    if len(tactile_ns) <= BASELINE_FRAMES or len(hand_ns) < 2:
        came = f"{len(tactile_ns)} tactile frames and {len(hand_ns)} readings of the hand"
        raise InputError(f"more than {BASELINE_FRAMES} frames and 2 readings", came, "a longer recording")
    onset, still = OnsetDetector(rule), StillDetector(rule)
    for when, frame in zip(tactile_ns, sums, strict=True):
        onset.feed(int(when), frame)
    first_ns = onset.first_ns
    for when, angles in zip(hand_ns, closing_deg, strict=True):
        if first_ns and when >= first_ns:
            still.feed(int(when), angles)
    tactile_s, hand_s = (float(np.median(np.diff(when))) / 1e9 for when in (tactile_ns, hand_ns))
    return SqueezeEvents(
        first_ns=first_ns,
        first_interval_ns=_interval(first_ns, tactile_ns, tactile_s),
        steady_ns=still.steady_ns,
        steady_interval_ns=_interval(still.steady_ns, hand_ns, hand_s),
        finger_ns=np.array(onset.finger_ns, np.int64),
        tactile_period_s=tactile_s,
        hand_period_s=hand_s,
        onset_counts=onset.threshold,
    )


def _interval(event_ns: int, sample_ns: IntArray, period_s: float) -> tuple[int, int]:
    """It was between the neighbouring samples, which may be far apart after losses, and within two sample periods
    otherwise."""
    if not event_ns:
        return 0, 0
    at = int(np.searchsorted(sample_ns, event_ns))
    before, after = int(sample_ns[max(at - 1, 0)]), int(sample_ns[min(at, len(sample_ns) - 1)])
    apart_ns = round(PERIODS * period_s * 1e9)
    return min(before, event_ns - apart_ns), max(after, event_ns + apart_ns)
