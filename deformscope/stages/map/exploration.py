"""What is known of a surface after each touch: the maps, the reason for the next touch, and what a touch measured.

Maps are on one grid over the surface: arrays (rows, columns) = (y, x), cell centres at (i + 0.5) cells. The surface
frame has x, y in the table's plane and z up.
"""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.poke.creep import CreepFit

DISPLAY = "display"
"""The stage that shows results."""


@dataclass(frozen=True, slots=True)
class SurfaceEstimate:
    """The surface as the camera saw it, and as the world Gaussian process has it (Thesis eq. 4.3, 4.4).

    points_m: (n, 3) filtered points; height_m, deviation_m: (rows, columns); cell_m: of the grid
    layer_m, layer_sd_m: thickness that a level layer of this foam is taken for, and its deviation [m]: as stated, or as
    seen over the table beside it; None = not known
    """

    points_m: FloatArray
    height_m: FloatArray
    deviation_m: FloatArray
    cell_m: float
    layer_m: float | None = None
    layer_sd_m: float | None = None


@dataclass(frozen=True, slots=True)
class TouchEstimate:
    """What one touch measured.

    number: from 0; xyz_m: (3,) contact; normal: (3,) unit, out of the surface
    approach_m, approach_n: (n,) displacement of the tip along the normal since the first reading [m], force on it [N]
    fitted_n: (n,) the fitted force at each [N]; contact_m: where contact began, on the same axis
    stiffness_n_per_mm, stiffness_interval: apparent, at the set force; rigid: a lower bound
    modulus_pa, modulus_interval_pa: corrected for the tip and the layer, None = rigid, or thickness not known
    depth_m, peak_force_n: of the dent
    beta, beta_interval, beta_verdict: of the MSM fitted to the dent, None = not fitted
    observed_m: (k, 3) raw points around the dent; simulated_m: (p, 3) particles of the fitted model there
    speed_m_s: at which the tip came down in contact, None = not known: foam that creeps is the stiffer the faster
    creep: what its hold and its way back say of the foam's creep, None = not asked for, or not fitted
    thickness_m: of the foam there, as it was seen; level_n_per_mm: its stiffness were the foam level and as thick as
    stated, which is what is mapped; both None where it was taken for that
    usable: whether it has a stiffness: where its contact could not be fitted, all that comes from the fit is nan
    """

    number: int
    xyz_m: FloatArray
    normal: FloatArray
    approach_m: FloatArray
    approach_n: FloatArray
    fitted_n: FloatArray
    contact_m: float
    stiffness_n_per_mm: float
    stiffness_interval: tuple[float, float]
    rigid: bool
    modulus_pa: float | None
    depth_m: float
    peak_force_n: float
    beta: float | None
    beta_interval: tuple[float, float] | None
    beta_verdict: str
    observed_m: FloatArray
    simulated_m: FloatArray
    creep: CreepFit | None = None
    thickness_m: float | None = None
    level_n_per_mm: float | None = None
    modulus_interval_pa: tuple[float, float] | None = None
    speed_m_s: float | None = None

    @property
    def usable(self) -> bool:
        return bool(np.isfinite(self.stiffness_n_per_mm))


