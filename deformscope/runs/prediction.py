"""Predicts pokes that were not fitted, and compares them with measurements."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.config.flags import Device, PokeText
from deformscope.errors import InputError
from deformscope.files.model_file import load_model
from deformscope.lab.slab import Dent, RigidTip, Slab, press
from deformscope.pictures.figures import dents_png
from deformscope.pictures.report import ColoredBody, Figure, Findings, Table
from deformscope.plain import Json
from deformscope.runs.calibration_result import CalibrationResult
from deformscope.runs.result import LibraryResult
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm.poke import Poke, Tip
from deformscope.stages.msm.quiet import quiet_warp
from deformscope.stages.msm.solver import pick_device
from deformscope.stages.poke import fitted
from deformscope.stages.poke.closed_form import half_space
from deformscope.stages.poke.fitted import (
    FittedModel,
    PokeComparison,
    PooledPokes,
    Prediction,
    Score,
    predict,
    predict_seen,
    score_of,
)
from deformscope.stages.poke.poke_fit import SeenPoke, seen_poke

ModelSource: TypeAlias = FittedModel | CalibrationResult | Path | str


@dataclass(frozen=True, slots=True)
class PredictionResult(LibraryResult):
    """Prediction of a poke. points: (n, 3) points of the surface whose deformed positions are predicted too [m]"""

    prediction: Prediction
    points: FloatArray | None = None

    @property
    def depth_m(self) -> float:
        """Depth of the tip [m]."""
        return self.prediction.depth

    @property
    def force_n(self) -> float | None:
        """The force on the tip [N]; None if the model was fitted without one."""
        return self.prediction.force

    @property
    def rest_m(self) -> FloatArray:
        """(K, d) particles before the poke [m]."""
        return self.prediction.rest

    @property
    def deformed_m(self) -> FloatArray:
        """(K, d) particles under the poke [m]."""
        return self.prediction.position

    def __repr__(self) -> str:
        force = "no force" if self.force_n is None else f"{self.force_n:.4g} N"
        return f"<poke {format_poke(self.prediction.poke)}: {1e3 * self.depth_m:.4g} mm, {force}>"

    def as_json(self) -> Json:
        found = self.prediction
        public: dict[str, Any] = {
            "poke": {
                "at_m": found.poke.at,
                "tip": found.poke.tip.shape,
                "size_m": found.poke.tip.size,
                "slips": found.poke.tip.slips,
                "depth_m": found.poke.depth,
                "force_n": found.poke.force,
            },
            "depth_m": found.depth,
            "force_n": found.force,
            "force_interval_n": found.force_interval,
            "stiffness_n_per_m": found.stiffness,
            "surface_error_m": found.surface_error,
            "extrapolated": found.extrapolated,
            "converged": found.converged,
            "surface": {"rest": found.rest[found.surface], "deformed": found.position[found.surface]},
            "touched": found.touched,
        }
        if self.points is not None:
            public["points"] = {"rest": self.points, "deformed": found.at(self.points)}
        return public

    def tables(self) -> tuple[Table, ...]:
        found = self.prediction
        rows = [("depth", f"{1e3 * found.depth:.4g} mm")]
        if found.force is None or found.force_interval is None:
            rows.append(("force", "not known: the model was fitted without a force (force_n in a pair file)"))
        else:
            low, high = found.force_interval
            rows.append(("force", f"{found.force:.4g} N, 90 % interval {low:.4g} to {high:.4g}"))
        rows.append(("surface", f"surface error {1e3 * found.surface_error:.3g} mm near the tip (rms, in the fit)"))
        rows.append(("touched", f"{len(found.touched)} particles"))
        rows += _beyond(found)
        rows.append(("converged", "yes" if found.converged else "NO: do not rely on it"))
        return (Table(rows, caption=f"Poke {format_poke(found.poke)}"),)

    def figures(self) -> tuple[Figure, ...]:
        return (Figure(dents_png([self.prediction], []), "A cut through the dent along x"),)

    def findings(self) -> Findings:
        return Findings(self.tables(), self.figures(), (moved_body(self.prediction),))


def moved_body(found: Prediction) -> ColoredBody:
    """The deformed particles, coloured by how far each moved."""
    moved_mm = 1e3 * np.linalg.norm(found.position - found.rest, axis=1)
    return ColoredBody("Particles under the poke, coloured by their displacement [mm]", found.position, moved_mm)


def _beyond(found: Prediction) -> list[tuple[str, str]]:
    words = f"BEYOND what was fitted: {'; '.join(found.extrapolated)}"
    return [("extrapolated", words)] if found.extrapolated else []


def comparison_table(name: str, found: PokeComparison) -> Table:
    """Errors of the model and its alternatives on a measured poke."""
    rows = []
    for one in found.scores:
        force = "no force" if one.force is None else f"force {one.force:.3g} N"
        off = "" if one.force_error is None else f" ({one.force_error:+.1%})"
        rows.append((one.method, f"surface error {one.surface_error:.1%} of the depth, {force}{off}"))
    rows += _beyond(found.prediction)
    if found.poke.force is not None:
        rows.append(("measured", f"force {found.poke.force:.3g} N at {1e3 * found.poke.depth:.3g} mm"))
    if found.prediction.force_interval is not None:
        low, high = found.prediction.force_interval
        rows.append(("MSM, 90 % interval", f"{low:.3g} to {high:.3g} N"))
    return Table(rows, caption=f"Against {name}")


def together_table(found: PooledPokes) -> Table:
    """Errors of the model on all measured pokes."""
    rows = [("surface", f"surface error {found.surface_error:.1%} of the depth (rms)")]
    if found.force_error is not None:
        rows.append(("force", f"off by {found.force_error:.1%} (rms)"))
        held = f"{found.held} of {found.forces} intervals contain the measured force, median width {found.width:.0%}"
        rows.append(("90 % intervals", held))
    return Table(rows, caption=f"Against {found.pokes} measured pokes")


def format_poke(poke: Poke) -> str:
    """Place and tip."""
    place = ", ".join(f"{v:.3g}" for v in poke.at)
    size = " x ".join(f"{1e3 * side:.3g}" for side in poke.tip.size)
    return f"at ({place}) m with a {poke.tip.shape} tip of {size} mm"


def predicted(model: FittedModel, text: PokeText, points_m: FloatArray | None, device: Device) -> PredictionResult:
    """Prediction of a poke. points_m: (n, 3) as in `PredictionResult`"""
    quiet_warp()
    found = fitted.predict(model, poke_of(text, model), device=pick_device(device))
    return PredictionResult(found, None if points_m is None else np.asarray(points_m, dtype=np.float64))


def fitted_model(model: ModelSource) -> FittedModel:
    """The model of any supported source."""
    if isinstance(model, CalibrationResult):
        return model.model()
    return model if isinstance(model, FittedModel) else load_model(Path(model))


def poke_of(text: PokeText, model: FittedModel) -> Poke:
    """A poke with missing values from the model."""
    if text.tip is None and model.tip is None:
        raise InputError("a tip, because the model has none", "none", "tip=flat size=0.02x0.02")
    slips = model.tip.slips if model.tip is not None else True
    if text.tip is not None:
        tip = Tip(text.tip, text.size, slips)
    else:
        assert model.tip is not None
        tip = dataclasses.replace(model.tip, size=text.size or model.tip.size)
    at = np.array(text.at)
    if model.dim == 3 and at.size == 2:
        at = np.append(at, model.rest[:, 2].max())
    if at.size != model.dim:
        raise InputError(f"at= with {2 if model.dim == 2 else '2 or 3'} coordinates", f"{at.size}", "at=0.28,0.2")
    return Poke(at, tip, text.depth, text.force)


def arrays_of(every: Sequence[Prediction]) -> Mapping[str, np.ndarray]:
    """The (K, d) particles of every poke at rest and deformed, in the unit of the model, and indices. (s,) are those of
    the surface, (m,) those that the tip touches, as in the command's file."""
    arrays: dict[str, np.ndarray] = {}
    for index, one in enumerate(every):
        arrays[f"rest_{index}"], arrays[f"deformed_{index}"] = one.rest, one.position
        arrays[f"surface_{index}"], arrays[f"touched_{index}"] = one.surface, one.touched
    return arrays


# Pokes that were not fitted: predicted by the model, and by its alternatives, compared with the measurement.
#
# The others have the model's information, the force at its first poke. The other methods are a rigid body, an elastic
# half-space in closed form, and linear finite elements of the same slab

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
