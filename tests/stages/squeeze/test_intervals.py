"""Intervals, comparisons and normality against published values."""

import numpy as np
import pytest
from scipy import stats

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.squeeze import scores as intervals


def test_wilson_is_as_published() -> None:
    # Newcombe 1998, table I, method 3: 81 of 263, 0 of 20 and 1 of 29 at 95 %.
    assert intervals.wilson(81 / 263, 263, 0.95) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert intervals.wilson(0.0, 20, 0.95) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert intervals.wilson(1 / 29, 29, 0.95) == pytest.approx((0.0061, 0.1718), abs=5e-5)


def test_splits_that_share_trials_widen_the_interval() -> None:
    found = intervals.over_splits(np.array([0.7, 0.8, 0.9, 0.8]), 3 / 7, 0.9)
    # By hand: variance 0.02 / 3, times 1 / 4 + 3 / 7.
    half = stats.t.ppf(0.95, 3) * np.sqrt(0.02 / 3 * (0.25 + 3 / 7))
    assert found.value == pytest.approx(0.8)
    assert found.interval == pytest.approx((0.8 - half, 0.8 + half))


def test_perfect_splits_are_no_surer_than_their_trials() -> None:
    found = intervals.share_of(np.ones(200), intervals.trials_worth(np.ones(50, int), 0.3, 200, 3 / 7), 0.9)
    assert found.interval == pytest.approx((intervals.wilson(1.0, 50 * 0.3 / (1 / 200 + 3 / 7), 0.9)[0], 1.0))
    assert found.interval[0] < intervals.wilson(1.0, 50, 0.9)[0] < 0.96


def test_trials_are_worth_fewer_by_design_alone() -> None:
    assert intervals.trials_worth(np.ones(200, int)) == 200  # each tested once, by one classifier
    assert intervals.trials_worth(np.full(20, 10)) == pytest.approx(200 / (1 + 9 * intervals.GROUP_CORRELATION))
    assert 20 < intervals.trials_worth(np.full(20, 10)) < 200
    # Splits that share their trials: about as many as train (Nadeau and Bengio 2003), whatever the number of splits.
    assert intervals.trials_worth(np.ones(100, int), 0.3, 10_000, 3 / 7) == pytest.approx(70, abs=0.1)
    assert intervals.trials_worth(np.ones(100, int), 0.3, 2, 3 / 7) < 35
    assert intervals.trials_worth(np.r_[190, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]) < intervals.trials_worth(np.full(10, 20))


@pytest.mark.parametrize("size", [np.ones(48, int), np.full(6, 8), np.array([40, 5, 3])])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.99])
def test_the_more_is_right_the_higher_are_both_ends(size: IntArray, level: float) -> None:
    total = int(size.sum())
    for worth in (intervals.trials_worth(size), intervals.trials_worth(size, 0.3, 200, 3 / 7)):
        ends = np.array([intervals.share_of(np.array([k / total]), worth, level).interval for k in range(total + 1)])
        assert (np.diff(ends, axis=0) > -1e-12).all()
        assert (np.diff(ends[1:-1], axis=0) > 0.0).all()
        np.testing.assert_allclose(ends, 1.0 - ends[::-1, ::-1], atol=1e-12)  # wrong ones count as right ones do
        assert (ends[0, 0], ends[-1, 1]) == pytest.approx((0.0, 1.0))


@pytest.mark.parametrize("rho", [0.03, 0.3, 0.7])
def test_many_groups_show_how_alike_their_trials_are(rho: float) -> None:
    rng, group = np.random.default_rng(5), np.repeat(np.arange(200), 8)
    alike = np.sqrt(rho) * rng.standard_normal(200)[group] + np.sqrt(1.0 - rho) * rng.standard_normal(len(group))
    assert intervals.group_correlation(group, -np.exp(-alike)) == pytest.approx(rho, abs=0.05)  # ranks alone count


def test_the_correlation_is_the_mean_of_its_posterior() -> None:
    """By drawing: correlations before any trial, whose trials differ between groups as much as these."""
    rng, group = np.random.default_rng(6), np.repeat(np.arange(4), 6)
    before = rng.beta(1.0, 1.0 / intervals.GROUP_CORRELATION - 1.0, 200_000)
    own = np.sqrt(1.0 - before)[:, None, None] * rng.standard_normal((len(before), 4, 6))
    drawn = np.sqrt(before)[:, None, None] * rng.standard_normal((len(before), 4, 1)) + own
    ratio = 6.0 * drawn.mean(axis=2).var(axis=1, ddof=1) / drawn.var(axis=2, ddof=1).mean(axis=1)
    score = stats.norm.ppf((np.arange(24) + 0.5) / 24)[rng.permutation(24)]
    seen = 6.0 * score.reshape(4, 6).mean(axis=1).var(ddof=1) / score.reshape(4, 6).var(axis=1, ddof=1).mean()
    same = np.abs(ratio / seen - 1.0) < 0.05
    assert same.sum() > 1000
    assert intervals.group_correlation(group, score) == pytest.approx(before[same].mean(), abs=0.015)


