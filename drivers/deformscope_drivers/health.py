"""The health of a device: its readings, its losses with reasons, its rate and age."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from deformscope_drivers.clock import ClockRelation
from deformscope_drivers.framing import NOISE, Skipped

# Readings that are missing by time: a device that should send and did not, whatever its own counter says.
#
# A counter restarts after a lost link, wraps in a long pause, or is absent; the host's clock continues. Therefore a
# pause between readings is compared with the rate at which the device sent before it

SHORTEST_PAUSE_S = 0.5
PAUSE_PERIODS = 5.0
"""A pause longer than both is no jitter."""
START_S = 3.0
"""A device that gives its first reading within this time was starting: cameras take a second or two."""
SETTLE_S = 1.0
"""After a pause of a link that held, what waited in a buffer arrives within this time, and is not missing."""
RATE_FROM_S, RATE_OVER_S = 1.0, 10.0
"""The observed rate is known after a stretch of this length; it is that of the latest stretch of about RATE_OVER_S."""


@dataclass(frozen=True, slots=True)
class Missing:
    """silent_s: how long readings were missing [s]; count: how many that is at the device's rate, 0 where unknown"""

    silent_s: float = 0.0
    count: int = 0


@dataclass(slots=True)
class _Pause:
    """A pause in the readings, from the last one before it until it is settled how many are missing.

    got: readings that had come, or were counted as lost, when it began; unlinked: the link was lost meanwhile
    resumed_ns: when readings came again, None = not yet; fewest: the smallest number missing at any time since then"""

    start_ns: int
    got: int
    rate_hz: float
    limit_s: float
    unlinked: bool
    resumed_ns: int | None = None
    fewest: float = math.inf

    def short_of(self, now_ns: int, got: int) -> float:
        """Number of missing readings relative to the rate."""
        return max(0.0, (now_ns - self.start_ns) / 1e9 * self.rate_hz - (got - self.got))

    def cost(self, now_ns: int, got: int) -> tuple[float, float]:
        """(seconds without readings, readings missing) that this pause counts for, until now_ns [ns]."""
        if not self.rate_hz:
            return ((self.resumed_ns or now_ns) - self.start_ns) / 1e9, 0.0
        count = self.short_of(now_ns, got) if self.resumed_ns is None else self.fewest
        if not self.unlinked and count <= self.limit_s * self.rate_hz:
            return 0.0, 0.0
        return count / self.rate_hz, count


