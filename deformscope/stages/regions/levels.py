"""Levels of stiffness of a map's regions, given touches: a Gaussian posterior in closed form (Bishop 2006).

A touch averages the regions under its contact, whose forces add, plus its errors (`touches`)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from scipy.special import ndtr

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.regions.partitions import FAMILY_SHARES, Partitions
from deformscope.stages.regions.touches import StiffnessSample, TouchErrorModel

LINEARISED = 2
"""Number of estimates of the levels before a contact's stiffness is linearized about them."""
FACTORS_BYTES = 32 << 20
"""Memory of the factors of maps that are computed at once: it would grow with the square of the touches."""


@dataclass(frozen=True, slots=True)
class RegionPrior:
    """Assumptions of a map.

    one, two, three, four, five, gradual: prior probabilities; blur_m: standard deviation of a contact's Gaussian;
    error: error model of a touch; mixed_share: touches near a boundary are off by up to this share of all contrast;
    level_sd: deviation of the regions' log stiffness about their common level; `common_sd`: deviation of that level
    about the touches'; mean: deviation of the mean; large, so that the places of touches do not inform it;
    least_contrast: least difference of log stiffness between two regions (0.13: 14 %; with a sphere 20 % in modulus);
    rigid_sd: deviation of touches that are lower bounds; forces_add: under a contact on two regions, else their log
    stiffness has a mean; family_shares: family shares of borders, in each family of curves (`partitions.Family`)

    blur_m was fitted to finite elements of a ball of 1 cm at 3 N, 0 to 4 cm from a border. With forces that add, 0.0075
    gives the true stiffness within 3 % if one side is 1.8 times as stiff as the other, within 6 % at 3.6 times. Next to
    a rigid part it is within a factor of 1.5, except for the nearest 4 mm. A mean of logarithms needs
    another blur for each of the two (0.008, 0.0045), and a border that is shifted by 2 to 6 mm."""

    one: float = 0.47
    two: float = 0.33
    three: float = 0.10
    four: float = 0.03
    five: float = 0.01
    gradual: float = 0.06
    blur_m: float = 0.0075
    error: TouchErrorModel = field(default_factory=TouchErrorModel)
    mixed_share: float = 0.12
    level_sd: float = 1.0
    common_sd: float = 2.0
    least_contrast: float = 0.13
    rigid_sd: float = 0.3
    forces_add: bool = True
    family_shares: tuple[float, ...] = FAMILY_SHARES

    def __post_init__(self) -> None:
        shares = (*self.regions, self.gradual)
        if min(shares) < 0.0 or abs(sum(shares) - 1.0) > 1e-9:
            raise InputError("prior probabilities that add up to 1", f"{shares}")
        if min(self.blur_m, self.level_sd, self.common_sd, self.rigid_sd) <= 0.0:
            came = f"{self.blur_m}, {self.level_sd}, {self.common_sd}, {self.rigid_sd}"
            raise InputError("a blur and deviations above 0", came)

    @property
    def regions(self) -> tuple[float, ...]:
        """Probability of each number of regions, from one on."""
        return self.one, self.two, self.three, self.four, self.five

    @property
    def any_level_sd(self) -> float:
        """Standard deviation of the level of one region alone, in log stiffness."""
        return float(np.hypot(self.level_sd, self.common_sd))


@dataclass(frozen=True, slots=True)
class Readings:
    """xy_m: (t, 2); value: (t,) log stiffness over `centre`; variance: (t,) variance of each alone, without the
    scatter; arm: (t,) shift of each if the arm's compliance is off by a deviation; related: (t, t) correlation of their
    scatter; spread: spread of all values."""

    xy_m: FloatArray
    value: FloatArray
    variance: FloatArray
    arm: FloatArray
    related: FloatArray
    centre: float
    spread: float


def readings_of(touches: Sequence[StiffnessSample], prior: RegionPrior) -> Readings:
    """Rigid touches are all at the highest of their bounds: one material, as stiff as can be measured."""
    value = np.array([touch.log_stiffness for touch in touches])
    sd = np.array([touch.log_sd for touch in touches])
    arm = np.array([touch.arm_sd for touch in touches])
    rigid = np.array([touch.rigid for touch in touches], dtype=bool)
    if rigid.any():
        value = np.where(rigid, value[rigid].max(), value)
        sd, arm = np.where(rigid, prior.rigid_sd, sd), np.where(rigid, 0.0, arm)
    centre = float(value.mean()) if len(value) else 0.0
    spread = float(np.ptp(value)) if len(value) else 0.0
    xy_m = np.array([touch.xy_m for touch in touches]).reshape(-1, 2)
    return Readings(xy_m, value - centre, sd**2, arm, prior.error.related(xy_m), centre, spread)


