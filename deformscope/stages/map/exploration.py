"""Results after each touch: the maps, the reason for the next touch, and the touch's measurement.

Maps are on one grid over the surface: arrays (rows, columns) = (y, x), cell centres at (i + 0.5) cells. The surface
frame has x, y in the table's plane and z up."""

import traceback
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.results.render import derived, reported
from deformscope.stages.poke.creep import CreepFit
from deformscope.stages.regions.touches import FIRST_REGIONS

NOT_ASKED = "not asked for"
"""Verdict of a touch whose beta was not requested."""
DISPLAY = "display"
"""The stage that shows results."""


@dataclass(frozen=True, slots=True)
class SurfaceEstimate:
    """The surface as the camera saw it, and as the world Gaussian process estimates it (Thesis eq. 4.3, 4.4).

    points_m: (n, 3) filtered points; height_m, deviation_m: (rows, columns); cell_m: cell size of the grid
    layer_m, layer_sd_m: assumed thickness of a level layer of this foam, and its deviation [m]: as stated, or as
    measured over the table around it; None = unknown"""

    points_m: FloatArray
    height_m: FloatArray
    deviation_m: FloatArray
    cell_m: float
    layer_m: float | None = None
    layer_sd_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchEstimate:
    """Measurement of one touch.

    number: its number, from 1; xyz_m: (3,) contact; normal: (3,) unit, out of the surface
    approach_m, approach_n: (n,) displacement of the tip along the normal since the first reading [m], force on it [N]
    fitted_n: (n,) fitted force at each displacement [N]; contact_m: where contact began, on the same axis
    stiffness_n_per_mm, stiffness_interval: apparent, at the set force; rigid: a lower bound
    modulus_pa, modulus_interval_pa: corrected for the tip and the layer, None = rigid, or thickness not known
    depth_m, peak_force_n: depth and peak force of the dent; peak_rate_n_per_s, peak_rate_interval_n_per_s: greatest
    rate of the force on the approach (`contact.peak_rate`), None with too few samples; beta, beta_interval,
    beta_verdict: beta, beta interval and beta verdict of the MSM fitted to the dent, None = not fitted
    observed_m: (k, 3) raw points around the dent; simulated_m: (p, 3) particles of the fitted model there
    speed_m_s: speed of the approach in contact, None = unknown: creeping foam is stiffer at higher speed
    creep: the foam's creep by the touch's hold and retract, None = not requested, or not fitted
    thickness_m: thickness of the foam there, as it was seen; level_n_per_mm: its stiffness on level foam of the stated
    thickness, which is mapped; both None if the foam is assumed to be that
    usable: whether it has a stiffness: where its contact could not be fitted, all that comes from the fit is nan"""

    number: int
    xyz_m: FloatArray = field(metadata=reported(key="xy_m", unit="m", json=lambda xyz_m: xyz_m[:2]))
    normal: FloatArray
    approach_m: FloatArray
    approach_n: FloatArray
    fitted_n: FloatArray
    contact_m: float
    stiffness_n_per_mm: float = field(
        metadata=reported(
            "stiffness",
            key="apparent_stiffness_n_per_mm",
            unit="N/mm",
            words=lambda touch: touch.stiffness_text + (f" ({touch.interval_text})" if touch.interval_text else ""),
            line="{}",
        )
    )
    stiffness_interval: tuple[float, float] = field(
        metadata=reported(
            key="apparent_stiffness_interval", words=lambda touch: touch.interval_text, caption="interval {}"
        )
    )
    rigid: bool = field(metadata=reported())
    thickness_m: float | None = field(default=None, metadata=reported(unit="m"))
    level_n_per_mm: float | None = field(default=None, metadata=reported(unit="N/mm"))

    @property
    @derived("dent", key=None, line="dent {}", caption="{}")
    def dent_text(self) -> str:
        """The dent and the force that made it; the force alone where no contact was fitted."""
        force = f"{self.peak_force_n:.2f} N"
        return f"{1e3 * self.depth_m:.1f} mm at {force}" if self.usable else force

    modulus_pa: float | None = field(
        default=None, metadata=reported("modulus", unit="Pa", scale=1e-3, shown_unit="kPa", caption="modulus about {}")
    )
    modulus_interval_pa: tuple[float, float] | None = field(default=None, metadata=reported(unit="Pa"))
    depth_m: float = field(metadata=reported(unit="m"))
    peak_force_n: float = field(metadata=reported(unit="N"))
    peak_rate_n_per_s: float | None = field(
        default=None,
        metadata=reported(
            "peak force rate",
            unit="N/s",
            shown_unit="N/s",
            interval="peak_rate_interval_n_per_s",
            line="peak force rate {}",
            caption="peak rate {}",
        ),
    )
    peak_rate_interval_n_per_s: tuple[float, float] | None = field(default=None, metadata=reported(unit="N/s"))
    beta: float | None = field(
        default=None,
        metadata=reported(
            unit="1", words=lambda touch: "" if touch.beta_verdict == NOT_ASKED else touch.beta_text, caption="{}"
        ),
    )
    beta_interval: tuple[float, float] | None = field(default=None, metadata=reported())
    beta_verdict: str = field(default=NOT_ASKED, metadata=reported())
    observed_m: FloatArray
    simulated_m: FloatArray
    speed_m_s: float | None = field(default=None, metadata=reported(key="approach_speed_mm_s", json_scale=1e3))

    @property
    @derived()
    def held_s(self) -> float:
        """How long the force was held [s]."""
        return 0.0 if self.creep is None else self.creep.held_s

    creep: CreepFit | None = field(
        default=None, metadata=reported("creep", words=lambda touch: "" if touch.creep is None else touch.creep.brief)
    )

    @property
    @derived("force, held in place", key=None, caption="{}")
    def force_kept_text(self) -> str:
        """The reasons to doubt the creep, and the remaining force at the end of the hold; empty without a hold."""
        if self.creep is None or not self.creep.force_kept:
            return ""
        return ", ".join([*(one.code for one in self.creep.reasons), str(self.creep.force_kept[-1])])

    @property
    def usable(self) -> bool:
        return bool(np.isfinite(self.stiffness_n_per_mm))

    @property
    def stiffness_text(self) -> str:
        """The stiffness without its interval."""
        if not self.usable:
            return "no contact fitted"
        return f"{'> ' * self.rigid}{self.stiffness_n_per_mm:.3g} N/mm"

    @property
    def interval_text(self) -> str:
        """The interval of the stiffness as text; empty without one."""
        if not self.usable or self.rigid:
            return ""
        low, high = self.stiffness_interval
        return f"{low:.3g} to {high:.3g}"

    @property
    def beta_text(self) -> str:
        """Beta with its interval and verdict, or why there is none."""
        if self.beta is None:
            return f"beta not fitted ({self.beta_verdict})" if self.beta_verdict else "beta not fitted"
        between = "" if self.beta_interval is None else ", {:.2f} to {:.2f}".format(*self.beta_interval)
        return f"beta {self.beta:.2f} ({self.beta_verdict}{between})"


