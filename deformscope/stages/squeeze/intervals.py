"""Uncertainty of an evaluation: intervals and comparisons over splits that share their trials."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Estimated:
    """A number with its interval."""

    value: float
    interval: Interval


def wilson(share: float, count: float, level: float) -> Interval:
    """Interval of a share that was observed in a number of independent trials (Wilson 1927)."""
    if count <= 0:
        return 0.0, 1.0
    z2 = float(scipy.stats.norm.ppf(0.5 + level / 2)) ** 2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = np.sqrt(z2 * share * (1 - share) / count + (z2 / (2 * count)) ** 2) / (1 + z2 / count)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def share_among_new(expected: Estimated, count: float, level: float, expected_level: float) -> Interval:
    """Interval of a share among a number of new independent trials, with probability `level`. The long-run share has a
    beta distribution with the expected mean, whose deviation is that of its interval of `expected_level`; the observed
    share is beta-binomial."""
    mean = min(max(expected.value, 1e-6), 1.0 - 1e-6)
    half = 0.5 * (expected.interval[1] - expected.interval[0])
    deviation = max(half / float(scipy.stats.norm.ppf(0.5 + expected_level / 2)), 1e-6)
    worth = max(mean * (1.0 - mean) / deviation**2 - 1.0, 1e-3)  # trials that the expectation itself is worth
    whole = max(round(count), 1)
    seen = scipy.stats.betabinom(whole, worth * mean, worth * (1.0 - mean))
    low, high = (float(seen.ppf(share)) / whole for share in (0.5 - level / 2, 0.5 + level / 2))
    return min(low, expected.interval[0]), max(high, expected.interval[1])


def corrected_deviation(values: FloatArray, ratio: float) -> float:
    """Standard deviation of the mean of (J,) values over splits. Splits share trials, so that the variance is that of
    one split times 1 / J + test / train (Nadeau and Bengio 2003, 4). ratio: tested trials over training ones"""
    if len(values) < 2:
        return float("nan")
    return float(np.sqrt((1.0 / len(values) + ratio) * np.var(values, ddof=1)))


def over_splits(values: FloatArray, ratio: float, level: float, worth: float = np.inf) -> Estimated:
    """The mean of values (J,) over splits with its corrected interval, in their unit; of shares see `share_of`.

    worth: effective number of independent trials. The standard deviation has a lower limit: otherwise values that are
    equal in every split would be much more certain than nearly equal ones"""
    found = values[np.isfinite(values)]
    if not found.size:
        return Estimated(float("nan"), (float("nan"), float("nan")))
    mean, deviation = float(found.mean()), float(np.hypot(corrected_deviation(found, ratio), 1.0 / max(worth, 1.0)))
    half = float(scipy.stats.t.ppf(0.5 + level / 2, len(found) - 1)) * deviation if len(found) > 1 else np.nan
    return Estimated(mean, (mean - half, mean + half) if np.isfinite(half) else (mean, mean))


def share_of(values: FloatArray, worth: float, level: float) -> Estimated:
    """The mean of shares (J,) over splits, with the interval of an effective number of independent trials
    (`trials_worth`): both ends of the interval rise with the number of right answers."""
    mean = float(np.mean(values[np.isfinite(values)])) if np.isfinite(values).any() else float("nan")
    return Estimated(mean, wilson(mean, worth, level))


GROUP_CORRELATION = 0.3
"""Expected correlation of the right answers of two trials of a group, before any was seen: a beta distribution that
falls from 0 on. If class means differ between groups by up to three standard deviations of one group's trials, the
estimated correlation is 0 to 0.33."""


def group_correlation(group: IntArray, log_truth: FloatArray) -> float:
    """Correlation of two trials of a group, the mean of its posterior: a one-way analysis of variance (Searle 1992,
    3.5) of the normal scores of `log_truth` (n,), the logarithm of each true class's probability. group: (n,) from 0 on

    It does not use the answers: a correlation estimated from errors would make a result without errors less certain
    than one with a single error."""
    size = np.bincount(group)
    count, total = len(size), len(group)
    if count < 2 or total <= count or not log_truth.max() > log_truth.min():
        return GROUP_CORRELATION
    correlations = (np.arange(50) + 0.5) / 50
    score = scipy.special.ndtri((scipy.stats.rankdata(log_truth) - 0.5) / total)
    mean = np.bincount(group, score) / size
    between = size @ (mean - score.mean()) ** 2 / (count - 1)
    within = max(float(((score - mean[group]) ** 2).sum()) / (total - count), 1e-9)
    alike = (total - float((size**2).sum()) / total) / (count - 1)
    ratio = 1.0 + alike * correlations / (1.0 - correlations)
    found = max(between / within, 1e-9)  # the density of equal means can be infinite
    log = scipy.stats.f.logpdf(found / ratio, count - 1, total - count) - np.log(ratio)
    log += (1.0 / GROUP_CORRELATION - 2.0) * np.log1p(-correlations)
    return float(scipy.special.softmax(log) @ correlations)


def trials_worth(
    size: IntArray, tested: float = 1.0, splits: int = 1, ratio: float = 0.0, correlation: float = GROUP_CORRELATION
) -> float:
    """Effective number of independent trials of some groups, (g,) sizes. The number is lower if trials of a group err
    together (the design effect of Kish 1965, 5.4), and if splits share them (Nadeau and Bengio 2003, 4).

    tested: share of the trials that a split tests; ratio: tested trials over training ones, 0 = one classifier for all;
    correlation: `group_correlation`"""
    total = float(size.sum())
    effect = 1.0 + correlation * (float((size**2).sum()) / max(total, 1.0) - 1.0)
    return total / effect * tested / (1.0 / splits + ratio)


def difference(
    one: FloatArray, other: FloatArray, ratio: float, level: float, worth: float = np.inf
) -> tuple[Estimated, float]:
    """Mean of one - other, (J,) over the same splits, with its interval, and the two-sided p-value of the corrected
    resampled t-test (Nadeau and Bengio 2003). worth: as in `over_splits`"""
    apart = one - other
    apart = apart[np.isfinite(apart)]
    found = over_splits(apart, ratio, level, worth)
    deviation = float(np.hypot(corrected_deviation(apart, ratio), 1.0 / max(worth, 1.0)))
    if not np.isfinite(deviation) or deviation == 0.0:
        return found, 1.0 if found.value == 0.0 or not np.isfinite(deviation) else 0.0
    return found, float(2 * scipy.stats.t.sf(abs(found.value) / deviation, len(apart) - 1))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number (Holm 1979)."""
    order = np.argsort(p_values)
    corrected = np.empty(len(order))
    highest = 0.0
    for rank, index in enumerate(order):
        highest = max(highest, min(1.0, (len(order) - rank) * p_values[index]))
        corrected[index] = highest
    return [float(one) for one in corrected]


