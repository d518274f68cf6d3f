"""Intervals, comparisons and normality against published values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from deformscope.stages.squeeze.intervals import (
    Estimated,
    difference,
    holm,
    lilliefors,
    over_splits,
    share_among_new,
    wilson,
)


def test_wilson_is_as_published() -> None:
    # Newcombe 1998, table I, method 3: 81 of 263, 0 of 20 and 1 of 29 at 95 %.
    assert wilson(81 / 263, 263, 0.95) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0.0, 20, 0.95) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(1 / 29, 29, 0.95) == pytest.approx((0.0061, 0.1718), abs=5e-5)


def test_splits_that_share_trials_widen_the_interval() -> None:
    values = np.array([0.7, 0.8, 0.9, 0.8])
    found = over_splits(values, 3 / 7, 0.9)
    # By hand: variance 0.02 / 3, times 1 / 4 + 3 / 7.
    half = stats.t.ppf(0.95, 3) * np.sqrt(0.02 / 3 * (0.25 + 3 / 7))

    assert found.value == pytest.approx(0.8)
    assert found.interval == pytest.approx((0.8 - half, 0.8 + half))


def test_perfect_splits_are_no_surer_than_their_trials() -> None:
    found = over_splits(np.ones(200), 3 / 7, 0.9, trials=50)

    assert found.interval == pytest.approx((wilson(1.0, 50, 0.9)[0], 1.0))
    assert found.interval[0] < 0.96


def test_the_corrected_comparison_is_the_t_test_of_nadeau_and_bengio() -> None:
    one, other = np.array([0.9, 0.8, 0.85, 0.95]), np.array([0.8, 0.75, 0.85, 0.8])
    found, p_value = difference(one, other, 3 / 7, 0.9)
    apart = one - other
    t = apart.mean() / np.sqrt(apart.var(ddof=1) * (1 / 4 + 3 / 7))

    assert found.value == pytest.approx(0.075)
    assert p_value == pytest.approx(2 * stats.t.sf(t, 3))
    assert p_value > stats.ttest_rel(one, other).pvalue
    assert difference(one, one, 3 / 7, 0.9)[1] == 1.0


def test_holm() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_lilliefors_has_the_published_critical_values() -> None:
    """Lilliefors 1967 as recomputed by Molin and Abdi 1998: at 0.05, 0.1920 for n = 20 and 0.1246 for n = 50."""
    for count, critical in ((20, 0.1920), (50, 0.1246)):
        rng = np.random.default_rng(5)
        samples = [rng.normal(3.0, 2.0, size=count) for _ in range(400)]
        found = [lilliefors(one) for one in samples]
        by_table = np.array([distance > critical for distance, _ in found])
        by_p = np.array([p < 0.05 for _, p in found])
        assert (by_table != by_p).mean() < 0.01
        assert 0.02 < by_p.mean() < 0.09


def test_what_is_not_normal_is_recognised() -> None:
    rng = np.random.default_rng(0)

    assert lilliefors(rng.exponential(size=100))[1] < 0.001
    assert np.isnan(lilliefors(np.array([1.0, 2.0, 3.0]))[1])
    assert np.isnan(lilliefors(np.ones(10))[1])


def test_a_share_seen_among_new_trials_scatters_by_the_expectation_and_by_their_number() -> None:
    rng = np.random.default_rng(3)
    expected = Estimated(0.86, (0.83, 0.89))  # a deviation of 0.03 / 1.645
    truth = rng.normal(0.86, 0.03 / 1.645, 20_000)
    for count in (60, 300):
        low, high = share_among_new(expected, count, 0.9, 0.9)
        seen = rng.binomial(count, truth) / count
        assert np.mean((seen >= low) & (seen <= high)) == pytest.approx(0.91, abs=0.025)
        assert high - low > 0.06
    assert share_among_new(expected, 1e6, 0.9, 0.9) == pytest.approx((0.83, 0.89), abs=2e-3)
