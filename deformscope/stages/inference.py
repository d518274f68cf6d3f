"""The posterior of one parameter, given all candidates that a search has simulated.

The prior is flat over the range that is searched. The likelihood is that of `deformscope.stages.noise`, its
hypotheses weighed and summed at each value; what is simulated between candidates is a cubic spline of them, in
-log(1 - beta), which spreads out what happens near 1. The range is narrowed until the spline's knots resolve the
posterior, however narrow it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.estimate import Posterior
from deformscope.stages.model import Observation
from deformscope.stages.msm.solver import TOLERANCE
from deformscope.stages.noise import ErrorModel, Hypotheses, Measured
from deformscope.stages.search import Progress, Search

KNOTS, BETWEEN = 25, 8
"""Candidates over the range, and steps of the grid from one to the next."""

ZOOMS = 10

RESOLVED = 0.3
"""The posterior is resolved where it fills this share of the range."""

DROP = 14.0
"""Values whose log density is this far below the highest do not count."""

NARROWEST = 1e-9
"""Range below which nothing is resolved: candidates there differ by the solver's tolerance alone."""

WEIGHT_LEAST = 1e-3
"""Hypotheses of less weight than this are left out once the data have been seen."""

MOST_PARTICLES, MOST_FOR_CHOICE = 1500, 150
"""Particles that the likelihood is taken from (of more, a random part), and those that hypotheses are chosen by."""

