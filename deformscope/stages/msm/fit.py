"""beta of one deformed shape by the gradient of its error, with the static state followed along."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.msm.cluster_functions import BY_BETA
from deformscope.stages.msm.iteration import Newton
from deformscope.stages.msm.iteration_kernels import CONVERGED
from deformscope.stages.msm.solver import TOLERANCE, Msm

LARGEST = 0.9999
"""Largest beta tried: at 1 nothing but the linear fit is left, and most bodies have no single static state."""

STATE_TOLERANCE = 1e-5
"""Of the static states along the way, as a share of the body's extent; the last one is relaxed to its default."""

DERIVATIVE_TOLERANCE = 1e-3
"""Of d state / d beta along the way, as a share: it is only to tell where to go."""


@dataclass(frozen=True, slots=True)
class Fit:
    """value: beta; position: (K, d) its static state [m]; aee: mean distance to what was observed [m] (Thesis eq. 3.18)

    evaluations: static states that were followed; converged: the last step of beta was below the tolerance
    """

    value: float
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

    Its derivative is known at every static state (implicit differentiation), and its zero is found by secants, kept
    between the betas that are known to lie on either side. Where the error has several minima, the one downhill from
    `start` is found; a sweep sees them all.

    held_position: (n, d); observed: (K, d), nan where a particle was not seen [m]; tolerance: on beta
    """
    way: Newton = body._way(Newton, 1, 0)
    seen: BoolArray = np.asarray(np.isfinite(observed).all(axis=1))
    target = np.where(seen[:, None], (observed - body.rest) / body.scale, 0.0)
    u = np.zeros_like(target)
    u[body.held] = (held_position - body.rest[body.held]) / body.scale
    way.put(u[None])
    spread = STATE_TOLERANCE * body.extent / body.scale
    low, high = 0.0, LARGEST
    before: tuple[float, float] | None = None
    beta, evaluations = start, 0
    settled = False
    while evaluations < max_evaluations and not settled:
        slope, curvature, moved = _downhill(way, body, beta, target, seen, spread)
        evaluations += 1
        low, high = (max(low, beta), high) if slope < 0.0 else (low, min(high, beta))
        step = -slope / curvature if curvature > 0.0 else 0.0
        if before is not None and slope != before[1]:
            secant = -slope * (beta - before[0]) / (slope - before[1])
            if np.sign(secant) == -np.sign(slope):
                step = secant
        new = float(np.clip(beta + step, low + 0.1 * (beta - low), high - 0.1 * (high - beta)))
        settled = abs(new - beta) <= tolerance
        before = (beta, slope)
        way.layout.put((way.layout.get(way.u, body.dim) + moved * (new - beta)), way.u)
        beta = new
    way.set(np.array([beta]), np.zeros(1))
    share = TOLERANCE[body.precision] * body.extent / body.scale
    ended = way.relax(None, share, 40 * len(body.rest) + 4000)
    position = body.rest + way.layout.get(way.u, body.dim)[0] * body.scale
    distance = np.linalg.norm(position[seen] - observed[seen], axis=1)
    found = settled and bool(ended.state[0] == CONVERGED)
    return Fit(beta, position, float(distance.mean()), evaluations, found)


def _downhill(
    way: Newton, body: Msm, beta: float, target: FloatArray, seen: BoolArray, tolerance: float
) -> tuple[float, float, FloatArray]:
    """Slope of the summed distance at beta, a curvature that never overshoots, and d state / d beta (1, K, d)."""
    way.set(np.array([beta]), np.zeros(1))
    way.relax(None, tolerance, 40 * len(body.rest) + 4000)
    way.derive(BY_BETA)
    way.solve(DERIVATIVE_TOLERANCE)
    moved = way.layout.get(way.step, body.dim)
    away = (way.layout.get(way.u, body.dim)[0] - target)[seen]
    along = moved[0][seen]
    distance = np.maximum(np.sqrt(np.sum(away * away, axis=1)), 1e-9)
    slope = float(np.sum(np.sum(away * along, axis=1) / distance))
    return slope, float(np.sum(np.sum(along * along, axis=1) / distance)), moved
