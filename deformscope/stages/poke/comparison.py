"""Accuracy of predicted pokes that were not fitted: displacements and force of each, against the measurement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.msm.poke import Poke
from deformscope.stages.poke.fitted import FittedModel, Prediction, predict
from deformscope.stages.poke.poke_fit import SeenPoke

NEAR_M = 0.03
"""The surface within this distance of the tip's edge is judged [m]."""


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of one method on one poke. surface_error: root mean square distance near the tip, as a share of the depth;
    force: predicted [N] and force_error, relative; None where the method has none or none was measured"""

    method: str
    surface_error: float
    force: float | None
    force_error: float | None


@dataclass(frozen=True, slots=True)
class PokeComparison:
    """A measured poke, the model's prediction, and the errors of every method."""

    poke: SeenPoke
    prediction: Prediction
    predicted: FloatArray
    scores: tuple[Score, ...]


@dataclass(frozen=True, slots=True)
class PooledPokes:
    """Errors of the model on several measured pokes. surface_error, force_error: root mean square, of the depth and of
    the measured force; forces: pokes whose force was measured and predicted; held: in how many of these the 90 %
    interval contains the force; width: median of the intervals' widths, of the predicted force; None without forces"""

    pokes: int
    surface_error: float
    forces: int
    force_error: float | None
    held: int
    width: float | None


def together(compared: Sequence[PokeComparison]) -> PooledPokes:
    """The pooled errors of all comparisons, at least one."""
    surface = [one.scores[0].surface_error for one in compared]
    off, held, width = [], 0, []
    for one in compared:
        found, measured = one.prediction, one.poke.force
        if measured is None or found.force is None or found.force_interval is None:
            continue
        low, high = found.force_interval
        off.append(found.force / measured - 1.0)
        held += low <= measured <= high
        width.append((high - low) / found.force)
    rms, median = (float(np.sqrt(np.mean(np.square(off)))), float(np.median(width))) if off else (None, None)
    return PooledPokes(len(compared), float(np.sqrt(np.mean(np.square(surface)))), len(off), rms, held, median)


def predict_seen(model: FittedModel, poke: SeenPoke, *, device: str = "cpu") -> tuple[Prediction, FloatArray, Score]:
    """A measured poke predicted from its place, tip and depth: displacement (n, 3) of its points [m] too, and how well
    that did."""
    prediction = predict(model, Poke(poke.at, poke.tip, depth=poke.depth), device=device)
    moved = prediction.at(poke.points) - poke.points
    return prediction, moved, score_of("MSM", poke, moved, prediction.force)


def score_of(method: str, poke: SeenPoke, moved: FloatArray, force: float | None) -> Score:
    """Errors of displacements (n, 3) of the points, and of a force, on a measured poke."""
    away = np.maximum(np.abs(poke.points[:, :2] - poke.at[:2]) - poke.tip.half, 0.0)  # seen from above
    near = np.linalg.norm(away, axis=1) <= NEAR_M + 1e-9
    error = float(np.sqrt(np.mean(np.sum((moved - poke.moved)[near] ** 2, axis=1)))) / poke.depth
    off = None if force is None or poke.force is None else force / poke.force - 1.0
    return Score(method, error, force, off)
