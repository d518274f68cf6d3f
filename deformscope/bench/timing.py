"""Clocks, and rows of results: the case, its times, and its reference row."""

import gc
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

SPREAD = 0.2
"""Interquartile range as a share of the median above which a row says that its samples disagree."""

OURS = "deformscope"


@dataclass(frozen=True, slots=True)
class Timing:
    """One run. wall_s: its duration [s]; cpu_s: processor time of all threads of its process [s]."""

    wall_s: float
    cpu_s: float

    def per(self, count: int) -> "Timing":
        """The share of one of `count` equal parts."""
        return Timing(self.wall_s / count, self.cpu_s / count)


@dataclass(frozen=True, slots=True)
class TimingRow:
    """One line of the table.

    case: which part of the bench; what: the case that is measured; who: who ran it; unit: unit of the samples; samples:
    one sample for each round; costs: median over rounds of its cost, divided by the cost of the row that it is compared
    with, None without such a row; beside: its reference row
    facts: other values, by name with their unit; note: a remark for readers"""

    case: str
    what: str
    who: str
    unit: str
    samples: tuple[float, ...]
    costs: float | None = None
    beside: str = ""
    facts: Mapping[str, object] = field(default_factory=dict)
    note: str = ""

    @property
    def median(self) -> float | None:
        return statistics.median(self.samples) if self.samples else None

    @property
    def spread(self) -> float | None:
        """Interquartile range, in the unit of the samples; None for fewer than 3."""
        if len(self.samples) < 3:
            return None
        low, _, high = statistics.quantiles(self.samples, n=4, method="inclusive")
        return high - low

    @property
    def positive(self) -> bool:
        """Whether every sample is one that a clock can give."""
        return all(sample > 0 for sample in self.samples)

    @property
    def doubt(self) -> str:
        """Reason to doubt the row's figure; empty without one."""
        if not self.positive:
            return f"FAILED: a sample of {min(self.samples):.3g} {self.unit} is not positive"
        if self.median and self.spread is not None and self.spread > SPREAD * self.median:
            return f"samples spread by {self.spread / self.median:.0%}"
        return ""

    def plain(self) -> dict[str, object]:
        """The row as in the JSON."""
        return asdict(self) | {
            "median": self.median,
            "iqr": self.spread,
            "repeats": len(self.samples),
            "doubt": self.doubt,
        }


@dataclass(frozen=True, slots=True)
class Contestant:
    """Something that can be run once, on the clock.

    run: runs it once, and returns the time; amount: number of units in one run (steps, candidates)
    beside: its reference; facts: values known before the run; found: values known after the run"""

    what: str
    who: str
    run: Callable[[], Timing]
    unit: str = "ms"
    amount: float = 1.0
    beside: "Contestant | None" = None
    facts: Mapping[str, object] = field(default_factory=dict)
    found: Callable[[], Mapping[str, object]] = dict
    note: str = ""

    def sample(self, timing: Timing) -> float:
        """The table's text of one run."""
        if self.unit.endswith("/s"):
            return self.amount / timing.wall_s
        return timing.wall_s / self.amount * (1e3 if self.unit.startswith("ms") else 1.0)


def clock(work: Callable[[], object]) -> Timing:
    """Run once, and return the time. Its return value is discarded after the clock has stopped."""
    gc.collect()
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    result = work()
    timing = Timing(time.perf_counter() - wall_s, time.process_time() - cpu_s)
    del result
    return timing


def compare(case: str, contestants: Sequence[Contestant], rounds: Callable[[float], int]) -> list[TimingRow]:
    """Every contestant once per round, in turn (A B C A B C...): disturbances of the machine affect all alike. rounds:
    how many, given the seconds of the first; that one only warms up, unless there is no other."""
    began_s = time.perf_counter()
    taken = [[contestant.run()] for contestant in contestants]
    count = rounds(time.perf_counter() - began_s)
    if count > 1:
        taken = [[] for _ in contestants]
    for _ in range(count if count > 1 else 0):
        for timings, contestant in zip(taken, contestants, strict=True):
            timings.append(contestant.run())
    return [_row(case, index, contestants, taken) for index in range(len(contestants))]


def _row(case: str, index: int, contestants: Sequence[Contestant], taken: Sequence[Sequence[Timing]]) -> TimingRow:
    contestant, timings, costs = contestants[index], taken[index], None
    other = contestant.beside
    if other is not None:
        costs = statistics.median(
            (mine.wall_s / contestant.amount) / (theirs.wall_s / other.amount)
            for mine, theirs in zip(timings, taken[contestants.index(other)], strict=True)
        )
    wall_s = sum(timing.wall_s for timing in timings)
    threads = {"threads": round(sum(timing.cpu_s for timing in timings) / wall_s, 2)}
    return TimingRow(
        *(case, contestant.what, contestant.who, contestant.unit, tuple(map(contestant.sample, timings)), costs),
        beside="" if other is None else f"{other.who}: {other.what}",
        facts=threads | dict(contestant.facts) | dict(contestant.found()),
        note=contestant.note,
    )
