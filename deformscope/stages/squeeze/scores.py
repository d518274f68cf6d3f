"""Scores of the answers over all splits: accuracy, confusion and calibration, each with its interval."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray
from deformscope.results.declared import derived, reported
from deformscope.stages.squeeze import intervals
from deformscope.stages.squeeze.intervals import Estimated, Interval, over_splits, share_of, trials_worth, wilson
from deformscope.stages.squeeze.splits import Protocol, Split
from deformscope.stages.squeeze.table import LabelledTable, TextArray
from deformscope.stages.squeeze.trial_run import Answers, Key, Method

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
    protocol: Protocol | Literal["transfer", "new"] = field(metadata=reported())
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
    return np.bincount(at), intervals.group_correlation(at, log_truth)


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
