"""Result of a calibration for predictions: a body, its law and its stiffness, enough to predict a poke.

Two kinds of body: `layers`, material below a surface, whose lattice is made for each poke; and `particles`, the fitted
particles themselves. Predictions are compared with pokes that were not fitted."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.force import pushed_along
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.plausible import check_poke
from deformscope.stages.msm import clusters
from deformscope.stages.msm.clusters import spacing as median_spacing
from deformscope.stages.msm.poke import Law, Poke, PokeSetup, Pressed, Tip, press
from deformscope.stages.msm.solver import Precision
from deformscope.stages.poke.layers import Layers, MeasuredSurface
from deformscope.stages.poke.poke_fit import CELLS_ACROSS_TIP, SLIPPED, DentResidual, SeenPoke, flat_edge, scene_below
from deformscope.stages.poke.stiffness_field import CONTACT, StiffnessField, fit_field
from deformscope.stages.regions.posterior import SurfaceKind

BodyKind = Literal["layers", "particles"]

TIP_SHARE, DEPTH_SHARE = 0.05, 0.1
"""Standard deviation of a predicted force's logarithm for each doubling or halving of the tip's width, and for each
doubling of the largest depth fitted. On finite element slabs, errors at tips of 1 to 4 cm were 1 to 6 % after a fit to
one of 2 cm. Real material beyond the pressed depth is unknown."""

BEYOND = 1.25
"""A depth, or depth over tip width, this many times the largest fitted is extrapolated to."""

DEEP = 0.3
"""Share of the thickness from which a poke is beyond the range of a linear law, for any fit."""

ALONG_AXIS = float(np.cos(np.radians(10.0)))
"""A push within 10 degrees of an axis is taken as along it."""


@dataclass(frozen=True, slots=True)
class Rival:
    """A law that follows the pokes about as well. stiffness: (p,) stiffness [N/m] of this law at the pokes with force;
    surface_error: share of the depth"""

    law: Law
    stiffness: FloatArray
    surface_error: float


@dataclass(frozen=True)
class FittedModel:
    """A model that can be poked.

    body; rest: (n, 3) points of the surface, or (K, d) particles [m]; thickness: below a surface [m]
    shape, cell: lattice of the particles, if they have one; fixed: particles that do not move
    toward: (d,) direction of a poke; spacing: spacing of the lattice to which `stiffness` belongs [m]
    tip: tip of the fit, and whether it slips law; places: (p, d) places of the pokes whose force was measured;
    stiffness: (p,) k there [N/m]; field_kind: kind of the surface between the pokes when the model was fitted
    left_out: (p,) relative error of each stiffness predicted from the other pokes
    surface_error: root mean square distance from the surface near the pokes, as a share of their depth; held_out: the
    same on pokes left out of the fit, nan with one poke; rivals: other laws that fit about as well
    fitted_depth: depth of the deepest fitted poke [m]; fitted_strain: the largest depth over tip width; nan: unknown
    residual: the law's residual on the surface around the tip of every fitted poke; provenance: where it comes from"""

    body: BodyKind
    rest: FloatArray
    law: Law
    spacing: float
    toward: FloatArray
    tip: Tip | None = None
    thickness: float | None = None
    shape: tuple[int, ...] | None = None
    cell: IntArray | None = None
    fixed: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    places: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    stiffness: FloatArray = field(default_factory=lambda: np.zeros(0))
    field_kind: SurfaceKind = "uniform"
    left_out: FloatArray = field(default_factory=lambda: np.zeros(0))
    surface_error: float = float("nan")
    held_out: float = float("nan")
    fitted_depth: float = float("nan")
    fitted_strain: float = float("nan")
    rivals: tuple[Rival, ...] = ()
    residual: DentResidual | None = None
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def dim(self) -> int:
        return int(self.rest.shape[1])

    @property
    def material_depth(self) -> float:
        """Thickness of material under a poke along its direction [m]."""
        return float(np.ptp(self.rest @ self.toward)) if self.thickness is None else self.thickness

    def beyond(self, depth: float, tip: Tip) -> tuple[str, ...]:
        """How a poke to a depth [m] exceeds the fitted ones, as text."""
        found = []
        if depth > BEYOND * self.fitted_depth:
            found.append(f"{1e3 * depth:.3g} mm deep, fitted to {1e3 * self.fitted_depth:.3g} mm")
        if (strain := depth / tip.width) > BEYOND * self.fitted_strain:
            found.append(f"depth over tip width {strain:.2g}, fitted to {self.fitted_strain:.2g}")
        if (share := depth / self.material_depth) > DEEP:
            found.append(f"{share:.0%} of the thickness deep, where materials stiffen more than the model")
        return tuple(found)

    def stiffness_at(self, poke: Poke, spacing: float, extra: float = 0.0) -> tuple[float, tuple[float, float]] | None:
        """k [N/m] of a lattice of this spacing under a poke, median and 90 % interval; None without a measured force.

        A finer lattice of the same material has a k that is smaller in proportion (in the plane: the same).
        extra: deviation of log stiffness for other reasons than the place"""
        if self.between is None:
            return None
        place, finer = self._across(poke.at[None]), float(spacing / self.spacing) ** (self.dim - 2)
        contact = CONTACT * poke.tip.width
        low, high = self.between.interval(place, contact_m=contact, extra=extra)[0] * finer
        return float(self.between.at(place, contact)[0]) * finer, (float(low), float(high))

    @cached_property
    def between(self) -> StiffnessField | None:
        """Stiffness between the pokes; None where no force was measured."""
        if not len(self.stiffness):
            return None
        return fit_field(self._across(self.places), self.stiffness, None if self.tip is None else self.tip.width)

    def _across(self, places: FloatArray) -> FloatArray:
        """Places (p, 2) of the field; in the plane the second is 0."""
        return np.column_stack([places[:, 0], places[:, 1] if self.dim == 3 else np.zeros(len(places))])

    def transfer_deviation(self, tip: Tip, depth: float, rivals: float = 0.0) -> float:
        """Deviation of the logarithm of a force for the sake of a tip, or a depth, that was not fitted.

        rivals: deviation of rival laws' predictions. They fit the same pokes and differ at other tips. Both describe
        the same uncertainty of the tip, so that only the larger one counts"""
        other = 0.0 if self.tip is None else abs(np.log2(np.sqrt(tip.area / self.tip.area)))
        deeper = np.log2(depth / self.fitted_depth) if depth > self.fitted_depth else 0.0
        return float(np.hypot(max(TIP_SHARE * other, rivals), DEPTH_SHARE * deeper))


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction of a poke.

    rest, position: (K, d) [m]; surface: (s,) indices of the particles that a tip could touch; touched: (m,) depth [m];
    force [N] and its 90 % interval, None without a measured force; stiffness: k [N/m] there; force_deviation: deviation
    of the force's logarithm for the law's, the tip's and the depth's sake, the place left out
    surface_error: how far particles of the surface near the tip may be off, root mean square [m]
    extrapolated: how the poke exceeds the fitted ones, as text
    layers: the lattice, for a body of layers; converged; residual: residual of the model, for points around the tip"""

    poke: Poke
    rest: FloatArray
    position: FloatArray
    surface: IntArray
    touched: IntArray
    depth: float
    force: float | None
    force_interval: tuple[float, float] | None
    force_deviation: float
    stiffness: float | None
    surface_error: float
    extrapolated: tuple[str, ...]
    layers: Layers | None
    converged: bool
    residual: DentResidual | None = None

    def at(self, points: FloatArray) -> FloatArray:
        """Displaced points (n, 3) of the surface, between the lattice's columns, with the law's residual around a tip;
        those beyond the lattice do not move."""
        if self.layers is None:
            raise InputError("a model of layers below a surface", "one of particles", "leave out the points")
        weights, inside = self.layers.interpolation(points[:, :2], flat_edge(self.poke.at, self.poke.tip))
        moved = weights @ (self.position - self.rest)
        if self.residual is not None and self.poke.tip.shape != "sphere":
            moved = moved + self.residual.at(points, self.poke.at[:2], self.poke.tip, self.depth)
        return np.asarray(points + np.where(inside[:, None], moved, 0.0))


def predict(model: FittedModel, poke: Poke, *, precision: Precision = "float32", device: str = "cpu") -> Prediction:
    """The static state under a poke that need not have been seen.

    poke.at: (d,) [m]; its component along the direction of the poke does not count The interval of the force combines
    the stiffness at this place by the pokes with the uncertainty of the law, an unusual tip and depth. Raises
    InputError for a poke that the material has no room for, and a force where no stiffness is known."""
    room = model.material_depth
    check_poke(model.rest, room, poke.depth or 0.0, poke.tip.width)
    scene, layers = scene_of(model, model.law, poke)
    known = model.stiffness_at(poke, scene.spacing)
    k = None if known is None else known[0]
    if poke.force is not None and k is None:
        raise InputError("a depth", "a force, but the model has no stiffness", "fit it with force_n in a pair file")
    found = press(scene, model.law, poke, stiffness=k, deepest=room, precision=precision, device=device)
    if found.depth >= room:
        wanted = f"a force that the {1e3 * room:.3g} mm of material under the tip can bear"
        raise InputError(wanted, f"{poke.force:g} N, which would press the tip through", "a smaller force")
    rivals = 0.0 if k is None else _rival_deviation(model, poke, found, precision, device)
    deviation = model.transfer_deviation(poke.tip, found.depth, rivals)
    here = model.stiffness_at(poke, scene.spacing, deviation)
    error = model.held_out if np.isfinite(model.held_out) else model.surface_error
    return Prediction(
        poke=poke,
        rest=scene.rest,
        position=found.position,
        surface=scene.open,
        touched=found.touched,
        depth=found.depth,
        force=None if k is None else k * found.reaction,
        force_interval=None if here is None else (here[1][0] * found.reaction, here[1][1] * found.reaction),
        force_deviation=deviation,
        stiffness=k,
        surface_error=error * found.depth,
        extrapolated=model.beyond(found.depth, poke.tip),
        layers=layers,
        converged=found.converged,
        residual=model.residual,
    )


def _rival_deviation(model: FittedModel, poke: Poke, found: Pressed, precision: Precision, device: str) -> float:
    """Root mean square difference of log force at this depth between the rival laws and the best one."""
    apart = []
    for rival in model.rivals:
        scene, _ = scene_of(model, rival.law, poke)
        same = dataclasses.replace(poke, depth=found.depth, force=None)
        other = press(scene, rival.law, same, start=found.position, precision=precision, device=device)
        if other.converged:
            apart.append(np.log(other.reaction / found.reaction * np.median(rival.stiffness / model.stiffness)))
    return float(np.sqrt(np.mean(np.square(apart)))) if apart else 0.0


def scene_of(model: FittedModel, law: Law, poke: Poke) -> tuple[PokeSetup, Layers | None]:
    """The model's body, ready for this poke. A tip narrower than the fitted one gets a finer lattice."""
    if model.body == "layers":
        assert model.thickness is not None
        assert law.cluster_size is not None
        fine = min(model.spacing, poke.tip.width / CELLS_ACROSS_TIP)
        if poke.tip.shape == "sphere":
            fine = min(model.spacing, poke.tip.width / (2 * CELLS_ACROSS_TIP))
        surface = MeasuredSurface(model.rest, model.thickness)
        return scene_below(surface, poke.at, poke.tip, fine, law.cluster_size)
    return particle_scene(model, law), None


