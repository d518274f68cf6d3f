"""Pokes that were not fitted: predicted by the model, and by what else a user might take, against what was measured.

The others know what the model knows, the force at its first poke: a rigid body, an elastic half-space in closed form,
and linear finite elements of the very slab.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.lab.slab import Dent, RigidTip, Slab, press
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.poke import Poke, Tip
from deformscope.stages.poke.closed_form import half_space
from deformscope.stages.poke.fitted import FittedModel, Prediction, predict
from deformscope.stages.poke.poke_fit import SeenPoke, seen_poke

NEAR_M = 0.03
"""The surface within this distance of the tip's edge is judged [m]."""

POISSON = 0.3
"""Poisson's ratio that the half-space and the finite elements are given: they have no data for it."""

FITTED_DEPTH = 1e-3
"""At which the elastic bodies are given their modulus [m]: there the model is linear."""


@dataclass(frozen=True, slots=True)
class Score:
    """How one method did on one poke. surface_error: root mean square distance near the tip, as a share of the depth;
    force: predicted [N] and force_error, relative; None where the method has none or none was measured"""

    method: str
    surface_error: float
    force: float | None
    force_error: float | None


@dataclass(frozen=True, slots=True)
class PokeComparison:
    """A measured poke, what the model predicts, and how every method did."""

    poke: SeenPoke
    prediction: Prediction
    predicted: FloatArray
    scores: tuple[Score, ...]


def compare(
    model: FittedModel, seen: Sequence[Observation], *, device: str = "cpu", progress: Progress | None = None
) -> list[PokeComparison]:
    """Predict measured pokes of a model of layers from their place, tip and depth.

    Raises InputError for a model of particles.
    """
    if model.body != "layers" or model.thickness is None:
        raise InputError("a model of layers below a surface", "one of particles", "fit it with --thickness-m")
    found = []
    elastic = _Elastic(model)
    for index, one in enumerate(seen):
        if progress is not None:
            progress("predicting", index, len(seen))
        poke = seen_poke(one)
        prediction, moved, ours = predict_seen(model, poke, device=device)
        scores = [ours]
        scores += [score_of("rigid", poke, np.zeros_like(poke.moved), None)]
        scores += elastic.scores(poke)
        found.append(PokeComparison(poke, prediction, poke.points + moved, tuple(scores)))
    return found


@dataclass(frozen=True, slots=True)
class PooledPokes:
    """How the model did on several measured pokes. surface_error, force_error: root mean square, of the depth and of
    the measured force; forces: pokes whose force was measured and predicted; held: of these, how many 90 % intervals
    hold it; width: median of the intervals' widths, of the predicted force; None without forces"""

    pokes: int
    surface_error: float
    forces: int
    force_error: float | None
    held: int
    width: float | None


def together(compared: Sequence[PokeComparison]) -> PooledPokes:
    """All of them, at least one."""
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


def _near(poke: SeenPoke) -> IntArray:
    half = 0.5 * np.asarray(poke.tip.size if len(poke.tip.size) == 2 else poke.tip.size * 2)
    away = np.maximum(np.abs(poke.points[:, :2] - poke.at[:2]) - half, 0.0)
    return np.flatnonzero(np.linalg.norm(away, axis=1) <= NEAR_M + 1e-9)


def score_of(method: str, poke: SeenPoke, moved: FloatArray, force: float | None) -> Score:
    """How displacements (n, 3) of the points, and a force, do on a measured poke."""
    near = _near(poke)
    error = float(np.sqrt(np.mean(np.sum((moved - poke.moved)[near] ** 2, axis=1)))) / poke.depth
    off = None if force is None or poke.force is None else force / poke.force - 1.0
    return Score(method, error, force, off)


class _Elastic:
    """Half-space and finite elements, each with the modulus that the force at the model's first poke gives it."""

    def __init__(self, model: FittedModel) -> None:
        self.model = model
        self.slab, self.corner = _slab(model)

    @functools.cached_property
    def _fitted(self) -> tuple[Tip, FloatArray, float] | None:
        """Tip and place of the model's first poke with force, and its force at `FITTED_DEPTH`."""
        model = self.model
        if not len(model.stiffness) or model.tip is None:
            return None
        found = predict(model, Poke(model.places[0], model.tip, depth=FITTED_DEPTH))
        return None if found.force is None else (model.tip, model.places[0], found.force)

    @functools.cached_property
    def _fitted_unit(self) -> float:
        """Force of the finite elements at that poke with a modulus of 1 Pa."""
        assert self._fitted is not None
        tip, at, _ = self._fitted
        return self._dent(at, tip, FITTED_DEPTH, self.model.rest[:1]).force

    def _dent(self, at: FloatArray, tip: Tip, depth: float, points: FloatArray) -> Dent:
        place = (float(at[0] - self.corner[0]), float(at[1] - self.corner[1]))
        return press(self.slab, place, _rigid(tip), points - self.corner, depth=depth)

    def scores(self, poke: SeenPoke) -> list[Score]:
        """Both, on one measured poke."""
        fitted = self._fitted
        shape = half_space(poke.tip, poke.depth, 1.0, POISSON)
        surface = shape.surface(poke.tip, poke.depth, poke.points[:, :2] - poke.at[:2])
        force = None
        if fitted is not None:
            force = half_space(fitted[0], FITTED_DEPTH, fitted[2], POISSON).force(poke.tip, poke.depth)
        found = [score_of("half-space", poke, surface, force)]
        dent = self._dent(poke.at, poke.tip, poke.depth, poke.points)
        force = None if fitted is None else dent.force * fitted[2] / self._fitted_unit
        return [*found, score_of("finite elements", poke, dent.displaced, force)]


def _slab(model: FittedModel) -> tuple[Slab, FloatArray]:
    """The slab below the surface, of modulus 1 Pa, and where its corner lies."""
    low, high = model.rest.min(axis=0), model.rest.max(axis=0)
    assert model.thickness is not None
    corner = np.array([low[0], low[1], float(np.median(model.rest[:, 2])) - model.thickness])
    return Slab((float(high[0] - low[0]), float(high[1] - low[1]), model.thickness), 1.0, POISSON), corner


def _rigid(tip: Tip) -> RigidTip:
    if tip.shape == "sphere":
        return RigidTip(radius=0.5 * tip.size[0], bonded=not tip.slips)
    side = tip.size if tip.shape == "flat" else (float(np.sqrt(tip.area)),)
    return RigidTip((0.5 * side[0], 0.5 * side[-1]), bonded=not tip.slips)
