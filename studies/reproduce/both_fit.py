"""beta and theta of one deformed shape together, by slopes of its error."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.msm.reference import Volume
from deformscope.stages.msm.solver import TOLERANCE, Msm

LARGEST = 0.9999
"""Largest beta tried: at 1 only the linear fit is left, and most bodies have no unique static state."""
STATE_TOLERANCE = 1e-5
"""Tolerance of the search's static states, as a share of the body's extent."""
SLOPE_STEP = 1e-3
"""Step of -log(1 - beta) and of theta for slopes of states: with states to 1e-9, exact to about 1e-6."""


@dataclass(frozen=True, slots=True)
class FitBoth:
    """beta, theta; position: (K, d) static state at these values [m]; aee: mean distance to the observed positions [m]
    (eq. 3.18)

    evaluations: static states that were followed; converged: no step is left that promises to lower the error"""

    beta: float
    theta: float
    position: FloatArray
    aee: float
    evaluations: int
    converged: bool


def fit_beta_theta(
    body: Msm,
    held_position: FloatArray,
    observed: FloatArray,
    *,
    volume: Volume = "project",
    start: tuple[float, float] = (0.9, 0.5),
    largest_beta: float = LARGEST,
    tolerance: float = 1e-4,
    max_evaluations: int = 60,
) -> FitBoth:
    """The beta in [0, largest_beta] and theta in [0, 1] at which the average Euclidean error (eq. 3.18) is least.

    Each step linearizes the static state in -log(1 - beta) and theta, by its slopes, and minimises the error over
    both. The step limit grows where the prediction held and shrinks where it did not (the error has long curved
    valleys: less beta needs more theta). The search goes downhill from `start`.

    held_position: (n, d); observed: (K, d), nan where a particle was not seen [m]
    start: beta, theta; tolerance: smallest decrease of the error worth a step, as a share of it"""
    seen: BoolArray = np.asarray(np.isfinite(observed).all(axis=1))
    highest = np.array([-np.log1p(-largest_beta), 1.0])
    at = np.clip([-np.log1p(-start[0]), start[1]], 0.0, highest)
    position, error = _relaxed(body, held_position, observed, seen, at, None, volume)
    smallest = 10.0 * TOLERANCE[body.precision] * body.extent
    reach, evaluations = np.array([1.0, 0.5]), 1
    settled = error <= smallest
    while np.isfinite(error) and evaluations < max_evaluations and not settled:
        slope = _slopes(body, held_position, at, highest, position, volume)
        while evaluations < max_evaluations:
            box = np.maximum(-reach, -at), np.minimum(reach, highest - at)
            step, promised = _least(position[seen] - observed[seen], slope[seen], error, box)
            if error - promised <= max(tolerance * error, smallest):
                settled = True
                break
            tried, found = _relaxed(body, held_position, observed, seen, at + step, position + slope @ step, volume)
            evaluations += 1
            kept = (error - found) / (error - promised)
            if kept < 0.3:
                reach = 0.35 * np.minimum(reach, np.abs(step).max())
            elif kept > 0.75:
                reach = np.minimum(2.0 * reach, [4.0, 2.0])
            if kept > 0.1:
                at, position, error = at + step, tried, found
                settled = error <= smallest
                break
    # the states of the search are good enough for its direction; the last one is relaxed to its default
    beta, theta = float(-np.expm1(-at[0])), float(at[1])
    ended = body.relax(held_position, beta, theta, volume=volume, start=position)
    error = float(np.linalg.norm(ended.position[0, seen] - observed[seen], axis=1).mean())
    return FitBoth(beta, theta, ended.position[0], error, evaluations, bool(settled and ended.converged[0]))


def _relaxed(
    body: Msm,
    held_position: FloatArray,
    observed: FloatArray,
    seen: BoolArray,
    at: FloatArray,
    start: FloatArray | None,
    volume: Volume,
) -> tuple[FloatArray, float]:
    """The static state at -log(1 - beta) and theta (K, d), and its error; infinite where it ran away."""
    beta = float(-np.expm1(-at[0]))
    found = body.relax(held_position, beta, float(at[1]), volume=volume, start=start, tolerance=STATE_TOLERANCE)
    if found.diverged[0]:
        return found.position[0], float("inf")
    return found.position[0], float(np.linalg.norm(found.position[0, seen] - observed[seen], axis=1).mean())


def _slopes(
    body: Msm, held_position: FloatArray, at: FloatArray, highest: FloatArray, position: FloatArray, volume: Volume
) -> FloatArray:
    """(K, d, 2) differences of the static state (K, d) at -log(1 - beta) and theta over steps within the bounds."""
    ends = np.clip(at + SLOPE_STEP * np.concatenate([np.eye(2), -np.eye(2)]), 0.0, highest)
    moved = body.relax(held_position, -np.expm1(-ends[:, 0]), ends[:, 1], volume=volume, start=position).position
    return np.stack([(moved[i] - moved[i + 2]) / (ends[i, i] - ends[i + 2, i]) for i in range(2)], axis=-1)


def _least(
    away: FloatArray, slope: FloatArray, error: float, box: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, float]:
    """The step (2,) within `box` at which the mean length of `away + slope @ step` is least, and that length (convex).
    away: (n, d); slope: (n, d, 2)"""

    def mean_length(step: FloatArray) -> tuple[float, FloatArray]:
        moved = away + slope @ step
        length = np.sqrt(np.sum(moved * moved, axis=1) + (1e-6 * error) ** 2)
        by = np.einsum("nd,ndp->p", moved / length[:, None], slope) / len(length)
        return float(length.mean() / error), by / error

    found = minimize(
        mean_length,
        np.zeros(2),
        jac=True,
        bounds=list(zip(*box, strict=True)),
        method="L-BFGS-B",
        options={"ftol": 1e-12, "gtol": 1e-9},
    )
    return np.asarray(found.x), float(found.fun) * error
