"""Readings that are missing by time: a device that should send and did not, whatever its own counter says.

A counter restarts after a lost link, wraps in a long pause, or is absent; the host's clock continues. Therefore a pause
between readings is compared with the rate at which the device sent before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
