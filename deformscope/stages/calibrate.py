"""Calibration of beta and theta: sweep all candidates at once, refine the minimum, say how sure it is.

The sweep is the thesis's Algorithm 3; `method="gradient"` serves Algorithm 2's purpose. The error is eq. 3.18, 3.19.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages import interval
from deformscope.stages.distance import distances, nearest_error
from deformscope.stages.estimate import Comparison, Curve, Estimate, LengthUnit, Parameter, Verdict
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.reference import Basis, Volume
from deformscope.stages.msm.solver import TOLERANCE, Msm, Precision, Relaxed

Method = Literal["sweep", "gradient"]
Progress = Callable[[str, int, int], None]

IDENTIFIED_WIDTH, WEAK_WIDTH = 0.2, 0.7
"""An interval narrower than the first is identified, narrower than the second weak."""

BETA_LIMIT = 0.9999
"""Highest beta that is searched: at 1 a cluster resists nothing but rigid motion of the whole."""

REPEATS = 400
MOST_HELD_DIRECTIONS, SKETCHED_DIRECTIONS = 200, 100
"""Held coordinates whose effect is computed one by one; beyond, this many random combinations stand for them."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One manipulation: a rest shape, what it became, and what was held.

    rest, deformed: (K, d), d = 2 or 3 [unit]; held: (n,) indices whose deformed position is prescribed
    observed: (K,) particles that were seen in `deformed`
    noise: (K,) standard deviation per coordinate, None if unknown
    shape, cell: the lattice that the particles stand on (last axis fastest, may have holes), None if they stand on none
    metres_per_unit: size of the unit, None for pixels of unknown size
    force_n: net force [N] on the held particles `contact`; None if it was not measured
    held_measured: whether the held positions were measured, with the noise of the others, or are exact; None = unknown
    """

    rest: FloatArray
    deformed: FloatArray
    held: IntArray
    observed: BoolArray
    noise: FloatArray | None = None
    shape: tuple[int, ...] | None = None
    cell: IntArray | None = None
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    force_n: float | None = None
    contact: IntArray | None = None
    held_measured: bool | None = None

    def __post_init__(self) -> None:
        count, d = self.rest.shape
        if not (np.isfinite(self.rest).all() and np.isfinite(self.deformed[self.observed]).all()):
            raise InputError("finite positions", "NaN or infinity in rest or deformed", "drop those particles")
        if not np.isfinite(self.deformed[self.held]).all():
            raise InputError("finite positions of the held particles", "NaN or infinity", "hold fewer particles")
        if np.unique(self.rest, axis=0).shape[0] != count:
            raise InputError("distinct rest positions", "duplicate points in rest", "keep each particle once")
        if self.held.size == 0:
            raise InputError("at least one held particle", "none", "name what was held and what was pushed")
        if np.unique(self.held).size != self.held.size:
            raise InputError("each held particle once", "repeated ones")
        if self.held.size == count:
            raise InputError("some free particles", "every particle held", "hold only what was fixed or pushed")
        if not self.free_observed.any():
            raise InputError("free particles that were observed", "none", "check `observed` and what is held")
        if clusters.rank(self.rest) < min(d, 2):
            raise InputError("rest points that span a plane", "points on a line", "observe an area, not a line")

    @property
    def pose_held(self) -> bool:
        """Whether the held particles keep the body from turning: two in the plane, three off a line in space."""
        return bool(clusters.rank(self.rest[self.held]) >= self.rest.shape[1] - 1)

    @property
    def free_observed(self) -> BoolArray:
        """(K,) particles that the fit is judged by: seen and not prescribed."""
        return np.asarray(self.observed & ~clusters.held_mask(len(self.rest), self.held))


@dataclass(frozen=True, slots=True)
class Model:
    """What is fitted: which parameter, and everything about the simulation that stays fixed.

    cluster_size: particles a side of the overlapping clusters; None = one cluster of all particles
    beta, theta: the value of the one that is not fitted; alpha does not change a static state and is recorded only
    volume: how theta conserves it: "scale" as eq. 3.17 does, or "project", which has an energy and stays stable in
    overlapping clusters
    """

    parameter: Parameter = "beta"
    basis: Basis = "linear"
    cluster_size: int | None = 3
    alpha: float = 1.0
    beta: float = 0.99
    theta: float = 0.0
    volume: Volume = "scale"
    precision: Precision = "float64"
    device: str = "cpu"

    def grouping(self, seen: Observation) -> clusters.Clusters:
        """How the particles of an observation are grouped."""
        if self.cluster_size is None:
            return clusters.single(len(seen.rest))
        if seen.shape is not None and seen.cell is not None:
            return clusters.lattice(seen.rest, seen.shape, seen.cell, self.cluster_size)
        return clusters.nearest(seen.rest, self.cluster_size ** seen.rest.shape[1])

    def body(self, seen: Observation) -> Msm:
        """The particles of an observation in this model's clusters, on its device."""
        grouped = self.grouping(seen)
        return Msm(seen.rest, grouped, seen.held, basis=self.basis, precision=self.precision, device=self.device)


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How the parameter of `model` is found within `bounds`, and how sure of it to be.

    method: "sweep" tries `candidates` values over `bounds` and refines around the lowest error (Algorithm 3);
    "gradient" follows the slope (Algorithm 2's purpose) and draws the curve only where it went
    level: of the interval; seed: of its random repeats
    """

    model: Model = Model()
    bounds: tuple[float, float] = (0.0, 0.99)
    method: Method = "sweep"
    candidates: int = 100
    level: float = 0.9
    seed: int = 0


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


@dataclass
class _Tried:
    """Every candidate simulated so far, in rising order.

    parameter: (g,); positions: for each observation (g, K, d); converged, usable (not diverged): (g,)
    """

    parameter: FloatArray = field(default_factory=lambda: np.empty(0))
    positions: list[FloatArray] = field(default_factory=list)
    converged: BoolArray = field(default_factory=lambda: np.empty(0, dtype=bool))
    usable: BoolArray = field(default_factory=lambda: np.empty(0, dtype=bool))


class _Fit:
    """One parameter against one or more observations that share it."""

    def __init__(self, seen: Sequence[Observation], model: Model, bounds: tuple[float, float]) -> None:
        self.seen = list(seen)
        self.model = model
        self.bounds = bounds
        self.bodies = [model.body(s) for s in self.seen]
        self.tried = _Tried(positions=[np.empty((0, *s.rest.shape)) for s in self.seen])
        self.held_converged = True
        self.responses: dict[float, list[FloatArray]] = {}

    def simulate(self, parameter: FloatArray, progress: Progress | None = None, what: str = "simulating") -> None:
        """Relax every candidate for every observation, starting from the nearest one known."""
        parameter = np.atleast_1d(np.asarray(parameter, dtype=np.float64))
        converged = np.ones(len(parameter), dtype=bool)
        usable = np.ones(len(parameter), dtype=bool)
        for row, (seen, body) in enumerate(zip(self.seen, self.bodies, strict=True)):
            start = None
            known = np.flatnonzero(self.tried.usable)
            if known.size:
                nearest = known[np.abs(self.tried.parameter[known, None] - parameter).argmin(axis=0)]
                start = self.tried.positions[row][nearest]
            note = None if progress is None else lambda done, all_: progress(what, done, all_)
            state = self._relax(body, seen.deformed[seen.held], parameter, start, note)
            self.tried.positions[row] = np.concatenate([self.tried.positions[row], state.position])
            converged &= state.converged
            usable &= ~state.diverged
        self.tried.parameter = np.concatenate([self.tried.parameter, parameter])
        self.tried.converged = np.concatenate([self.tried.converged, converged])
        self.tried.usable = np.concatenate([self.tried.usable, usable])
        order = np.argsort(self.tried.parameter, kind="stable")
        self.tried = _Tried(
            self.tried.parameter[order],
            [p[order] for p in self.tried.positions],
            self.tried.converged[order],
            self.tried.usable[order],
        )

    def _relax(
        self,
        body: Msm,
        held_position: FloatArray,
        parameter: FloatArray | float,
        start: FloatArray | None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Relaxed:
        beta, theta = (parameter, self.model.theta) if self.model.parameter == "beta" else (self.model.beta, parameter)
        volume = self.model.volume
        return body.relax(held_position, beta, theta, volume=volume, start=start, progress=progress)

    def error(self) -> FloatArray:
        """AEE of every candidate tried over all observed particles of all observations; NaN where not usable."""
        total = np.zeros(len(self.tried.parameter))
        count = 0
        for seen, position in zip(self.seen, self.tried.positions, strict=True):
            total += distances(position[:, seen.observed], seen.deformed[seen.observed]).sum(axis=1)
            count += int(seen.observed.sum())
        return np.where(self.tried.usable, total / count, np.nan)

    # -- the best value --------------------------------------------------------------------------------------------

    def best(self) -> int:
        error = self.error()
        if np.isnan(error).all():
            raise InputError(
                "a simulation that stays finite",
                "every candidate diverged (eq. 3.17 with overlapping clusters does at high theta)",
                "a lower --theta, or one cluster",
            )
        return int(np.nanargmin(error))

    def sweep(self, count: int, progress: Progress | None) -> None:
        """Algorithm 3: all candidates of the range in one run."""
        self.simulate(np.linspace(*self.bounds, count), progress, "sweeping")

    def refine(self, tolerance: float = 1e-4, rounds: int = 6) -> None:
        """Narrow the bracket around the lowest error, eight candidates at a time, spaced evenly in `_stretch`."""
        for _ in range(rounds):
            i = self.best()
            low = self.tried.parameter[max(i - 1, 0)]
            high = self.tried.parameter[min(i + 1, len(self.tried.parameter) - 1)]
            if high - low <= tolerance:
                return
            inner = self._shrink(np.linspace(self._stretch(low), self._stretch(high), 10)[1:-1])
            new = inner[np.abs(inner[:, None] - self.tried.parameter).min(axis=1) > 0.02 * tolerance]
            if new.size == 0:
                return
            self.simulate(new)

    def descend(self, progress: Progress | None, tolerance: float = 1e-4) -> str:
        """Algorithm 2's purpose: follow the slope of the error to its minimum. Returns why it stopped.

        The thesis takes fixed steps of 0.01 times the slope and stops when the error changes little, often before the
        minimum. Here the slope comes from two neighbours simulated beside each point, the step from the slope's own
        change (secant), kept inside the bracket in which the slope changes sign; it stops when that bracket is
        narrower than `tolerance`, or at a bound that the slope pushes against.
        """
        low, high = (self._stretch(b) for b in self.bounds)
        h = 1e-3 * (high - low)
        # a few values in between, so that neither a bound nor the nearest valley is taken for the lowest
        inner = np.linspace(low, high, 7)
        self.simulate(self._shrink(inner[1:-1]))
        ends = {low: self._slope(low, h), high: self._slope(high, h)}
        deepest = int(np.nanargmin([self._error_at(float(self._shrink(x))) for x in inner]))
        if deepest == 0 and ends[low] >= 0.0:
            return "at the lower bound: the error rises from there"
        if deepest == len(inner) - 1 and ends[high] <= 0.0:
            return "at the upper bound: the error still falls there"
        a, b = float(inner[max(deepest - 1, 0)]), float(inner[min(deepest + 1, len(inner) - 1)])
        ends |= {x: self._slope(x, h) for x in (a, b) if x not in ends}
        if ends[a] >= 0.0 or ends[b] <= 0.0:
            self.refine()
            return "the slope does not change sign around the lowest value; refined there instead"
        point = 0.5 * (a + b)
        for step in range(60):
            if progress is not None:
                progress("descending", step, 60)
            slope = self._slope(point, h)
            if slope == 0.0:
                return "the slope is zero"
            if slope < 0.0:
                a = point
            else:
                b = point
            ends[point] = slope
            if abs(float(self._shrink(b)) - float(self._shrink(a))) <= tolerance:
                return f"the slope changes sign within {tolerance:g}"
            secant = a - ends[a] * (b - a) / (ends[b] - ends[a])
            # a secant that creeps along one side of the bracket is replaced by its middle
            inside = a + 0.1 * (b - a) < secant < b - 0.1 * (b - a)
            point = secant if inside and step % 3 != 2 else 0.5 * (a + b)
            h = min(h, 0.05 * (b - a))
        return "60 steps were taken"

    def _slope(self, point: float, h: float) -> float:
        low, high = (self._stretch(b) for b in self.bounds)
        ends = self._shrink(np.array([max(point - h, low), min(point + h, high)]))
        self.simulate(ends)
        pair = [self._error_at(float(e)) for e in ends]
        return (pair[1] - pair[0]) / (self._stretch(ends[1]) - self._stretch(ends[0]))

    def _error_at(self, parameter: float) -> float:
        """The AEE of a candidate that was tried (the nearest one)."""
        return float(self.error()[np.abs(self.tried.parameter - parameter).argmin()])

    def _stretch(self, parameter: float) -> float:
        """-log(1 - beta) resolves beta near 1, where the shape still changes; theta stays as it is."""
        return float(-np.log1p(-parameter)) if self.model.parameter == "beta" else float(parameter)

    def _shrink(self, stretched: FloatArray | float) -> FloatArray:
        value = np.asarray(stretched, dtype=np.float64)
        value = -np.expm1(-value) if self.model.parameter == "beta" else value
        return np.clip(value, *self.bounds)

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
        at, low, high = self._stretch(value), self._stretch(self.bounds[0]), self._stretch(self.bounds[1])
        observed = np.concatenate([s.deformed[s.free_observed] for s in self.seen])
        ends, grid = (value, value), np.array([value])
        for widen in range(6):
            reach = half * 2.5**widen
            grid = self._shrink(
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
        ) / max(self._stretch(self.tried.parameter[b]) - self._stretch(self.tried.parameter[a]), 1e-12)
        size = float(np.sum(move**2))
        whole = self._stretch(self.bounds[1]) - self._stretch(self.bounds[0])
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
            moved = self._relax(body, held, float(self.tried.parameter[place]), base)
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
        at = self._stretch(float(grid[place]))
        ends = np.array([self._stretch(float(node)) for node in nodes])
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


def stiffness(
    seen: Sequence[Observation], model: Model, positions: Sequence[FloatArray], parameter: FloatArray
) -> FloatArray | None:
    """The energy's stiffness k [N/m] at each parameter (g,), from the measured forces; None where there is none.

    positions: for each observation (g, K, d). k minimises the squared difference of measured and simulated net force
    over the observations. Eq. 3.17 has no energy, so with theta in that form there is no force to compare.
    """
    told = [row for row, s in enumerate(seen) if s.force_n is not None and s.metres_per_unit is not None]
    no_energy = model.volume == "scale" and (model.parameter == "theta" or model.theta != 0.0)
    if not told or no_energy:
        return None
    simulated = np.zeros((len(parameter), len(told)))
    measured = np.array([float(seen[row].force_n or 0.0) for row in told])
    for column, row in enumerate(told):
        s = seen[row]
        rest = reference.build_rest(s.rest, model.grouping(s), s.held, basis=model.basis)
        contact = s.held if s.contact is None else s.contact
        for g, value in enumerate(parameter):
            beta, theta = (value, model.theta) if model.parameter == "beta" else (model.beta, value)
            net = reference.reaction(positions[row][g], rest, float(beta), float(theta))[contact].sum(axis=0)
            simulated[g, column] = float(np.linalg.norm(net)) * float(s.metres_per_unit or 1.0)
    size = np.sum(simulated**2, axis=1)
    return np.asarray(np.where(size > 0.0, simulated @ measured / np.where(size > 0.0, size, 1.0), np.nan))


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
