"""The search for the parameter of the lowest error: simulate candidates together, and narrow the range around the best.

The sweep is the thesis's Algorithm 3, the descent serves Algorithm 2's purpose. The error is eq. 3.18, 3.19."""

import copy
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import Model, Observation, distances
from deformscope.stages.msm.solver import Msm, Relaxed

TOLERANCE, ROUNDS = 1e-4, 6
"""Width of a bracket of the parameter that is not narrowed further, and rounds of narrowing."""

Progress = Callable[[str, int, int], None]
"""A function that is called with the present step, its progress, and its total."""


@dataclass
class Tried:
    """Every candidate simulated so far, in rising order.

    parameter: (g,); positions: (g, K, d) for each observation; converged, usable (not diverged): (g,)"""

    parameter: FloatArray = field(default_factory=lambda: np.empty(0))
    positions: list[FloatArray] = field(default_factory=list)
    converged: BoolArray = field(default_factory=lambda: np.empty(0, dtype=bool))
    usable: BoolArray = field(default_factory=lambda: np.empty(0, dtype=bool))


class Search:
    """Finds one parameter for one or more observations that share it.

    weight: (observations,) how much each counts, in the error and in the posterior"""

    def __init__(self, seen: Sequence[Observation], model: Model, bounds: tuple[float, float]) -> None:
        self.seen = list(seen)
        self.model = model
        self.bounds = bounds
        self.weight: FloatArray = np.ones(len(self.seen))
        made: dict[tuple[object, ...], Msm] = {}  # observations of one rest shape, lattice and held set share a body
        self.bodies: list[Msm] = []
        for one in self.seen:
            key = (id(one.rest), id(one.held), id(one.cell), one.shape)
            if key not in made:
                made[key] = model.body(one)
            self.bodies.append(made[key])
        self.tried = Tried(positions=[np.empty((0, *s.rest.shape)) for s in self.seen])

    def simulate(self, parameter: FloatArray, progress: Progress | None = None, what: str = "simulating") -> None:
        """Relax candidates (B,) of the sought parameter for every observation, starting from the nearest one known."""
        parameter = np.atleast_1d(np.asarray(parameter, dtype=np.float64))
        converged, usable = np.ones((2, len(parameter)), dtype=bool)
        start = None
        known = np.flatnonzero(self.tried.usable)
        if known.size:
            nearest = known[np.abs(self.tried.parameter[known, None] - parameter).argmin(axis=0)]
            start = [p[nearest] for p in self.tried.positions]
        note = None if progress is None else lambda done, all_: progress(what, done, all_)
        for row, state in enumerate(self.states(parameter, start, note)):
            self.tried.positions[row] = np.concatenate([self.tried.positions[row], state.position])
            converged &= state.converged
            usable &= ~state.diverged
        every = np.concatenate([self.tried.parameter, parameter])
        order = np.argsort(every, kind="stable")
        converged = np.concatenate([self.tried.converged, converged])[order]
        usable = np.concatenate([self.tried.usable, usable])[order]
        self.tried = Tried(every[order], [p[order] for p in self.tried.positions], converged, usable)

    def states(
        self, parameter: FloatArray, start: Sequence[FloatArray] | None, progress: Callable[[int, int], None] | None
    ) -> list[Relaxed]:
        """The candidates (g,) in every observation, from starts (g, K, d); observations of one body run at once."""
        found: dict[int, Relaxed] = {}
        for body in dict.fromkeys(self.bodies):
            rows = [row for row, other in enumerate(self.bodies) if other is body]
            held = [self.seen[row].deformed[self.seen[row].held] for row in rows]
            begin = None if start is None else np.concatenate([start[row] for row in rows])
            if len(rows) == 1:
                found[rows[0]] = self.relax(body, held[0], parameter, begin, progress)
                continue
            every = np.tile(parameter, len(rows))
            state = self.relax(body, np.repeat(np.stack(held), len(parameter), axis=0), every, begin, progress)
            names = [f.name for f in dataclasses.fields(Relaxed)]
            parts = zip(*(np.split(getattr(state, name), len(rows)) for name in names), strict=True)
            found |= {row: Relaxed(*part) for row, part in zip(rows, parts, strict=True)}
        return [found[row] for row in range(len(self.seen))]

    def only(self, rows: IntArray, weight: FloatArray) -> "Search":
        """The search over only the observations at rows (n,), weighted by `weight` (n,), with the candidates so far."""
        some = copy.copy(self)
        some.seen = [self.seen[row] for row in rows]
        some.bodies = [self.bodies[row] for row in rows]
        some.weight = weight
        some.tried = dataclasses.replace(self.tried, positions=[self.tried.positions[row] for row in rows])
        return some

    def rows_of(self, parameter: FloatArray) -> IntArray:
        """Indices (B,) of these candidates (B,) among those tried; new ones are simulated."""
        known = np.abs(parameter[:, None] - self.tried.parameter).min(axis=1) <= 1e-13
        if not known.all():
            self.simulate(parameter[~known])
        return np.asarray(np.abs(parameter[:, None] - self.tried.parameter).argmin(axis=1))

    def relax(
        self,
        body: Msm,
        held_position: FloatArray,
        parameter: FloatArray | float,
        start: FloatArray | None,
        progress: Callable[[int, int], None] | None = None,
        tolerance: float | None = None,
    ) -> Relaxed:
        """Static states of one body for held positions (n, d) or (B, n, d) and parameters, one or (B,)."""
        how: Any = {"volume": self.model.volume, "start": start, "progress": progress, "tolerance": tolerance}
        return body.relax(held_position, *self.values(parameter), **how)

    def values(self, parameter: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """beta and theta (B,) of candidates (B,)."""
        given, other = np.asarray(parameter, np.float64), np.ones(np.shape(parameter))
        if self.model.parameter == "beta":
            return given, self.model.theta * other
        return self.model.beta * other, given

    def error(self) -> FloatArray:
        """(B,) average Euclidean error of every candidate tried over all observed particles of all observations, each
        with its weight, in their unit of length; NaN if unusable."""
        total = np.zeros(len(self.tried.parameter))
        count = 0.0
        for seen, position, weight in zip(self.seen, self.tried.positions, self.weight, strict=True):
            total += weight * distances(position[:, seen.observed], seen.deformed[seen.observed]).sum(axis=1)
            count += float(weight) * int(seen.observed.sum())
        return np.where(self.tried.usable, total / count, np.nan)

    def each_best(self) -> FloatArray:
        """(observations,) the value of the lowest error of each observation alone, out of the candidates tried."""
        some = [self.only(np.array([row]), np.ones(1)).error() for row in range(len(self.seen))]
        return np.array([self.tried.parameter[int(np.nanargmin(error))] for error in some])

    # -- the best value --------------------------------------------------------------------------------------------

    def best(self) -> int:
        error = self.error()
        if np.isnan(error).all():
            came = "every candidate diverged (eq. 3.17 with overlapping clusters does at high theta)"
            raise InputError("a simulation that stays finite", came, "a lower --theta, or one cluster")
        return int(np.nanargmin(error))

    def sweep(self, count: int, progress: Progress | None) -> None:
        """Algorithm 3: all candidates of the range in one run."""
        self.simulate(np.linspace(*self.bounds, count), progress, "sweeping")

    def fitted(self, seen: Sequence[Observation]) -> list[FloatArray]:
        """Positions (K, d) at the lowest error of these observations, of the same shapes and held positions."""
        self.seen = list(seen)
        self.refine()
        best = self.best()
        return [position[best] for position in self.tried.positions]

    def again(self, count: int) -> None:
        """Sweep and refine again, because held positions have changed."""
        self.tried = Tried(positions=[np.empty((0, *s.rest.shape)) for s in self.seen])
        self.sweep(count, None)
        self.refine()

    def refine(self) -> None:
        """Narrow the bracket around the lowest error, eight candidates at a time, spaced evenly in `stretch`."""
        for _ in range(ROUNDS):
            i = self.best()
            low = self.tried.parameter[max(i - 1, 0)]
            high = self.tried.parameter[min(i + 1, len(self.tried.parameter) - 1)]
            if high - low <= TOLERANCE:
                return
            inner = self.shrink(np.linspace(self.stretch(low), self.stretch(high), 10)[1:-1])
            new = inner[np.abs(inner[:, None] - self.tried.parameter).min(axis=1) > 0.02 * TOLERANCE]
            if new.size == 0:
                return
            self.simulate(new)

    def descend(self, progress: Progress | None) -> str:
        """Algorithm 2's purpose: follow the slope of the error to its minimum. Returns why it stopped.

        The thesis takes fixed steps of 0.01 times the slope and stops when the error changes little, often before the
        minimum. Here the slope comes from two neighbours simulated around each point, the step from the slope's own
        change (secant), limited to the bracket in which the slope changes sign. It stops when that bracket is narrower
        than `TOLERANCE`, or at a bound if the error falls toward it."""
        low, high = (self.stretch(b) for b in self.bounds)
        h = 1e-3 * (high - low)
        # a few values in between, so that neither a bound nor the nearest valley is taken for the lowest
        inner = np.linspace(low, high, 7)
        self.simulate(self.shrink(inner[1:-1]))
        ends = {low: self._slope(low, h), high: self._slope(high, h)}
        deepest = int(np.nanargmin([self._error_at(float(self.shrink(x))) for x in inner]))
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
            if abs(float(self.shrink(b)) - float(self.shrink(a))) <= TOLERANCE:
                return f"the slope changes sign within {TOLERANCE:g}"
            secant = a - ends[a] * (b - a) / (ends[b] - ends[a])
            # a secant that creeps along one side of the bracket is replaced by its middle
            inside = a + 0.1 * (b - a) < secant < b - 0.1 * (b - a)
            point = secant if inside and step % 3 != 2 else 0.5 * (a + b)
            h = min(h, 0.05 * (b - a))
        return "60 steps were taken"

    def _slope(self, point: float, h: float) -> float:
        low, high = (self.stretch(b) for b in self.bounds)
        ends = self.shrink(np.array([max(point - h, low), min(point + h, high)]))
        self.simulate(ends)
        pair = [self._error_at(float(e)) for e in ends]
        return (pair[1] - pair[0]) / (self.stretch(ends[1]) - self.stretch(ends[0]))

    def _error_at(self, parameter: float) -> float:
        """The AEE of a candidate that was tried (the nearest one)."""
        return float(self.error()[np.abs(self.tried.parameter - parameter).argmin()])

    def stretch(self, parameter: float) -> float:
        """-log(1 - beta) resolves beta near 1, where the shape still changes; theta is unchanged."""
        return float(-np.log1p(-parameter)) if self.model.parameter == "beta" else float(parameter)

    def shrink(self, stretched: FloatArray | float) -> FloatArray:
        """The parameter (n,) from stretched values (-log(1 - beta) for beta, theta unchanged), within its bounds."""
        value = np.asarray(stretched, dtype=np.float64)
        return beta_of(value, self.bounds) if self.model.parameter == "beta" else np.clip(value, *self.bounds)


def beta_of(stretched: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    """beta (n,) from values of -log(1 - beta), within its bounds, and exactly at them, as verdicts compare."""
    low, high = bounds
    inner = np.where(stretched <= -np.log1p(-low), low, np.clip(-np.expm1(-stretched), low, high))
    return np.asarray(np.where(stretched >= -np.log1p(-high), high, inner))
