"""Calibration of beta and theta: sweep all candidates at once, refine the minimum, say how sure it is.

The sweep is the thesis's Algorithm 3; `method="gradient"` serves Algorithm 2's purpose. The error is eq. 3.18, 3.19.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages import interval
from deformscope.stages.distance import distances, nearest_error
from deformscope.stages.estimate import Comparison, Curve, Estimate, Verdict
from deformscope.stages.force import stiffness
from deformscope.stages.model import FitOptions, Model, Observation
from deformscope.stages.msm.solver import TOLERANCE
from deformscope.stages.search import Progress, Search

__all__ = ["Calibration", "FitOptions", "Model", "Observation", "Progress", "calibrate", "stiffness", "verdict"]

IDENTIFIED_WIDTH, WEAK_WIDTH = 0.2, 0.7
"""An interval narrower than the first is identified, narrower than the second weak."""

BETA_LIMIT = 0.9999
"""Highest beta that is searched: at 1 a cluster resists nothing but rigid motion of the whole."""

REPEATS = 400
MOST_HELD_DIRECTIONS, SKETCHED_DIRECTIONS = 200, 100
"""Held coordinates whose effect is computed one by one; beyond, this many random combinations stand for them."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """An estimate, and the simulation at it of every observation that it rests on."""

    estimate: Estimate
    comparisons: tuple[Comparison, ...]


@dataclass(frozen=True, slots=True)
class _Support:
    """An interval; the white noise of a coordinate that it allows for; whether all that it rests on has settled."""

    ends: tuple[float, float]
    noise: float
    converged: bool


class _Fit(Search):
    """A search whose lowest error is given an interval."""

    def __init__(self, seen: Sequence[Observation], model: Model, bounds: tuple[float, float]) -> None:
        super().__init__(seen, model, bounds)
        self.held_converged = True
        self.responses: dict[float, list[FloatArray]] = {}

    # -- the interval ----------------------------------------------------------------------------------------------

    def support(self, level: float, seed: int, progress: Progress | None) -> _Support:
        """The interval of `deformscope.stages.interval`, and what it rests on."""
        best = self.best()
        value = float(self.tried.parameter[best])
        rng = np.random.default_rng(seed)
        directions = [_held_directions(one, rng) for one in self.seen]
        response = self._response(value, directions, progress)
        left = [self._residuals(row, best, d, r) for row, (d, r) in enumerate(zip(directions, response, strict=True))]
        models = [interval.explain(r, seed) for r in left]
        found = [np.sqrt(float(m.weight @ m.scale**2)) * r.deviation() for r, m in zip(left, models, strict=True)]
        soft = np.concatenate(found)
        size = sum(r.value.size for r in left)
        count = int(np.clip(4e5 / size, 150, REPEATS))
        draws = [interval.draw(r, m, count, rng) for r, m in zip(left, models, strict=True)]
        half = self._guess_half_width(_added(draws, [r.held_response for r in left]))
        at, low, high = self.stretch(value), self.stretch(self.bounds[0]), self.stretch(self.bounds[1])
        observed = np.concatenate([s.deformed[s.free_observed] for s in self.seen])
        ends, grid = (value, value), np.array([value])
        for widen in range(6):
            reach = half * 2.5**widen
            grid = self.shrink(
                np.unique(np.concatenate([np.linspace(max(at - reach, low), min(at + reach, high), 41), [at]]))
            )
            simulated = self._at(grid, progress)
            nodes = np.unique([grid[0], value, grid[-1]])
            responses = [self._response(float(node), directions, progress) for node in nodes]
            repeats = functools.partial(self._repeats, draws, nodes, responses, grid)
            ends = interval.accepted(grid, simulated, observed, repeats, level, soft)
            open_low = ends[0] <= grid[0] and grid[0] > self.bounds[0]
            open_high = ends[1] >= grid[-1] and grid[-1] < self.bounds[1]
            if not (open_low or open_high):
                break
        value = float(self.tried.parameter[self.best()])  # the interval's own candidates may have found a better one
        used = (self.tried.parameter >= grid[0]) & (self.tried.parameter <= grid[-1])
        return _Support(
            ends=(min(ends[0], value), max(ends[1], value)),
            noise=float(np.sqrt(np.mean(soft**2))),
            converged=bool(self.tried.converged[used].all() and self.held_converged),
        )

    def _at(self, grid: FloatArray, progress: Progress | None) -> FloatArray:
        """Free observed particles of all observations at these parameters, (g, n, d)."""
        known = np.abs(grid[:, None] - self.tried.parameter).min(axis=1) <= 1e-12
        if not known.all():
            self.simulate(grid[~known], progress, "interval")
        rows = np.abs(grid[:, None] - self.tried.parameter).argmin(axis=1)
        return np.concatenate(
            [p[rows][:, s.free_observed] for s, p in zip(self.seen, self.tried.positions, strict=True)], axis=1
        )

    def _guess_half_width(self, draws: FloatArray) -> float:
        """Five standard deviations of the estimate, in stretched units, from its sensitivity."""
        i = self.best()
        a, b = max(i - 1, 0), min(i + 1, len(self.tried.parameter) - 1)
        move = np.concatenate(
            [(p[b] - p[a])[s.free_observed] for s, p in zip(self.seen, self.tried.positions, strict=True)]
        ) / max(self.stretch(self.tried.parameter[b]) - self.stretch(self.tried.parameter[a]), 1e-12)
        size = float(np.sum(move**2))
        whole = self.stretch(self.bounds[1]) - self.stretch(self.bounds[0])
        if size <= 0.0:
            return whole
        deviation = float(np.std(np.einsum("rnd,nd->r", draws, move) / size))
        return float(np.clip(5.0 * deviation, 1e-4 * whole, whole))

    def _residuals(self, row: int, best: int, directions: _HeldDirections, response: FloatArray) -> interval.Residuals:
        seen, position = self.seen[row], self.tried.positions[row][best]
        judged = seen.free_observed
        floor = 10.0 * TOLERANCE[self.model.precision] * self.bodies[row].extent
        floor += 4.0 * float(np.finfo(np.float64).eps * np.abs(seen.deformed[seen.observed]).max())
        return interval.Residuals(
            rest=seen.rest[judged],
            value=(seen.deformed - position)[judged],
            noise=None if seen.noise is None else seen.noise[judged],
            spacing=self.bodies[row].scale,
            floor=floor,
            held_response=response,
            held_deviation=directions.deviation,
            held_rest=None if directions.sketched else seen.rest[seen.held],
            held_measured=seen.held_measured,
        )

    def _response(
        self, parameter: float, directions: Sequence[_HeldDirections], progress: Progress | None
    ) -> list[FloatArray]:
        """How a unit step along each direction of the held positions moves the free observed particles, (n, d, m)."""
        if parameter not in self.responses:
            self._at(np.array([parameter]), progress)
            place = int(np.abs(self.tried.parameter - parameter).argmin())
            self.responses[parameter] = [
                self._moved(row, place, one.step, progress) for row, one in enumerate(directions)
            ]
        return self.responses[parameter]

    def _moved(self, row: int, place: int, steps: FloatArray, progress: Progress | None) -> FloatArray:
        """Finite differences of the static state for steps (m, n held, d), at the free observed particles."""
        seen, body = self.seen[row], self.bodies[row]
        base = self.tried.positions[row][place]
        small = 1e-3 * body.scale / (float(np.abs(steps).max()) or 1.0)
        moves = np.empty((len(steps), *base.shape))
        for first in range(0, len(steps), 64):
            if progress is not None:
                progress("held noise", first, len(steps))
            held = base[seen.held] + small * steps[first : first + 64]
            moved = self.relax(body, held, float(self.tried.parameter[place]), base)
            self.held_converged &= bool(moved.converged.all())
            moves[first : first + 64] = (moved.position - base) / small
        return np.moveaxis(moves[:, seen.free_observed], 0, -1)

    def _repeats(
        self,
        draws: Sequence[interval.Repeats],
        nodes: FloatArray,
        responses: Sequence[Sequence[FloatArray]],
        grid: FloatArray,
        place: int,
    ) -> FloatArray:
        """What each repeat adds to observed - simulated at `grid[place]`, (r, n, d): the responses to held noise lie
        between those at the nodes."""
        at = self.stretch(float(grid[place]))
        ends = np.array([self.stretch(float(node)) for node in nodes])
        right = int(np.clip(np.searchsorted(ends, at), 1, max(len(ends) - 1, 1)))
        if len(ends) == 1:
            return _added(draws, responses[0])
        share = (at - ends[right - 1]) / (ends[right] - ends[right - 1])
        pairs = zip(responses[right - 1], responses[right], strict=True)
        return _added(draws, [(1.0 - share) * a + share * b for a, b in pairs])


@dataclass(frozen=True, slots=True)
class _HeldDirections:
    """Directions along which held positions may be off: step (m, n held, d), and the noise along each, (m,).

    sketched: they are random combinations, noise included, that stand for too many coordinates to take one by one
    """

    step: FloatArray
    deviation: FloatArray
    sketched: bool


def _held_directions(seen: Observation, rng: np.random.Generator) -> _HeldDirections:
    count, d = len(seen.held), seen.rest.shape[1]
    deviation = np.repeat(np.ones(count) if seen.noise is None else seen.noise[seen.held], d)
    if count * d <= MOST_HELD_DIRECTIONS:
        return _HeldDirections(np.eye(count * d).reshape(-1, count, d), deviation, False)
    combined = rng.standard_normal((SKETCHED_DIRECTIONS, count * d)) * deviation / np.sqrt(SKETCHED_DIRECTIONS)
    return _HeldDirections(combined.reshape(-1, count, d), np.ones(SKETCHED_DIRECTIONS), True)


def _added(draws: Sequence[interval.Repeats], responses: Sequence[FloatArray]) -> FloatArray:
    """Own errors less what the held ones do through the simulation, all observations together, (r, n, d)."""
    every = [one.own - np.tensordot(one.held, response, (1, 2)) for one, response in zip(draws, responses, strict=True)]
    return np.concatenate(every, axis=1)


def calibrate(
    seen: Sequence[Observation],
    options: FitOptions,
    *,
    settings: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Fit one parameter to observations that share it, with its interval and verdicts.

    settings: recorded with the estimate; progress: called with (what, done, all)
    """
    model, bounds = options.model, options.bounds
    if len({(s.unit, s.metres_per_unit) for s in seen}) != 1:
        raise InputError("observations in one unit", "pixels and metres mixed, or several scales", "fit them apart")
    highest = BETA_LIMIT if model.parameter == "beta" else 1.0
    if not 0.0 <= bounds[0] < bounds[1] <= highest:
        raise InputError(f"a range that rises within 0 to {highest:g}", f"{bounds[0]:g} to {bounds[1]:g}")
    if options.candidates < 3:
        raise InputError("at least 3 candidates", str(options.candidates))
    fit = _Fit(seen, model, bounds)
    used: dict[str, object] = {
        "cluster_size": model.cluster_size,
        "mode": model.basis,
        "alpha": model.alpha,
        "beta": None if model.parameter == "beta" else model.beta,
        "theta": None if model.parameter == "theta" else model.theta,
        "volume": model.volume,
        "method": options.method,
        "bounds": list(bounds),
        "seed": options.seed,
        "precision": model.precision,
        "device": model.device,
        "pose_held": all(s.pose_held for s in seen),
    }
    if options.method == "sweep":
        fit.sweep(options.candidates, progress)
        curve = Curve(fit.tried.parameter.copy(), fit.error())
        fit.refine()
        used["candidates"] = options.candidates
    else:
        used["stopped"] = fit.descend(progress)
        curve = Curve(fit.tried.parameter.copy(), fit.error())
    with threadpool_limits(1):  # small matrices: more threads cost time, and change the last digits
        support = fit.support(options.level, options.seed, progress)
    ends = support.ends
    best = fit.best()
    used["noise"] = support.noise
    used["noise_source"] = "residuals" if seen[0].noise is None else "given"
    comparisons = tuple(
        Comparison(s.rest, s.deformed, p[best], s.observed, s.held, s.unit)
        for s, p in zip(seen, fit.tried.positions, strict=True)
    )
    free = np.concatenate(
        [distances(c.simulated, c.observed)[s.free_observed] for c, s in zip(comparisons, seen, strict=True)]
    )
    near = [nearest_error(c.simulated[c.seen], c.observed[c.seen]) for c in comparisons]
    supported = (fit.tried.parameter >= ends[0]) & (fit.tried.parameter <= ends[1])
    converged = support.converged and bool(fit.tried.converged[supported].all())
    inside = np.flatnonzero(supported)
    inside = np.unique([*inside[:: max(1, inside.size // 12)], *inside[-1:], best])
    k = stiffness(seen, model, [p[inside] for p in fit.tried.positions], fit.tried.parameter[inside])
    told: tuple[float, tuple[float, float]] | None = None
    if k is not None and np.isfinite(k).all():
        told = float(k[inside == best][0]), (float(k.min()), float(k.max()))
    estimate = Estimate(
        parameter=model.parameter,
        value=float(fit.tried.parameter[best]),
        interval=ends,
        level=options.level,
        bounds=bounds,
        verdict=verdict(ends, bounds) if converged else "unidentified",
        stiffness_verdict="unidentified" if told is None else _relative_verdict(*told),
        aee=float(fit.error()[best]),
        aee_free=float(free.mean()),
        nearest=float(np.mean(near)),
        unit=seen[0].unit,
        curve=curve,
        converged=converged,
        settings={**used, **(settings or {})},
        stiffness=told,
        metres_per_unit=seen[0].metres_per_unit,
    )
    return Calibration(estimate, comparisons)


def verdict(ends: tuple[float, float], bounds: tuple[float, float]) -> Verdict:
    """What an interval within its bounds allows to say."""
    width = ends[1] - ends[0]
    if width >= WEAK_WIDTH:
        return "unidentified"
    if ends[0] <= bounds[0] or ends[1] >= bounds[1]:
        return "at-bound"
    return "identified" if width < IDENTIFIED_WIDTH else "weak"


def _relative_verdict(value: float, ends: tuple[float, float]) -> Verdict:
    """The verdict on a positive quantity without bounds: its interval's width against its value."""
    width = (ends[1] - ends[0]) / value
    return "identified" if width < IDENTIFIED_WIDTH else "weak" if width < WEAK_WIDTH else "unidentified"
