"""Predicted positions of the particles under another load, with intervals.

Uncertain are the parameter (its posterior), the model (the misfit of the fit, scaled with the size of the deformation),
and the noise of the prescribed positions through its effect on the simulation. For particles that will be measured as
those of the fit, the noise of that measurement is added."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.calibrate import Calibration
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.residuals import Explanation
from deformscope.stages.msm.solver import Msm
from deformscope.stages.poke.stiffness_field import quantile

VALUES = 15
"""Values of the parameter that stand for its posterior, each of equal probability."""

LEAST_WEIGHT = 0.005
"""Explanations of less weight are left out."""


@dataclass(frozen=True, slots=True)
class Predicted:
    """Predicted particles. position: (K, d) median of each coordinate; low, high: (K, d) ends of the interval of each
    at `level` [unit]; held particles are where they were put."""

    position: FloatArray
    low: FloatArray
    high: FloatArray
    level: float


def predict(
    found: Calibration,
    seen: Sequence[Observation],
    model: Model,
    poke: Observation,
    *,
    level: float = 0.9,
    measured: bool = True,
) -> Predicted:
    """Particles of a poke that was not fitted.

    seen, model: what `found` was fitted to, and how; poke: poke of the same body, or of one of its material: its rest
    shape, `held` particles and their deformed positions are used, nothing else
    measured: whether the positions that the intervals are for will carry noise of measurement, as those fitted did"""
    posterior = found.inferred.posterior
    value = posterior.quantile((np.arange(VALUES) + 0.5) / VALUES)
    beta, theta = (value, model.theta) if model.parameter == "beta" else (model.beta, value)
    body = model.body(poke)
    held_position = poke.deformed[poke.held]
    state = body.relax(held_position, beta, theta, volume=model.volume)
    simulated = state.position
    middle = simulated[VALUES // 2]
    motion = _motion(middle, poke.rest, body.free)
    by_held = _response_square(body, model, middle, poke, float(value[VALUES // 2]))
    mean, deviation, weight = [], [], []
    for one, fitted in zip(found.inferred.explanations, seen, strict=True):
        white = np.full(len(poke.rest), 1.0 if fitted.noise is None else float(np.sqrt(np.mean(fitted.noise**2))))
        grown = motion / max(_motion(fitted.deformed, fitted.rest, fitted.free_observed), 1e-300)
        for h in np.flatnonzero(one.likely >= LEAST_WEIGHT):
            variance = _variance(one, h, white, grown, by_held, measured=measured)
            for row in range(VALUES):
                mean.append(simulated[row])
                deviation.append(np.sqrt(variance))
                weight.append(one.likely[h] / VALUES / len(seen))
    share = np.array(weight) / np.sum(weight)
    tails = 0.5 * (1.0 - level), 0.5, 0.5 * (1.0 + level)
    ends = [quantile(np.array(mean), np.array(deviation), share, q) for q in tails]
    for end in ends:
        end[poke.held] = held_position
    return Predicted(position=ends[1], low=ends[0], high=ends[2], level=level)


def _motion(deformed: FloatArray, rest: FloatArray, which: BoolArray) -> float:
    """Root mean square displacement of a coordinate of the particles (K, d) at `which`, in their unit."""
    return float(np.sqrt(np.mean((deformed - rest)[which] ** 2)))


def _response_square(body: Msm, model: Model, base: FloatArray, poke: Observation, value: float) -> FloatArray:
    """(K, d) sum of squares of what unit steps of the held coordinates do."""
    count, d = len(poke.held), poke.rest.shape[1]
    steps = np.eye(count * d).reshape(-1, count, d)
    small = 1e-3 * body.scale
    beta, theta = (value, model.theta) if model.parameter == "beta" else (model.beta, value)
    total = np.zeros_like(base)
    for first in range(0, len(steps), 64):
        held = base[poke.held] + small * steps[first : first + 64]
        moved = body.relax(held, beta, theta, volume=model.volume, start=base).position
        total += np.sum(((moved - base) / small) ** 2, axis=0)
    return total


def _variance(
    one: Explanation, h: np.intp, white: FloatArray, grown: float, by_held: FloatArray, *, measured: bool
) -> FloatArray:
    """(K, d) of observed - simulated under one explanation."""
    noise2 = (one.white[h] * white[:, None]) ** 2
    shared2 = one.field[h] ** 2 if one.shared[h] else 0.0
    variance = np.zeros_like(by_held)
    if measured:
        variance += noise2 + shared2
    if one.held[h]:
        variance += (noise2.mean() + shared2) * by_held
    if not one.shared[h]:
        variance += (one.field[h] * grown) ** 2
    return np.asarray(np.maximum(variance, 1e-300))