@dataclass(frozen=True, slots=True)
class MapRegion:
    """A region of a map: a part of the surface with one stiffness.

    stiffness_n_per_mm, stiffness_interval_n_per_mm: (2,) 90 % interval; rigid: stiffness_n_per_mm is a lower bound
    modulus_pa, modulus_interval_pa: (2,) Young's modulus of linear foam with this stiffness. The modulus is shown
    without its interval, which does not cover foam whose stress has a plateau: that is up to `PLATEAU_FACTOR` times
    stiffer. The modulus is None if the thickness is unknown, its interval also for a bound"""

    stiffness_n_per_mm: float = field(
        metadata=reported(key="log_stiffness", unit="natural logarithm of N/mm", json=np.log)
    )
    stiffness_interval_n_per_mm: FloatArray = field(metadata=reported(key="interval", json=np.log))
    modulus_pa: float | None = field(
        metadata=reported(unit="Pa", scale=1e-3, shown_unit="kPa", words=lambda one: one.modulus_text)
    )
    modulus_interval_pa: FloatArray | None = field(metadata=reported(unit="Pa"))
    rigid: bool = field(metadata=reported())

    @property
    def level_text(self) -> str:
        """The stiffness [N/mm], without its unit."""
        return f"{'> ' * self.rigid}{self.stiffness_n_per_mm:.3g}"

    @property
    def modulus_text(self) -> str:
        """The region's modulus as text; empty if it was not separated from stiffness, or is a bound."""
        return "" if self.modulus_pa is None or self.rigid else f"about {self.modulus_pa / 1e3:.3g} kPa"


