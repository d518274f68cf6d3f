"""Prediction error of a choice of model: error on blocks of particles that were left out of the fit.

Blocks, not single particles, because neighbours share errors: a particle whose neighbours were fitted is not held out.
Particles are left out, not frames, whose errors are similar: a frame left out is no independent test."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.search import Search
from deformscope.stages.fit.shared_errors import patches

FOLDS = 5

BLOCK = 3.0
"""Least side of a block [spacings]."""

BLOCKS_ACROSS = 3
"""Least number of blocks along the longer side, whatever the flow's window."""

FINE = 10
"""Number of evaluated values from one candidate of the parameter to the next, by a spline of the states."""


TOLD_LEAST = 0.01
"""Share of the held-out error by which two choices must differ to count as different."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Errors of one choice of model over all frames [unit].

    error: held-out AEE; block: (b,) error of each block; fit: AEE of the same particles when all are fitted; value: the
    fitted parameter; usable: the simulation stayed finite"""

    error: float
    block: FloatArray
    fit: float
    value: float

    @property
    def usable(self) -> bool:
        return bool(np.isfinite(self.error))


def blocks_of(rest: FloatArray, spacing: float, window: float) -> tuple[IntArray, IntArray]:
    """Block and fold (K,) of each particle; window: how far the flow's errors reach [unit of rest]. A fold's blocks are
    spread out: with K folds, block (i, j) goes to fold (i + 2 j) mod K, a knight's move apart."""
    side = min(max(BLOCK * spacing, window), float(np.ptp(rest, axis=0).max()) / BLOCKS_ACROSS)
    block = patches(rest, side)
    middle = np.array([rest[block == one].mean(axis=0) for one in range(int(block.max()) + 1)])
    place = np.round((middle - middle.min(axis=0)) / side).astype(np.int64)
    fold = (place @ (1 + np.arange(rest.shape[1]))) % FOLDS
    return block, np.unique(fold, return_inverse=True)[1][block]


def hold_out(search: Search, judged: BoolArray, block: IntArray, fold: IntArray) -> HeldOut:
    """For each fold, fit to all other folds and judge by this one, with the candidates that a search has tried. judged:
    (K,) particles that count; block, fold: (K,)"""
    from scipy.interpolate import CubicSpline

    tried = search.tried
    if tried.usable.sum() < 4:
        return HeldOut(np.nan, np.full(int(block.max()) + 1, np.nan), np.nan, np.nan)
    stretched = np.array([search.stretch(float(p)) for p in tried.parameter[tried.usable]])
    fine = np.linspace(stretched[0], stretched[-1], FINE * (len(stretched) - 1) + 1)
    count = int(block.max()) + 1
    total, number = np.zeros((len(fine), count)), np.zeros(count)
    for seen, position in zip(search.seen, tried.positions, strict=True):
        use = np.flatnonzero(judged & seen.observed)
        states = CubicSpline(stretched, position[tried.usable][:, use], axis=0)(fine)
        distance = np.sqrt(np.sum((states - seen.deformed[use]) ** 2, axis=-1))
        for one in np.unique(block[use]):
            total[:, one] += distance[:, block[use] == one].sum(axis=1)
        number += np.bincount(block[use], minlength=count)
    fold_of = np.array([fold[block == one][0] for one in range(count)])
    some = number > 0
    out = np.full(count, np.nan)
    for one in np.unique(fold_of[some]):
        left, fitted = some & (fold_of == one), some & (fold_of != one)
        at = int(total[:, fitted].sum(axis=1).argmin())
        out[left] = total[at, left] / number[left]
    every = total.sum(axis=1)
    at = int(every.argmin())
    return HeldOut(
        error=float(out[some] @ number[some] / number.sum()),
        block=out,
        fit=float(every[at] / number.sum()),
        value=float(search.shrink(fine[at])),
    )


def difference(one: HeldOut, other: HeldOut) -> tuple[float, float]:
    """Held-out error of the first less that of the second, and the standard error of this difference over blocks."""
    gap = one.block - other.block
    gap = gap[np.isfinite(gap)]
    if gap.size < 2:
        return one.error - other.error, np.inf
    return one.error - other.error, float(gap.std(ddof=1) / np.sqrt(gap.size))


def separates(worse: HeldOut, better: HeldOut) -> bool:
    """Whether the data separate two choices: beyond two standard errors, and by more than a hundredth."""
    gap, scatter = difference(worse, better)
    return bool(gap > 2.0 * scatter and gap > TOLD_LEAST * better.error)
