"""The posterior of one parameter, given all candidates that a search has simulated.

The prior is flat over the range that is searched. The likelihood is that of `deformscope.stages.fit.noise`, its
hypotheses weighted and summed at each value. States between candidates are cubic splines over -log(1 - beta), which
resolves the range near 1. The range is narrowed until the spline's knots resolve the posterior, however narrow it is.

All residuals together identify their causes (noise, its reach, its level, misfit, a displaced tool or camera) and the
parameter. The part that the parameter does not change shows the size of the errors that resemble it.

If misfit exceeds the noise, a few projections of the residuals, which the parameter can change, identify it, with the
noise of the first step. In that case an estimate is no sharper than that of least squares. Weighting every detail by a
guessed covariance (as generalised least squares does) would treat the finest part of a misfit as information."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import logsumexp

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.doubts import NOISE_NAMED
from deformscope.stages.fit.estimate import Posterior
from deformscope.stages.fit.noise import Evidence, few
from deformscope.stages.fit.residuals import DROP, Explanation, Residuals
from deformscope.stages.fit.search import Progress, Search

Judge = Callable[[int, FloatArray, FloatArray, Sequence[FloatArray], FloatArray], FloatArray]
"""Computes the log likelihood (f,) of one observation, from residuals (r, n, d), their judged sums (f, r), the effect
of held positions at some nodes, and the share of each node at each value (k, f)."""

KNOTS, BETWEEN = 25, 8
"""Candidates over the range, and steps of the grid from one to the next."""

CHOSEN_BY = 2
"""Step between the candidates that choose the hypotheses."""

ZOOMS = 10

NODES_FROM = (0.15, 0.5)
"""Widths of the range above which the effect of held positions is computed at two, and at three places."""

RESOLVED = 0.3
"""Share of the range from which the posterior counts as resolved."""

NARROWEST = 1e-9
"""Width of a range below which candidates differ only by the solver's tolerance."""


@dataclass(frozen=True, slots=True)
class Inferred:
    """posterior; explanations: one for each observation; noise: typical white noise of a coordinate [unit]
    rise: standard deviations by which the data separate the likeliest value of the range from the least likely
    converged: all simulations that it uses have settled"""

    posterior: Posterior
    explanations: tuple[Explanation, ...]
    noise: float
    rise: float
    converged: bool