@dataclass(frozen=True, slots=True)
class MapEstimate:
    """The maps after a number of touches, and every number that is reported of them: terminal, JSON, panel, pictures
    and replay take them from here.

    stiffness_n_per_mm: (rows, columns) median; stiffness_log_sd: of its logarithm
    beta, beta_sd: (rows, columns), None before two touches gave one
    labels: (rows, columns) region of each cell, 0 the softest, -1 without regions
    label_probability: of that label, the doubt about the number of regions and about `gradual` included
    region_count: 0 without regions; verdict: "regions" or "gradual"; probability: of verdict and region_count
    level_n_per_mm: (region_count,) stiffness of each region; level_interval_n_per_mm: (region_count, 2) of 90 %
    level_rigid: (region_count,) regions whose level is a lower bound, at which the interval begins; it is open above
    contacts_m: (n, 2) touches so far; tip_radius_m: of what touched
    travel_m: over the surface, in straight lines from its corner (0, 0), where planning begins, from touch to touch
    level_modulus_pa, level_modulus_interval_pa: (region_count,), (region_count, 2) Young's modulus at each level, with
    its 90 %, a lower bound of what is rigid; None where the thickness is not known
    levelled_m: all stiffness is as on a level layer so thick [m], None = apparent
    loss, loss_log_sd: (rows, columns) median share of a touch's energy that is lost, deviation of its logarithm;
    level_loss: (region_count,) of each region, level_loss_interval: (region_count, 2) of 90 %; all four None unless
    the regions are those of the loss, 0 the one that loses least: stiffness is then a field through the touches, the
    levels its means, none of them a bound
    isopleths: (k,) levels of beta between which the regions lie, by the thesis's rule, which has no probability:
    `probability` is then that of as many regions by stiffness; None = the regions are of stiffness, or of the loss
    truth_labels: where it is known; iou, boundary_m: against it; boundary_m is None where one has no boundary
    """

    touches: int
    cell_m: float
    stiffness_n_per_mm: FloatArray
    stiffness_log_sd: FloatArray
    beta: FloatArray | None
    beta_sd: FloatArray | None
    labels: IntArray
    label_probability: FloatArray
    region_count: int
    verdict: str
    probability: float
    level_n_per_mm: FloatArray
    level_interval_n_per_mm: FloatArray
    level_rigid: BoolArray
    contacts_m: FloatArray
    tip_radius_m: float
    travel_m: float
    truth_labels: IntArray | None = None
    iou: float | None = None
    boundary_m: float | None = None
    level_modulus_pa: FloatArray | None = None
    level_modulus_interval_pa: FloatArray | None = None
    levelled_m: float | None = None
    loss: FloatArray | None = None
    loss_log_sd: FloatArray | None = None
    level_loss: FloatArray | None = None
    level_loss_interval: FloatArray | None = None
    isopleths: FloatArray | None = None

    @property
    def mapped(self) -> str:
        """By what the regions are told apart."""
        if self.isopleths is not None:
            return "beta"
        return "stiffness" if self.loss is None else "energy loss"

    @property
    def claimed(self) -> float | None:
        """Probability of the verdict and the number of regions; None where they come from a rule that has none."""
        return self.probability if self.isopleths is None else None


@dataclass(frozen=True, slots=True)
class Missed:
    """What the touches so far may have missed.

    untouched_m, untouched_at_m: radius and centre (2,) of the largest circle on the surface without a touch [m]
    lump_radius_m: (n,) of lumps that fit on the surface, rising [m]; lump_probability: (n,) that there is one of these
    which no touch has felt; it was `prior` before any touch
    contrast: they are so many times as stiff, or as soft, as what is around them
    deepest_m: from the surface to their uppermost points, at most; None = they reach from top to bottom
    """

    untouched_m: float
    untouched_at_m: FloatArray
    lump_radius_m: FloatArray
    lump_probability: FloatArray
    contrast: float
    prior: float
    deepest_m: float | None = None

    def probability(self, radius_m: float) -> float:
        """Of lumps of one of these radii [m]; 0 where they do not fit."""
        return float(self.lump_probability[self.lump_radius_m == radius_m].sum())


@dataclass(frozen=True, slots=True)
class LumpsFound:
    """What the touches so far say of lumps below a surface that shows nothing (`stages.map.lump_posterior`).

    centre_m: (k, 2) middles of those that were found; within_m: (k,) distance from it within which each lies in 90 %
    radius_m: (k,), radius_interval_m: (k, 2) of 90 % [m]; stiff: (k,) rather than soft; probability: (k,) of each
    depth: of each `shallow` (the uppermost point at most `deep_m` down), `deep`, or empty where it cannot be told
    covered: (rows, columns) probability that a cell lies above a lump, found or not; cell_m: of that map
    size_m: (n,) radii, rising [m]; missed: (n,) probability of a lump of each that is not among those found, were lumps
    of this radius alone there; missed_smallest: the largest of these from the radius `smallest_m` on
    prior, contrast, deepest_m: what is taken for granted: a lump is there with `prior` before any touch, `contrast`
    times as stiff or as soft as the foam or more, and its uppermost point at most so deep [m]
    scatter: deviation of log stiffness within the foam; contacts_m: (n, 2) touches so far
    truth_m: (m, 4) where it is known: x, y, radius, depth of each [m]
    """

    centre_m: FloatArray
    within_m: FloatArray
    radius_m: FloatArray
    radius_interval_m: FloatArray
    stiff: BoolArray
    probability: FloatArray
    depth: tuple[str, ...]
    covered: FloatArray
    cell_m: float
    size_m: FloatArray
    missed: FloatArray
    smallest_m: float
    missed_smallest: float
    prior: float
    contrast: float
    deepest_m: float
    deep_m: float
    scatter: float
    contacts_m: FloatArray
    truth_m: FloatArray | None = None

    def __len__(self) -> int:
        """How many were found."""
        return len(self.centre_m)


