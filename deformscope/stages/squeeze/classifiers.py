"""Classifiers with probabilities: nearest neighbours and quadratic discriminant analysis (Thesis 2.4.3), and a linear
one.

Each is fitted to (n, d) points and (n,) indices of classes, is a frozen set of arrays, and gives (m, C) logarithms of
posteriors. A class without any training point is never the answer. scikit-learn's discriminant analyses are not used:
with the share of the unit matrix found by cross-validation they are less often right (`qda`, `qda-raw`) or surer of
wrong answers (`linear`), at 100 times the time (docs/results/containers.md).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from scipy.linalg.lapack import dtrtrs

from deformscope.arrays import BoolArray, FloatArray, IntArray

LEAST = float(np.log(1e-9))
"""The logarithm of the smallest posterior."""
NEIGHBOURS = {3: 3, 5: 5}
"""Neighbours by the number of classes (Thesis 2.5.3)."""
NEIGHBOURS_TRIED: tuple[int, ...] = (1, 3, 5, 7, 9)
"""Numbers of neighbours that are tried for other numbers of classes: the best on training points left out is used."""
FOLDS = 5
"""Folds of the training side, which measure a classifier on points left out."""
LINEAR_COMPONENTS = 200
"""Largest components that the linear classifier and the raw quadratic one take."""

SHARES = (0.001, 0.01, 0.03, 0.1, 0.2, 0.4, 0.7, 1.0)
"""Tried shares of the unit matrix in the linear classifier's covariance."""

Name = Literal["knn", "qda", "qda-raw", "linear"]
NAMES: tuple[Name, ...] = ("knn", "qda", "qda-raw", "linear")
"""knn and qda use the components that hold 80 % of the variance; the others use all components."""


@dataclass(frozen=True, slots=True)
class Neighbours:
    """k nearest neighbours (eq. 2.2, 2.3). points: (n, d); target: (n,); k; classes: C"""

    points: FloatArray
    target: IntArray
    k: int
    classes: int

    def log_posterior(self, test: FloatArray) -> FloatArray:
        """(m, C) logarithms of (votes + 1 / C) / (k + 1) of the k nearest, the nearer ones ahead where votes are
        equal."""
        from sklearn.neighbors import NearestNeighbors

        if not len(test):  # scikit-learn refuses none
            return np.zeros((0, self.classes))
        k = min(self.k, len(self.points))
        nearest = NearestNeighbors(n_neighbors=k, algorithm="brute").fit(self.points)
        target = self.target[nearest.kneighbors(test, return_distance=False)]
        # A vote less than one more for those that are nearer: it decides between equal numbers of votes alone.
        weight = np.broadcast_to(1.0 + 1e-3 * 0.5 ** np.arange(k), target.shape)
        counted = np.full((len(test), self.classes), 1.0 / self.classes)
        np.add.at(counted, (np.arange(len(test))[:, None], target), weight)
        return np.asarray(np.log(counted / counted.sum(axis=1, keepdims=True)))


@dataclass(frozen=True, slots=True)
class Quadratic:
    """One Gaussian for each class (eq. 2.4, 2.5, with a covariance for each class), all classes with equal prior
    probability.

    mean: (C, d); factor: (C, d, d) lower Cholesky factors of the covariances; present: (C,) classes with points"""

    mean: FloatArray
    factor: FloatArray
    present: BoolArray

    def log_posterior(self, test: FloatArray) -> FloatArray:
        """(m, C)"""
        density = np.full((len(test), len(self.mean)), -np.inf)
        for one in np.flatnonzero(self.present):
            white, _ = dtrtrs(self.factor[one].T, (test - self.mean[one]).T, lower=0, trans=1)
            density[:, one] = -0.5 * (white**2).sum(axis=0) - np.log(np.diagonal(self.factor[one])).sum()
        return floored(density)


@dataclass(frozen=True, slots=True)
class Linear:
    """Gaussians with one shrunk covariance. slope: (d, C), offset: (C,); present: (C,) whether there were points"""

    slope: FloatArray
    offset: FloatArray
    present: BoolArray

    def log_posterior(self, test: FloatArray) -> FloatArray:
        """(m, C)"""
        score = test[:, : len(self.slope)] @ self.slope + self.offset
        return floored(np.where(self.present, score, -np.inf))


