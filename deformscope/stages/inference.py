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

from deformscope.arrays import FloatArray
from deformscope.stages.estimate import Posterior
from deformscope.stages.residuals import DROP, Explanation, Residuals
from deformscope.stages.search import Progress, Search

KNOTS, BETWEEN = 25, 8
"""Candidates over the range, and steps of the grid from one to the next."""

ZOOMS = 10

RESOLVED = 0.3
"""The posterior is resolved where it fills this share of the range."""

NARROWEST = 1e-9
"""Range below which nothing is resolved: candidates there differ by the solver's tolerance alone."""


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
        self.parts = [Residuals(seen, body, rng) for seen, body in zip(search.seen, search.bodies, strict=True)]
        self.converged = True

    def run(self, progress: Progress | None = None) -> Inferred:
        search = self.search
        low, high = (search.stretch(bound) for bound in search.bounds)
        best = search.best()
        spread = np.linspace(0, len(search.tried.parameter) - 1, 10).round().astype(int)
        rows = np.unique([best, *spread[search.tried.usable[spread]]])
        for row, part in enumerate(self.parts):
            part.choose(search.tried.positions[row][rows], self._response(row, best))
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
        return Inferred(posterior, explanations, white_noise(explanations, self.parts), rise, self.converged)

    def _over(self, low: float, high: float) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        """A grid (f,) of stretched values, the log likelihoods there of each observation (h, f), and of all (f,)."""
        search = self.search
        knots, fine = np.linspace(low, high, KNOTS), np.linspace(low, high, (KNOTS - 1) * BETWEEN + 1)
        rows = search.rows_of(search.shrink(knots))
        usable = search.tried.usable[rows]
        self.converged &= bool(search.tried.converged[rows[usable]].all())
        standing = np.flatnonzero(usable)
        nearest = standing[np.abs(np.arange(len(knots))[:, None] - standing).argmin(axis=1)]
        out = np.interp(fine, knots, usable.astype(float)) < 1.0
        nodes = np.unique(nearest[np.array([0, len(knots) // 2, len(knots) - 1])])
        found = []
        for row, part in enumerate(self.parts):
            left = part.left(search.tried.positions[row][rows[nearest]])
            residual = CubicSpline(knots, left, axis=0)(fine)
            responses = [self._response(row, int(rows[node])) for node in nodes]
            at_nodes = [part.errors.evidence(residual, response, part.chosen) for response in responses]
            value = _between(knots[nodes], fine, [one.log_likelihood for one in at_nodes])
            part.log_scale = _between(knots[nodes], fine, [one.log_scale for one in at_nodes])
            value[:, out] = -np.inf
            found.append(value)
        each = [weight * logsumexp(one, axis=0) for weight, one in zip(search.weight, found, strict=True)]
        return fine, found, np.sum(each, axis=0)

    def _response(self, row: int, place: int) -> FloatArray:
        """What the held positions of one observation do at one of the candidates tried."""
        search, part = self.search, self.parts[row]
        parameter = float(search.tried.parameter[place])
        return part.response(
            parameter,
            search.tried.positions[row][place],
            lambda held, base: search.relax(part.body, held, parameter, base),
        )


def white_noise(explanations: Sequence[Explanation], parts: Sequence[Residuals]) -> float:
    """Typical white noise of a coordinate [unit]."""
    every = [(e.weight @ e.white**2) * p.errors.noise**2 for e, p in zip(explanations, parts, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(every))))


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
