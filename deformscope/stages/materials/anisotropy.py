"""beta along each axis of a material, from pairs of rest and deformed positions; and whether a single beta is
sufficient."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import scipy

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit import least_squares
from deformscope.stages.fit.calibrate import BETA_LIMIT, Model, Observation, explained, shape_doubts
from deformscope.stages.fit.doubts import bulging, found_in_numbers, noise_source, ordered, residual_ratio, swapped_axes
from deformscope.stages.fit.estimate import Doubt, Identifiability, verdict
from deformscope.stages.fit.least_squares import Noise
from deformscope.stages.fit.noise import independent, shared_over
from deformscope.stages.fit.residuals import Residuals
from deformscope.stages.fit.search import Progress
from deformscope.stages.fit.two_materials import FittedBody, two_materials
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.msm.materials import AxisBeta
from deformscope.stages.msm.solver import TOLERANCE, Msm, Relaxed

RANGE = np.linspace(0.0, -np.log1p(-0.99), 13)
"""Values of -log(1 - beta), the same along all axes; the search starts from the best of them."""

DIFFERENCE = 2e-3
"""Change of -log(1 - beta), for derivatives."""

HELD_REPEATS = 48
"""Number of draws of the prescribed positions' noise."""

SURE = 0.99
"""Level at which a single beta for all axes is rejected."""


def fit_axes(
    seen: Sequence[Observation],
    model: Model,
    *,
    axes: FloatArray | None = None,
    level: float = 0.9,
    seed: int = 0,
    progress: Progress | None = None,
) -> AxisEstimate:
    """The betas along `axes` (d, d; default x, y, z) that leave the least squared error over all observations.

    The intervals are Gaussian in -log(1 - beta), with the noise of observed and of measured prescribed positions.
    Errors that neighbours share, as those of a misfitting model, widen them. The verdicts follow the rule of one
    beta: `at-bound` if the interval reaches 0 or the upper end of the search. It is `unidentified` if it is wide, the
    error does not rise over the range of that beta, or the betas explain too little of the motion."""
    d = seen[0].rest.shape[1]
    if any(s.rest.shape[1] != d for s in seen):
        raise InputError("observations in the plane, or in space", "both", "fit them apart")
    if model.basis != "linear" or model.theta != 0.0:
        raise InputError("linear clusters and theta 0 with a beta along each axis", "something else")
    directions = np.eye(d) if axes is None else np.asarray(axes, dtype=np.float64)
    fit = _AxisFit(seen, model, directions)
    observed = fit.observed()
    note = progress or (lambda what, done, total: None)
    note("one beta", 0, 2)
    top = float(-np.log1p(-BETA_LIMIT))
    one_bounds = np.array([[0.0, top]])
    every = RANGE[:, None]
    squares = np.sum((observed - fit.isotropic(every)) ** 2, axis=1)
    if not np.isfinite(squares).any():
        raise InputError("a simulation that settles", "none for any beta", "check the held particles")
    start, bounds = every[int(np.nanargmin(squares))], np.repeat(one_bounds, d, axis=0)
    even = least_squares.minimise(fit.isotropic, observed, start, one_bounds, np.array([DIFFERENCE]))
    note("axes", 1, 2)
    best = least_squares.minimise(fit.along, observed, np.repeat(even.at, d), bounds, np.full(d, DIFFERENCE))
    noise = fit.noise(best, np.random.default_rng(seed))
    covariance = noise.covariance(best.jacobian)
    freedom = observed.size - d
    half = least_squares.half_width(covariance, level, freedom)
    ends = -np.expm1(-np.clip(np.column_stack([best.at - half, best.at + half]), 0.0, top))
    away = best.simulated - even.simulated
    excess = max(even.squares - best.squares, 0.0) / noise.variance_along(away)
    p_isotropic = float(scipy.stats.chi2.sf(excess, d - 1))
    converged = bool(best.converged and even.converged and np.isfinite(best.jacobian).all())
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    share, misfit = explained(seen, fit.positions(best)), least_squares.deviation_of(best.residual, d)
    identifiability = tuple(
        Identifiability(rise, share, deviation=float(spread * np.exp(-at)), misfit=misfit)
        for rise, spread, at in zip(fit.rises(best, noise), deviation, best.at, strict=True)
    )
    reasons = fit.reasons(best, ends, identifiability, converged=converged)
    strain, strain_sd = mean_strain(seen, directions, noise.deviation)
    verdicts = tuple(
        verdict((float(low), float(high)), (0.0, BETA_LIMIT), one, some)
        for (low, high), one, some in zip(ends, identifiability, reasons, strict=True)
    )
    return AxisEstimate(
        axes=directions,
        value=-np.expm1(-best.at),
        interval=ends,
        level=level,
        correlation=covariance / np.outer(deviation, deviation),
        verdict=verdicts,
        reasons=reasons,
        identifiability=identifiability,
        anisotropic=converged and p_isotropic < 1.0 - SURE,
        p_isotropic=p_isotropic,
        beta=float(-np.expm1(-even.at[0])),
        aee=fit.aee(best.simulated),
        aee_isotropic=fit.aee(even.simulated),
        noise=noise.deviation,
        converged=converged,
        settings={
            "cluster_size": model.cluster_size,
            "mode": model.basis,
            "theta": model.theta,
            "precision": model.precision,
            "device": model.device,
            "seed": seed,
            "noise_source": noise_source(seen),
        },
        strain=strain,
        strain_sd=strain_sd,
        unit=seen[0].unit,
        metres_per_unit=seen[0].metres_per_unit,
    )


