"""How to explore: the options, common lengths, and the strategies that the options choose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.config.explore import BORDER_M, REGION_TOUCHES, BetaModel, Detail, ExploreFlags, Relief
from deformscope.errors import InputError
from deformscope.experiments.quantity import (
    ApparentStiffness,
    EnergyLoss,
    RelaxedStiffness,
    StiffnessAtReferenceSpeed,
)
from deformscope.experiments.search import InclusionSearch, RegionSearch, SurfaceSearch, ThesisSearch
from deformscope.stages.map.inclusion_posterior import InclusionPosterior, InclusionPrior
from deformscope.stages.map.perception import COARSE_GRID_M
from deformscope.stages.map.plan import INCLUSION_M, PlanOptions
from deformscope.stages.map.thesis_field import SIGMA_W_M, ThesisField
from deformscope.stages.regions.posterior import RegionPosterior, RegionPrior
from deformscope.stages.regions.touch_error import TouchErrorModel
from deformscope.stages.regions.touches import MapGrid

SECOND_FORCE_N, SECOND_SHARE = 5.0, 5.0 / 3.0
SHALLOW_M = 0.002
VIEW_CELL_M = 0.004
"""Points of the surface before any touch are reduced to one in each cell of this size."""
TRAVEL_M_S = {"careful": 0.05, "quick": 0.15}
"""Between touches in the laboratory, by pace; a rig file says it for a rig."""
PLAN_CELL_M = 0.02
"""Places that are considered for a touch are this far apart."""
PLANNED_COSTS = {"careful": (6.0, 0.1), "quick": (4.0, 0.15)}
"""Duration of a touch for the planner [s], and the speed of the path to it [m/s], by pace. Chosen near the measured
times, and such that both paces weight a touch and its travel alike, and touch the same places."""
DRY_RUN_M = 0.1
"""A dry run is made so far above the surface: the tip stays 8 cm above it, a hand's breadth."""
EDGE_M, ABOVE_M, LOW_SHARE, LOW_UNSTATED = 0.005, 0.08, 0.5, 0.2
"""Bounds of points that count as surface: distance from its edges, height above its thickness, and lowest share of the
thickness; another share without a stated thickness."""


@dataclass(frozen=True, slots=True)
class ExploreOptions(ExploreFlags):
    """How to explore: options of a user, of a rig file or a scene, and of studies.

    relief, beta_grid_m, beta_step, sigma_w_m: without values, as in older recordings, the foam is level and as thick as
    stated. beta is then swept over 50 values up to 0.95 (step 0) on a grid of 1 cm, with sigma_w for that
    set_force_n, max_depth_m: set force and largest depth of a touch; tip_radius_m: tip radius of its ball; thickness_m:
    thickness of the foam; cell_m: cell size of the maps; seed
    standoff_m: height of the tip above the surface before and after a touch, and above all that it crosses
    go_on: touch until the budget is spent, even if the plan is complete (for studies)
    inclusion_m: radius of the smallest inclusions that are sought
    lift_m: all touches are made this far above the surface, without contact: a dry run
    tangential: while it presses the tip is "held" on the surface's normal, or "free" to follow forces across it
    thickness_stated: else thickness_m is only the height at which the surface is sought
    detail: where nothing is said, as in older recordings, lean
    plan_version: plan version of what the planner expects of touches (`PlanOptions`), in older recordings 1
    relaxation_version: relaxation version of intervals of a touch's creep (`relaxation.NEWEST_RELAXATION`), in older
    recordings 1
    """

    budget: flags.ManyFlag = REGION_TOUCHES
    beta_model: BetaModel = "volume"
    relief: Relief = "stated"
    beta_grid_m: float = COARSE_GRID_M
    beta_step: float = 0.0
    sigma_w_m: float = SIGMA_W_M
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
    detail: Detail = "lean"
    plan_version: int = 1
    relaxation_version: int = 1

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
        """Pressed with where the set force makes a small dent: 5 N after 3 N, and in proportion, 5 N at most."""
        return min(SECOND_FORCE_N, SECOND_SHARE * self.set_force_n)

    @property
    def stated_m(self) -> float | None:
        """Thickness of the foam, where it was stated."""
        return self.thickness_m if self.thickness_stated else None

    @property
    def planning(self) -> PlanOptions:
        """Weights of the planner for touches."""
        touch_s, speed_m_s = PLANNED_COSTS[self.pace]
        return PlanOptions(
            planner=self.planner,
            budget=self.budget,
            threshold=self.threshold,
            # before the sweep had a step, the planner "thesis" looked at fewer places
            cell_m=self.beta_grid_m if self.planner == "thesis" and self.beta_step else PLAN_CELL_M,
            inclusion_m=self.inclusion_m,
            touch_s=touch_s,
            speed_m_s=speed_m_s,
            version=self.plan_version,
        )

    @property
    def quantity(self) -> ApparentStiffness:
        """The mapped quantity of a touch."""
        if not self.hold_s:
            return ApparentStiffness()
        return {"apparent": StiffnessAtReferenceSpeed, "relaxed": RelaxedStiffness, "loss": EnergyLoss}[self.feel]()

    def search(self, grid: MapGrid, error: TouchErrorModel) -> SurfaceSearch:
        """The goal on a surface, before any touch. error: error model of touches' stiffness"""
        error = self.quantity.error(error)
        if self.goal == "inclusions":
            prior = InclusionPrior(
                smallest_m=self.inclusion_m, tip_radius_m=self.tip_radius_m, set_force_n=self.set_force_n, error=error
            )
            return InclusionSearch(InclusionPosterior(grid, prior))
        posterior = RegionPosterior.before_touches(grid, RegionPrior(error=error), seed=self.seed)
        if self.planner == "thesis":
            return ThesisSearch(posterior, self.seed, thesis=ThesisField(width_m=self.sigma_w_m))
        return RegionSearch(posterior, self.seed)

    def first_place(self, size_m: tuple[float, float], search: SurfaceSearch) -> tuple[FloatArray, str] | None:
        """Place of the first touch (2,) [m], and its reason; None = the most informative place."""
        if self.first_m is not None:
            return np.array(self.first_m), "as asked for"
        if search.first_share is not None:
            return np.multiply(search.first_share, size_m), "the preset place"
        return None
