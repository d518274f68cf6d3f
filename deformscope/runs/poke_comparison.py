"""Pokes that were not fitted: predicted by the model, and by its alternatives, compared with the measurement.

The others have the model's information, the force at its first poke. The other methods are a rigid body, an elastic
half-space in closed form, and linear finite elements of the same slab."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.slab import Dent, RigidTip, Slab, press
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.poke import Poke, Tip
from deformscope.stages.poke.closed_form import half_space
from deformscope.stages.poke.comparison import PokeComparison, Score, predict_seen, score_of
from deformscope.stages.poke.fitted import FittedModel, predict
from deformscope.stages.poke.poke_fit import SeenPoke, seen_poke

POISSON = 0.3
"""Poisson's ratio of the half-space and the finite elements, for which there are no data."""

FITTED_DEPTH = 1e-3
"""Depth at which the elastic bodies get their modulus [m]: there the model is linear."""


def compare(
    model: FittedModel, seen: Sequence[Observation], *, device: str = "cpu", progress: Progress | None = None
) -> list[PokeComparison]:
    """Predict measured pokes of a model of layers from their place, tip and depth.

    Raises InputError for a model of particles."""
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
