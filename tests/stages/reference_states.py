"""The energy, time steps and static states of a body by the float64 reference: what the engine's are compared to."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.msm import reference
from deformscope.stages.msm.clusters import held_mask
from deformscope.stages.msm.reference import Rest, Volume


def energy(x: FloatArray, rest: Rest, beta: float, theta: float = 0.0) -> float:
    """What the body stores, per unit of its stiffness k, with volume conserved by projection. x: (K, d).

    1/2 sum_c { (1 - beta) min_R |p - R q|^2 + beta [ (1 - theta) min_A~ |p - A~ q~|^2 + theta min_{A~: measure of A is
    that at rest} |p - A~ q~|^2 ] }, each |.|^2 weighted with the masses. A goal is the mean of the three best fits with
    these same weights, so a step to the goals never raises the energy.
    """
    total = 0.0
    for cluster in rest.clusters:
        for weight, b, th in ((1.0 - beta, 0.0, 0.0), (beta * (1.0 - theta), 1.0, 0.0), (beta * theta, 1.0, 1.0)):
            left = x[cluster.index] - reference.cluster_goals(x, cluster, b, th, volume="project")
            total += 0.5 * weight * float(np.einsum("n,ni,ni->", cluster.mass, left, left))
    return total


def step(
    x: FloatArray,
    v: FloatArray,
    rest: Rest,
    held_position: FloatArray,
    *,
    beta: float,
    theta: float = 0.0,
    alpha: float = 1.0,
    dt: float = 2e-3,
    acceleration: Sequence[float] | FloatArray | None = None,
    volume: Volume = "scale",
) -> tuple[FloatArray, FloatArray]:
    """One time step (Algorithm 1 with eq. 3.11). x, v: (K, d); held_position: (n, d); acceleration: f_ext / m."""
    push = np.zeros(x.shape[1]) if acceleration is None else np.asarray(acceleration, dtype=np.float64)
    x_star = x + (v + push * dt) * dt  # eq. 3.1, 3.2
    x_star[rest.held] = held_position
    goal = reference.goals(x_star, rest, beta, theta, volume=volume)
    x_new = x_star + alpha * (goal - x_star)  # eq. 3.11
    return x_new, (x_new - x) / dt  # eq. 3.12


def relax(
    rest: Rest,
    held_position: FloatArray,
    *,
    beta: float,
    theta: float = 0.0,
    start: FloatArray | None = None,
    tolerance: float = 1e-11,
    max_iterations: int = 3000,
    memory: int = 10,
    volume: Volume = "scale",
) -> tuple[FloatArray, float]:
    """The static state x = goals(x), by Anderson's acceleration of that map. Returns (K, d) and the residual.

    Stops when no particle's goal is further from it than `tolerance` times the body's extent; the residual returned
    is that largest distance over the extent. It does not depend on dt, alpha or the start (for theta = 0).
    """
    x = (rest.position if start is None else start).astype(np.float64).copy()
    x[rest.held] = held_position
    return fixed_point(
        lambda at: reference.goals(at, rest, beta, theta, volume=volume), x, rest, tolerance, max_iterations, memory
    )


def fixed_point(
    goals_at: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    rest: Rest,
    tolerance: float = 1e-11,
    max_iterations: int = 3000,
    memory: int = 10,
) -> tuple[FloatArray, float]:
    """x = goals_at(x) from `start` (K, d), whose held particles stay: see `relax`."""
    x = start.copy()
    free = ~held_mask(len(x), rest.held)
    extent = float(np.ptp(rest.position, axis=0).max()) or 1.0
    states: list[FloatArray] = []
    residuals: list[FloatArray] = []
    worst = 0.0
    for _ in range(max_iterations):
        f = (goals_at(x) - x)[free].ravel()
        worst = float(np.abs(f).max(initial=0.0)) / extent
        if worst <= tolerance or not np.isfinite(worst):
            break
        states.append(x[free].ravel())
        residuals.append(f)
        del states[: -memory - 1], residuals[: -memory - 1]
        new = states[-1] + f
        if len(states) > 1:
            dx, df = np.diff(states, axis=0).T, np.diff(residuals, axis=0).T
            gamma = np.linalg.lstsq(df, f, rcond=1e-12)[0]
            new = new - (dx + df) @ gamma
        x[free] = new.reshape(-1, x.shape[1])
    return x, worst
