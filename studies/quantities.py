"""How far off several estimated quantities are, and how often their intervals hold the truth: a row for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from studies.random_bodies import Rate

NEAR = 0.1
LEAST_TRUTH = 1e-2
"""A truth below this has no errors that are shares of it."""


class QuantityOutcome(Protocol):
    """Of one try. truth, value, low, high: (q,) of its quantities, nan where there is none"""

    @property
    def truth(self) -> tuple[float, ...]: ...

    @property
    def value(self) -> tuple[float, ...]: ...

    @property
    def low(self) -> tuple[float, ...]: ...

    @property
    def high(self) -> tuple[float, ...]: ...


@dataclass(frozen=True, slots=True)
class QuantityRow:
    """Of one quantity. error: rms share off; near: how many are within NEAR; held: in their intervals; width: median,
    as a share of the truth"""

    quantity: str
    error: float
    near: Rate
    held: Rate
    width: float


def quantity_rows(outcomes: Sequence[QuantityOutcome], quantities: Sequence[str]) -> tuple[QuantityRow, ...]:
    """A row for each quantity that has a truth."""
    truth, value, low, high = (
        np.array([getattr(one, name) for one in outcomes]) for name in ("truth", "value", "low", "high")
    )
    rows = []
    for at, quantity in enumerate(quantities):
        known = np.isfinite(truth[:, at]) & np.isfinite(value[:, at]) & (np.abs(truth[:, at]) > LEAST_TRUTH)
        if not known.any():
            continue
        true = truth[known, at]
        off = value[known, at] / true - 1.0
        count = int(known.sum())
        held = int(((low[known, at] <= true) & (true <= high[known, at])).sum())
        rows.append(
            QuantityRow(
                quantity,
                float(np.sqrt(np.mean(off**2))),
                Rate(count, int((np.abs(off) < NEAR).sum())),
                Rate(count, held),
                float(np.median((high[known, at] - low[known, at]) / true)),
            )
        )
    return tuple(rows)
