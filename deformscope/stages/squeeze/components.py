"""Features made comparable and few: constant columns dropped, standardised, principal components (Thesis 2.4.2).

All of it is fitted to the training side of a split alone; the test side is projected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray

EXPLAINED = 0.8
"""Share of the variance that the principal components keep (Thesis 2.4.2)."""
FLAT = 1e-10
"""Of the largest variance: components below it are rounding."""


@dataclass(frozen=True, slots=True)
class Scaling:
    """What makes columns comparable. used: (p,) columns that vary; mean, scale: (q,) of those"""

    used: BoolArray
    mean: FloatArray
    scale: FloatArray

    def apply(self, features: FloatArray) -> FloatArray:
        """(n, q) standardised columns of (n, p) features. What was not measured (NaN) becomes the mean."""
        scaled: FloatArray = (features[:, self.used] - self.mean) / self.scale
        return np.nan_to_num(scaled, copy=False, nan=0.0)


def fit_scaling(features: FloatArray) -> Scaling:
    """Of (n, p) training features, n > 0; NaN are left out."""
    known = ~np.isnan(features)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, features, 0.0).sum(axis=0) / count
    deviation = np.sqrt(np.where(known, (features - mean) ** 2, 0.0).sum(axis=0) / count)
    used = deviation > 1e-12 * np.maximum(np.abs(mean), 1e-300)
    return Scaling(used, mean[used], deviation[used])


@dataclass(frozen=True, slots=True)
class Space:
    """Both sides of a split on the principal components of the training side, the largest variance first.

    train: (n, d), test: (m, d) with d up to the rank of the training side: among these, distances between a test point
    and training points differ from those between the standardised features by the same amount for all of them
    kept: so many components hold `EXPLAINED` of the variance; raw: columns that vary, before the rotation
    """

    train: FloatArray
    test: FloatArray
    kept: int
    raw: int

    @property
    def few(self) -> tuple[FloatArray, FloatArray]:
        """(n, kept) and (m, kept): training and test points on the components that hold `EXPLAINED` of the variance."""
        return self.train[:, : self.kept], self.test[:, : self.kept]


def kept_of(variance: FloatArray, share: float = EXPLAINED) -> int:
    """How many components hold that share of the variance; falling (d,) variances."""
    if not variance.size or not variance.sum() > 0.0:
        return 0
    return int(np.searchsorted(np.cumsum(variance) / variance.sum(), share - 1e-12) + 1)


def loadings(train: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal directions (q, d) of (n, q) standardised training features, and their variances (d,), falling.

    Signs are fixed (the largest entry is positive), so that the same data give the same pictures.
    """
    if not train.size:
        return np.zeros((train.shape[1], 0)), np.zeros(0)
    _, singular, rows = np.linalg.svd(train - train.mean(axis=0), full_matrices=False)
    variance = singular**2 / len(train)
    rows = rows[variance > FLAT * max(float(variance[0]), 1e-300)]
    rows *= np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])[:, None] if len(rows) else 1.0
    return rows.T, variance[: len(rows)]


def project(train: FloatArray, test: FloatArray, gram: FloatArray | None = None) -> Space:
    """(n, q) and (m, q) standardised features on the training side's components.

    gram: (n + m, n + m) products of all rows, training first, where there are more columns than rows: it is cheaper
    than the columns, and that of joined modalities is the sum of theirs.
    """
    count, raw = len(train), train.shape[1]
    if gram is None and raw > count:
        both = np.concatenate([train, test])
        gram = both @ both.T
    if gram is None:
        mean = train.mean(axis=0)
        variance, directions = np.linalg.eigh((train - mean).T @ (train - mean) / max(count, 1))
        keep = _falling(variance)
        directions = directions[:, keep]
        return Space((train - mean) @ directions, (test - mean) @ directions, kept_of(variance[keep]), raw)
    # The same from inner products: with X = U S V^T, X V = U S and, of other rows Y, Y V = (Y X^T) U / S.
    inside, across = gram[:count, :count], gram[count:, :count]
    column = inside.mean(axis=0)
    centred = inside - column - column[:, None] + column.mean()
    crossed = across - across.mean(axis=1, keepdims=True) - column + column.mean()
    squared, left = np.linalg.eigh(centred)
    keep = _falling(squared)
    singular = np.sqrt(squared[keep])
    left = left[:, keep]
    return Space(left * singular, (crossed @ left) / singular, kept_of(squared[keep]), raw)


def _falling(variance: FloatArray) -> IntArray:
    """Indices (n,) of the eigenvalues that are not due to rounding, the largest first."""
    order = np.argsort(variance)[::-1]
    return order[variance[order] > FLAT * max(float(variance[order[0]]), 1e-300)] if order.size else order
