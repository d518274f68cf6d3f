"""Input of a fit: one observed manipulation of a body, the fitted model, the method, and its error."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.estimate import Doubt, LengthUnit, NoiseSource, Parameter
from deformscope.stages.msm import clusters
from deformscope.stages.msm.poke import Tip
from deformscope.stages.msm.reference import Basis, Volume
from deformscope.stages.msm.solver import Msm, Precision


def distances(simulated: FloatArray, observed: FloatArray) -> FloatArray:
    """Euclidean distance of each particle from its observed place: (..., K, d) and (K, d) give (..., K). Their mean is
    the average Euclidean error (AEE) of Thesis eq. 3.18 and 3.19."""
    return np.asarray(np.sqrt(np.sum((simulated - observed) ** 2, axis=-1)))


def nearest_error(simulated: FloatArray, observed: FloatArray) -> float:
    """Mean distance from each simulated point (n, d) to the nearest observed one (m, d) (Thesis eq. 4.6). One-sided:
    observed points that no simulated point comes near do not count."""
    distance, _ = cKDTree(observed).query(simulated)
    return float(np.mean(distance))


def unexplained(
    rest: FloatArray, deformed: FloatArray, simulated: FloatArray, judged: BoolArray, known: BoolArray
) -> tuple[float, float]:
    """Residuals of a simulation of a motion, and of the best rigid motion: sums of squares over the judged particles
    [unit^2]. rest, deformed, simulated: (K, d); judged: (K,) free and seen; known: (K,) deformed position is known"""
    rigid = rigid_positions(rest, deformed, known)
    return float(np.sum((simulated - deformed)[judged] ** 2)), float(np.sum((rigid - deformed)[judged] ** 2))


def explained_share(left: Iterable[tuple[float, float]], size: float) -> float:
    """Share of a motion beyond a rigid one that a simulation explains, from its parts (`unexplained`). The share is 0
    or less if the model explains nothing, and 0 without deformation. size: size of the body [unit]"""
    by_model, by_rigid = np.sum(list(left), axis=0)
    return float(1.0 - by_model / by_rigid) if by_rigid > (1e-9 * size) ** 2 else 0.0


def rigid_positions(rest: FloatArray, deformed: FloatArray, fitted: BoolArray) -> FloatArray:
    """Positions of rest (K, d) after the best rigid motion: that which fits deformed (K, d) where `fitted` (K,) is
    True, in least squares (Kabsch 1976)."""
    a, b = rest[fitted], deformed[fitted]
    u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    sign = np.ones(rest.shape[1])
    sign[-1] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((rest - a.mean(axis=0)) @ (u * sign @ vt).T + b.mean(axis=0))


Method = Literal["sweep", "gradient"]

FORCE_SHARE = 0.05
"""Standard deviation of a force without stated noise, as a share of the force."""

TOUCHED_SHARE = 0.5
"""Held particles that moved more than this share of the largest motion among them count as touched."""


def touched_of(rest: FloatArray, deformed: FloatArray, held: IntArray) -> IntArray:
    """The held particles (m,) of (n,) that something moved. rest, deformed: (K, d)."""
    moved = np.linalg.norm((deformed - rest)[held], axis=1)
    return np.asarray(held[moved > TOUCHED_SHARE * moved.max(initial=0.0)])


@dataclass(frozen=True, slots=True)
class Observation:
    """One manipulation: a rest shape, the deformed shape, and the held particles.

    rest, deformed: (K, d), d = 2 or 3 [unit]; held: (n,) indices whose deformed position is prescribed
    observed: (K,) particles that were seen in `deformed`
    noise: (K,) standard deviation per coordinate, None if unknown; noise_source: where it is known from
    shape, cell: the particles' lattice (last axis fastest, may have holes), None without one
    metres_per_unit: size of the unit, None for pixels of unknown size; force_n: net force [N] on the held particles
    `contact`, None if it was not measured; force_noise_n: its standard deviation [N], None if unknown
    scale_sd: standard deviation of metres_per_unit, as a share
    held_measured: whether the held positions were measured, with the noise of the others, or are exact; None = unknown
    tip: the tip that pressed the particles of `contact`, if known; tip_at: (d,) place where the tip's axis enters it
    [unit], if known; particles show it only to within their spacing
    held_shift: standard deviation of the common error of all held positions [unit]: of a robot's or a fixture's
    registration; None = some hundredths of a spacing (`systematic.TOOL_SHIFT`)
    loose: held particles whose position was estimated, not measured, None = none
    turn, turn_sd: the camera's turn between both, from x to y, and its standard deviation [rad]"""

    rest: FloatArray
    deformed: FloatArray
    held: IntArray
    observed: BoolArray
    noise: FloatArray | None = None
    shape: tuple[int, ...] | None = None
    cell: IntArray | None = None
    unit: LengthUnit = "m"
    metres_per_unit: float | None = 1.0
    force_n: float | None = None
    contact: IntArray | None = None
    held_measured: bool | None = None
    tip: Tip | None = None
    force_noise_n: float | None = None
    tip_at: FloatArray | None = None
    loose: IntArray | None = None
    noise_source: NoiseSource = "given"
    held_shift: float | None = None
    scale_sd: float = 0.0
    turn: float = 0.0
    turn_sd: float = 0.0

    def __post_init__(self) -> None:
        count, d = self.rest.shape
        if not (np.isfinite(self.rest).all() and np.isfinite(self.deformed[self.observed]).all()):
            raise InputError("finite positions", "NaN or infinity in rest or deformed", "drop those particles")
        if not np.isfinite(self.deformed[self.held]).all():
            raise InputError("finite positions of the held particles", "NaN or infinity", "hold fewer particles")
        if np.unique(self.rest, axis=0).shape[0] != count:
            raise InputError("distinct rest positions", "duplicate points in rest", "keep each particle once")
        if self.held.size == 0:
            raise InputError("at least one held particle", "none", "name what was held and what was pushed")
        if np.unique(self.held).size != self.held.size:
            raise InputError("each held particle once", "repeated ones")
        if self.held.size == count:
            raise InputError("some free particles", "every particle held", "hold only what was fixed or pushed")
        if not self.free_observed.any():
            raise InputError("free particles that were observed", "none", "check `observed` and what is held")
        if clusters.rank(self.rest) < min(d, 2):
            raise InputError("rest points that span a plane", "points on a line", "observe an area, not a line")

    @property
    def pose_held(self) -> bool:
        """Whether the held particles prevent rotation of the body: two in the plane, three off a line in space."""
        return bool(clusters.rank(self.rest[self.held]) >= self.rest.shape[1] - 1)

    @property
    def touched(self) -> IntArray:
        """(m,) particles that something pressed: `contact`, or, if that is unknown, the held particles that moved."""
        return touched_of(self.rest, self.deformed, self.held) if self.contact is None else self.contact

    @property
    def force_sd_n(self) -> float:
        """Standard deviation of the force [N], the stated one if there is any; 0 without a force."""
        return FORCE_SHARE * (self.force_n or 0.0) if self.force_noise_n is None else self.force_noise_n

    @property
    def free_observed(self) -> BoolArray:
        """(K,) particles by which the fit is judged: seen and not prescribed."""
        return np.asarray(self.observed & ~clusters.held_mask(len(self.rest), self.held))


