"""The first search for the yield strain, with beta and creep."""

import numpy as np
from scipy.ndimage import minimum_filter1d

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit import least_squares
from deformscope.stages.fit.calibrate import BETA_LIMIT
from deformscope.stages.fit.least_squares import Minimum
from deformscope.stages.materials.yield_history import YieldHistories

YIELDS, BETAS, CREEPS = 14, 6, 8
"""Values of the first search; for each yield strain beta and creep are searched again, closer in `ZOOMS` rounds."""

ZOOMS = 2

STARTS = 3
"""Number of valleys of the first search that are followed: yield strain and creep can partly replace each other."""

DIFFERENCE = 0.01
"""Change of log yield, log creep and -log(1 - beta), for derivatives: clusters yield one after the other, so not too
small."""

LEAST_SHARE = 0.02
"""Smallest yield strain tried, as a share of the largest strain that the motion would give without yielding."""


def elastic_minimum(histories: YieldHistories) -> Minimum:
    """The best body that never yields."""

    def simulate(at: FloatArray) -> FloatArray:
        beta = histories.shrink(at[:, 0]) if histories.fits_beta else np.full(len(at), histories.options.beta)
        never = np.full(len(at), np.inf)
        return histories.compared(histories.run(never, beta, never)[0])

    if not histories.fits_beta:
        at = histories.stretched(np.array([histories.options.beta], dtype=np.float64))
        found = simulate(at[None])[0]
        residual, nothing = histories.observed - found, np.zeros(1, dtype=bool)
        return Minimum(at, found, np.zeros((found.size, 1)), residual, inside=nothing, converged=True)
    every = histories.stretched(np.linspace(0.05, 0.98, 2 * BETAS))[:, None]
    squares = np.sum((histories.observed - simulate(every)) ** 2, axis=1)
    if not np.isfinite(squares).any():
        raise InputError("a simulation that settles", "none for any beta", "check the held particles")
    limits = np.array([[0.0, float(histories.stretched(BETA_LIMIT))]])
    start = every[int(np.nanargmin(squares))]
    return least_squares.minimise(simulate, histories.observed, start, limits, np.array([DIFFERENCE]))


def without_yielding(histories: YieldHistories, beta: FloatArray | float) -> tuple[FloatArray, float]:
    """(T, K, d) the motion without yielding, and the largest strain in it."""
    never = np.array([np.inf])
    states, largest = histories.run(never, np.array([float(beta)]), never)
    return states[0], float(largest[0])


def parameter_bounds(histories: YieldHistories, largest: float) -> FloatArray:
    """(p, 2) lowest and highest of each fitted parameter: log yield strain, -log(1 - beta), log creep rate."""
    rows = [np.log([LEAST_SHARE * largest, 1.5 * largest])]
    if histories.fits_beta:
        rows.append(np.array([0.0, float(histories.stretched(BETA_LIMIT))]))
    if histories.fits_creep:
        rows.append(np.log(_creep_rates(histories)[[0, -1]]))
    return np.array(rows)


def _creep_rates(histories: YieldHistories) -> FloatArray:
    """(n,) creep rates that a motion of this many frames and this length can separate, per unit of its duration."""
    assert histories.motion.duration is not None
    return np.geomspace(0.1 / histories.motion.duration.sum(), 1.0 / histories.motion.duration.min(), CREEPS + 2)


def deepest_valleys(histories: YieldHistories, largest: float) -> FloatArray:
    """(s, m) the deepest valleys over the yield strain, with the others at their best for each."""
    strains = np.log(np.geomspace(LEAST_SHARE * largest, 0.98 * largest, YIELDS))
    others = []
    if histories.fits_beta:
        others.append(histories.stretched(np.linspace(0.1, 0.97, BETAS)))
    if histories.fits_creep:
        others.append(np.log(_creep_rates(histories)[1:-1]))
    at = np.column_stack([strains, *(np.full(YIELDS, np.mean(each)) for each in others)])
    offsets = [each - np.mean(each) for each in others]
    squares = np.full((YIELDS, 1), np.inf)
    for _ in range(1 + ZOOMS if others else 1):
        away = np.stack(np.meshgrid(*offsets, indexing="ij"), axis=-1).reshape(-1, len(others)) if others else None
        tried = at[:, None] if away is None else at[:, None] + np.pad(away, [(0, 0), (1, 0)])
        simulated = histories.simulate(tried.reshape(-1, at.shape[1]))
        squares = np.sum((histories.observed - simulated) ** 2, axis=1).reshape(YIELDS, -1)
        squares = np.where(np.isfinite(squares), squares, np.inf)
        at = tried[np.arange(YIELDS), squares.argmin(axis=1)]
        offsets = [np.diff(each).max() * np.linspace(-0.8, 0.8, 5) for each in offsets]
    deep = squares.min(axis=1)
    if not np.isfinite(deep).any():
        raise InputError("a simulation that settles", "none for any yield strain", "a smaller --cluster-size")
    valleys = np.flatnonzero(np.isfinite(deep) & (deep == minimum_filter1d(deep, 3, mode="nearest")))
    return np.asarray(at[valleys[np.argsort(deep[valleys])][:STARTS]])
