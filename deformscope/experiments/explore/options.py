"""How to explore: the options, common lengths, the mapped quantity, and the strategies that the options choose."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.config import flags
from deformscope.config.explore import BORDER_M, BetaModel, ExploreFlags
from deformscope.errors import InputError
from deformscope.experiments.explore.search import InclusionSearch, RegionSearch, SurfaceSearch
from deformscope.stages.map.inclusion_posterior import InclusionPosterior, InclusionPrior
from deformscope.stages.map.plan import INCLUSION_M, PlanOptions
from deformscope.stages.poke.creep import REFERENCE_SPEED_M_S, CreepFit
from deformscope.stages.regions.levels import RegionPrior
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import LAW_SD, MapGrid, StiffnessSample, TouchErrorModel

SPEED_SD = 0.03
"""Change of log stiffness for each e-fold of the approach speed, for touches without a fitted creep. Assumed: a third
of the modulus relaxes evenly over three decades of time."""


class ApparentStiffness:
    """Stiffness of each touch during its approach, at its own speed."""

    def stiffness(
        self, sample: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        """The stiffness with which touches are compared; None if the touch does not determine it.

        felt: the stiffness of the contact; creep: the touch's creep, None if it was not fitted; speed_m_s: speed of the
        approach in contact, None where it is not known"""
        return sample


class StiffnessAtReferenceSpeed(ApparentStiffness):
    """Stiffness at the reference speed of approach: of touches with measured creep."""

    def stiffness(
        self, sample: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        if sample.rigid:
            return sample
        if creep is None:  # how much it would creep is not known
            speed_m_s = REFERENCE_SPEED_M_S if speed_m_s is None else max(speed_m_s, 1e-4)
            away = SPEED_SD * abs(float(np.log(speed_m_s / REFERENCE_SPEED_M_S)))
            return dataclasses.replace(sample, log_sd=float(np.hypot(sample.log_sd, away)))
        log_stiffness = sample.log_stiffness + creep.log_at_reference
        log_sd = float(np.hypot(sample.log_sd, creep.log_at_reference_sd))
        return dataclasses.replace(sample, log_stiffness=log_stiffness, log_sd=log_sd)


class RelaxedStiffness(ApparentStiffness):
    """Stiffness after complete relaxation."""

    def stiffness(
        self, sample: StiffnessSample, creep: CreepFit | None, speed_m_s: float | None
    ) -> StiffnessSample | None:
        if sample.rigid or creep is None:
            return sample if sample.rigid else None
        if creep.relaxed_n_per_mm is None or creep.relaxed_log_sd is None:
            raise InputError("a relaxed stiffness", creep.reasons[0].text, "a longer `hold_s`, or feel=apparent")
        log_sd = float(np.hypot(creep.relaxed_log_sd, LAW_SD))
        return dataclasses.replace(sample, log_stiffness=float(np.log(creep.relaxed_n_per_mm)), log_sd=log_sd)


SECOND_FORCE_N, SECOND_SHARE = 5.0, 5.0 / 3.0
SHALLOW_M = 0.002
VIEW_CELL_M = 0.004
"""Points of the surface before any touch are reduced to one in each cell of this size."""
TRAVEL_M_S = {"careful": 0.05, "quick": 0.15}
"""Speed between touches in the laboratory, by pace; for a rig the rig file states it."""
PLAN_CELL_M = 0.02
"""Distance of the places that are considered for a touch."""
PLANNED_COSTS = {"careful": (6.0, 0.1), "quick": (4.0, 0.15)}
"""Duration of a touch for the planner [s], and the speed of the path to it [m/s], by pace. Chosen near the measured
times, so that a touch and its travel have the same relative cost at both paces and the places are the same."""
DRY_RUN_M = 0.1
"""Height of a dry run above the surface: the tip stays 8 cm above it, a hand's breadth."""
EDGE_M, ABOVE_M, LOW_SHARE, LOW_UNSTATED = 0.005, 0.08, 0.5, 0.2
"""Bounds of points that count as surface: distance from its edges, height above its thickness, and lowest share of the
thickness; another share without a stated thickness."""