def from_pair(
    seen: Observation, law: Law, stiffness: float | None, error: float, provenance: Mapping[str, object]
) -> FittedModel:
    """A model of the very particles of one observation. stiffness: k [N/m], None if unknown; in images with a force, k
    follows from that instead, and from the depth of the contact's face; error: average distance of the free particles
    [m]. Raises InputError where the scale is not known, or nothing was pushed."""
    scale = seen.metres_per_unit
    if scale is None:
        raise InputError("positions in metres for a model that is saved", "pixels of unknown size", "--px-per-cm")
    move = seen.deformed - seen.rest
    touched = seen.touched
    push = move[touched].mean(axis=0) if len(touched) else np.zeros(seen.rest.shape[1])
    depth = float(np.linalg.norm(push))
    if depth <= 0.0:
        raise InputError("held particles that were pushed", "none that moved", "name the pushing part in `held`")
    toward = push / depth
    axis = int(np.abs(toward).argmax())
    if abs(toward[axis]) > ALONG_AXIS:
        toward = np.sign(toward[axis]) * np.eye(len(toward))[axis]
    gap = median_spacing(seen.rest)
    across = np.ptp(np.delete(seen.rest[touched], axis, axis=1), axis=0)
    sideways = move[touched] - np.outer(move[touched] @ toward, toward)
    slips = bool(np.abs(sideways - sideways.mean(axis=0)).max() > SLIPPED * depth)
    place = seen.rest[touched].mean(axis=0) * scale
    tip = seen.tip or Tip("flat", tuple(float(max(side, gap)) * scale for side in across), slips)
    model = FittedModel(
        body="particles",
        rest=seen.rest * scale,
        law=law,
        spacing=gap * scale,
        toward=toward,
        tip=tip,
        shape=seen.shape,
        cell=seen.cell,
        fixed=np.setdiff1d(seen.held, touched),
        places=place[None] if stiffness is not None else np.zeros((0, len(place))),
        stiffness=np.array([]) if stiffness is None else np.array([stiffness]),
        left_out=np.array([]) if stiffness is None else np.array([np.nan]),
        surface_error=error / depth,
        fitted_depth=depth * scale,
        fitted_strain=depth * scale / tip.width,
        provenance=provenance,
    )
    at_face = pushed_along(seen) if seen.unit == "px" and seen.force_n else None
    if stiffness is None or at_face is None:
        return model
    face = at_face[1] * scale  # a contact's face moves farther than the particles below it: k for its depth
    found = press(particle_scene(model, law), law, Poke(place, tip, depth=face))
    k = np.array([(seen.force_n or 0.0) / found.reaction]) if found.converged else model.stiffness
    return dataclasses.replace(model, stiffness=k, fitted_depth=face, fitted_strain=face / tip.width)


def particle_scene(model: FittedModel, law: Law) -> PokeSetup:
    """The fitted particles; a tip can touch those that no other particle shields."""
    rest, gap = model.rest, median_spacing(model.rest)
    if law.cluster_size is None:
        grouped = clusters.single(len(rest))
    elif model.shape is not None and model.cell is not None:
        grouped = clusters.lattice(rest, model.shape, model.cell, law.cluster_size)
    else:
        grouped = clusters.nearest(rest, law.cluster_size**model.dim)
    covered = np.zeros(len(rest), dtype=bool)
    pairs = cKDTree(rest).query_pairs(1.7 * gap, output_type="ndarray")
    between = rest[pairs[:, 1]] - rest[pairs[:, 0]]
    along = between @ model.toward
    aside = np.linalg.norm(between - along[:, None] * model.toward, axis=1)
    stacked = aside < 0.6 * gap
    covered[pairs[stacked & (along > 0.3 * gap), 1]] = True
    covered[pairs[stacked & (along < -0.3 * gap), 0]] = True
    covered[model.fixed] = True
    return PokeSetup(rest, grouped, model.fixed, np.flatnonzero(~covered), model.toward, spacing=gap)


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
