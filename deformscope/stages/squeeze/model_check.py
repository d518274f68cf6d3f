"""Whether a trained classifier keeps its promise on labelled trials that it has never seen."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.results.declared import derived, reported
from deformscope.stages.squeeze import scores
from deformscope.stages.squeeze.groupings import trained_on
from deformscope.stages.squeeze.model import ContentModel
from deformscope.stages.squeeze.table import LabelledTable
from deformscope.stages.squeeze.trial_run import joined_name

DRAWS = 4000
"""Perfectly calibrated classifiers that are drawn: a share of 0.1 is then known within 0.01."""


DRIFTED = 1.0
"""A feature whose mean is off by more than this many deviations of the training trials has drifted."""


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """labels: the model's C contents; score: score of all its modalities; alone: score of each modality alone

    promised: accuracy with its interval that the model carries, None = none
    expected: interval of the accuracy of this number of independent trials, if the promise is right
    inside: how many bins of the reliability diagram are inside the band, and how many have answers
    calibrated: share of perfectly calibrated classifiers with the same posteriors that stray as far or farther
    trained: number of the trials that trained the model: these do not test it
    drifted: features by modality and column, and by how many deviations of the training trials their means are off, the
    farthest first"""

    labels: tuple[str, ...]
    score: scores.ClassificationScore
    alone: Mapping[str, scores.ClassificationScore]
    promised: scores.Estimated | None = field(metadata=reported(interval_key="promised_interval"))
    expected: scores.Interval | None = field(metadata=reported(key="expected_interval"))
    inside: tuple[int, int]
    calibrated: float = field(metadata=reported(key="calibrated_p"))
    trained: int = field(default=0, metadata=reported(key="trained_on"))
    drifted: Mapping[str, float] = field(default_factory=dict, metadata=reported())

    @property
    @derived(key="promise_kept")
    def kept(self) -> bool | None:
        """Whether the accuracy is within the interval of this number of trials, if the promise is right; None without
        one, and if trials trained the model."""
        if self.expected is None or self.trained:
            return None
        return self.expected[0] <= self.score.accuracy.value <= self.expected[1]

    @property
    def calibration_kept(self) -> bool:
        """Whether the reliability diagram, as a whole, lies where a perfectly calibrated classifier's would."""
        return self.calibrated >= 1.0 - self.score.level


def check_model(model: ContentModel, table: LabelledTable, *, level: float = 0.9, seed: int = 0) -> ModelCheck:
    """Evaluation of a model on a table of new trials. Raises InputError for labels and columns that the model does not
    have, and for missing modalities."""
    if unknown := [one for one in table.classes if one not in model.labels]:
        came = ", ".join(map(repr, unknown))
        raise InputError(f"labels out of {', '.join(model.labels)}", came, "--merge, or relabel")
    features = {name: table.modalities[name] for name in model.modalities if name in table.modalities}
    if model.settings and table.settings and model.settings != table.settings:
        wanted = "features computed as those that the model was trained on"
        raise InputError(wanted, "others", "the same [hand] section")
    rows = np.flatnonzero(~np.all([np.isnan(values).all(axis=1) for values in features.values()], axis=0))
    if not features or not len(rows):
        raise InputError(f"features of {' or '.join(model.modalities)}", "none")
    posterior = model.predict_proba({name: values[rows] for name, values in features.items()})
    score = score_of(model, table, posterior, rows, tuple(features), level)
    alone = {}
    for name, values in features.items() if len(features) > 1 else ():
        own = np.flatnonzero(~np.isnan(values).all(axis=1))
        if len(own):
            alone[name] = score_of(model, table, model.predict_proba({name: values[own]}), own, (name,), level)
    found = score.reliability
    filled = found.count > 0
    within = (found.right >= found.band[:, 0]) & (found.right <= found.band[:, 1])
    bins = int((within & filled).sum()), int(filled.sum())
    promised = expected = None
    value, interval = model.promised.get("accuracy"), model.promised.get("interval")
    if isinstance(value, float | int) and isinstance(interval, Sequence):
        low, high = map(float, interval)
        promised = scores.Estimated(float(value), (low, high))
        stated = model.promised.get("level", level)
        expected = scores.share_among_new(
            promised, score.worth, level, float(stated) if isinstance(stated, float) else level
        )
    calibrated = _calibrated(posterior, score, seed)
    trained = int(trained_on(table, model.seen)[rows].sum())
    return ModelCheck(
        model.labels, score, alone, promised, expected, bins, calibrated, trained, _drifted(model, features)
    )