class Continuity:
    """Follows when a device's readings arrive, on the host's clock [ns].

    Readings that the device's own counter says are lost (`count_lost`) are not counted here again."""

    def __init__(self) -> None:
        self._set_hz: float | None = 0.0
        self._last_ns: int | None = None
        self._over_ns: int | None = None
        self._received = False
        self._got = self._got_at_last = 0
        self._seen = self._seen_s = 0.0
        self._pause: _Pause | None = None
        self._silent_s = self._missing = 0.0

    def begin(self, now_ns: int) -> None:
        """The device is connected, for the first time or again."""
        self._last_ns = now_ns if self._last_ns is None else self._last_ns

    def expect(self, now_ns: int, rate_hz: float | None) -> None:
        """Expected readings from now on. rate_hz: rate to which the device was set, 0 = unknown; None = no readings
        without request"""
        if rate_hz == self._set_hz:
            return
        if self._set_hz is None or rate_hz is None:
            self._last_ns = None if self._last_ns is None else now_ns
        self._set_hz = rate_hz
        self._seen = self._seen_s = 0.0

    def add(self, now_ns: int) -> None:
        """A reading arrived at now_ns [ns]."""
        before_ns, self._last_ns = self._last_ns, now_ns
        got_before = self._got_at_last
        limit_s = self._limit_s() if self._received else START_S
        self._received = True
        self._got = self._got_at_last = self._got + 1
        if before_ns is None or (self._set_hz is None and self._pause is None):
            return
        length_s = (now_ns - before_ns) / 1e9
        if length_s > limit_s and (self._pause is None or self._pause.resumed_ns is not None):
            self._settle(now_ns)
            self._pause = self._pause_from(before_ns, got_before, unlinked=False)
        pause = self._pause
        if pause is None:
            self._seen = max(0.0, self._seen + (self._got - got_before))
            self._seen_s += length_s
            if self._seen_s > RATE_OVER_S:
                self._seen /= 2.0
                self._seen_s /= 2.0
            return
        if pause.resumed_ns is None:
            pause.resumed_ns = now_ns
        pause.fewest = min(pause.fewest, pause.short_of(now_ns, self._got))
        if pause.unlinked or now_ns - pause.resumed_ns >= SETTLE_S * 1e9:
            self._settle(now_ns)

    def count_lost(self, count: int) -> None:
        """The device's counter shows this number of sent and missing readings; below 0 takes some back."""
        self._got += count

    def lose_link(self, now_ns: int) -> None:
        """Note that the link is lost: readings sent after the last one do not arrive."""
        if self._pause is not None and self._pause.unlinked:
            return
        self._settle(now_ns)
        start_ns = now_ns if self._last_ns is None or self._set_hz is None else self._last_ns
        self._pause = self._pause_from(start_ns, self._got_at_last, unlinked=True)

    def end(self, now_ns: int) -> None:
        """Note that the device is closed: no reading is missing after now_ns [ns]."""
        self._over_ns = now_ns if self._over_ns is None else self._over_ns

    def at(self, now_ns: int) -> Missing:
        """Missing readings up to now, a present pause included."""
        now_ns = now_ns if self._over_ns is None else min(now_ns, self._over_ns)
        costs = [(self._silent_s, self._missing)]
        if self._pause is not None:
            costs.append(self._pause.cost(now_ns, self._got))
        if self._last_ns is not None and self._set_hz is not None and not (self._pause and not self._pause.resumed_ns):
            length_s = (now_ns - self._last_ns) / 1e9
            if length_s > (self._limit_s() if self._received else SHORTEST_PAUSE_S):
                costs.append((length_s, length_s * self._rate_hz()))
        silent_s, missing = map(sum, zip(*costs, strict=True))
        return Missing(silent_s, round(missing))

    # Within ----------------------------------------------------------------------------------------------------------

    def _rate_hz(self) -> float:
        """The observed rate; until enough is observed, the rate that was set; 0 = not known."""
        return self._seen / self._seen_s if self._seen_s >= RATE_FROM_S else self._set_hz or 0.0

    def _limit_s(self) -> float:
        rate_hz = self._rate_hz()
        return max(SHORTEST_PAUSE_S, PAUSE_PERIODS / rate_hz) if rate_hz > 0.0 else math.inf

    def _pause_from(self, start_ns: int, got: int, *, unlinked: bool) -> _Pause:
        return _Pause(start_ns, got, self._rate_hz(), self._limit_s(), unlinked)

    def _settle(self, now_ns: int) -> None:
        if self._pause is not None:
            silent_s, missing = self._pause.cost(now_ns, self._got)
            self._silent_s += silent_s
            self._missing += missing
            self._pause = None


RATE_WINDOW = 512
RATE_SPAN_NS = 5_000_000_000


class Link(StrEnum):
    """The state of a device's link."""

    CLOSED = "closed"
    CONNECTED = "connected"
    LOST = "lost"  # attempts to get it back go on
    FAILED = "failed"  # they do not


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """The link was made, lost, made again or given up. host_ns: when the host noticed [ns]; reason: in words."""

    host_ns: int
    link: Link
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Health:
    """The health of a device at one time.

    link: the state of the connection; reason: why it is so, in words; received: readings since it was opened
    lost: readings that should have come and never did: by the device's counter, or by time
    dropped: readings that came and that a reader was too slow to take, over all readers
    skipped_bytes: bytes that fit no frame; refused: frames refused, by reason (checksum, length...)
    resyncs: stretches of skipped bytes; reconnects: links made again
    rate_hz: readings a second lately, 0 where none; age_s: time since the last reading, None before the first
    stuck: the same reading came again and again, as from a sensor that has died behind a link that lives
    clock: relation of the device's clock to the host's, None without one; extra: what only this kind of device counts
    lost_by_time: how many of the lost ones are estimated from the device's rate and the time of a lost link or of
    silence, where its counter does not show them; silent_s: how long that was [s]
    jitter_s: standard deviation of the time from one reading to the next, lately, as the host stamps them [s]
    alarms: its readings', each as text that begins with `stuck` or `saturated`; set where they are checked"""

    link: Link
    reason: str = ""
    received: int = 0
    lost: int = 0
    dropped: int = 0
    skipped_bytes: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    resyncs: int = 0
    reconnects: int = 0
    rate_hz: float = 0.0
    age_s: float | None = None
    stuck: bool = False
    clock: ClockRelation | None = None
    extra: Mapping[str, float] = field(default_factory=dict)
    lost_by_time: int = 0
    silent_s: float = 0.0
    jitter_s: float = 0.0
    alarms: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity that a connected device reports; empty fields if it reports none."""

    model: str = ""
    serial: str = ""
    firmware: str = ""


@dataclass(frozen=True, slots=True)
class PadLayout:
    """One pad of a tactile sensor. rows, columns: its texels; texel_m: (width, height) size of a texel [m]; index:
    its place among the device's pads; finger: 0 to 2; part: 0 proximal, 1 distal"""

    name: str
    rows: int
    columns: int
    texel_m: tuple[float, float]
    index: int
    finger: int
    part: int


