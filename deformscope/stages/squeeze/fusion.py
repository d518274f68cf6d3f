"""Calibrated posteriors, and several modalities together: late fusion (Thesis 2.6, future work).

Everything is fitted on the training side alone: the classifier of a modality, its posteriors' calibration, and the
reliability of each modality for each class. The posteriors that this is learned from are of points left out."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.squeeze import classifiers

MODALITY_DEVIATION, CLASS_DEVIATION, OFFSET_DEVIATION = 1.0, 0.3, 1.0
"""Priors: weights of modalities are normal about 1 (Bayes' rule for modalities with independent errors), those of
classes about their modality's, offsets of classes about 0. With few trials they stay there."""


@dataclass(frozen=True, slots=True)
class Pool:
    """Weighed logarithms of posteriors: log p(c) = sum_m weight[m, c] log p_m(c) + offset[c] + constant.

    weight: (M, C) reliability of modality m for class c, 0 or more; offset: (C,)"""

    weight: FloatArray
    offset: FloatArray

    def log_posterior(self, logs: FloatArray, present: BoolArray) -> FloatArray:
        """(n, C) from (M, n, C) logarithms of posteriors; present: (M, n), a missing modality has no effect."""
        score: FloatArray = np.einsum("mnc,mc->nc", np.where(present[..., None], logs, 0.0), self.weight)
        return classifiers.log_softmax(score + self.offset)


def fit_pool(
    logs: FloatArray, present: BoolArray, target: IntArray, centre: float = 1.0, near: Pool | None = None
) -> Pool:
    """The most probable weights and offsets for (M, n, C) logarithms of posteriors of points left out, (n,) classes.
    centre: centre of the weights before any data; near: where the search begins, default there"""
    modalities, count, classes = logs.shape
    shown = np.where(present[..., None], logs, 0.0)
    row = np.arange(count)

    def loss(parameters: FloatArray) -> tuple[float, FloatArray]:
        weight, offset = parameters[:-classes].reshape(modalities, classes), parameters[-classes:]
        log_posterior = classifiers.log_softmax(np.einsum("mnc,mc->nc", shown, weight) + offset)
        wrong = np.exp(log_posterior)
        wrong[row, target] -= 1.0
        mean = weight.mean(axis=1, keepdims=True)
        penalty = (
            ((weight - mean) ** 2).sum() / CLASS_DEVIATION**2
            + ((mean - centre) ** 2).sum() / MODALITY_DEVIATION**2
            + (offset**2).sum() / OFFSET_DEVIATION**2
        )
        by_weight = np.einsum("mnc,nc->mc", shown, wrong)
        by_weight += (weight - mean) / CLASS_DEVIATION**2 + (mean - centre) / (MODALITY_DEVIATION**2 * classes)
        gradient = np.concatenate([by_weight.ravel(), wrong.sum(axis=0) + offset / OFFSET_DEVIATION**2])
        return float(0.5 * penalty - log_posterior[row, target].sum()), gradient

    near = near or Pool(np.full((modalities, classes), centre), np.zeros(classes))
    start = np.concatenate([near.weight.ravel(), near.offset])
    bounds = [(0.0, None)] * (modalities * classes) + [(None, None)] * classes
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 100, "ftol": 1e-7}).x
    return Pool(found[:-classes].reshape(modalities, classes), found[-classes:])


# One modality --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Member:
    """A classifier of a modality. name: which; columns: number of components that it takes, None = all"""

    name: classifiers.Name
    columns: int | None
    classifier: classifiers.Classifier

    def log_posterior(self, test: FloatArray) -> FloatArray:
        """(m, C) of (m, d) components."""
        return self.classifier.log_posterior(test[:, : self.columns])


@dataclass(frozen=True, slots=True)
class Expert:
    """A modality's classifiers on its components, pooled into one calibrated posterior."""

    members: tuple[Member, ...]
    pool: Pool

    def log_posterior(self, test: FloatArray) -> FloatArray:
        """(m, C) calibrated, of (m, d) components."""
        return everywhere(self.pool, np.stack([one.log_posterior(test) for one in self.members]))


def everywhere(pool: Pool, logs: FloatArray) -> FloatArray:
    """(n, C) pooled posterior from (M, n, C), all present."""
    return pool.log_posterior(logs, np.ones(logs.shape[:2], dtype=bool))


@dataclass(frozen=True, slots=True)
class Fitted:
    """An expert, with its posteriors for its training points when they are left out.

    logs: (n, C) calibrated; known: (n,) whether there was another point, or group, of the class to learn it from"""

    expert: Expert
    logs: FloatArray
    known: BoolArray


def fit_expert(
    points: FloatArray, kept: int, raw: int, target: IntArray, classes: int, apart: IntArray | None, *, seed: int = 0
) -> Fitted:
    """All possible classifiers of a modality, pooled by their posteriors for points left out.

    points: (n, d) components of the training side, the first `kept` of which hold 80 % of the variance; raw: columns
    before the rotation; apart: (n,) groups that are left out together, or None"""
    fold = classifiers.folds_of(target, apart, seed)
    known = np.zeros(len(target), dtype=bool)
    for one in range(classifiers.FOLDS):
        inside = fold == one
        known[inside] = np.isin(target[inside], target[~inside])
    members, said = [], []
    for name in (one for one in classifiers.NAMES if classifiers.usable(one, raw)):
        columns = classifiers.columns_of(name, kept)
        chosen = points[:, :columns]
        fitting = classifiers.fitter(name, chosen, target, classes, fold)
        logs = np.full((len(target), classes), -np.log(classes))
        for one in np.unique(fold):
            inside = fold == one
            if not inside.all():
                logs[inside] = fitting(chosen[~inside], target[~inside], classes).log_posterior(chosen[inside])
        members.append(Member(name, columns, fitting(chosen, target, classes)))
        said.append(logs)
    stacked = np.stack(said)

    def pooled(of: BoolArray, near: Pool | None = None) -> Pool:
        return fit_pool(stacked[:, of], np.ones((len(said), int(of.sum())), bool), target[of], 1.0 / len(said), near)

    pool = pooled(known)
    logs = everywhere(pool, stacked)
    for one in np.unique(fold):
        # The pool that weighs a point has not seen it either: else fusion learns from posteriors surer than new ones.
        if (others := known & (fold != one)).any():
            logs[fold == one] = everywhere(pooled(others, pool), stacked[:, fold == one])
    return Fitted(Expert(tuple(members), pool), logs, known)


# Several modalities --------------------------------------------------------------------------------------------------


def fuse(pool: Pool, logs: FloatArray, present: BoolArray) -> FloatArray:
    """(n, C) fused of (M, n, C) calibrated ones. With one modality, the result is that modality's posterior; with none,
    only the offsets count. present: (M, n) which modalities are present"""
    fused = pool.log_posterior(logs, present)
    alone = present.sum(axis=0) == 1
    if alone.any():
        fused[alone] = logs[present[:, alone].argmax(axis=0), np.flatnonzero(alone)]
    return fused