PLATEAU_FACTOR = 2.8
"""Largest ratio of the modulus of foam on its plateau to that of linear foam with the same stiffness at 3 N
(docs/results/maps.md)."""

REGION_LABELS = "region from 0, the softest; -1: no regions"


@dataclass(frozen=True, slots=True)
class MapEstimate:
    """The maps after a number of touches, and all numbers about them that terminal, JSON, panel, pictures and replay
    show.

    stiffness_n_per_mm: (rows, columns) median; stiffness_log_sd: deviation of its logarithm
    beta, beta_sd: (rows, columns) map of beta and its deviation, None until two touches have a beta
    labels: (rows, columns) region of each cell, 0 the softest, -1 without regions
    label_probability: probability of that label, the doubt about the number of regions and about `gradual` included
    region_count: 0 without regions; at_least: `region_count` is the largest number that is distinguished, so that there
    may be more; verdict: "regions" or "gradual"; probability: probability of both (`RegionMap.claimed`)
    level_n_per_mm: (region_count,) stiffness of each region; level_interval_n_per_mm: (region_count, 2) 90 % interval
    level_rigid: (region_count,) regions whose level is a lower bound, at which the interval begins; it is open above
    contacts_m: (n, 2) touches so far; tip_radius_m: tip radius of the touching tip; travel_m: travel over the surface
    in straight lines, from its corner (0, 0), where planning begins, from touch to touch
    level_modulus_pa, level_modulus_interval_pa: (region_count,), (region_count, 2) Young's modulus at each level, with
    its 90 %, a lower bound for rigid parts; None with an unknown thickness
    levelled_m: thickness of the level layer to which all stiffness is converted [m], None = apparent stiffness
    truth_labels: where it is known; iou, boundary_m: agreement with the truth; boundary_m is None if either has no
    boundary"""

    touches: int
    cell_m: float = field(metadata=reported(unit="m"))
    stiffness_n_per_mm: FloatArray = field(metadata=reported(unit="N/mm"))
    stiffness_log_sd: FloatArray = field(metadata=reported(unit="natural logarithm"))
    beta: FloatArray | None = field(metadata=reported(unit="1"))
    beta_sd: FloatArray | None = field(metadata=reported(unit="1"))
    labels: IntArray = field(metadata=reported(unit=REGION_LABELS))
    label_probability: FloatArray = field(metadata=reported(unit="1"))
    region_count: int
    verdict: str
    probability: float
    level_n_per_mm: FloatArray
    level_interval_n_per_mm: FloatArray
    level_rigid: BoolArray
    contacts_m: FloatArray = field(metadata=reported(unit="m, (x, y)"))
    tip_radius_m: float
    travel_m: float
    truth_labels: IntArray | None = field(default=None, metadata=reported(unit="region from 0"))
    iou: float | None = None
    boundary_m: float | None = None
    level_modulus_pa: FloatArray | None = None
    level_modulus_interval_pa: FloatArray | None = None
    levelled_m: float | None = None
    at_least: bool = False

    @property
    def regions(self) -> tuple[MapRegion, ...]:
        """Each region, from label 0 on."""
        modulus, between = self.level_modulus_pa, self.level_modulus_interval_pa
        return tuple(
            MapRegion(
                float(self.level_n_per_mm[one]),
                self.level_interval_n_per_mm[one],
                None if modulus is None or between is None else float(modulus[one]),
                None if modulus is None or between is None or self.level_rigid[one] else between[one],
                bool(self.level_rigid[one]),
            )
            for one in range(self.region_count)
        )

    @property
    def more_possible(self) -> bool:
        """Whether there may be more regions: three and more are not distinguished reliably (`studies regions`)."""
        return self.at_least or self.region_count >= FIRST_REGIONS