def _drifted(model: ContentModel, features: Mapping[str, FloatArray]) -> dict[str, float]:
    """See `ModelCheck.drifted`; features: (n, p) by modality"""
    found: dict[str, float] = {}
    for name, values in features.items():
        scaling = model.modalities[name].scaling
        known = values[~np.isnan(values).all(axis=1)]
        off = scaling.apply(known).sum(axis=0) / max(len(known), 1)
        found |= {f"{name}[{column}]": float(by) for column, by in zip(np.flatnonzero(scaling.used), off, strict=True)}
    far = sorted(found, key=lambda name: -abs(found[name]))
    return {name: found[name] for name in far if abs(found[name]) > DRIFTED}


def targets(model: ContentModel, table: LabelledTable, rows: IntArray) -> IntArray:
    """(n,) index of each label among those of the model."""
    return np.array([model.labels.index(one) for one in table.label[rows]])


def score_of(
    model: ContentModel,
    table: LabelledTable,
    posterior: FloatArray,
    rows: IntArray,
    names: tuple[str, ...],
    level: float,
) -> scores.ClassificationScore:
    """The score as that of an evaluation, for trials that each were answered once. posterior: (n, classes); rows: (n,)
    indices of these trials in the table"""
    target = targets(model, table, rows)
    answer = posterior.argmax(axis=1)
    right, sure = answer == target, posterior.max(axis=1)
    classes = len(model.labels)
    confusion = np.zeros((classes, classes), dtype=np.int64)
    np.add.at(confusion, (target, answer), 1)
    trials = confusion.sum(axis=1)
    seen = trials > 0
    recall = np.diagonal(confusion)[seen] / trials[seen]
    log_truth = np.log(posterior[np.arange(len(rows)), target])
    size, correlation = scores.clusters(table.group, rows, log_truth)
    worth = scores.trials_worth(size, correlation=correlation)
    reliability = scores.reliability_of(sure, right, 1.0, level)
    filled = reliability.count > 0
    error = np.abs(reliability.sure - reliability.right)[filled] @ reliability.count[filled] / len(rows)
    over = float(sure.mean() - right.mean())
    accuracy, balanced = float(right.mean()), float(recall.mean())
    spread = np.hypot((sure - right).std() / np.sqrt(len(rows)), 1.0 / worth)
    half = float(scipy.stats.norm.ppf(0.5 + level / 2) * spread)
    return scores.ClassificationScore(
        modality=joined_name(names),
        method="late-fusion" if len(names) > 1 else "pooled",
        protocol="new",
        fusion="late" if len(names) > 1 else "none",
        accuracy=scores.Estimated(accuracy, scores.wilson(accuracy, worth, level)),
        balanced=scores.Estimated(balanced, scores.wilson(balanced, scores.balanced_worth(worth, trials), level)),
        chance=float(trials.max() / len(rows)),
        confusion=confusion,
        trials=trials,
        worth=worth,
        calibration_error=float(error),
        overconfidence=scores.Estimated(over, (over - half, over + half)),
        log_loss=float(-log_truth.mean()),
        reliability=reliability,
        components=float("nan"),
        level=level,
        pair=None,
        split_accuracy=np.array([accuracy]),
    )


def _calibrated(posterior: FloatArray, score: scores.ClassificationScore, seed: int) -> float:
    """p-value of the calibration of a posterior (n, classes). Answers are drawn that are right as often as their
    posteriors say. The distance from the diagonal is the sum over the bins of (right - expected)^2 over its
    variance."""
    sure = posterior.max(axis=1)
    bins = len(score.reliability.count)
    place = np.minimum((sure * bins).astype(int), bins - 1)
    variance = np.maximum(np.bincount(place, sure * (1.0 - sure), bins), 1e-12)
    expected = np.bincount(place, sure, bins)
    count = score.reliability.count
    found = np.where(count > 0, np.nan_to_num(score.reliability.right) * count, 0.0)
    random = np.random.default_rng([seed, 0xCA])
    drawn = np.stack([np.bincount(place, random.random(len(sure)) < sure, bins) for _ in range(DRAWS)])
    away = ((drawn - expected) ** 2 / variance).sum(axis=1)
    return float((1 + (away >= ((found - expected) ** 2 / variance).sum() - 1e-9).sum()) / (1 + DRAWS))
