"""beta of one deformed shape, by derivatives of its error, while the static state is followed."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.msm.cluster_functions import BY_BETA
from deformscope.stages.msm.iteration import Newton
from deformscope.stages.msm.newton_functions import CONVERGED
from deformscope.stages.msm.solver import TOLERANCE, Msm

LARGEST = 0.9999
"""Largest beta tried: at 1 only the linear fit is left, and most bodies have no unique static state."""

STATE_TOLERANCE = 1e-5
"""Tolerance of the search's static states, as a share of the body's extent; the last one is relaxed to its default."""

DERIVATIVE_TOLERANCE = 1e-3
"""Tolerance of d state / d beta in the search, as a share: it only gives the direction."""

EVALUATIONS = 40
"""Most evaluations of a fit."""


@dataclass(frozen=True, slots=True)
class Fit:
    """value: beta; position: (K, d) static state at that value [m]; aee: mean distance to those observed [m] (Thesis
    eq. 3.18)

    evaluations: static states that were followed; converged: the last step of beta was below the tolerance"""

    value: float
    position: FloatArray
    aee: float
    evaluations: int
    converged: bool


def fit_beta(
    body: Msm, held_position: FloatArray, observed: FloatArray, *, start: float = 0.5, tolerance: float = 1e-4
) -> Fit:
    """The beta in [0, 0.9999] at which the average Euclidean error (Thesis eq. 3.18) is least, for theta = 0.

    Its derivative is known at every static state (implicit differentiation). The derivative's zero is found by secants
    within an interval of betas whose derivatives have opposite signs. If the error has several minima, the one downhill
    from `start` is found; a sweep finds all.

    held_position: (n, d); observed: (K, d), nan where a particle was not seen [m]; tolerance: tolerance of beta"""
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
            most=EVALUATIONS,
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
            method, body, target, seen, start=start, tolerance=tolerance, most=EVALUATIONS
        )
        method.set(np.array([beta]), np.zeros(1))
        found = bool(method.relax(None, share, limit).state[0] == CONVERGED)
    position = body.rest + method.layout.get(method.u, body.dim)[0] * body.scale
    distance = np.linalg.norm(position[seen] - observed[seen], axis=1)
    return Fit(beta, position, float(distance.mean()), evaluations, settled and found)


def _followed(
    method: Newton, body: Msm, target: FloatArray, seen: BoolArray, *, start: float, tolerance: float, most: int
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
