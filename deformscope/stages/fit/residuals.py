"""Residuals of an observation: particles that count, model of errors, and effect of wrong prescribed positions."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import logsumexp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.noise import ErrorModel, Measured, NoiseHypotheses
from deformscope.stages.fit.systematic import TOOL_SHIFT
from deformscope.stages.msm.solver import TOLERANCE, Msm, Relaxed

Relax = Callable[[FloatArray, FloatArray, float], Relaxed]
"""Static states for held positions (B, n, d), from a start (K, d), to a tolerance (see `Msm.relax`)."""

STEP, STEP_TOLERANCE = 3e-3, 1e-3
"""Step of a held coordinate, in spacings, by which its effect is found, and how well, as a share of the step."""

AT_ONCE = 64
"""Number of steps of held positions that are simulated together."""

DROP = 14.0
"""Difference from the highest log density at which a value no longer counts."""

WEIGHT_LEAST, WEIGHT_LEAST_OF_SOME = 1e-3, 2e-2
"""Hypotheses of less weight than this are left out once the data have been seen."""

TEMPER = 0.3
"""Power of the likelihood by which explanations are weighed, and share of the coordinates that count as independent
where their size is uncertain. No explanation on the list is the true one, and the finest detail of the residuals, which
decides between them at full power, says little of the long waves that a parameter is mistaken for (a coarsened
posterior: Miller and Dunson 2019). Compared with 0.1 and 1 on tuning seeds, 90 bodies per kind of error. At 1 intervals
held 0.83 to 0.84 for errors shared over 3 and 6 cells, at 0.3 0.87 to 0.88, at 0.1 0.90."""

SYSTEMATIC_LEAST = 0.1
"""Least effect of an error of tool or camera along a direction, in deviations of the noise, that counts."""

RESOLVED = 1e-14
"""Share of the mean variance of projections below which a variance is a rounding error."""

SUMMARIES, SUMMARY_LEAST = 3, 0.02
"""Directions that represent the parameter's effect on the particles: largest number, and least share."""

MOST_PARTICLES, MOST_FOR_CHOICE = 1500, 150
"""Particles that the likelihood is taken from (of more, a random part), and those that hypotheses are chosen by."""

MOST_HELD, SKETCHED = 200, 100
"""Held coordinates whose effect is computed one by one; beyond, this many random combinations stand for them."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """The errors of one observation, each model with its weight, (h,).

    weight: weight by the tempered likelihood, for the parameter; likely: weight by the likelihood, for predicted errors
    white: deviation of the white noise, as a multiple of the stated one (or in the unit of the rest shape)
    field: deviation of the smooth field [unit]; length: its correlation length [spacings]; shared: prescribed particles
    have the field too, so that it is measurement and not misfit; held: the prescribed positions were noisy"""

    weight: FloatArray
    likely: FloatArray
    white: FloatArray
    field: FloatArray
    length: FloatArray
    shared: BoolArray
    held: BoolArray

    def misfit(self) -> float:
        """Root mean square of the model's error, per coordinate [unit]."""
        return float(np.sqrt(self.weight @ np.where(self.shared, 0.0, self.field**2)))