@dataclass(frozen=True, slots=True)
class MissProbability:
    """The probability that an inclusion of a radius [m] is missed."""

    radius_m: float = field(metadata=reported(unit="m"))
    probability: float = field(metadata=reported())


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """Detection limit of the touches so far.

    untouched_m, untouched_at_m: radius and centre (2,) of the largest circle on the surface without a touch [m]
    lump_radius_m: (n,) radii of inclusions that fit on the surface, rising [m]; lump_probability: (n,) probability that
    one of this radius exists undetected; it was `prior` before any touch
    contrast: ratio of their stiffness to that of their surroundings, or the inverse
    deepest_m: largest depth of their uppermost points below the surface; None = they reach from top to bottom"""

    untouched_m: float = field(metadata=reported(unit="m"))
    untouched_at_m: FloatArray = field(metadata=reported(unit="m"))
    lump_radius_m: FloatArray
    lump_probability: FloatArray
    contrast: float = field(metadata=reported())
    prior: float = field(metadata=reported())
    deepest_m: float | None = None

    @property
    @derived()
    def inclusions(self) -> list[MissProbability]:
        """Each size with its probability."""
        return [*map(MissProbability, self.lump_radius_m, self.lump_probability)]

    def probability(self, radius_m: float) -> float:
        """Probability of inclusions of one of these radii [m]; 0 where they do not fit."""
        return float(self.lump_probability[self.lump_radius_m == radius_m].sum())


@dataclass(frozen=True, slots=True)
class InclusionsResult:
    """Posterior of inclusions below a homogeneous surface, by the touches so far (`stages.map.inclusion_posterior`).

    centre_m: (k, 2) middles of the found inclusions; within_m: (k,) distance from it within which each lies in 90 %
    radius_m: (k,) their radii, radius_interval_m: (k, 2) 90 % intervals [m]; stiff: (k,) whether each is stiffer than
    the foam, not softer; probability: (k,) probability of each
    depth: depth of each `shallow` (the uppermost point at most `deep_m` down), `deep`, or empty if it is not identified
    covered: (rows, columns) probability that a cell lies above an inclusion, found or not; cell_m: cell size of that
    map; size_m: (n,) radii, rising [m]; missed: (n,) probability of an inclusion of each that is not among those found,
    were inclusions of this radius alone there; missed_smallest: the largest of these for radii of `smallest_m` and more
    prior, contrast, deepest_m: assumptions. Before any touch an inclusion exists with probability `prior`. An inclusion
    is at least `contrast` times as stiff or as soft as the foam. Its uppermost point is at most `deepest_m` down [m]
    scatter: deviation of log stiffness within the foam; contacts_m: (n, 2) touches so far
    truth_m: (m, 4) true x, y, radius, depth of each [m], if known"""

    @property
    @derived()
    def found(self) -> list[dict[str, Any]]:
        """Each inclusion that was found."""
        names = ("centre_m", "within_m", "radius_m", "radius_interval_m", "stiff", "probability", "depth")
        return [{name: getattr(self, name)[number] for name in names} for number in range(len(self))]

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

    @property
    @derived(key="missed")
    def missed_each(self) -> list[MissProbability]:
        """Each size with its probability."""
        return [*map(MissProbability, self.size_m, self.missed)]

    smallest_m: float = field(metadata=reported())
    missed_smallest: float = field(metadata=reported())
    prior: float = field(metadata=reported())
    contrast: float = field(metadata=reported())
    deepest_m: float = field(metadata=reported())
    deep_m: float = field(metadata=reported(key="shallow_to_m"))
    scatter: float = field(metadata=reported())
    contacts_m: FloatArray = field(metadata=reported(key="touches", json=len))
    truth_m: FloatArray | None = None

    @property
    @derived()
    def truth(self) -> list[dict[str, Any]]:
        """Each true inclusion; empty where these are not known."""
        known = () if self.truth_m is None else self.truth_m
        return [{"centre_m": one[:2], "radius_m": one[2], "depth_m": one[3]} for one in known]

    @property
    @derived(key="words")
    def rows(self) -> list[tuple[str, str]]:
        """Every found inclusion, and the detection limit, as names and values."""
        rows = []
        for number in range(len(self)):
            x, y = 100.0 * self.centre_m[number]
            depth = {"shallow": "up to {:g} cm deep", "deep": "deeper than {:g} cm"}.get(self.depth[number])
            parts = [
                f"{'stiff' if self.stiff[number] else 'soft'}, its middle at ({x:.1f}, {y:.1f}) cm"
                f" (90 % within {100.0 * self.within_m[number]:.1f} cm)",
                f"radius about {100.0 * self.radius_m[number]:.1f} cm",
                "its depth cannot be determined" if depth is None else depth.format(100.0 * self.deep_m),
                f"probability {self.probability[number]:.2f}",
            ]
            rows.append((f"inclusion {number + 1}", ", ".join(parts)))
        for x, y, radius, depth_m in 100.0 * (np.zeros((0, 4)) if self.truth_m is None else self.truth_m):
            off = np.hypot(*(100.0 * self.centre_m - (x, y)).T).min(initial=np.inf)
            at, found = f"({x:.1f}, {y:.1f}) cm", f"found, {off:.1f} cm off" if off <= radius else "not found"
            rows.append(("true inclusion", f"{at}, radius {radius:.1f} cm, {depth_m:.1f} cm deep: {found}"))
        each = ", ".join(
            f"{100.0 * radius:.3g} cm {share:.2f}" for radius, share in zip(self.size_m, self.missed, strict=True)
        )
        wanted = f"of {100.0 * self.smallest_m:.3g} cm radius or more, chance about {self.missed_smallest:.2f}"
        taken = (
            f"balls {self.contrast:g} times as stiff or soft or more, at most {100.0 * self.deepest_m:g} cm deep;"
            f" {self.prior:g} before any touch"
        )
        return [*rows, ("an inclusion missed", f"{wanted}; by radius {each} ({taken})")]

    def __len__(self) -> int:
        """Number found."""
        return len(self.centre_m)