def mean_strain(seen: Sequence[Observation], axes: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """(d,) strain along each axis (d, d) of the affine motion nearest to the observation, and its standard deviation by
    noise; the mean over observations."""
    strains, variances = [], []
    for one in seen:
        rest = one.rest[one.observed] - one.rest[one.observed].mean(axis=0)
        moved = one.deformed[one.observed]
        slope = np.linalg.lstsq(rest, moved - moved.mean(axis=0), rcond=None)[0].T
        stretch = slope.T @ slope
        strains.append(np.sqrt(np.einsum("ik,ij,jk->k", axes, stretch, axes)) - 1.0)
        variances.append(noise**2 * np.einsum("ik,ij,jk->k", axes, np.linalg.pinv(rest.T @ rest), axes))
    return np.mean(strains, axis=0), np.sqrt(np.sum(variances, axis=0)) / len(seen)


class _AxisFit:
    """Static states of all observations for betas along the axes, in coordinates -log(1 - beta)."""

    def __init__(self, seen: Sequence[Observation], model: Model, axes: FloatArray) -> None:
        self.seen, self.model, self.axes = list(seen), model, axes
        self.bodies: list[Msm] = [model.body(s) for s in seen]
        self.starts: list[FloatArray | None] = [None for _ in seen]
        self.judged: list[BoolArray] = [s.free_observed for s in seen]

    def observed(self) -> FloatArray:
        """(n,) free observed coordinates of all observations."""
        return np.concatenate([s.deformed[j].ravel() for s, j in zip(self.seen, self.judged, strict=True)])

    def along(self, stretched: FloatArray) -> FloatArray:
        """(B, n) for (B, d)."""
        beta = AxisBeta(np.clip(-np.expm1(-stretched), 0.0, BETA_LIMIT), self.axes)
        return self._relax(beta, [s.deformed[s.held] for s in self.seen], len(stretched))

    def isotropic(self, stretched: FloatArray) -> FloatArray:
        """(B, n) for one beta along all axes, (B, 1)."""
        return self.along(np.repeat(stretched, len(self.axes), axis=1))

    def noise(self, best: least_squares.Minimum, rng: np.random.Generator) -> Noise:
        """Noise of the observed numbers: the stated one, else the fit's residual; and of the held ones alike."""
        stated = [s.noise[j] for s, j in zip(self.seen, self.judged, strict=True) if s.noise is not None]
        least = max(10.0 * TOLERANCE[body.precision] * body.extent for body in self.bodies)
        if len(stated) == len(self.seen):
            least = max(least, float(np.sqrt(np.mean(np.concatenate(stated) ** 2))))
        tried = max(least, least_squares.deviation_of(best.residual, len(best.at)))
        shaken = []
        for s in self.seen:
            held, size = s.deformed[s.held], 0.0 if s.held_measured is False else tried
            shaken.append(held + size * rng.standard_normal((HELD_REPEATS, *held.shape)))
        beta = AxisBeta(-np.expm1(-best.at), self.axes)
        moved = self._relax(beta, shaken, HELD_REPEATS) - best.simulated
        moved = moved[np.isfinite(moved).all(axis=1)]
        found = least_squares.shared_noise(best.residual, len(best.at), moved, tried, least)
        # a misfit is shared by neighbours: a mean of the residuals varies more than if they shared no error
        worth = count = 0.0
        for s, j, body, one in zip(self.seen, self.judged, self.bodies, self.positions(best), strict=True):
            points, residual = s.rest[j], (s.deformed - one)[j]
            length = shared_over(points, residual, body.scale)
            worth += independent(points, length) if length > 0.0 else len(points)
            count += len(points)
        return dataclasses.replace(found, shared=count / worth)

    def rises(self, best: least_squares.Minimum, noise: Noise) -> list[float]:
        """By how many standard deviations the data separate each beta from the least likely one of its range, (d,)."""
        d = len(best.at)
        tried = np.repeat(best.at[None], d * len(RANGE), axis=0)
        for k in range(d):
            tried[k * len(RANGE) : (k + 1) * len(RANGE), k] = RANGE
        square = np.zeros(len(tried))
        for row, simulated in enumerate(self.along(tried)):
            if np.isfinite(simulated).all():
                away = simulated - best.simulated
                more = float(np.sum((best.residual - away) ** 2)) - best.squares
                square[row] = max(more, 0.0) / noise.variance_along(away)
        return [float(np.sqrt(one)) for one in square.reshape(d, -1).max(axis=1)]

    def reasons(
        self,
        best: least_squares.Minimum,
        ends: FloatArray,
        identifiability: Sequence[Identifiability],
        *,
        converged: bool,
    ) -> tuple[tuple[Doubt, ...], ...]:
        """(d,) reasons to doubt each beta."""
        floor = max(10.0 * TOLERANCE[body.precision] * body.extent for body in self.bodies)
        ratio = residual_ratio(self.seen, self.positions(best), floor)
        common = [*shape_doubts(self.seen), *(self._in_residuals(best) if converged else ())]
        noise = ratio, None, noise_source(self.seen)
        found = []
        for (low, high), one in zip(ends, identifiability, strict=True):
            own = float(low), float(high)
            numbers = found_in_numbers("beta", own, one, converged=converged, noise=noise, seen=self.seen)
            found.append(ordered([*numbers, *common]))
        return tuple(found)

    def _in_residuals(self, best: least_squares.Minimum) -> Iterator[Doubt]:
        """Evidence of simulations with other axes, and with two materials, in the residuals of the best."""
        tried = np.concatenate([np.repeat(RANGE[::3, None], len(best.at), axis=1), best.at[None]])

        def simulate(shapes: Sequence[FloatArray]) -> list[FloatArray]:
            beta = AxisBeta(np.clip(-np.expm1(-tried), 0.0, BETA_LIMIT), self.axes)
            each = zip(self.seen, self.bodies, shapes, strict=True)
            return [body.relax(shape[one.held], beta).settled for one, body, shape in each]

        bulge = bulging(self.seen, self.bodies, -np.expm1(-tried.mean(axis=1)))
        yield from swapped_axes(self.seen, simulate, bulge)
        if any(body.cluster_count < 2 for body in self.bodies):
            return
        rng, bodies, first = np.random.default_rng(0), [], 0
        for row, one in enumerate(self.seen):
            part, body = Residuals(one, self.bodies[row], rng), self.bodies[row]
            count = int(self.judged[row].sum()) * one.rest.shape[1]
            slope = best.jacobian[first : first + count].T.reshape(len(best.at), -1, one.rest.shape[1])
            first += count
            along = body.variant(axes=self.axes)
            simulated = self._at(along, one, best.at[None, None])[0]

            def relax(held: FloatArray, base: FloatArray, tolerance: float, along: Msm = along) -> Relaxed:
                beta = -np.expm1(-best.at)[None, None]
                return along.relax(held, np.repeat(beta, len(held), axis=0), start=base, tolerance=tolerance)

            response = part.response(tuple(best.at), simulated, relax)
            part.choose(simulated[None], response)
            part.kept = part.chosen

            def states(stretched: FloatArray, along: Msm = along, one: Observation = one) -> FloatArray:
                # each cluster's betas change alike, from where they are along the axes
                change = stretched - float(best.at.mean())
                return self._at(along, one, best.at + change[..., None])

            rows = np.searchsorted(np.flatnonzero(self.judged[row]), part.judged)
            bodies.append(FittedBody(part, self.model.grouping(one), simulated, response, slope[:, rows], states))
        yield from two_materials(bodies, float(-np.expm1(-best.at.mean())), BETA_LIMIT)

    @staticmethod
    def _at(along: Msm, one: Observation, stretched: FloatArray) -> FloatArray:
        """(B, K, d) for -log(1 - beta) along the axes of each cluster (B, C or 1, d), NaN where it did not settle."""
        beta = np.clip(-np.expm1(-stretched), 0.0, BETA_LIMIT)
        return along.relax(one.deformed[one.held], beta).settled

    def positions(self, best: least_squares.Minimum) -> list[FloatArray]:
        """(K, d) of every observation at the best betas; unjudged particles are as observed."""
        found, first = [], 0
        for s, j in zip(self.seen, self.judged, strict=True):
            position, size = s.deformed.copy(), int(j.sum()) * s.rest.shape[1]
            position[j] = best.simulated[first : first + size].reshape(-1, s.rest.shape[1])
            found.append(position)
            first += size
        return found

    def aee(self, simulated: FloatArray) -> float:
        """Average Euclidean error of simulated coordinates (n,) over all observed particles, in their unit of length;
        the held ones, which have none, are included."""
        total, count, first = 0.0, 0, 0
        for s, j in zip(self.seen, self.judged, strict=True):
            size = int(j.sum()) * s.rest.shape[1]
            found = simulated[first : first + size].reshape(-1, s.rest.shape[1])
            total += float(np.linalg.norm(found - s.deformed[j], axis=1).sum())
            count += int(s.observed.sum())
            first += size
        return total / count

    def _relax(self, beta: AxisBeta, held: Sequence[FloatArray], size: int) -> FloatArray:
        """(B, n) simulated coordinates that are judged, NaN where a simulation did not converge. held: (B, h, d) by
        observation"""
        parts = []
        for row, (body, judged) in enumerate(zip(self.bodies, self.judged, strict=True)):
            found = body.relax(held[row], beta, start=self.starts[row])
            position = np.where(found.converged[:, None, None], found.position, np.nan)
            if found.converged.any():
                self.starts[row] = found.position[int(np.argmax(found.converged))]
            parts.append(position[:, judged].reshape(len(position), -1))
        return np.concatenate([np.broadcast_to(part, (size, part.shape[1])) for part in parts], axis=1)