# Normality -----------------------------------------------------------------------------------------------------------

LILLIEFORS_DRAWS = 4000
"""Normal samples that a p-value is counted among: 0.05 is then known within 0.004."""


def lilliefors(values: FloatArray) -> tuple[float, float]:
    """Distance of (n,) values from the normal distribution of their mean and deviation, and its p-value. It is the
    Kolmogorov-Smirnov test with mean and deviation of the same sample (Lilliefors 1967).

    NaN for fewer than four values or equal ones."""
    if len(values) < 4 or not np.ptp(values) > 0.0:
        return float("nan"), float("nan")
    found = float(_distance(values[None])[0])
    null = _null_distances(len(values))
    return found, float((1 + (null >= found).sum()) / (1 + len(null)))


@cache
def _null_distances(count: int) -> FloatArray:
    rng = np.random.default_rng(count)
    return np.concatenate([_distance(rng.normal(size=(500, count))) for _ in range(LILLIEFORS_DRAWS // 500)])


def _distance(samples: FloatArray) -> FloatArray:
    """(s,) Kolmogorov-Smirnov distances of (s, n) samples."""
    count = samples.shape[1]
    ordered = np.sort(samples, axis=1)
    mean, deviation = ordered.mean(axis=1, keepdims=True), ordered.std(axis=1, ddof=1, keepdims=True)
    share = scipy.stats.norm.cdf((ordered - mean) / deviation)
    step = np.arange(1, count + 1) / count
    return np.asarray(np.maximum((step - share).max(axis=1), (share - step + 1.0 / count).max(axis=1)))
