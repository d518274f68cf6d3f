"""A motion by time stepping (Thesis Algorithm 1, eq. 3.11): held particles go from frame to frame in straight lines.

Without gravity alpha and dt do not alter a static state. They determine how fast a body reaches it, so that they matter
only if frames follow each other within few time steps."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.search import Search
from deformscope.stages.msm.reference import Volume
from deformscope.stages.msm.solver import Msm, Relaxed


@dataclass(frozen=True, slots=True)
class Pace:
    """Parameters of time: alpha, dt [s], and when each frame was taken, (F,) [s] after the rest shape, rising."""

    alpha: float
    dt: float
    times: tuple[float, ...]

    def steps(self) -> list[int]:
        """Time steps up to each frame, at least one."""
        return [max(1, round(gap / self.dt)) for gap in np.diff(self.times, prepend=0.0)]


def step_through(
    body: Msm,
    held: FloatArray,
    beta: FloatArray,
    theta: FloatArray | float,
    pace: Pace,
    volume: Volume = "scale",
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Positions (B, F, K, d) of B candidates at every frame, from rest; and which candidates diverged (B,). held: (F,
    n, d) positions of the held particles at the frames"""
    state = body.start(len(beta))
    before = body.rest[body.held]
    found = np.empty((len(beta), len(held), *body.rest.shape))
    for index, (target, steps) in enumerate(zip(held, pace.steps(), strict=True)):
        how: Any = {"volume": volume, "alpha": pace.alpha, "dt": pace.dt, "steps": steps, "held_from": before}
        found[:, index] = body.step(state, target, beta, theta, **how)
        before = target
        if progress is not None:
            progress(index + 1, len(held))
    return found, state.diverged


class MovingSearch(Search):
    """Fits one parameter to the frames of a motion, in order, simulated by time stepping instead of static states."""

    def __init__(self, seen: Sequence[Observation], model: Model, bounds: tuple[float, float], pace: Pace) -> None:
        super().__init__(seen, model, bounds)
        self.pace = pace
        self.every = list(self.seen)
        self.rows = np.arange(len(self.seen))

    def only(self, rows: IntArray, weight: FloatArray) -> Search:
        """See `Search.only`. rows: (n,) frames; weight: (n,) weight of each observation"""
        some = super().only(rows, weight)
        assert isinstance(some, MovingSearch)
        some.rows = self.rows[rows]
        return some

    def states(
        self, parameter: FloatArray, start: Sequence[FloatArray] | None, progress: Callable[[int, int], None] | None
    ) -> list[Relaxed]:
        """See `Search.states`: parameter (B,); each state (B, K, d), stepped through time from rest."""
        body = self.bodies[0]
        beta, theta = self.values(parameter)
        held = np.stack([one.deformed[one.held] for one in self.every])
        moved, diverged = step_through(body, held, beta, theta, self.pace, self.model.volume, progress)
        none = np.zeros(len(parameter))
        count, yes = np.zeros(len(parameter), dtype=np.int64), np.ones(len(parameter), dtype=bool)
        return [Relaxed(moved[:, row], none, none, count, yes, diverged, count, ~yes, ~yes) for row in self.rows]

    def relax(
        self,
        body: Msm,
        held_position: FloatArray,
        parameter: FloatArray | float,
        start: FloatArray | None,
        progress: Callable[[int, int], None] | None = None,
        tolerance: float | None = None,
    ) -> Relaxed:
        """Effect of wrong held positions (B, n, d) on a moving state (K, d), computed as for the static state there."""
        assert start is not None
        still = super().relax(body, start[body.held], parameter, None, tolerance=tolerance)
        moved = super().relax(body, held_position, parameter, still.position[0], progress, tolerance)
        return dataclasses.replace(moved, position=moved.position - still.position + start)