@dataclass(frozen=True, slots=True)
class Description:
    """Properties of an open device's readings.

    rate_hz: rate to which it was set, 0 = not known; channels: channels of a force sensor; torques: whether it measures
    them; pads: layout of a tactile sensor; full_scale_pa: pressure of its largest count [Pa], 0 = not known
    urdf: URDF of an arm, for viewers"""

    rate_hz: float = 0.0
    channels: int = 1
    torques: bool = False
    pads: tuple[PadLayout, ...] = ()
    full_scale_pa: float = 0.0
    urdf: Path | None = None


class Rate:
    """Readings a second, over the last few seconds or the last few hundred readings."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=RATE_WINDOW)

    def add(self, host_ns: int) -> None:
        self._times.append(host_ns)

    def at(self, now_ns: int) -> float:
        """The present rate: it falls when readings stop."""
        while self._times and now_ns - self._times[0] > RATE_SPAN_NS:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        count, span = len(self._times) - 1, self._times[-1] - self._times[0]
        silence = now_ns - self._times[-1]
        if count and silence > 3 * span / count:
            span += silence
        return count / span * 1e9 if span > 0 else 0.0

    @property
    def jitter_s(self) -> float:
        """Standard deviation of the time from one reading to the next [s], 0 before the third."""
        return float(np.diff(self._times).std()) / 1e9 if len(self._times) > 2 else 0.0


class Tally:
    """Counts of a device while it is open; `Health` shows them."""

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0  # by the device's own counter
        self.continuity = Continuity()
        self.dropped = 0
        self.raw_dropped = 0
        self.skipped_bytes = 0
        self.joining_bytes = 0
        self.resyncs = 0
        self.reconnects = 0
        self.refused: dict[str, int] = {}
        self.rate = Rate()
        self._skipping = False
        self._joining = True

    def skip(self, skipped: Skipped) -> None:
        """Bytes that fit no frame; those that follow one another are one resync."""
        self.skipped_bytes += skipped.count
        self.joining_bytes += skipped.count if self._joining else 0
        self.resyncs += not self._skipping
        self._skipping = True
        if skipped.reason != NOISE:
            self.refuse(skipped.reason)

    def receive(self, host_ns: int) -> None:
        """Count a reading that arrived at host_ns [ns]."""
        self.received += 1
        self.rate.add(host_ns)
        self.continuity.add(host_ns)

    def follow_link(self, link: Link, host_ns: int) -> None:
        """The link is in this state from host_ns [ns] on."""
        match link:
            case Link.CONNECTED:
                self.continuity.begin(host_ns)
            case Link.CLOSED:
                self.continuity.end(host_ns)
            case _:
                self.continuity.lose_link(host_ns)
                self._joining = True

    def lose(self, count: int) -> None:
        """Readings that the device's counter says were sent and never came; below 0 takes some back."""
        self.lost += count
        self.continuity.count_lost(count)

    def refuse(self, reason: str) -> None:
        """Count a frame that was refused. reason: reason under which it is counted"""
        self.refused[reason] = self.refused.get(reason, 0) + 1

    def in_sync(self) -> None:
        """A good frame came: bytes that are skipped from now on begin a new loss of synchronization."""
        self._skipping = self._joining = False