def test_without_a_difference_or_a_second_group_the_correlation_is_the_expected_one() -> None:
    for group, log_truth in (
        (np.repeat([0, 1, 2], 5), np.zeros(15)),
        (np.zeros(15, int), np.arange(15.0)),
        (np.arange(15), np.arange(15.0)),
    ):
        assert intervals.group_correlation(group, log_truth) == intervals.GROUP_CORRELATION
    assert intervals.group_correlation(np.repeat([0, 1, 2], 2), np.repeat([0.0, 1.0, 2.0], 2)) > 0.5


def test_two_groups_with_equal_means_are_hardly_alike() -> None:
    """The density of no difference between two groups is infinite; a true class may have the probability 0."""
    group = np.repeat([0, 1], 4)
    for log_truth in (np.tile([1.0, 2.0, 3.0, 4.0], 2), np.tile([-np.inf, -np.inf, 3.0, 4.0], 2)):
        assert 0.0 <= intervals.group_correlation(group, log_truth) < intervals.GROUP_CORRELATION


@pytest.mark.parametrize("apart", [0.0, 1.0, 3.0])
def test_new_groups_are_known_as_well_as_the_interval_says(apart: float) -> None:
    """Two classes whose means differ from group to group: the interval of 90 % holds what new groups give, also where
    these differ by more than trials of one group."""
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(60):
        group, target, x = _grouped(rng, 10, apart)
        _, new_target, new = _grouped(rng, 150, apart)
        seen, true = [], []
        margin, times = np.zeros(len(group)), np.zeros(len(group))
        for split in range(20):
            test = np.isin(group, rng.permutation(10)[:3])
            means = np.stack([x[~test & (target == one)].mean(axis=0) for one in (0, 1)])
            away = ((x[test, None] - means) ** 2).sum(axis=-1)
            margin[test] += np.diff(away, axis=1)[:, 0] * (1 - 2 * target[test])
            times += test
            seen.append(float((_nearest(means, x[test]) == target[test]).mean()))
            if split % 5 == 0:
                true.append(float((_nearest(means, new) == new_target).mean()))
        correlation = intervals.group_correlation(group, margin / np.maximum(times, 1.0))
        worth = intervals.trials_worth(np.full(10, 20), 0.3, 20, 3 / 7, correlation)
        low, high = intervals.share_of(np.array(seen), worth, 0.9).interval
        held += low <= np.mean(true) <= high
    assert held >= 48  # 90 % less 2.6 binomial deviations


def _grouped(rng: np.random.Generator, groups: int, apart: float) -> tuple[IntArray, IntArray, FloatArray]:
    group, target = np.repeat(np.arange(groups), 20), np.tile([0, 1], 10 * groups)
    mean = rng.normal(size=(groups, 2, 5)) * apart
    mean[:, 1, 0] += 2.5 + apart
    return group, target, mean[group, target] + rng.normal(size=(len(group), 5))


def _nearest(means: FloatArray, x: FloatArray) -> IntArray:
    return np.asarray(((x[:, None] - means) ** 2).sum(axis=-1).argmin(axis=1))


def test_the_corrected_comparison_is_the_t_test_of_nadeau_and_bengio() -> None:
    one, other = np.array([0.9, 0.8, 0.85, 0.95]), np.array([0.8, 0.75, 0.85, 0.8])
    found, p_value = intervals.difference(one, other, 3 / 7, 0.9)
    apart = one - other
    t = apart.mean() / np.sqrt(apart.var(ddof=1) * (1 / 4 + 3 / 7))
    assert found.value == pytest.approx(0.075)
    assert p_value == pytest.approx(2 * stats.t.sf(t, 3))
    assert p_value > stats.ttest_rel(one, other).pvalue
    assert intervals.difference(one, one, 3 / 7, 0.9)[1] == 1.0


def test_holm() -> None:
    assert intervals.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_lilliefors_has_the_published_critical_values() -> None:
    """Lilliefors 1967 as recomputed by Molin and Abdi 1998: at 0.05, 0.1920 for n = 20 and 0.1246 for n = 50."""
    for count, critical in ((20, 0.1920), (50, 0.1246)):
        rng = np.random.default_rng(5)
        samples = [rng.normal(3.0, 2.0, size=count) for _ in range(400)]
        found = [intervals.lilliefors(one) for one in samples]
        by_table = np.array([distance > critical for distance, _ in found])
        by_p = np.array([p < 0.05 for _, p in found])
        assert (by_table != by_p).mean() < 0.01
        assert 0.02 < by_p.mean() < 0.09


def test_what_is_not_normal_is_recognised() -> None:
    assert intervals.lilliefors(np.random.default_rng(0).exponential(size=100))[1] < 0.001
    assert np.isnan(intervals.lilliefors(np.array([1.0, 2.0, 3.0]))[1])
    assert np.isnan(intervals.lilliefors(np.ones(10))[1])
