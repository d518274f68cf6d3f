"""Scores of the answers over all splits: accuracy, confusion and calibration, each with its interval; comparisons over
splits that share their trials."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray
from deformscope.results.render import derived, reported
from deformscope.stages.squeeze.table import LabelledTable, Protocol, Split, TextArray
from deformscope.stages.squeeze.trial_run import Answers, Key, Method

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


BINS = 10
"""Bins of the reliability diagram."""


@dataclass(frozen=True, slots=True)
class Reliability:
    """Share of right answers over their probability.

    sure: (B,) mean posterior of the answers in each bin; right: (B,) share that was right; count: (B,) answers over all
    splits; band: (B, 2) within which `right` lies for a perfectly calibrated classifier, at the evaluation's level"""

    sure: FloatArray
    right: FloatArray
    count: IntArray
    band: FloatArray


@dataclass(frozen=True, slots=True)
class ClassificationScore:
    """Score of a method on a modality.

    fusion: none, early (columns joined) or late (posteriors pooled); chance: the no-information rate, of always naming
    the most frequent of the classes that are tested; confusion: (C, C) answers over all splits, row = truth
    trials: (C,) different trials of each class that were tested; worth: how many independent trials these are
    calibration_error: mean distance of posterior and share right, over the bins; overconfidence: mean posterior less
    share right; log_loss: mean
    components: mean number in use; pair: in a transfer, the kinds that trained and were tested; split_accuracy: (J,)"""

    modality: str = field(metadata=reported("modality"))
    method: Method = field(metadata=reported("method"))
    protocol: Protocol | Literal["transfer"] = field(metadata=reported())
    fusion: Literal["none", "early", "late"] = field(metadata=reported())
    accuracy: Estimated = field(metadata=reported("accuracy", interval_key="interval", digits=".1%"))
    balanced: Estimated = field(
        metadata=reported("balanced", "balanced_accuracy", interval_key="balanced_interval", digits=".1%")
    )
    chance: float = field(metadata=reported())
    confusion: IntArray = field(metadata=reported())
    trials: IntArray
    worth: float = field(metadata=reported(key="independent_trials"))
    calibration_error: float = field(metadata=reported("calibration error", digits=".1%"))
    overconfidence: Estimated = field(metadata=reported(interval_key="overconfidence_interval"))
    log_loss: float = field(metadata=reported())
    reliability: Reliability = field(metadata=reported())
    components: float
    level: float = field(metadata=reported())
    pair: tuple[str, str] | None
    split_accuracy: FloatArray

    @property
    @derived("splits", digits=".0f")
    def splits(self) -> int:
        return len(self.split_accuracy)

    @property
    def shares(self) -> FloatArray:
        """(C, C) rows of the confusion as shares; NaN for a class that was never tested."""
        total = self.confusion.sum(axis=1, keepdims=True)
        return np.where(total > 0, self.confusion / np.maximum(total, 1), np.nan)

    def share_interval(self, truth: int, answer: int) -> Interval:
        """Wilson's interval of an entry of `shares`, its trials worth as much as all are on average."""
        count = self.worth * float(self.trials[truth]) / max(int(self.trials.sum()), 1)
        return wilson(float(self.shares[truth, answer]), count, self.level)


def accuracy_of(outcome: Answers, target: IntArray) -> float:
    """Share of the tested trials whose class was named; NaN where none was tested. target: (trials,) true class"""
    return float((outcome.answer == target[outcome.rows]).mean()) if len(outcome.rows) else float("nan")


def recalls(outcome: Answers, target: IntArray, classes: int) -> FloatArray:
    """(C,) share of each class that was named; NaN where none of it was tested."""
    truth = target[outcome.rows]
    tested = np.bincount(truth, minlength=classes)
    right = np.bincount(truth[outcome.answer == truth], minlength=classes)
    return np.where(tested > 0, right / np.maximum(tested, 1), np.nan)


def split_ratio(splits: Sequence[Split]) -> float:
    """Tested trials over training ones, on average."""
    return float(np.mean([len(one.test) / len(one.train) for one in splits]))


def worth_of(
    table: LabelledTable, protocol: Protocol | Literal["transfer"], splits: Sequence[Split], outcomes: Sequence[Answers]
) -> float:
    """Effective number of independent answers; the trials of a group are one cluster if groups are left out."""
    rows, log_truth = (np.concatenate([getattr(one, name) for one in outcomes]) for name in ("rows", "log_truth"))
    tested, at, times = np.unique(rows, return_inverse=True, return_counts=True)
    group = table.group if protocol in ("group", "transfer") else None
    size, correlation = clusters(group, tested, np.bincount(at, log_truth, len(tested)) / times)
    if protocol == "transfer":
        return trials_worth(size, correlation=correlation)
    share = float(np.mean([len(one.rows) for one in outcomes])) / max(len(tested), 1)
    return trials_worth(size, share, len(splits), split_ratio(splits), correlation)