@dataclass(frozen=True, slots=True)
class PlannedTouch:
    """Where the next touch goes, and why.

    target_m: (2,), None = no further touch; excluded: cells that may not be touched
    gain, cost_s: (rows, columns) expected gain and time [s], None where no planner computed one; gain_unit: of gain, as
    `plan.TouchChoice` has it
    reason: in words; stop_reason: why none follows; missed: by the touches so far, None where it was not computed
    """

    target_m: FloatArray | None
    gain: FloatArray | None
    cost_s: FloatArray | None
    excluded: BoolArray
    reason: str
    stop_reason: str = ""
    missed: Missed | None = None
    gain_unit: str | None = None


@dataclass(frozen=True, slots=True)
class TouchForecast:
    """A touch that a person asks for, as it would be, and what is expected to be felt.

    xyz_m: (3,) where the surface is believed to be; normal: (3,) along which it is touched; way_m: (k, 3) of the tip's
    lowest point, down to it [m]; set_force_n: pressed with
    stiffness_n_per_mm, stiffness_interval: apparent, at the set force, as one touch is expected to measure it in 90 %
    force_n: (n,) [N]; depth_m, depth_low_m, depth_high_m: (n,) of the dent at each, and its interval [m]
    touches: that it rests on
    """

    xyz_m: FloatArray
    normal: FloatArray
    way_m: FloatArray
    set_force_n: float
    stiffness_n_per_mm: float
    stiffness_interval: tuple[float, float]
    force_n: FloatArray
    depth_m: FloatArray
    depth_low_m: FloatArray
    depth_high_m: FloatArray
    touches: int


@dataclass(frozen=True, slots=True)
class SteeringDecision:
    """What a person decided about the next touch, where it was not left to the plan.

    kind: veto = not at xy_m, touch = at xy_m instead, held = it was broken off before it measured anything
    xy_m: (2,) [m]; touch: how many were made before; reason: in words
    """

    kind: Literal["veto", "touch", "held"]
    xy_m: FloatArray
    touch: int
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StageFailure:
    """A stage failed on one touch: the exploration goes on without what it would have given.

    stage: surface, dent, contact, creep, loss, regions, beta, maps, beta field, lumps, plan or display
    touch: from 1, 0 = before the first
    reason: in one line; trace: where it failed, for whoever mends it
    """

    stage: str
    touch: int
    reason: str
    trace: str

    @classmethod
    def of(cls, stage: str, touch: int, error: Exception) -> StageFailure:
        """What an error says of itself."""
        words = " ".join(str(error).split())
        kind = "" if isinstance(error, InputError) else type(error).__name__ + ": " * bool(words)
        return cls(stage=stage, touch=touch, reason=kind + words, trace="".join(traceback.format_exception(error)))


@dataclass(frozen=True, slots=True)
class PhaseStart:
    """The robot began something. name: look, travel, tare, approach, press, dwell, retreat, plan, paused,
    "stopped: ..." """

    name: str
    touch: int


@dataclass(frozen=True, slots=True)
class ExplorationStop:
    """The exploration ended before its plan said so.

    kind: what was wrong, in the supervisor's words or the touch's; reason: what was seen of it; advice: what to do
    action: stop = the arm stands and its FIFO is erased, back off = it went away first
    touch: as in PhaseStart
    """

    kind: str
    reason: str
    advice: str
    action: str
    touch: int