@dataclass(frozen=True, slots=True)
class Model:
    """Which parameter is fitted, and the fixed settings of the simulation.

    cluster_size: particles along a side of the overlapping clusters; None = one cluster of all particles
    beta, theta: value of the parameter that is not fitted; alpha does not change a static state and is only recorded
    volume: how theta conserves it: "scale" as eq. 3.17 does, or "project", which has an energy and stays stable in
    overlapping clusters"""

    parameter: Parameter = "beta"
    basis: Basis = "linear"
    cluster_size: int | None = 3
    alpha: float = 1.0
    beta: float = 0.99
    theta: float = 0.0
    volume: Volume = "scale"
    precision: Precision = "float64"
    device: str = "cpu"

    def grouping(self, seen: Observation) -> clusters.Clusters:
        """How the particles of an observation are grouped."""
        if self.cluster_size is None:
            return clusters.single(len(seen.rest))
        if seen.shape is not None and seen.cell is not None:
            return clusters.lattice(seen.rest, seen.shape, seen.cell, self.cluster_size)
        return clusters.nearest(seen.rest, self.cluster_size ** seen.rest.shape[1])

    def body(self, seen: Observation) -> Msm:
        """The particles of an observation in this model's clusters, on its device."""
        grouped = self.grouping(seen)
        return Msm(seen.rest, grouped, seen.held, basis=self.basis, precision=self.precision, device=self.device)


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How the parameter of `model` is found within `bounds`, and the level of its interval.

    method: "sweep" tries `candidates` values over `bounds` and refines around the lowest error (Algorithm 3).
    "gradient" follows the slope (Algorithm 2's purpose) and draws the curve only along its path
    level: level of the interval; seed: seed of its random repeats
    at: a value whose error is reported as well, None = none
    doubts: those of the input, known before the fit; found: what was found in the input, for the record"""

    model: Model = Model()
    bounds: tuple[float, float] = (0.0, 0.99)
    method: Method = "sweep"
    candidates: int = 100
    level: float = 0.9
    seed: int = 0
    at: float | None = None
    doubts: tuple[Doubt, ...] = ()
    found: dict[str, Any] = field(default_factory=dict)
