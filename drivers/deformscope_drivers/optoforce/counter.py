"""Losses by the counter that every reading carries: a u16 that wraps, whose unit is not documented.

The counter may count readings, or the DAQ's samples at 1 kHz, so that its usual step is learned from the stream."""

from collections import Counter
from dataclasses import dataclass
from enum import Enum

WRAP = 0x10000
LEARNED_FROM = 8
"""Number of steps from which the usual one is estimated, and after which a new usual one is accepted."""
LATE_STEPS = 16
"""Largest delay of a reading that others overtook."""
JITTER_NS = 250_000_000
"""Largest variation of a reading's arrival; a counter that is further ahead of the host's clock has jumped."""
ANCHOR_NS = 10_000_000_000
"""Period of comparing the clocks, so that their drift does not matter."""


class CounterStep(Enum):
    """The interpretation of a reading's counter."""

    FIRST = "first"
    NEXT = "next"
    LOST = "lost"  # readings before this one are missing
    REPEATED = "repeated"
    LATE = "late"  # overtaken by readings that came before it
    JUMPED = "jumped"  # further than time allows; the next reading shows whether the device restarted
    RESTARTED = "restarted"  # the reading before this one was the first after a restart
    CORRECTED = "corrected"  # the counter of the reading before this one was damaged; nothing was lost there


@dataclass(frozen=True, slots=True)
class Gap:
    """Gap between a reading and the one before it.

    lost: number of missing readings; negative for readings that were counted as missing before and were not (the sum
    over a stream is its loss). While the step is learned it is 0; the reading that completes the learning carries what
    was lost meanwhile."""

    verdict: CounterStep
    lost: int = 0


_NEXT = Gap(CounterStep.NEXT)