@dataclass(frozen=True, slots=True)
class PlannedTouch:
    """Place of the next touch, and its reason.

    target_m: (2,) place, None = no further touch; excluded: cells that may not be touched
    gain, cost_s: (rows, columns) expected gain and time [s], None where no planner computed one; gain_unit: unit of
    `gain`, as in `plan.TouchChoice`; reason: in words; stop_reason: why no touch follows; missed: detection limit of
    the touches so far, None if not computed"""

    target_m: FloatArray | None
    gain: FloatArray | None
    cost_s: FloatArray | None
    excluded: BoolArray
    reason: str
    stop_reason: str = ""
    missed: DetectionLimit | None = None
    gain_unit: str | None = None


@dataclass(frozen=True, slots=True)
class TouchForecast:
    """The plan of a touch that a person requests, and its forecast.

    xyz_m: (3,) estimated place of the surface; normal: (3,) direction of the touch, outwards; way_m: (k, 3) way of the
    tip's lowest point, down to it [m]; set_force_n: force of the touch
    stiffness_n_per_mm, stiffness_interval: apparent stiffness at the set force, and the interval of 90 % of touches
    force_n: (n,) [N]; depth_m, depth_low_m, depth_high_m: (n,) depth, lower end and upper end of the dent at each, and
    its interval [m]; touches: touches of the estimate"""

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
    """A person's decision about the next touch, if it was not left to the plan.

    kind: veto = not at xy_m, touch = at xy_m instead, held = it was broken off before it measured anything
    xy_m: (2,) [m]; touch: how many were made before; reason: in words"""

    kind: Literal["veto", "touch", "held"]
    xy_m: FloatArray
    touch: int
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StageFailure:
    """A stage failed on one touch: the exploration continues without its result.

    stage: surface, dent, contact, creep, regions, beta, maps, beta field, lumps, plan or display
    touch: its number from 1, 0 = before the first
    reason: reason in one line; trace: place of the failure, for developers"""

    stage: str = field(metadata=reported())
    touch: int = field(metadata=reported())
    reason: str = field(metadata=reported())
    trace: str

    @classmethod
    def of(cls, stage: str, touch: int, error: Exception) -> "StageFailure":
        """The failure of a stage at a touch, from the error that it raised."""
        words = " ".join(str(error).split())
        kind = "" if isinstance(error, InputError) else type(error).__name__ + ": " * bool(words)
        return cls(stage=stage, touch=touch, reason=kind + words, trace="".join(traceback.format_exception(error)))


@dataclass(frozen=True, slots=True)
class PhaseStart:
    """The robot began a phase. name: look, travel, tare, approach, press, dwell, retreat, plan, paused,
    "stopped: ..." """

    name: str
    touch: int


@dataclass(frozen=True, slots=True)
class ExplorationStop:
    """The exploration ended before the end of its plan.

    kind: kind of the fault, in the supervisor's text or the touch's; reason: its evidence; advice: the remedy
    action: stop = the arm is at rest and its FIFO is erased, back off = it moved away first; touch: as in PhaseStart"""

    kind: str
    reason: str
    advice: str
    action: str
    touch: int
