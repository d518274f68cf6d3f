"""The frames of one motion as one set of observations: how much they tell together.

Frames are not independent. Advected particles carry their errors along, the model's misfit is much the same in
neighbouring frames, and adding up the frames' log likelihoods as if each were new would shrink the interval as
1/sqrt(frames). Here the sum is a *composite likelihood* (Varin, Reid and Firth 2011), sum_t w_t log L_t, scaled so that
its curvature is that of its score's variance, as a true likelihood's is (Chandler and Bate 2007; Pauli, Racugno and
Ventura 2011). With C_ts = rho for two frames and 1 for one, and a_t, what frame t alone tells of the parameter:

    w ~ (C^-1 a) / a, none below 0 (the sharpest sum), times sum_t w_t a_t^2 / ((w a)^T C (w a))

With rho = 1 (errors fully shared) that leaves the one frame that tells most, with weight 1; with rho = 0 every frame
counts in full. rho is taken from the residuals: the correlation, between frames, of the scores of patches of particles
larger than what the flow's errors share. It is uncertain, and too low a rho gives false confidence: the weights among
frames use its estimate, their scale its upper bound over resampled patches, and errors count as fully shared where there
are too few patches to tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.search import Search

PATCH = 3.0
"""Side of a patch of particles whose errors count as one [spacings]."""

PATCHES_LEAST = 4
"""Fewer patches than this cannot tell whether frames share their errors."""

RHO_MOST = 0.999
RHO_LEVEL = 0.9
RESAMPLED = 400

STEP = 0.05
"""Share of the (stretched) range by which the parameter is changed to see what a frame tells of it."""

FRAMES_IN_POSTERIOR = 8
"""Frames that the posterior is taken from, spread over those that tell something: more would tell little else."""

WEIGHT_LEAST = 0.02
"""Frames of less weight than this share of the largest are left out of the posterior."""


@dataclass(frozen=True, slots=True)
class Together:
    """What frames tell together.

    weight: (F,) of each frame's error and log likelihood; 1 = as an observation of its own
    rho: correlation of two frames' errors, as estimated and its upper bound; told: (F,) what each frame alone tells of
    the parameter, in standard deviations over `STEP` of the range
    """

    weight: FloatArray
    rho: tuple[float, float]
    told: FloatArray

    @property
    def worth(self) -> float:
        """Of how many of the best frame all of them are worth; 1 where errors are fully shared."""
        return float(self.weight @ self.told**2 / np.max(self.told) ** 2) if self.told.any() else 1.0


def together(search: Search, seed: int) -> Together:
    """Weights of a search's observations, which are frames of one motion, from its best candidate's residuals."""
    best = float(search.tried.parameter[search.best()])
    low, high = (search.stretch(bound) for bound in search.bounds)
    step = STEP * (high - low)
    place = min(max(search.stretch(best), low + step), high - step)
    ends = search.rows_of(search.shrink(np.array([place - step, place + step])))
    at = search.best()
    patch = patches(search.seen[0].rest, PATCH * search.bodies[0].scale)
    count = int(patch.max()) + 1
    told, score = np.zeros(len(search.seen)), np.zeros((len(search.seen), count))
    for row, (seen, position) in enumerate(zip(search.seen, search.tried.positions, strict=True)):
        free = seen.free_observed
        effect = (position[ends[1]] - position[ends[0]])[free]
        residual = (seen.deformed - position[at])[free]
        floor = 1e-9 * search.bodies[row].extent
        deviation = float(np.sqrt(np.mean(residual**2) + floor**2))
        told[row] = np.sqrt(np.sum(effect**2)) / deviation
        score[row] = np.bincount(patch[free], np.sum(effect * residual, axis=1), count)
    rho = shared_part(score, np.random.default_rng(seed))
    return Together(weights(told, rho), rho, told)


def patches(rest: FloatArray, side: float) -> IntArray:
    """(K,) the patch of each particle (K, d), in squares or cubes of a side, numbered from 0."""
    # patches of even size over the extent, none of which is a sliver
    extent = np.ptp(rest, axis=0)
    many = np.maximum(np.round(extent / side), 1.0)
    place = np.floor((rest - rest.min(axis=0)) / np.maximum(extent, 1e-300) * many * (1.0 - 1e-9)).astype(np.int64)
    return np.asarray(np.unique(place, axis=0, return_inverse=True)[1].reshape(-1))


def shared_part(score: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    """Correlation between frames of the scores (F, patches): estimate, and upper bound."""
    used = np.flatnonzero(np.any(score != 0.0, axis=0))
    size = np.sqrt(np.sum(score**2, axis=1))
    moving = size > 1e-12 * size.max()
    if moving.sum() < 2 or used.size < PATCHES_LEAST:
        return RHO_MOST, RHO_MOST
    score = score[moving][:, used] / size[moving, None]
    pick = rng.integers(0, used.size, (RESAMPLED, used.size))
    pick[0] = np.arange(used.size)
    some = score[:, pick]  # (F, repeats, patches)
    own = np.sum(some**2, axis=(0, 2))
    every = np.sum(some.sum(axis=0) ** 2, axis=1)
    rho = np.clip((every / np.maximum(own, 1e-300) - 1.0) / (len(score) - 1), 0.0, RHO_MOST)
    return float(rho[0]), max(float(rho[0]), float(np.quantile(rho, RHO_LEVEL)))


def weights(told: FloatArray, rho: tuple[float, float]) -> FloatArray:
    """(F,) weights of frames that alone tell (F,) standard deviations each.

    rho: correlation of their errors, as estimated and its upper bound
    """
    weight = np.zeros(len(told))
    kept = np.flatnonzero(told > 0.0)
    if kept.size == 0:
        return np.ones(len(told))
    likely, most = rho
    while True:
        a = told[kept]
        share = (a - likely * a.sum() / (1.0 + (len(a) - 1) * likely)) / (1.0 - likely)
        if share.min() >= 0.0:
            break
        kept = kept[share >= 0.0]
    variance = (1.0 - most) * np.sum(share**2) + most * share.sum() ** 2
    weight[kept] = share / a * (share @ a) / variance
    return weight


def for_posterior(found: Together) -> tuple[IntArray, FloatArray]:
    """The frames that the posterior is taken from, and their weights among themselves."""
    rows = np.flatnonzero(found.weight >= WEIGHT_LEAST * found.weight.max())
    if rows.size > FRAMES_IN_POSTERIOR:
        rows = rows[np.linspace(0, rows.size - 1, FRAMES_IN_POSTERIOR).round().astype(int)]
    weight = weights(found.told[rows], found.rho)
    return rows[weight > 0.0], weight[weight > 0.0]