class CounterTrack:
    """Follows the counter of a stream.

    step: the usual step between readings, None while it is learned
    lost, late, repeated, damaged, restarts: how many there were

    period_ns: time between readings, by which a restart is distinguished from a loss; None = unknown: then a counter
    that goes back has restarted. If both are possible, it counts as a loss. A pause in which the counter goes once
    round and more is not distinguished from a shorter one."""

    def __init__(self, period_ns: float | None = None) -> None:
        self.lost = self.late = self.repeated = self.damaged = self.restarts = 0
        self.restart(period_ns)

    def restart(self, period_ns: float | None) -> None:
        """Restart, and estimate the step again; the totals continue."""
        self.step: int | None = None
        self._period_ns = period_ns
        self._last: int | None = None
        self._learned_from: list[int] = []
        self._doubted: _Doubted | None = None
        self._other = _Run()
        self._anchor = (0, 0)
        self._ticks = 0

    def follow(self, counter: int, host_ns: int, *, twin: bool = False) -> Gap:
        """Interpretation of the next reading's counter.

        host_ns: its arrival on the host's clock [ns]; twin: the whole reading equals the one before, which was then
        sent twice; a damaged counter may equal the one before, but the rest would differ"""
        last, self._last = self._last, counter
        if last is None:
            return Gap(CounterStep.FIRST)
        step = (counter - last) % WRAP
        if twin and step == 0:
            self.repeated += 1
            return Gap(CounterStep.REPEATED)
        if self.step is None:
            return self._learn(step, host_ns)
        if step == self.step:
            return self._usual(step, host_ns)
        return self._unusual(last, counter, step, self.step, host_ns)

    def _learn(self, step: int, host_ns: int) -> Gap:
        if step == 0:
            self.repeated += 1
            return Gap(CounterStep.REPEATED)
        self._learned_from.append(step)
        if len(self._learned_from) < LEARNED_FROM:
            return _NEXT
        often = Counter(self._learned_from)
        usual = max(often, key=lambda seen: (often[seen], -seen))
        span = sum(self._learned_from) % WRAP  # of all steps together: a damaged counter between them does not matter
        lost = max(0, round(span / usual) - LEARNED_FROM) if span < WRAP // 2 else 0
        self.step = usual
        self.lost += lost
        self._learned_from = []
        self._anchor = (host_ns, self._ticks)
        return Gap(CounterStep.LOST if lost else CounterStep.NEXT, lost)

    def _usual(self, step: int, host_ns: int) -> Gap:
        doubted, self._doubted = self._doubted, None
        self._other = _Run()
        if doubted is not None and doubted.verdict is CounterStep.JUMPED:
            self.restarts += 1
            self._anchor = (host_ns, self._ticks)
            return Gap(CounterStep.RESTARTED)
        self._ticks += step
        if self._period_ns is not None:
            ahead_ns = self._ahead_ns(0, host_ns)
            stalled = ahead_ns < -JITTER_NS
            if ahead_ns > 0 or (not stalled and host_ns - self._anchor[0] > ANCHOR_NS):
                self._anchor = (host_ns, self._ticks)
        return _NEXT

    def _unusual(self, last: int, counter: int, step: int, usual: int, host_ns: int) -> Gap:
        if step and self._other.again(step) == LEARNED_FROM:
            gap = Gap(CounterStep.NEXT, -self._other.lost)
            self.lost += gap.lost
            self.step = step
            self._anchor = (host_ns, self._ticks)
            self._doubted = None
            return gap
        gap = self._judge(step, usual, host_ns)
        doubted = self._doubted
        if doubted is not None:
            jumped = CounterStep.JUMPED in (doubted.verdict, gap.verdict)
            since = (counter - doubted.base) % WRAP
            if since == 2 * usual or (jumped and 2 * usual < since <= LATE_STEPS * usual):
                return self._correct(doubted, since, usual)
            if doubted.verdict is CounterStep.JUMPED and gap.verdict is CounterStep.LOST:
                self.restarts += 1
                self.restart(self._period_ns)
                self._last = counter
                return Gap(CounterStep.RESTARTED)
        self._count(gap)
        if gap.verdict in (CounterStep.LATE, CounterStep.REPEATED):
            self._last = last
        self._doubted = _Doubted(last, gap.verdict, gap.lost)
        if gap.verdict is CounterStep.LOST:
            self._other.lost += gap.lost
            self._ticks += (gap.lost + 1) * usual
        return gap

    def _judge(self, step: int, usual: int, host_ns: int) -> Gap:
        if step == 0:
            return Gap(CounterStep.REPEATED)
        if WRAP - step <= LATE_STEPS * usual:
            return Gap(CounterStep.LATE, -1 if self.lost else 0)
        if self._period_ns is None:
            return Gap(CounterStep.JUMPED) if step >= WRAP // 2 else Gap(CounterStep.LOST, _missing(step, usual))
        if self._ahead_ns(step, host_ns) > JITTER_NS:
            return Gap(CounterStep.JUMPED)
        return Gap(CounterStep.LOST, _missing(step, usual))

    def _count(self, gap: Gap, times: int = 1) -> None:
        self.lost += times * gap.lost
        self.late += times * (gap.verdict is CounterStep.LATE)
        self.repeated += times * (gap.verdict is CounterStep.REPEATED)

    def _correct(self, doubted: "_Doubted", since: int, usual: int) -> Gap:
        """The counter of the reading before was damaged, and its interpretation wrong."""
        self._count(Gap(doubted.verdict, doubted.lost), times=-1)
        if doubted.verdict is CounterStep.LOST:
            self._ticks -= (doubted.lost + 1) * usual
        missing = _missing(since, usual) - 1
        self.damaged += 1
        self.lost += missing
        self._ticks += since
        self._doubted = None
        return Gap(CounterStep.CORRECTED, missing - doubted.lost)

    def _ahead_ns(self, step: int, host_ns: int) -> float:
        """By how much the counter would be ahead of the host's clock."""
        assert self._period_ns is not None
        assert self.step is not None
        anchor_ns, anchor_ticks = self._anchor
        return (self._ticks + step - anchor_ticks) * self._period_ns / self.step - (host_ns - anchor_ns)


@dataclass(slots=True)
class _Doubted:
    """The reading before, with an unusual step.

    base: the counter of the one before it; verdict and lost: its interpretation"""

    base: int
    verdict: CounterStep
    lost: int


@dataclass(slots=True)
class _Run:
    """The same unusual step again and again: the device's rate has changed, and nothing was lost."""

    step: int = 0
    length: int = 0
    lost: int = 0

    def again(self, step: int) -> int:
        """Number of successive occurrences of this step between counters, this time included."""
        if step != self.step:
            self.step, self.length, self.lost = step, 0, 0
        self.length += 1
        return self.length


def _missing(step: int, usual: int) -> int:
    return max(0, round(step / usual) - 1)