Classifier: TypeAlias = Neighbours | Quadratic | Linear


def log_softmax(score: FloatArray) -> FloatArray:
    """(n, C) normalised logarithms; scipy's takes ten times as long for few numbers."""
    shifted = score - score.max(axis=1, keepdims=True)
    return np.asarray(shifted - np.log(np.exp(shifted).sum(axis=1, keepdims=True)))


def floored(score: FloatArray) -> FloatArray:
    """Logarithms of posteriors from scores (m, C), none below `LEAST`."""
    return log_softmax(np.maximum(log_softmax(score), LEAST))


# Neighbours ----------------------------------------------------------------------------------------------------------


def neighbour_count(points: FloatArray, target: IntArray, classes: int, fold: IntArray) -> int:
    """Number of neighbours: as the thesis for three and five classes, else what does best on the points (n, d) of each
    fold (n,), left out."""
    if classes in NEIGHBOURS:
        return NEIGHBOURS[classes]
    right = dict.fromkeys(NEIGHBOURS_TRIED, 0)
    for one in np.unique(fold) if len(np.unique(fold)) > 1 else ():
        inside = fold == one
        for k in right:
            logs = Neighbours(points[~inside], target[~inside], k, classes).log_posterior(points[inside])
            right[k] += int((logs.argmax(axis=1) == target[inside]).sum())
    return max(right, key=lambda k: (right[k], -k))


# Gaussians -----------------------------------------------------------------------------------------------------------


def _moments(points: FloatArray, target: IntArray, classes: int) -> tuple[IntArray, FloatArray, FloatArray]:
    """Points in each class (C,), their means (C, d), and all points about the mean of their class (n, d)."""
    one_hot = (target[:, None] == np.arange(classes)).astype(np.float64)
    count = one_hot.sum(axis=0)
    mean = one_hot.T @ points / np.maximum(count, 1.0)[:, None]
    return count.astype(np.int64), mean, points - mean[target]


def pooled_covariance(about: FloatArray, free: int) -> FloatArray:
    """(d, d) within classes, shrunk to a multiple of the unit matrix as in Ledoit and Wolf 2004. about: (n, d) points
    about the mean of their class; free: n less the number of classes"""
    from sklearn.covariance import ledoit_wolf

    count, size = about.shape
    level = float((about**2).sum()) / max(count * size, 1)
    if level <= 0.0:
        return np.eye(size)
    shrunk, _ = ledoit_wolf(about, assume_centered=True)
    return np.asarray((shrunk + 1e-9 * level * np.eye(size)) * (count / max(free, 1)))


def fit_quadratic(points: FloatArray, target: IntArray, classes: int) -> Quadratic:
    """Each class's covariance is combined with the pooled one, which counts as d + 2 points: the mean of an inverse
    Wishart posterior. A class of few points rests on the pooled one. points: (n, d) features; target: (n,) class of
    each"""
    count, mean, about = _moments(points, target, classes)
    size = points.shape[1]
    pooled = pooled_covariance(about, len(points) - int((count > 0).sum()))
    prior = size + 2.0
    factor = np.tile(np.eye(size), (classes, 1, 1))
    for one in np.flatnonzero(count):
        mine = about[target == one]
        factor[one] = np.linalg.cholesky((mine.T @ mine + prior * pooled) / (count[one] - 1 + prior))
    return Quadratic(mean, factor, count > 0)


def fit_linear(points: FloatArray, target: IntArray, classes: int, share: float | None = None) -> Linear:
    """Linear discriminant analysis with a shrunk pooled covariance, all classes equally likely before; on the largest
    `LINEAR_COMPONENTS`. share: share of the unit matrix, default `linear_share`. points: (n, d) features; target: (n,)
    class of each"""
    points = points[:, :LINEAR_COMPONENTS]
    share = linear_share(points, target, classes) if share is None else share
    count, mean, about = _moments(points, target, classes)
    pooled = about.T @ about / max(len(points) - int((count > 0).sum()), 1)
    level = float(np.trace(pooled)) / max(len(pooled), 1) or 1.0
    slope = np.linalg.solve((1.0 - share) * pooled + share * level * np.eye(len(pooled)), mean.T)
    return Linear(slope, -0.5 * (mean.T * slope).sum(axis=0), count > 0)