class Inference:
    """The posterior over the candidates that a search has simulated."""

    def __init__(self, search: Search, seed: int) -> None:
        self.search = search
        rng = np.random.default_rng(seed)
        self.parts = [Residuals(seen, body, rng) for seen, body in zip(search.seen, search.bodies, strict=True)]
        self.converged = True
        self._found = [Evidence(*3 * (np.zeros((0, 0)),))] * len(self.parts)

    @property
    def floor(self) -> float:
        """Smallest deviation of a coordinate that numbers resolve [unit]."""
        return max(part.measured.floor for part in self.parts)

    def run(self, progress: Progress | None = None) -> Inferred:
        search = self.search
        low, high = (search.stretch(bound) for bound in search.bounds)
        fine, total, rise = self._narrowed(low, high, self._explain, progress)
        for part, found in zip(self.parts, self._found, strict=True):
            density = np.exp(total - total.max()) * np.gradient(search.shrink(fine))
            part.weigh(found.log_likelihood, found.log_scale, density / density.sum())
        if misfit_outweighs(self.parts):
            fine, total, rise = self._narrowed(low, high, self._summarise, progress)
        grid = search.shrink(fine)
        density = np.exp(total - total.max())
        area = float(np.trapezoid(density, grid))
        if area <= 0.0:  # a single value is left
            density, area = np.ones_like(density), float(grid[-1] - grid[0]) or 1.0
        explanations = tuple(part.explanation for part in self.parts)
        white = [(e.weight @ e.white**2) * p.errors.noise**2 for e, p in zip(explanations, self.parts, strict=True)]
        noise = float(np.sqrt(np.mean(np.concatenate(white))))
        return Inferred(Posterior(grid, density / area), explanations, noise, rise, self.converged)

    def _narrowed(
        self, low: float, high: float, judge: Judge, progress: Progress | None
    ) -> tuple[FloatArray, FloatArray, float]:
        """A grid (f,) of stretched values that resolves a posterior, its logarithm there (f,), and the number of
        standard deviations that separate the most likely value of the whole range from the least likely."""
        fine, total = self._over(low, high, judge)
        finite = total[np.isfinite(total)]
        rise = float(np.sqrt(2.0 * (finite.max() - finite.min())))
        for zoom in range(ZOOMS):
            if progress is not None:
                progress("interval", zoom, ZOOMS)
            alive = np.flatnonzero(total >= total.max() - DROP)
            first, last = max(alive[0] - 1, 0), min(alive[-1] + 1, len(fine) - 1)
            if last - first >= RESOLVED * len(fine) or fine[last] - fine[first] < NARROWEST:
                break
            fine, total = self._over(fine[first], fine[last], judge)
        return fine, total, rise

    def _over(self, low: float, high: float, judge: Judge) -> tuple[FloatArray, FloatArray]:
        """A grid (f,) of stretched values, and the log likelihood of all observations there."""
        search = self.search
        knots, fine = np.linspace(low, high, KNOTS), np.linspace(low, high, (KNOTS - 1) * BETWEEN + 1)
        rows = search.rows_of(search.shrink(knots))
        usable = search.tried.usable[rows]
        self.converged &= bool(search.tried.converged[rows[usable]].all())
        standing = np.flatnonzero(usable)
        if not standing.size:
            raise InputError("simulations that stay finite", "all diverged", "a lower --theta, or --volume project")
        nearest = standing[np.abs(np.arange(len(knots))[:, None] - standing).argmin(axis=1)]
        count = 1 + int(np.searchsorted(NODES_FROM, high - low))
        nodes = np.unique(nearest[np.array([[KNOTS // 2], [0, KNOTS - 1], [0, KNOTS // 2, KNOTS - 1]][count - 1])])
        total = np.zeros(len(fine))
        spline = spline_between(KNOTS, BETWEEN)
        for row, part in enumerate(self.parts):
            left = part.left(search.tried.positions[row][rows[nearest]])
            responses = [self.response(row, int(rows[node])) for node in nodes]
            if judge == self._explain:  # what explains the best of a coarse grid may not explain the best of a fine one
                some = np.unique([search.best(), *rows[nearest[::CHOSEN_BY]]])
                part.choose(search.tried.positions[row][some], responses[len(responses) // 2])
            total += search.weight[row] * judge(row, *few(left, spline), responses, _shares(knots[nodes], fine))
        total[np.interp(fine, knots, usable.astype(float)) < 1.0] = -np.inf
        return fine, total

    def _explain(
        self, row: int, residual: FloatArray, mix: FloatArray, responses: Sequence[FloatArray], share: FloatArray
    ) -> FloatArray:
        """(f,) log likelihood by all that the residuals are: identifies their causes."""
        part = self.parts[row]
        each = [part.errors.evidence(residual, response, part.chosen, mix) for response in responses]
        names = ("log_likelihood", "log_scale", "log_scale_deviation")
        parts = ([getattr(one, name) for one in each] for name in names)
        self._found[row] = found = Evidence(*(np.sum(share[:, None] * np.stack(some), axis=0) for some in parts))
        return np.asarray(logsumexp(found.log_likelihood, axis=0))

    def _summarise(
        self, row: int, residual: FloatArray, mix: FloatArray, responses: Sequence[FloatArray], share: FloatArray
    ) -> FloatArray:
        """(f,) log likelihood by what of the residuals the parameter can change, given their causes."""
        part = self.parts[row]
        residual = np.tensordot(mix, residual, 1)
        onto, amplitude = part.summary(residual, responses[len(responses) // 2])
        each = [part.log_summary(residual, onto, amplitude, response) for response in responses]
        return np.asarray(np.sum(share * np.stack(each), axis=0))

    def response(self, row: int, place: int, *, exact: bool = True) -> FloatArray:
        """Effect (n, d, m) [unit] of held positions of one observation on its particles, at one of the tried
        candidates; see `Residuals.response`."""
        search, part = self.search, self.parts[row]
        parameter = float(search.tried.parameter[place])
        return part.response(
            parameter,
            search.tried.positions[row][place],
            lambda held, base, tolerance: search.relax(part.body, held, parameter, base, tolerance=tolerance),
            exact=exact,
        )


@cache
def spline_between(knots: int, steps: int) -> FloatArray:
    """(f, k) share of the values at k evenly spaced knots in the cubic spline through them, so many steps from each to
    the next; its first and last two pieces are one cubic each (not-a-knot)."""
    value = np.eye(knots)
    rise = np.diff(value, axis=0)
    slopes, by = np.diag(np.full(knots, 4.0)) + np.eye(knots, k=1) + np.eye(knots, k=-1), np.empty_like(value)
    by[1:-1] = 3.0 * (rise[1:] + rise[:-1])
    for end, inner, near, next_ in ((0, 1, 0, 1), (-1, -2, -1, -2)):
        slopes[end, [end, inner]], by[end] = (1.0, 2.0), 2.5 * rise[near] + 0.5 * rise[next_]
    slope = np.linalg.solve(slopes, by)
    piece, step = np.divmod(np.arange((knots - 1) * steps + 1), steps)
    step = np.where(piece == knots - 1, steps, step)[:, None] / steps
    piece = np.minimum(piece, knots - 2)
    value, rise, begin, end_ = value[piece], rise[piece], slope[piece], slope[piece + 1]
    bend = 3.0 * rise - 2.0 * begin - end_ + step * (begin + end_ - 2.0 * rise)
    return np.asarray(value + step * (begin + step * bend))


def misfit_outweighs(parts: Sequence[Residuals]) -> bool:
    """Whether the residuals are misfit of the model rather than noise, by how likely each explanation is. Errors that
    neighbours share count as misfit, not noise, if they contradict the stated noise, or without one."""
    misfit, white = 0.0, 0.0
    for part in parts:
        one, noise = part.explanation, float(np.mean(part.errors.noise**2))
        stated = 0.0 if part.measured.noise is None else noise
        shared = float(one.likely @ one.field**2) < NOISE_NAMED**2 * stated
        misfit += float(one.likely @ np.where(one.shared & shared, 0.0, one.field**2))
        white += float(one.likely @ one.white**2) * noise
    return misfit > white


def _shares(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """(k, f) share of each node in straight lines between nodes (k,), for all `at` (f,)."""
    if len(nodes) == 1:
        return np.ones((1, len(at)))
    return np.stack([np.interp(at, nodes, one) for one in np.eye(len(nodes))])
