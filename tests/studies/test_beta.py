"""Intervals where data are not as assumed: what is disturbed, and what is counted."""

import pytest

from studies.beta import DisturbedCase, DisturbedOutcome, disturbed_rows, try_disturbed
from studies.random_bodies import Outcome
from studies.theta import SIDES, try_setting


@pytest.mark.slow
def test_wrong_tracks_are_counted_against_those_left_out() -> None:
    found = [try_disturbed(DisturbedCase("10 % outliers", number, seed=1000)) for number in range(4)]
    (row,) = disturbed_rows(found)
    assert row["caught"].cases > 0
    assert row["caught"].rate >= 0.5
    assert row["alarms"].hits <= 1
    assert sum(one.disturbed for one in found) == row["caught"].cases


def test_a_held_particle_that_is_off_is_counted() -> None:
    found = try_disturbed(DisturbedCase("a held particle off by .3 cell", 0, seed=1000))
    assert (found.disturbed, found.found, found.both) == (1, 1, 1)
    assert found.outcome.codes == ("held-off",)


@pytest.mark.slow
def test_theta_at_another_depth_is_compared_with_the_one_found_there() -> None:
    found = try_setting(DisturbedCase("another depth", 1, 1000, "theta")).outcome
    assert found.particles in [side**3 for side in SIDES]
    assert abs(found.beta - found.value) < 0.1
    assert "setting" in found.codes


def test_rows_count_truths_and_verdicts() -> None:
    def outcome(low: float, high: float, dim: int) -> DisturbedOutcome:
        return DisturbedOutcome(
            Outcome("a", dim, 3, 20, 0.5, low, (low, high), 0.5, "identified", 0.1, ("setting",)), 2, 3, 1, (0.1, 0.2)
        )

    (row,) = disturbed_rows([outcome(0.4, 0.6, 2), outcome(0.6, 0.7, 3)])
    assert (row["covered"].hits, row["covered_2d"].hits, row["covered_3d"].hits) == (1, 1, 0)
    assert (row["wrong"].cases, row["wrong"].hits) == (2, 1)
    assert (row["caught"].cases, row["caught"].hits) == (4, 2)
    assert (row["reasons"]["setting"].cases, row["reasons"]["setting"].hits) == (2, 2)
    assert (row["alarms"].cases, row["alarms"].hits) == (36, 4)
    assert row["over_oracle"] == pytest.approx([1.5, 0.75])