def linear_share(points: FloatArray, target: IntArray, classes: int) -> float:
    """The share of the unit matrix in the covariance with the least log loss on points (n, d) of classes (n,), each
    left out in turn.

    Ledoit and Wolf's share, which serves the covariance, is far too small for classification where a few directions
    have most of the variance. Leaving a point out subtracts a a^T from the covariance, where a is the point relative to
    its class mean. Its inverse follows in closed form (Sherman and Morrison)."""
    points = points[:, :LINEAR_COMPONENTS]
    count, mean, about = _moments(points, target, classes)
    free = max(len(points) - int((count > 0).sum()), 1)
    variance, directions = np.linalg.eigh(about.T @ about / free)
    level = float(variance.sum()) / max(len(variance), 1)
    several = np.flatnonzero(count[target] > 1)
    if level <= 0.0 or not len(several):
        return SHARES[-1]
    own, size = target[several], count[target[several]]
    row = np.arange(len(several))
    x, m, a = (one @ directions for one in (points[several], mean, about[several]))
    loss = []
    for share in SHARES:
        white = 1.0 / ((1.0 - share) * np.maximum(variance, 0.0) + share * level)
        removed = (1.0 - share) * size / ((size - 1.0) * free)
        itself = ((a * a) @ white) * removed
        # Squared distances to all means, and products of these differences with a.
        apart = ((x * x) @ white)[:, None] - 2.0 * (x * white) @ m.T + (m * m) @ white
        product = ((x * a) @ white)[:, None] - (a * white) @ m.T
        stretch = size / (size - 1.0)
        apart[row, own] *= stretch**2
        product[row, own] *= stretch
        apart += removed[:, None] * product**2 / np.maximum(1.0 - itself, 1e-9)[:, None]
        score = np.where(count > 0, -0.5 * apart, -np.inf)
        loss.append(-floored(score)[row, own].mean())
    return SHARES[int(np.argmin(loss))]


# By name -------------------------------------------------------------------------------------------------------------


def columns_of(name: Name, kept: int) -> int | None:
    """Number of components that a classifier of that name uses; None = all."""
    return {"qda-raw": None, "linear": LINEAR_COMPONENTS}.get(name, kept)


def usable(name: Name, raw: int) -> bool:
    """Whether a classifier of that name supports this number of columns: a raw covariance is no estimate of
    thousands."""
    return name != "qda-raw" or raw <= LINEAR_COMPONENTS


def fitter(
    name: Name, points: FloatArray, target: IntArray, classes: int, fold: IntArray
) -> Callable[[FloatArray, IntArray, int], Classifier]:
    """A function that fits a classifier of that name to some of the points (n, d), with settings found on all points.
    target: (n,) class of each; fold: (n,) fold in which it is left out for them"""
    if name == "knn":
        k = neighbour_count(points, target, classes, fold)
        return lambda some, of, count: Neighbours(some, of, k, count)
    if name == "linear":
        return partial(fit_linear, share=linear_share(points, target, classes))
    return fit_quadratic


def fit(name: Name, points: FloatArray, target: IntArray, classes: int, apart: IntArray | None = None) -> Classifier:
    """A classifier by its name, on the (n, d) points that `columns_of` says. apart: (n,) groups that are left out
    together when the number of neighbours is chosen"""
    return fitter(name, points, target, classes, folds_of(target, apart))(points, target, classes)


def folds_of(target: IntArray, apart: IntArray | None, seed: int = 0) -> IntArray:
    """(n,) fold of each point: every class, or every class's groups, spread over `FOLDS`."""
    rng = np.random.default_rng(seed)
    group = np.arange(len(target)) if apart is None else np.unique(apart, return_inverse=True)[1].reshape(-1)
    fold = np.full(int(group.max()) + 1, -1)
    following = 0
    for one in rng.permutation(int(target.max()) + 1):
        members = rng.permutation(np.unique(group[target == one]))
        free = members[fold[members] < 0]
        fold[free] = (following + np.arange(len(free))) % FOLDS
        following += len(free)
    return np.asarray(fold[group])