@dataclass(frozen=True, slots=True)
class ExploreOptions(ExploreFlags):
    """How to explore: options of a user, of a rig file or a scene, and of studies.

    set_force_n, max_depth_m: set force and largest depth of a touch; tip_radius_m: radius of its ball; thickness_m:
    thickness of the foam; cell_m: cell size of the maps; seed
    standoff_m: height of the tip above the surface before and after a touch, and above all that it crosses
    go_on: touch until the budget is spent, even if the plan is complete (for studies)
    inclusion_m: radius of the smallest inclusions that are sought
    lift_m: height above the surface at which all touches of a dry run are made, without contact
    tangential: while it presses the tip is "held" on the surface's normal, or "free" to follow forces across it
    thickness_stated: thickness_m was stated; otherwise it is only the height at which the surface is sought
    perception: compute also results between frames and estimates, for a recording"""

    budget: flags.ManyFlag = None  # type: ignore[assignment]  # the flags' default follows from the goal
    beta_model: BetaModel = None  # type: ignore[assignment]  # and so does that
    set_force_n: float = 3.0
    max_depth_m: float = 0.015
    tip_radius_m: float = 0.01
    thickness_m: float = 0.05
    cell_m: float = 0.005
    seed: flags.SeedFlag = 0
    standoff_m: float = 0.05
    go_on: bool = False
    inclusion_m: float = INCLUSION_M
    lift_m: float = 0.0
    tangential: Literal["held", "free"] = "held"
    thickness_stated: bool = True
    perception: bool = False

    def check(self) -> None:
        ExploreFlags.check(self)
        if not 0.0 < self.set_force_n <= SECOND_FORCE_N:
            raise InputError(f"a set force above 0 and up to {SECOND_FORCE_N:g} N", f"{self.set_force_n:g} N")
        lengths = ("max_depth_m", "tip_radius_m", "thickness_m", "cell_m", "standoff_m", "inclusion_m")
        for name in lengths:
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} above 0", f"{getattr(self, name):g}")
        if self.border_m < BORDER_M and not self.thickness_stated:
            raise InputError("a stated thickness, for touches near the edge", "none", "thickness_m in [surface]")

    @property
    def second_force_n(self) -> float:
        """Force that is used if the set force makes only a small dent: 5/3 of it, at most 5 N."""
        return min(SECOND_FORCE_N, SECOND_SHARE * self.set_force_n)

    @property
    def stated_m(self) -> float | None:
        """Thickness of the foam, if it was stated."""
        return self.thickness_m if self.thickness_stated else None

    @property
    def planning(self) -> PlanOptions:
        """Weights of the planner for touches."""
        touch_s, speed_m_s = PLANNED_COSTS[self.pace]
        return PlanOptions(
            budget=self.budget,
            threshold=self.threshold,
            cell_m=PLAN_CELL_M,
            inclusion_m=self.inclusion_m,
            touch_s=touch_s,
            speed_m_s=speed_m_s,
        )

    @property
    def quantity(self) -> ApparentStiffness:
        """The mapped quantity of a touch."""
        if not self.hold_s:
            return ApparentStiffness()
        return RelaxedStiffness() if self.feel == "relaxed" else StiffnessAtReferenceSpeed()

    def search(self, grid: MapGrid, error: TouchErrorModel) -> SurfaceSearch:
        """The goal on a surface, before any touch. error: error model of touches' stiffness"""
        if self.goal == "inclusions":
            prior = InclusionPrior(
                smallest_m=self.inclusion_m, tip_radius_m=self.tip_radius_m, set_force_n=self.set_force_n, error=error
            )
            return InclusionSearch(InclusionPosterior(grid, prior))
        return RegionSearch(RegionPosterior.before_touches(grid, RegionPrior(error=error), seed=self.seed))
