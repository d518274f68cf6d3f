"""Pokes that were not fitted: predicted by the model, and by what else a user might take, against what was measured.

The others know what the model knows, the force at its first poke: a rigid body, an elastic half-space in closed form,
and linear finite elements of the very slab.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.lab.slab import Dent, RigidTip, Slab, press
from deformscope.stages.closed_form import half_space
from deformscope.stages.fitted import FittedModel, Prediction, predict
from deformscope.stages.model import Observation
from deformscope.stages.poke import Poke, Tip
from deformscope.stages.poke_fit import SeenPoke, seen_poke

NEAR_M = 0.03
"""The surface within this distance of the tip's edge is judged [m]."""

POISSON = 0.3
"""Poisson's ratio that the half-space and the finite elements are given: nothing tells it to them."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Score:
    """How one method did on one poke. surface_error: root mean square distance near the tip, as a share of the depth;
    force: predicted [N] and force_error, relative; None where the method has none or none was measured"""

    method: str
    surface_error: float
    force: float | None
    force_error: float | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """A measured poke, what the model predicts, and how every method did."""

    poke: SeenPoke
    prediction: Prediction
    predicted: FloatArray
    scores: tuple[Score, ...]


def compare(
    model: FittedModel, seen: Sequence[Observation], *, device: str = "cpu", progress: Progress | None = None
) -> list[Comparison]:
    """Predict measured pokes of a model of layers from their place, tip and depth.

    Raises InputError for a model of particles.
    """
    if model.body != "layers" or model.thickness is None:
        raise InputError("a model of layers below a surface", "one of particles", "fit it with --thickness-m")
    found = []
    for index, one in enumerate(seen):
        if progress is not None:
            progress("predicting", index, len(seen))
        poke = seen_poke(one)
        asked = Poke(poke.at, poke.tip, depth=poke.depth)
        prediction = predict(model, asked, device=device)
        moved = prediction.at(poke.points) - poke.points
        scores = [_score("MSM", poke, moved, prediction.force)]
        scores += [_score("rigid", poke, np.zeros_like(poke.moved), None)]
        scores += _elastic(model, poke)
        found.append(Comparison(poke, prediction, poke.points + moved, tuple(scores)))
    return found


def _near(poke: SeenPoke) -> IntArray:
    half = 0.5 * np.asarray(poke.tip.size if len(poke.tip.size) == 2 else poke.tip.size * 2)
    away = np.maximum(np.abs(poke.points[:, :2] - poke.at[:2]) - half, 0.0)
    return np.flatnonzero(np.linalg.norm(away, axis=1) <= NEAR_M + 1e-9)


def _score(method: str, poke: SeenPoke, moved: FloatArray, force: float | None) -> Score:
    near = _near(poke)
    error = float(np.sqrt(np.mean(np.sum((moved - poke.moved)[near] ** 2, axis=1)))) / poke.depth
    off = None if force is None or poke.force is None else force / poke.force - 1.0
    return Score(method, error, force, off)


def _elastic(model: FittedModel, poke: SeenPoke) -> list[Score]:
    """Half-space and finite elements, each with the modulus that its own fit to the model's poke gives."""
    aside = poke.points[:, :2] - poke.at[:2]
    fitted = _fitted_poke(model)
    solid = half_space(fitted[0], fitted[1], fitted[2], POISSON) if fitted is not None else None
    shape = half_space(poke.tip, poke.depth, 1.0, POISSON)
    force = None if solid is None else solid.force(poke.tip, poke.depth)
    scores = [_score("half-space", poke, shape.surface(poke.tip, poke.depth, aside), force)]
    slab, corner = _slab(model)

    def dent(at: FloatArray, tip: Tip, depth: float) -> Dent:
        place = (float(at[0] - corner[0]), float(at[1] - corner[1]))
        return press(slab, place, _rigid(tip), poke.points - corner, depth=depth)

    found = dent(poke.at, poke.tip, poke.depth)
    force = None
    if fitted is not None:
        force = found.force * fitted[2] / dent(fitted[3], fitted[0], fitted[1]).force
    return [*scores, _score("finite elements", poke, found.displaced, force)]


def _fitted_poke(model: FittedModel) -> tuple[Tip, float, float, FloatArray] | None:
    """Tip, depth, force and place of the model's first poke with force."""
    if not len(model.stiffness) or model.tip is None:
        return None
    depth = 1e-3
    place = model.places[0]
    found = predict(model, Poke(place, model.tip, depth=depth))
    if found.force is None:
        return None
    return model.tip, depth, found.force, place


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