MOST_HELD, SKETCHED = 450, 100
"""Held coordinates whose effect is computed one by one; beyond, this many random combinations stand for them."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """What the errors of one observation were like, each with its weight, (h,).

    white: deviation of the white noise, as a multiple of the stated one (or in the unit of the rest shape)
    field: deviation of the smooth field [unit]; length: its correlation length [spacings]; shared: by prescribed
    particles, hence measurement and not misfit; held: the prescribed positions were noisy
    """

    weight: FloatArray
    white: FloatArray
    field: FloatArray
    length: FloatArray
    shared: BoolArray
    held: BoolArray

    def misfit(self) -> float:
        """Root mean square of what the model cannot do, a coordinate [unit]."""
        return float(np.sqrt(self.weight @ np.where(self.shared, 0.0, self.field**2)))


@dataclass(frozen=True, slots=True)
class Inferred:
    """posterior; explanations: one an observation; noise: typical white noise of a coordinate [unit]
    rise: by how many standard deviations the data tell the likeliest value of the range from the least likely
    converged: all simulations that it rests on have settled"""

    posterior: Posterior
    explanations: tuple[Explanation, ...]
    noise: float
    rise: float
    converged: bool


class Inference:
    """The posterior over what a search has simulated."""

    def __init__(self, search: Search, seed: int) -> None:
        self.search = search
        rng = np.random.default_rng(seed)
        self.parts = [_Part(search, row, rng) for row in range(len(search.seen))]
        self.converged = True

    def run(self, progress: Progress | None = None) -> Inferred:
        search = self.search
        low, high = (search.stretch(bound) for bound in search.bounds)
        best = float(search.tried.parameter[search.best()])
        for part in self.parts:
            part.choose(search, best)
        fine, each, total = self._over(low, high)
        finite = total[np.isfinite(total)]
        rise = float(np.sqrt(2.0 * (finite.max() - finite.min())))
        for zoom in range(ZOOMS):
            if progress is not None:
                progress("interval", zoom, ZOOMS)
            alive = np.flatnonzero(total >= total.max() - DROP)
            first, last = max(alive[0] - 1, 0), min(alive[-1] + 1, len(fine) - 1)
            if last - first >= RESOLVED * len(fine) or fine[last] - fine[first] < NARROWEST:
                break
            fine, each, total = self._over(fine[first], fine[last])
        grid = search.shrink(fine)
        density = np.exp(total - total.max())
        area = float(np.trapezoid(density, grid))
        if area <= 0.0:  # a single value is left
            density, area = np.ones_like(density), float(grid[-1] - grid[0]) or 1.0
        posterior = Posterior(grid, density / area)
        share = density * np.gradient(grid)
        explanations = tuple(
            part.explain(one - logsumexp(one, axis=0), share / share.sum())
            for part, one in zip(self.parts, each, strict=True)
        )
        white = [
            float(np.sqrt(e.weight @ e.white**2)) * p.errors.noise
            for e, p in zip(explanations, self.parts, strict=True)
        ]
        return Inferred(
            posterior, explanations, float(np.sqrt(np.mean(np.concatenate(white) ** 2))), rise, self.converged
        )

    def _over(self, low: float, high: float) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        """A grid (f,) of stretched values, the log likelihoods there of each observation (h, f), and of all (f,)."""
        search = self.search
        knots, fine = np.linspace(low, high, KNOTS), np.linspace(low, high, (KNOTS - 1) * BETWEEN + 1)
        rows = search.rows_of(search.shrink(knots))
        usable = search.tried.usable[rows]
        self.converged &= bool(search.tried.converged[rows[usable]].all())
        standing = np.flatnonzero(usable)
        nearest = standing[np.abs(np.arange(len(knots))[:, None] - standing).argmin(axis=1)]
        out = ~np.interp(fine, knots, usable.astype(float)).astype(bool)
        nodes = np.unique(nearest[np.array([0, len(knots) // 2, len(knots) - 1])])
        found = []
        for row, part in enumerate(self.parts):
            position = search.tried.positions[row][rows[nearest]][:, part.judged]
            residual = part.observed - CubicSpline(knots, position, axis=0)(fine)
            at_nodes = []
            for node in nodes:
                response = part.response(search, int(rows[node]))
                at_nodes.append(part.errors.evidence(residual, response, part.chosen))
            value = _between(knots[nodes], fine, [one.log_likelihood for one in at_nodes])
            part.log_scale = _between(knots[nodes], fine, [one.log_scale for one in at_nodes])
            value[:, out] = -np.inf
            found.append(value)
        return fine, found, np.sum([logsumexp(one, axis=0) for one in found], axis=0)


def _between(nodes: FloatArray, at: FloatArray, values: Sequence[FloatArray]) -> FloatArray:
    """Straight lines between values (h, f) at nodes, each for all `at` (f,)."""
    if len(nodes) == 1:
        return values[0].copy()
    place = np.interp(at, nodes, np.arange(len(nodes)))
    left = np.minimum(place.astype(int), len(nodes) - 2)
    share = place - left
    every: FloatArray = np.stack(values)
    columns = np.arange(len(at))
    lower, upper = every[left, :, columns], every[left + 1, :, columns]
    return np.asarray(((1.0 - share)[:, None] * lower + share[:, None] * upper).T)


class _Part:
    """One observation: its free particles that count, its errors, and what its held ones do."""

    def __init__(self, search: Search, row: int, rng: np.random.Generator) -> None:
        self.row = row
        seen: Observation = search.seen[row]
        body = search.bodies[row]
        judged: IntArray = np.flatnonzero(seen.free_observed)
        if judged.size > MOST_PARTICLES:
            judged = np.sort(rng.permutation(judged)[:MOST_PARTICLES])
        self.judged = judged
        self.observed = seen.deformed[judged]
        floor = 10.0 * TOLERANCE[search.model.precision] * body.extent
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
        )
        self.errors = ErrorModel(self.measured)
        self.chosen: IntArray = np.arange(len(self.errors.hypotheses.size))
        self.log_scale: FloatArray = np.zeros((0, 0))
        self._responses: dict[float, FloatArray] = {}
        self._some = np.sort(rng.permutation(len(judged))[:MOST_FOR_CHOICE]) if len(judged) > MOST_FOR_CHOICE else None

    def choose(self, search: Search, best: float) -> None:
        """Keep the hypotheses that may matter: by the residuals at the lowest error and at ten values beside it."""
        place = int(np.abs(search.tried.parameter - best).argmin())
        spread = np.linspace(0, len(search.tried.parameter) - 1, 10).round().astype(int)
        rows = np.unique([place, *spread[search.tried.usable[spread]]])
        residual = self.observed - search.tried.positions[self.row][rows][:, self.judged]
        response = self.response(search, place)
        errors = self.errors
        if self._some is not None:
            errors = ErrorModel(self.measured.some(self._some))
            residual, response = residual[:, self._some], response[self._some]
        value = errors.evidence(residual, response).log_likelihood
        # a value of the parameter that fits badly asks for explanations that no good one needs
        good = value[:, logsumexp(value, axis=0) > logsumexp(value, axis=0).max() - DROP]
        weight = np.exp(good - logsumexp(good, axis=0)).max(axis=1)
        self.chosen = np.flatnonzero(weight >= WEIGHT_LEAST)

    def response(self, search: Search, place: int) -> FloatArray:
        """How a unit step along each direction of the held positions moves the particles that count, (n, d, m)."""
        parameter = float(search.tried.parameter[place])
        if self.measured.held_measured is False:
            return np.zeros((len(self.judged), self.observed.shape[1], 0))
        if parameter not in self._responses:
            seen, body = search.seen[self.row], search.bodies[self.row]
            base = search.tried.positions[self.row][place]
            small = 1e-3 * body.scale / (float(np.abs(self.steps).max()) or 1.0)
            moves = np.empty((len(self.steps), len(self.judged), base.shape[1]))
            for first in range(0, len(self.steps), 64):
                held = base[seen.held] + small * self.steps[first : first + 64]
                moved = search.relax(body, held, parameter, base).position
                moves[first : first + 64] = (moved - base)[:, self.judged] / small
            self._responses[parameter] = np.moveaxis(moves, 0, -1)
        return self._responses[parameter]

    def explain(self, log_share: FloatArray, over: FloatArray) -> Explanation:
        """Weights of the hypotheses, (h, f) at each value, averaged over the posterior (f,)."""
        every: Hypotheses = self.errors.hypotheses
        share = np.exp(np.where(np.isfinite(log_share), log_share, -np.inf)) * over
        weight = share.sum(axis=1)
        keep = weight > WEIGHT_LEAST * weight.max()
        scale = np.exp(2.0 * self.log_scale)
        white = np.sqrt((share * scale).sum(axis=1)[keep] / weight[keep])
        rows = self.chosen[keep]
        unit = float(np.sqrt(np.mean(self.errors.noise**2)))
        return Explanation(
            weight=weight[keep] / weight[keep].sum(),
            white=white,
            field=white * unit * np.sqrt(every.size[rows]),
            length=every.length[rows],
            shared=every.shared[rows],
            held=every.held[rows],
        )
