"""Statistics of many outcomes: quantities, each declared once for the table and the JSON."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from deformscope.pictures.report import Table
from deformscope.stages.squeeze.scores import wilson

OutcomeT = TypeVar("OutcomeT")
KeyT = TypeVar("KeyT")
GroupT = TypeVar("GroupT")
Row = dict[str, Any]
"""Values by the keys of their quantities, as the JSON has them."""


@dataclass(frozen=True, slots=True)
class Rate:
    """How many of some cases did something; rate: as a share, with its Wilson band at 95 %"""

    cases: int
    hits: int
    rate: float = field(init=False)
    band: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        rate = self.hits / self.cases if self.cases else float("nan")
        object.__setattr__(self, "rate", rate)
        object.__setattr__(self, "band", wilson(rate, self.cases, 0.95))

    @classmethod
    def of(cls, happened: Iterable[object]) -> "Rate":
        """Rate of cases, by whether each did so."""
        hits = [bool(one) for one in happened]
        return cls(len(hits), sum(hits))


@dataclass(frozen=True, slots=True)
class Quantity(Generic[GroupT]):
    """One value of a group, mostly of some outcomes. key: in the JSON; of: computes it; columns: how it is written in
    the table, by heading"""

    key: str
    of: Callable[[GroupT], Any]
    columns: Mapping[str, Callable[[Any], object]] = field(default_factory=dict)


def by(outcomes: Iterable[OutcomeT], key: Callable[[OutcomeT], KeyT]) -> dict[KeyT, list[OutcomeT]]:
    """Outcomes that have the same key, in the order in which the first of them came."""
    groups: dict[KeyT, list[OutcomeT]] = {}
    for one in outcomes:
        groups.setdefault(key(one), []).append(one)
    return groups


def rows(groups: Iterable[GroupT], quantities: Sequence[Quantity[GroupT]]) -> list[Row]:
    """All quantities of each group."""
    return [{one.key: one.of(some) for one in quantities} for some in groups]


def table(
    lines: Sequence[Row], quantities: Sequence[Quantity[Any]], title: str, shown: Mapping[str, str] | None = None
) -> Table:
    """A line for each row. shown: the columns, and their names here; None: all"""
    columns = {name: (one.key, write) for one in quantities for name, write in one.columns.items()}
    names = shown if shown is not None else {name: name for name in columns}
    chosen = [columns[name] for name in names]
    return Table([tuple(write(row[key]) for key, write in chosen) for row in lines], tuple(names.values()), title)


def number(digits: int) -> Callable[[float], str]:
    """Writes a number with this number of digits."""
    return f"{{:.{digits}f}}".format


def percent(digits: int) -> Callable[[float], str]:
    """Writes a share with this number of digits."""
    return f"{{:.{digits}%}}".format


def share(digits: int) -> Callable[[Rate], str]:
    """Writes how often something happened; nothing where it could not."""
    return lambda rate: f"{rate.rate:.{digits}f}" if rate.cases else ""


def band(digits: int) -> Callable[[Rate], str]:
    """Writes the band of a rate."""
    return lambda rate: f"{rate.band[0]:.{digits}f} to {rate.band[1]:.{digits}f}"


def of_cases(rate: Rate) -> str:
    """`3 of 7`"""
    return f"{rate.hits} of {rate.cases}"


def counts(names: Iterable[str]) -> dict[str, int]:
    """Number of each value, in alphabetical order."""
    every = list(names)
    return {name: every.count(name) for name in sorted(set(every))}


# Intervals of several quantities -------------------------------------------------------------------------------------

NEAR = 0.1
LEAST_TRUTH = 1e-2
"""A truth below this has no errors that are shares of it."""


@dataclass(frozen=True, slots=True)
class KnownEstimate:
    """Estimate of one object. kind: kind of object; truth, value, low, high: (q,) numbers of its quantities, nan where
    there is none, infinite where the data leave it open"""

    kind: str
    verdict: str
    truth: tuple[float, ...]
    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def of(
        cls,
        kind: str,
        verdict: str,
        truth: Sequence[float],
        estimates: Iterable[tuple[float, tuple[float, float | None]]],
    ) -> "KnownEstimate":
        """estimates: each quantity's value and interval, without an upper end where the data leave it open"""
        value, interval = zip(*estimates, strict=True)
        high = (np.inf if ends[1] is None else ends[1] for ends in interval)
        return cls(kind, verdict, tuple(truth), tuple(value), tuple(ends[0] for ends in interval), tuple(high))


def interval_rows(outcomes: Sequence[KnownEstimate], names: Sequence[str]) -> list[Row]:
    """Rows of each quantity that has a truth. error: rms share off; near: how many are within NEAR; held: in their
    intervals; width: median, as a share of the truth"""
    truth, value, low, high = (
        np.array([getattr(one, name) for one in outcomes]) for name in ("truth", "value", "low", "high")
    )
    found = []
    for at, name in enumerate(names):
        known = np.isfinite(truth[:, at]) & np.isfinite(value[:, at]) & (np.abs(truth[:, at]) > LEAST_TRUTH)
        if known.any():
            true = truth[known, at]
            off = value[known, at] / true - 1.0
            found.append(
                {
                    "quantity": name,
                    "error": float(np.sqrt(np.mean(off**2))),
                    "near": Rate.of(np.abs(off) < NEAR),
                    "held": Rate.of((low[known, at] <= true) & (true <= high[known, at])),
                    "width": float(np.median((high[known, at] - low[known, at]) / true)),
                }
            )
    return found


def interval_table(lines: Sequence[Row], tried: str, title: str) -> Table:
    """A line a quantity. tried: what was, in the plural"""
    written = [
        (
            *(row["quantity"], row["held"].cases, f"{row['error']:.1%}", share(2)(row["near"])),
            *(f"{share(2)(row['held'])} ({band(2)(row['held'])})", f"{row['width']:.0%}"),
        )
        for row in lines
    ]
    names = ("quantity", tried, "off (rms)", "within 10 %", "held (95 % band)", "width")
    return Table(written, names, f"90 % intervals, {title}")