class Residuals:
    """One observation: its free particles that count, its errors, and the effect of its held particles."""

    def __init__(self, seen: Observation, body: Msm, rng: np.random.Generator) -> None:
        self.seen, self.body = seen, body
        judged: IntArray = np.flatnonzero(seen.free_observed)
        if judged.size > MOST_PARTICLES:
            judged = np.sort(rng.permutation(judged)[:MOST_PARTICLES])
        self.judged = judged
        self.observed = seen.deformed[judged]
        floor = 10.0 * TOLERANCE[body.precision] * body.extent
        floor += 4.0 * float(np.finfo(np.float64).eps * np.abs(seen.deformed[seen.observed]).max())
        count, d = len(seen.held), seen.rest.shape[1]
        sketched = count * d > MOST_HELD
        if sketched:
            deviation = np.ones(count) if seen.noise is None else seen.noise[seen.held]
            self.steps = rng.standard_normal((SKETCHED, count, d)) * deviation[:, None] / np.sqrt(SKETCHED)
        else:
            self.steps = np.eye(count * d).reshape(-1, count, d)
        self.measured = Measured(
            rest=seen.rest[judged],
            held_rest=None if sketched else seen.rest[seen.held],
            noise=None if seen.noise is None else seen.noise[judged],
            held_noise=None if seen.noise is None else seen.noise[seen.held],
            held_measured=seen.held_measured,
            spacing=body.scale,
            floor=floor,
            loose=None if seen.loose is None or sketched else np.isin(seen.held, seen.loose),
            touched=None if sketched else np.isin(seen.held, seen.touched),
            shift=TOOL_SHIFT * body.scale if seen.held_shift is None else seen.held_shift,
        )
        self.errors = ErrorModel(self.measured)
        self.chosen: IntArray = np.arange(len(self.errors.hypotheses.size))
        self.kept: IntArray = self.chosen
        self.explanation: Explanation
        self._responses: dict[Hashable, FloatArray] = {}
        self._some = np.sort(rng.permutation(len(judged))[:MOST_FOR_CHOICE]) if len(judged) > MOST_FOR_CHOICE else None

    def left(self, position: FloatArray) -> FloatArray:
        """Observed - simulated (..., K, d) at the particles that count, (..., n, d)."""
        return np.asarray(self.observed - position[..., self.judged, :])

    def choose(self, position: FloatArray, response: FloatArray) -> None:
        """Keep the hypotheses that may matter, judged by states (g, K, d) of good and bad values."""
        residual, errors = self.left(position), self.errors
        if self._some is not None:
            errors = ErrorModel(self.measured.some(self._some))
            residual, response = residual[:, self._some], response[self._some]
        products = errors.products(residual, response, settle=True)
        self.errors.log_scale = errors.log_scale
        value = errors.judged(products, np.eye(len(residual))).log_likelihood
        # a value of the parameter that fits badly asks for explanations that no good one needs
        total = logsumexp(value, axis=0)
        good = total > total.max() - DROP
        weight = np.exp(value[:, good] - total[good]).max(axis=1)
        # what is unlikely for some of the particles is more so for all
        least = WEIGHT_LEAST if self._some is None else WEIGHT_LEAST_OF_SOME
        self.chosen = np.flatnonzero(weight >= least ** (1.0 / TEMPER))

    def response(self, parameter: Hashable, base: FloatArray, relax: Relax, *, exact: bool = True) -> FloatArray:
        """How a unit step along each direction of the held positions moves the particles that count, (n, d, m).

        base: (K, d) static state at `parameter`, the key of stored responses; relax: states for held positions
        exact: no response is computed if the held positions were stated to be exact"""
        if exact and self.measured.held_measured is False and self.measured.loose is None:
            return np.zeros((len(self.judged), self.observed.shape[1], 0))
        if parameter not in self._responses:
            small = STEP * self.body.scale / (float(np.abs(self.steps).max()) or 1.0)
            tolerance = max(STEP * STEP_TOLERANCE * self.body.scale / self.body.extent, TOLERANCE[self.body.precision])
            moves = np.empty((len(self.steps), len(self.judged), base.shape[1]))
            for first in range(0, len(self.steps), AT_ONCE):
                held = base[self.seen.held] + small * self.steps[first : first + AT_ONCE]
                moves[first : first + AT_ONCE] = (relax(held, base, tolerance).position - base)[:, self.judged] / small
            self._responses[parameter] = np.moveaxis(moves, 0, -1)
        return self._responses[parameter]

    def weigh(self, log_likelihood: FloatArray, log_scale: FloatArray, over: FloatArray) -> Explanation:
        """Weights and scales of the hypotheses, from log likelihoods (h, f) averaged over a posterior (f,)."""
        log_prior = self.errors.hypotheses.log_prior[self.chosen, None]
        likely = _shares(log_likelihood, over).sum(axis=1)
        share = _shares(log_prior + TEMPER * (log_likelihood - log_prior), over)
        weight = share.sum(axis=1)
        keep = weight > WEIGHT_LEAST * weight.max()
        white2 = (share * np.exp(2.0 * log_scale)).sum(axis=1)[keep] / weight[keep]
        self.kept = self.chosen[keep]
        every: NoiseHypotheses = self.errors.hypotheses
        unit = float(np.sqrt(np.mean(self.errors.noise**2)))
        self.explanation = Explanation(
            weight=weight[keep] / weight[keep].sum(),
            likely=likely[keep] / likely[keep].sum(),
            white=np.sqrt(white2),
            field=np.sqrt(white2 * every.size[self.kept]) * unit,
            length=every.length[self.kept],
            shared=every.shared[self.kept],
            held=every.held[self.kept],
        )
        return self.explanation

    def summary(
        self, residual: FloatArray, response: FloatArray, most: int = SUMMARIES
    ) -> tuple[FloatArray, FloatArray]:
        """Effect of the parameter, and of errors of tool and camera, on the residuals (f, n, d), as few directions (n,
        d, q), weighted by each particle's noise and misfit; and the second moment (a, a) of those errors' factors.

        Details that the parameter does not change distinguish such errors from it if white noise dominates. If misfit
        and shared errors outweigh it, they only bound the size of such errors.
        response: that of held positions (n, d, m)"""
        one = self.explanation
        variance = one.weight @ one.white**2 * self.errors.noise**2 + one.weight @ one.field**2
        weight = np.repeat(variance**-0.5, residual.shape[2])
        moved = (residual - residual.mean(axis=0)).reshape(len(residual), -1) * weight
        others = self.errors.modes(response, held=True).reshape(len(weight), -1) * weight[:, None]
        prior = np.eye(others.shape[1])
        off = self.errors.deviations(self.errors.hypotheses.off[self.kept], len(prior))
        share = np.sqrt(one.weight @ (off > 0.0))  # how likely each is off at all
        often = np.outer(share, share)
        size, axes = eigh(moved @ moved.T)
        size, axes = size[::-1], axes[:, ::-1]
        if size[0] <= 0.0:  # it does nothing: any direction will do
            return np.asarray(weight.reshape(*residual.shape[1:], 1)), often * prior
        count = max(1, min(most, int(np.count_nonzero(size > SUMMARY_LEAST**2 * size[0]))))
        along = moved.T @ axes[:, :count] / np.sqrt(size[:count])
        across, spread, _ = np.linalg.svd(others - along @ (along.T @ others), full_matrices=False)
        across = across[:, spread > SYSTEMATIC_LEAST]
        both = np.concatenate([along, across], axis=1), across
        onto, details = ((some * weight[:, None]).reshape(*residual.shape[1:], -1) for some in both)
        noisy = one.weight @ one.field**2 < np.mean(one.weight @ one.white**2 * self.errors.noise**2)
        if noisy or not across.size:
            return onto, often * prior
        onto = onto[..., :count]
        best = residual[np.sum(np.tensordot(residual, onto, 2) ** 2, axis=1).argmin()]
        each = self.errors.projected(details, response, self.kept, 0.0 * prior)
        noise = np.tensordot(one.weight * one.white**2, each, 1)
        act = across.T @ others
        by = np.linalg.solve(noise, act)
        left = np.linalg.inv(prior + act.T @ by)
        mean = left @ by.T @ np.tensordot(details, best, ((0, 1), (0, 1)))
        return onto, often * (left + np.outer(mean, mean))

    def log_summary(
        self, residual: FloatArray, onto: FloatArray, amplitude: FloatArray, response: FloatArray
    ) -> FloatArray:
        """Log likelihood (f,) of the projections of residuals (f, n, d) onto the directions of `summary`: Student's t,
        as wide as the noise's scale is uncertain."""
        one = self.explanation
        z = np.tensordot(residual, onto, 2)
        freedom, q = TEMPER * residual.shape[1] * residual.shape[2], onto.shape[2]
        covariance = self.errors.projected(onto, response, self.kept, amplitude)
        # where there is next to no noise, errors of a tool outweigh it by more than numbers resolve
        covariance += RESOLVED * np.trace(covariance, axis1=1, axis2=2)[:, None, None] / q * np.eye(q)
        covariance *= one.white[:, None, None] ** 2
        chi2 = np.einsum("fi,hij,fj->hf", z, np.linalg.inv(covariance), z)
        log_det = np.linalg.slogdet(covariance)[1][:, None]
        each = -0.5 * log_det - 0.5 * (freedom + q) * np.log1p(chi2 / freedom)
        return np.asarray(logsumexp(each + np.log(one.weight)[:, None], axis=0))


def _shares(log_likelihood: FloatArray, over: FloatArray) -> FloatArray:
    """(h, f) probability of each hypothesis at each value of the parameter, times the posterior (f,) there."""
    total = logsumexp(log_likelihood, axis=0)
    return np.asarray(np.exp(log_likelihood - np.where(np.isfinite(total), total, 0.0)) * over)