def clusters(group: TextArray | None, rows: IntArray, log_truth: FloatArray) -> tuple[IntArray, float]:
    """(groups,) how many of the trials at rows (n,) are in each group, each one where there are no groups; and
    correlation in these. log_truth: (n,) as in `group_correlation`"""
    at = np.arange(len(rows)) if group is None else np.unique(group[rows], return_inverse=True)[1]
    return np.bincount(at), group_correlation(at, log_truth)


def balanced_worth(worth: float, trials: IntArray) -> float:
    """Number of independent trials of the mean of the classes' shares, which their (C,) numbers of trials weigh
    unequally."""
    share = trials[trials > 0] / max(int(trials.sum()), 1)
    return float(worth * len(share) ** 2 / (1.0 / share).sum()) if len(share) else 0.0


def score_of(
    table: LabelledTable,
    key: Key,
    protocol: Protocol | Literal["transfer"],
    splits: Sequence[Split],
    outcomes: Sequence[Answers],
    level: float,
    pair: tuple[str, str] | None = None,
) -> ClassificationScore:
    """The score from the outcomes of one method on one modality in all splits."""
    target, classes = table.target, len(table.classes)
    accuracy = np.array([accuracy_of(one, target) for one in outcomes])
    recall = np.array([recalls(one, target, classes) for one in outcomes])
    tested = np.unique(np.concatenate([one.rows for one in outcomes]))
    confusion = np.zeros((classes, classes), dtype=np.int64)
    for one in outcomes:
        np.add.at(confusion, (target[one.rows], one.answer), 1)
    with np.errstate(invalid="ignore"):
        balanced = np.array([np.mean(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in recall])
    right = np.concatenate([one.answer == target[one.rows] for one in outcomes])
    worth = worth_of(table, protocol, splits, outcomes)
    sure = np.concatenate([one.sure for one in outcomes])
    log_truth = np.concatenate([one.log_truth for one in outcomes])
    over = np.array([np.mean(one.sure) - accuracy_of(one, target) if len(one.rows) else np.nan for one in outcomes])
    repeats = len(right) / max(len(tested), 1)
    reliability = reliability_of(sure, right, repeats, level)
    filled = reliability.count > 0
    error = np.abs(reliability.sure - reliability.right)[filled] @ reliability.count[filled] / max(len(right), 1)
    modality, method = key
    trials = np.bincount(target[tested], minlength=classes)
    every = trials if protocol == "transfer" else np.bincount(target, minlength=classes)
    frequent = np.where(trials > 0, every, 0)
    return ClassificationScore(
        modality=modality,
        method=method,
        protocol=protocol,
        fusion="late" if method == "late-fusion" else "none" if modality in table.modalities else "early",
        accuracy=share_of(accuracy, worth, level),
        balanced=share_of(balanced, balanced_worth(worth, trials), level),
        chance=float(frequent.max() / max(int(frequent.sum()), 1)),
        confusion=confusion,
        trials=trials,
        worth=worth,
        calibration_error=float(error),
        overconfidence=over_splits(over, split_ratio(splits), level, worth),
        log_loss=float(-log_truth.mean()) if len(log_truth) else float("nan"),
        reliability=reliability,
        components=float(np.mean([one.components for one in outcomes])),
        level=level,
        pair=pair,
        split_accuracy=accuracy,
    )


def reliability_of(sure: FloatArray, right: IntArray, repeats: float, level: float) -> Reliability:
    """sure, right: (n,) probability of every answer, and whether it is right; repeats: how often each trial was
    answered on average."""
    bins = np.minimum((sure * BINS).astype(int), BINS - 1)
    count = np.bincount(bins, minlength=BINS)
    many = np.maximum(count, 1)
    mean = np.where(count > 0, np.bincount(bins, sure, BINS) / many, np.nan)
    share = np.where(count > 0, np.bincount(bins, right.astype(float), BINS) / many, np.nan)
    trials = np.maximum(np.round(count / max(repeats, 1.0)), 1.0)
    low, high = (
        scipy.stats.binom.ppf(tail, trials, np.nan_to_num(mean)) / trials for tail in (0.5 - level / 2, 0.5 + level / 2)
    )
    return Reliability(mean, share, count, np.stack([low, high], axis=1))
