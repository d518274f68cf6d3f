"""Which yield strains the noise allows: a first search with beta and creep, the squared error over them; doubts of
one."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit import doubts, least_squares
from deformscope.stages.fit.calibrate import BETA_LIMIT, TURNED, Observation, shape_doubts
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.least_squares import Minimum, Noise
from deformscope.stages.fit.noise import independent, shared_over
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.fit.two_materials import FittedBody, two_materials
from deformscope.stages.materials.yield_history import YieldHistories
from deformscope.stages.msm.solver import Relaxed

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


PROFILE = 41
"""Number of yield strains whose errors give the curve and the interval."""

HELD_REPEATS = 48
"""Draws of the prescribed positions' noise."""


@dataclass(frozen=True, slots=True)
class StrainProfile:
    """(n,) yield strains, squared errors there, and by how many noise variances they exceed the least one."""

    grid: FloatArray
    squares: FloatArray
    excess: FloatArray


def least_noise(histories: YieldHistories) -> float:
    """Deviation of a coordinate's noise, as stated, and no less than numbers can resolve, in the unit of positions."""
    return max(histories.motion.noise or 0.0, histories.resolved)


def prescribed_noise(histories: YieldHistories, best: Minimum, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """Effect of more noise of the prescribed positions on the best simulation, (r, n), and its size."""
    tried = max(least_noise(histories), least_squares.deviation_of(best.residual, len(best.at)))
    held: list[FloatArray] = [
        each + tried * rng.standard_normal((HELD_REPEATS, *each.shape)) for each in histories.prescribed()
    ]
    strain, beta, creep = histories.numbers(np.repeat(best.at[None], HELD_REPEATS, axis=0))
    moved = histories.compared(histories.run(strain, beta, creep, held)[0]) - best.simulated
    return moved[np.isfinite(moved).all(axis=1)], tried


def shared_errors(histories: YieldHistories, best: Minimum) -> float:
    """How many times more a mean of the residuals varies than if neither neighbours nor frames shared errors."""
    residual = np.full(histories.motion.position.shape, np.nan)
    residual[histories.judged] = best.residual.reshape(-1, histories.motion.rest.shape[1])
    worth = count = 0.0
    for one, judged in zip(residual, histories.judged, strict=True):
        if judged.any():
            points = histories.motion.rest[judged]
            length = shared_over(points, one[judged], histories.body.scale)
            worth += independent(points, length) if length > 0.0 else len(points)
            count += len(points)
    both = (histories.judged[1:] & histories.judged[:-1])[..., None]
    pairs = int(both.sum()) * histories.motion.rest.shape[1]
    alike = 0.0
    if pairs:
        product = np.where(both, residual[1:] * residual[:-1], 0.0)
        alike = float(product.sum()) / pairs / max(float(np.nanmean(residual**2)), 1e-300)
        alike = max(alike - 1.645 / np.sqrt(pairs), 0.0)
    frames = int(histories.judged.any(axis=1).sum())
    return float(count / worth) * (1.0 + (frames - 1) * min(alike, 1.0))


def strain_grid(best: Minimum, noise: Noise, largest: float) -> FloatArray:
    """(n,) yield strains [-] around the best, some standard errors wide, and some beyond, up to no yielding."""
    error = float(np.sqrt(max(noise.covariance(best.jacobian)[0, 0], 0.0)))
    reach = float(np.clip(5.0 * error, 0.02, 3.0))
    low, high = np.log(LEAST_SHARE * largest), np.log(1.05 * largest)
    near = np.linspace(max(best.at[0] - reach, low), min(best.at[0] + reach, high), PROFILE)
    return np.unique(np.exp([*near, *np.linspace(low, high, 15), best.at[0]]))


def strain_profile(histories: YieldHistories, best: Minimum, noise: Noise, grid: FloatArray) -> StrainProfile:
    """Squared error and its excess at yield strains (n,), the other parameters refitted in linear approximation."""
    at = np.repeat(best.at[None], len(grid), axis=0)
    at[:, 0] = np.log(grid)
    simulated = histories.simulate(at)
    squares, excess = np.full(len(grid), np.nan), np.full(len(grid), np.inf)
    others = best.jacobian[:, 1:]
    for row, one in enumerate(simulated):
        if np.isfinite(one).all():
            away = one - best.simulated
            if others.shape[1]:  # beta and creep adapt as well as possible
                away = away + others @ np.linalg.lstsq(others, best.residual - away, rcond=1e-12)[0]
            residual = best.residual - away
            squares[row] = float(residual @ residual)
            excess[row] = excess_over(best, noise, best.simulated + away, squares[row])
    return StrainProfile(grid, squares, excess)


def excess_over(best: Minimum, noise: Noise, other: FloatArray, squares: float) -> float:
    """By how many noise variances another simulation's squared error exceeds the least one. other: (n,) simulated
    coordinates"""
    return float(squares - best.squares) / noise.variance_along(other - best.simulated)


def interval_ends(
    grid: FloatArray, excess: FloatArray, inside: IntArray, value: float, limit: float
) -> tuple[float, float | None]:
    """The yield strains, out of a grid (n,), at which the excess (n,) crosses the limit on either side of the value;
    None above if it never does."""
    if not inside.size:
        return value, value

    def cross(a: int, b: int) -> float:
        share = (limit - excess[a]) / (excess[b] - excess[a])
        return float(np.exp(np.log(grid[a]) + share * (np.log(grid[b]) - np.log(grid[a]))))

    first, last = int(inside[0]), int(inside[-1])
    low = cross(first, first - 1) if first > 0 else float(grid[0])
    high = cross(last, last + 1) if last + 1 < len(grid) else None
    return min(low, value), None if high is None else max(high, value)


def yield_doubts(
    histories: YieldHistories, best: Minimum, simulated: FloatArray, explained: float, *, converged: bool
) -> tuple[Doubt, ...]:
    """Reasons to doubt the yield strain. simulated: (T, K, d) at the best"""
    rows = np.flatnonzero(histories.judged.any(axis=1))
    frames = [histories.frame(row) for row in rows]
    ratio = doubts.residual_ratio(frames, list(simulated[rows]), histories.resolved)
    found = [
        *doubts.not_converged(converged),
        *doubts.little_explained(explained, left_is_noise=ratio is not None and ratio < doubts.LIKE_NOISE, seen=frames),
        *doubts.noise_contradicted(ratio, histories.motion.noise_source),
        *shape_doubts(frames),
    ]
    if converged:
        found += _in_residuals(histories, best, rows, frames, simulated)
    return doubts.ordered(found)


def _in_residuals(
    histories: YieldHistories, best: Minimum, rows: IntArray, frames: Sequence[Observation], simulated: FloatArray
) -> Iterator[Doubt]:
    """Doubts that histories with other axes, and with two betas, show in the residuals of the best. rows: (n,)
    frames"""
    strain, beta, creep = histories.numbers(best.at[None])
    tried = np.append(histories.shrink(np.linspace(0.1, 3.0, TURNED)), beta)
    betas, count = np.tile(tried, 2), 2 * len(tried)
    strains = np.repeat([float(strain[0]), np.inf], len(tried))

    def simulate(shapes: Sequence[FloatArray]) -> list[FloatArray]:
        held = histories.prescribed()
        for at, shape in zip(rows, shapes, strict=True):
            held[at] = shape[histories.frames[at]]
        states = histories.run(strains, betas, np.repeat(creep, count), held)[0]
        return [states[:, at] for at in rows]

    bodies = [histories.body.holding(one.held) for one in frames]
    yield from doubts.swapped_axes(frames, simulate, doubts.bulging(frames, bodies, tried))
    if histories.body.cluster_count < 2:
        return
    # at the frame with the largest motion: errors of all frames are much the same
    moved = np.where(histories.judged[:, :, None], histories.motion.position - histories.motion.rest, 0.0)
    row = int(np.sum(moved**2, axis=(1, 2)).argmax())
    one = histories.frame(row)
    part = Residuals(one, histories.body.holding(one.held), np.random.default_rng(histories.options.seed))

    def history(betas: FloatArray, held: FloatArray | None = None) -> FloatArray:
        size, every = len(betas), histories.prescribed()
        if held is not None:
            every[row] = held
        return histories.run(np.repeat(strain, size), betas, np.repeat(creep, size), every)[0]

    def relax(held: FloatArray, base: FloatArray, tolerance: float) -> Relaxed:
        position = history(np.repeat(beta, len(held)), held)[:, row]
        zero, settled = np.zeros(len(held)), np.isfinite(position[:, 0, 0])
        count, no = zero.astype(np.int64), np.zeros(len(held), dtype=bool)
        return Relaxed(position, zero, zero, count, settled, ~settled, smoothed=count, unaided=no, out_of_time=no)

    response = part.response(tuple(best.at), simulated[row], relax)
    part.choose(simulated[row][None], response)
    part.kept = part.chosen
    first, count = (int(some.sum()) * one.rest.shape[1] for some in (histories.judged[:row], histories.judged[row]))
    others = best.jacobian[first : first + count].T.reshape(len(best.at), -1, one.rest.shape[1])
    some = np.searchsorted(np.flatnonzero(histories.judged[row]), part.judged)

    def states(stretched: FloatArray) -> FloatArray:
        return history(histories.shrink(stretched))

    body = FittedBody(
        part,
        histories.model.grouping(one),
        simulated[row],
        response,
        others[:, some],
        states=lambda stretched: states(stretched)[:, row],
        whole=(histories.observed, lambda stretched: histories.compared(states(stretched))),
    )
    yield from two_materials([body], float(beta[0]), BETA_LIMIT)
