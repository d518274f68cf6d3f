"""beta of one deformed shape, or beta and theta, by derivatives of its error, while the static state is followed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.msm.cluster_functions import BY_BETA
from deformscope.stages.msm.iteration import Newton
from deformscope.stages.msm.newton_functions import CONVERGED
from deformscope.stages.msm.reference import Volume
from deformscope.stages.msm.solver import TOLERANCE, Msm

LARGEST = 0.9999
"""Largest beta tried: at 1 only the linear fit is left, and most bodies have no unique static state."""

STATE_TOLERANCE = 1e-5
"""Tolerance of the search's static states, as a share of the body's extent; the last one is relaxed to its default."""

DERIVATIVE_TOLERANCE = 1e-3
"""Tolerance of d state / d beta in the search, as a share: it only gives the direction."""


@dataclass(frozen=True, slots=True)
class Fit:
    """value: beta; position: (K, d) static state at that value [m]; aee: mean distance to the observed positions [m]
    (Thesis eq. 3.18)

    evaluations: static states that were followed; converged: the last step of beta was below the tolerance
    """

    value: float
    position: FloatArray
    aee: float
    evaluations: int
    converged: bool


@dataclass(frozen=True, slots=True)
class FitBoth:
    """beta, theta; position: (K, d) static state at these values [m]; aee: mean distance to the observed positions [m]
    (eq. 3.18)

    evaluations: static states that were followed; converged: no step is left that promises to lower the error
    """

    beta: float
    theta: float
    position: FloatArray
    aee: float
    evaluations: int
    converged: bool


def fit_beta(
    body: Msm,
    held_position: FloatArray,
    observed: FloatArray,
    *,
    start: float = 0.5,
    tolerance: float = 1e-4,
    max_evaluations: int = 40,
) -> Fit:
    """The beta in [0, 0.9999] at which the average Euclidean error (Thesis eq. 3.18) is least, for theta = 0.

    Its derivative is known at every static state (implicit differentiation). The derivative's zero is found by secants
    within an interval of betas whose derivatives have opposite signs. If the error has several minima, the one downhill
    from `start` is found; a sweep finds all.

    held_position: (n, d); observed: (K, d), nan where a particle was not seen [m]; tolerance: tolerance of beta
    """
    method: Newton = body._method(Newton, 1, 0)
    seen: BoolArray = np.asarray(np.isfinite(observed).all(axis=1))
    target = np.where(seen[:, None], (observed - body.rest) / body.scale, 0.0)
    u = np.zeros_like(target)
    u[body.held] = (held_position - body.rest[body.held]) / body.scale
    method.put(u[None])
    spread = STATE_TOLERANCE * body.extent / body.scale
    share = TOLERANCE[body.precision] * body.extent / body.scale
    limit = 40 * len(body.rest) + 4000
    if method.threads:
        method.set(np.array([start]), np.zeros(1))
        beta, evaluations, settled, found = method.follow(
            target,
            seen,
            most=max_evaluations,
            limit=limit,
            start=start,
            largest=LARGEST,
            tolerance=tolerance,
            spread=spread,
            share=share,
            relative=DERIVATIVE_TOLERANCE,
        )
    else:
        beta, evaluations, settled = _followed(
            method, body, target, seen, start=start, tolerance=tolerance, most=max_evaluations
        )
        method.set(np.array([beta]), np.zeros(1))
        found = bool(method.relax(None, share, limit).state[0] == CONVERGED)
    position = body.rest + method.layout.get(method.u, body.dim)[0] * body.scale
    distance = np.linalg.norm(position[seen] - observed[seen], axis=1)
    return Fit(beta, position, float(distance.mean()), evaluations, settled and found)


def _followed(
    method: Newton,
    body: Msm,
    target: FloatArray,
    seen: BoolArray,
    *,
    start: float,
    tolerance: float,
    most: int,
) -> tuple[float, int, bool]:
    """The search of `fit_beta` where no kernel does it in one launch: beta, evaluations, whether it settled."""
    layout, spread = method.layout, STATE_TOLERANCE * body.extent / body.scale
    low, high, beta, evaluations = 0.0, LARGEST, start, 0
    before: tuple[float, float] | None = None
    settled = False
    while evaluations < most and not settled:
        method.set(np.array([beta]), np.zeros(1))
        method.relax(None, spread, 40 * len(body.rest) + 4000)
        method.derive(BY_BETA)
        method.solve(DERIVATIVE_TOLERANCE)
        evaluations += 1
        u, moved = (layout.get(each, body.dim) for each in (method.u, method.step))
        away, along = (u[0] - target)[seen], moved[0][seen]
        distance = np.maximum(np.sqrt(np.sum(away * away, axis=1)), 1e-9)
        slope = float(np.sum(np.sum(away * along, axis=1) / distance))
        curvature = float(np.sum(np.sum(along * along, axis=1) / distance))  # with it no step overshoots
        low, high = (max(low, beta), high) if slope < 0.0 else (low, min(high, beta))
        step = -slope / curvature if curvature > 0.0 else 0.0
        if before is not None and slope != before[1]:
            secant = -slope * (beta - before[0]) / (slope - before[1])
            if np.sign(secant) == -np.sign(slope):
                step = secant
        new = float(np.clip(beta + step, low + 0.1 * (beta - low), high - 0.1 * (high - beta)))
        settled = abs(new - beta) <= tolerance
        before = (beta, slope)
        layout.put(u + moved * (new - beta), method.u)
        beta = new
    return beta, evaluations, settled


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

    Each step linearizes the static state in -log(1 - beta) and theta, by its derivatives, and minimises the error over
    both. The step limit grows where the prediction held and shrinks where it did not (the error has long curved
    valleys: less beta needs more theta). The search goes downhill from `start`, as in `fit_beta`.

    held_position: (n, d); observed: (K, d), nan where a particle was not seen [m]
    start: beta, theta; tolerance: smallest decrease of the error worth a step, as a share of it
    """
    seen: BoolArray = np.asarray(np.isfinite(observed).all(axis=1))
    highest = np.array([-np.log1p(-largest_beta), 1.0])
    at = np.clip([-np.log1p(-start[0]), start[1]], 0.0, highest)
    position, error = _relaxed(body, held_position, observed, seen, at, None, volume)
    smallest = 10.0 * TOLERANCE[body.precision] * body.extent
    reach, evaluations = np.array([1.0, 0.5]), 1
    settled = error <= smallest
    while np.isfinite(error) and evaluations < max_evaluations and not settled:
        by = body.sensitivity(position, float(-np.expm1(-at[0])), float(at[1]), volume=volume)
        slope = np.stack([by.beta[0] * np.exp(-at[0]), by.theta[0]], axis=-1)
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
