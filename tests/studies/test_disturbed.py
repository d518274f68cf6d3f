"""Intervals where data are not as assumed: what is disturbed, and what is counted."""

from __future__ import annotations

import pytest

pytest.importorskip("warp")

from deformscope.studies.coverage import Outcome
from deformscope.studies.disturbed import DisturbedCase, DisturbedOutcome, disturbed_rows, try_disturbed


def test_wrong_tracks_are_counted_against_those_left_out() -> None:
    found = [try_disturbed(DisturbedCase("10 % outliers", number, seed=1000)) for number in range(4)]
    (row,) = disturbed_rows(found)
    assert row.caught.cases > 0
    assert row.caught.rate >= 0.5
    assert row.alarms.hits <= 1
    assert sum(one.disturbed for one in found) == row.caught.cases


def test_rows_count_truths_and_verdicts() -> None:
    def outcome(low: float, high: float, dim: int) -> DisturbedOutcome:
        return DisturbedOutcome(Outcome("a", dim, 3, 20, 0.5, low, (low, high), 0.5, "identified", 0.1), 2, 3, 1)

    (row,) = disturbed_rows([outcome(0.4, 0.6, 2), outcome(0.6, 0.7, 3)])
    assert (row.covered.hits, row.by_dim[2].hits, row.by_dim[3].hits) == (1, 1, 0)
    assert (row.wrong.cases, row.wrong.hits) == (2, 1)
    assert (row.caught.cases, row.caught.hits) == (4, 2)
    assert (row.alarms.cases, row.alarms.hits) == (36, 4)