def levels_of(
    shares: FloatArray,
    readings: Readings,
    prior: RegionPrior,
    scatter: FloatArray | float = 0.0,
    last_noise: float = 1.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For maps with contact shares (n, t, k): log likelihood (n,), levels (n, k) over the centre, their covariance (n,
    k, k). scatter: (n,) scatter of touches, or of all maps; with one axis more, (s, n) or (s, 1), so have the results

    The touches are a linear model in the levels, whose prior is Gaussian (Bishop 2006, 3.49 and 3.86), their errors
    correlated by scatter that neighbours share and by the arm. The remaining part of the prior, for levels that differ
    enough, is counted afterwards, pair by pair.
    last_noise: factor on the variance of the last touch"""
    count, touches, _ = shares.shape
    scatter = np.broadcast_to(scatter, np.broadcast_shapes(np.shape(scatter), (count,)))
    at_once = max(1, FACTORS_BYTES // max(1, 8 * touches**2 * math.prod(scatter.shape[:-1])))
    blocks = (slice(at, at + at_once) for at in range(0, count or 1, at_once))
    found = [_block_levels(shares[one], readings, prior, scatter[..., one], last_noise) for one in blocks]
    log_likelihood, level, cov = zip(*found, strict=True)
    return np.concatenate(log_likelihood, axis=-1), np.concatenate(level, axis=-2), np.concatenate(cov, axis=-3)


def _block_levels(
    shares: FloatArray, readings: Readings, prior: RegionPrior, scatter: FloatArray, last_noise: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`levels_of` of maps whose factors fit into memory. scatter: (n,) or (s, n)"""
    _, touches, k = shares.shape
    mixed = 2.0 * (1.0 - (shares**2).sum(axis=-1))  # 1 midway between two regions
    own = (readings.variance + (prior.mixed_share * readings.spread * mixed) ** 2).T
    square = scatter**2
    value = readings.value[:, None]
    if k > 1 and prior.forces_add:
        shares, value = _linear_in_levels(shares, readings, prior, own)
    # the touches' errors made white, column by column of the Cholesky factor of their covariance; by hand, since a
    # library would solve each of thousands of small matrices by itself
    lower = np.empty((touches, touches, *square.shape))
    white = np.empty((touches, k + 1, *square.shape))
    white[:, :k] = np.expand_dims(np.moveaxis(shares, 0, -1), tuple(range(2, square.ndim + 1)))
    white[:, k] = np.expand_dims(value, tuple(range(1, square.ndim)))
    log_det = np.zeros(square.shape)
    for j in range(touches):
        shared = np.expand_dims(readings.related[j:, j], tuple(range(1, square.ndim + 1))) * square
        shared += np.expand_dims(readings.arm[j:] * readings.arm[j], tuple(range(1, square.ndim + 1)))
        shared[0] = (shared[0] + own[j]) * (last_noise if j == touches - 1 else 1.0)
        left = shared - (lower[j:, :j] * lower[j, :j]).sum(axis=1)
        lower[j:, j] = left / np.sqrt(left[0])
        log_det += np.log(left[0])
        white[j] = (white[j] - (lower[j, :j, None] * white[:j]).sum(axis=0)) / lower[j, j]
    products = [(white[:, i] * white[:, j]).sum(axis=0) for i in range(k) for j in range(i + 1)]
    pull = [(white[:, i] * white[:, k]).sum(axis=0) for i in range(k)]
    before = prior.level_sd**2 * np.eye(k) + prior.common_sd**2
    level, cov, log_det_cov = _solved(products, pull, np.linalg.inv(before))
    log_likelihood = 0.5 * (
        (np.stack(pull, axis=-1) * level).sum(axis=-1)
        + log_det_cov
        - np.linalg.slogdet(before)[1]
        - log_det
        - touches * np.log(2.0 * np.pi)
        - (white[:, k] ** 2).sum(axis=0)
    )
    at_first = 2.0 * ndtr(-prior.least_contrast / (np.sqrt(2.0) * prior.level_sd))
    for i in range(k):
        for j in range(i):
            apart = level[..., i] - level[..., j]
            sd = np.sqrt(np.maximum(cov[..., i, i] + cov[..., j, j] - 2.0 * cov[..., i, j], 1e-12))
            left = ndtr((apart - prior.least_contrast) / sd) + ndtr((-apart - prior.least_contrast) / sd)
            log_likelihood += np.log(np.maximum(left, 1e-300) / at_first)
    return log_likelihood, level, cov


def mixed_stiffness(shares: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log stiffness (n, t) of contacts with shares (n, t, k) of levels (n, k), and its derivative by each."""
    most = level.max(axis=1, keepdims=True)
    force = shares * np.exp(level - most)[:, None]
    total = force.sum(axis=-1)
    return np.log(total) + most, force / total[..., None]


def _linear_in_levels(
    shares: FloatArray, readings: Readings, prior: RegionPrior, own: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A contact's stiffness, linear in the levels about their approximate values: its slopes (n, t, k) and the readings
    (t, n) less its value at levels of 0. own: (t, n) variance of the touches"""
    k = shares.shape[-1]
    precision = 1.0 / (own.T + prior.error.scatter_median**2)
    before = np.linalg.inv(prior.level_sd**2 * np.eye(k) + prior.common_sd**2)
    slope, value = shares, np.broadcast_to(readings.value, shares.shape[:2])
    for _ in range(LINEARISED):
        weighted = slope * precision[..., None]
        products = [(weighted[..., i] * slope[..., j]).sum(axis=1) for i in range(k) for j in range(i + 1)]
        pull = [(weighted[..., i] * value).sum(axis=1) for i in range(k)]
        level, _, _ = _solved(products, pull, before)
        mixed, slope = mixed_stiffness(shares, level)
        value = readings.value - mixed + (slope * level[:, None]).sum(axis=-1)
    return slope, value.T


def _solved(
    products: Sequence[FloatArray], pull: Sequence[FloatArray], prior_precision: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (..., c), covariance (..., c, c) and its log determinant (...,) of c levels. products: lower triangle of
    their precision, row by row; prior_precision: (c, c) added to it; pull: (c) their pull"""
    size = len(pull)
    lower: dict[tuple[int, int], FloatArray] = {}
    inverse: dict[tuple[int, int], FloatArray] = {}
    entry, nothing = iter(products), np.zeros(pull[0].shape)
    for i in range(size):
        for j in range(i + 1):
            rest = next(entry) + prior_precision[i, j] - sum((lower[i, m] * lower[j, m] for m in range(j)), nothing)
            lower[i, j] = np.sqrt(rest) if i == j else rest / lower[j, j]
    for j in range(size):
        inverse[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, size):
            inverse[i, j] = -sum((lower[i, m] * inverse[m, j] for m in range(j, i)), nothing) / lower[i, i]
    cov = np.empty((*nothing.shape, size, size))
    for i in range(size):
        for j in range(i + 1):
            both = sum((inverse[m, i] * inverse[m, j] for m in range(i, size)), nothing)
            cov[..., i, j] = cov[..., j, i] = both
    mean = (cov * np.stack(pull, axis=-1)[..., None, :]).sum(axis=-1)
    return mean, cov, 2.0 * sum((np.log(inverse[i, i]) for i in range(size)), nothing)


def log_likelihood_by_scatter(
    shares: FloatArray, readings: Readings, prior: RegionPrior, last_noise: float = 1.0
) -> FloatArray:
    """(s, n) log likelihood of maps under each scatter, with its prior."""
    scatter, share = prior.error.scatters()
    return levels_of(shares, readings, prior, scatter[:, None], last_noise)[0] + np.log(share)[:, None]


def log_likelihood_of(
    shares: FloatArray, readings: Readings, prior: RegionPrior, last_noise: float = 1.0
) -> FloatArray:
    """(n,) of maps, whatever the scatter."""
    logs = log_likelihood_by_scatter(shares, readings, prior, last_noise)
    most = logs.max(axis=0)
    return cast(FloatArray, most + np.log(np.exp(logs - most).sum(axis=0)))


def labels_of(maps: Partitions | None, level: FloatArray, xy_m: FloatArray) -> IntArray:
    """(n, p) labels by level, 0 the softest; of one region too, which has no maps."""
    if maps is None:
        return np.zeros((len(level), len(xy_m)), dtype=np.int8)
    rank = np.argsort(np.argsort(level, axis=1), axis=1)
    return cast(IntArray, np.take_along_axis(rank, maps.labels(xy_m).astype(np.intp), axis=1).astype(np.int8))


def sorted_levels(level: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Levels (n, k) from soft to stiff, covariances (n, k, k) alike."""
    order = np.argsort(level, axis=1)
    cov = np.take_along_axis(np.take_along_axis(cov, order[:, :, None], axis=1), order[:, None, :], axis=2)
    return np.take_along_axis(level, order, axis=1), cov
