"""How to explore: the options, the lengths that all of it keeps to, and the strategies that the options choose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.quantity import (
    ApparentStiffness,
    EnergyLoss,
    RelaxedStiffness,
    StiffnessAtReferenceSpeed,
)
from deformscope.experiments.search import InclusionSearch, RegionSearch, SurfaceSearch, ThesisSearch
from deformscope.stages.map.lump_posterior import LumpPosterior, LumpPrior
from deformscope.stages.map.plan import INCLUSION_M, Planner, PlanOptions
from deformscope.stages.regions.posterior import RegionPosterior, RegionPrior
from deformscope.stages.regions.touch_error import TouchErrorModel
from deformscope.stages.regions.touches import MapGrid

BetaModel = Literal["volume", "thesis", "layers", "none"]
Feel = Literal["apparent", "relaxed", "loss"]
Relief = Literal["stated", "seen"]
MOST_HOLD_S = 60.0
SECOND_FORCE_N, SECOND_SHARE = 5.0, 5.0 / 3.0
SHALLOW_M = 0.002
BORDER_M, LEAST_BORDER_M = 0.02, 0.01
"""No touch is made so near the surface's edge, unless it is asked for; from where on an edge's law was measured."""
VIEW_CELL_M = 0.004
"""Points of the surface before any touch are reduced to one in each cell of this size."""
Goal = Literal["regions", "inclusions"]
Pace = Literal["careful", "quick"]
TRAVEL_M_S = {"careful": 0.05, "quick": 0.15}
"""Between touches in the laboratory, by pace; a rig file says it for a rig."""
PLAN_CELL_M = 0.02
"""Places that are considered for a touch are this far apart."""
PLANNED_COSTS = {"careful": (6.0, 0.1), "quick": (4.0, 0.15)}
"""What the planner takes a touch for [s], and the speed of the way to it [m/s], by pace. Chosen: near enough to
what they take, and such that both paces weigh a touch and its way alike, and touch the same places."""
DRY_RUN_M = 0.1
"""A dry run is made so far above the surface: the tip stays 8 cm above it, a hand's breadth."""
EDGE_M, ABOVE_M, LOW_SHARE, LOW_UNSTATED = 0.005, 0.08, 0.5, 0.2
"""What a camera sees counts as the surface so far from its edges, so far above its thickness, and down to this share of
it; or to the other one, where its thickness is not stated."""


@dataclass(frozen=True, slots=True)
class ExploreOptions:
    """How to explore.

    planner, budget, threshold: where to touch, how often at most, and Th of the thesis's rule
    set_force_n, max_depth_m: of a touch; tip_radius_m: of its ball; thickness_m: of the foam
    beta_model: layers below the surface; the thesis's sweep of a single layer, or of layers, with one particle held; or
    no beta; cell_m: of the maps; seed
    standoff_m: of the tip above the surface before and after a touch, and above all that it crosses
    goal: regions of one stiffness each, or lumps below a surface that shows nothing (`stages.map.lump_posterior`)
    inclusion_m: radius of the smallest lumps that are sought
    first_m: where to touch first, None = where it says most (of the thesis: at a preset place)
    tangential: while it presses the tip is "held" on the surface's normal, or "free" to follow forces across it
    lift_m: all touches are made so far above the surface, where nothing is met: a dry run
    hold_s: how long each touch holds its force, for the foam's creep; 0 = no longer than to see the dent
    feel: which stiffness is mapped: as the touch comes down, or when all has relaxed; or the share of its energy that a
    touch loses
    pace: "quick" = low and fast over what is known of the surface
    relief: the foam is level and as thick as stated, or, on a table at z = 0, as thick and as curved as it was seen
    border_m: no touch is made so near the surface's edge; thickness_stated: else thickness_m says where to look for the
    surface, and nothing more
    go_on: touch until the budget is spent, even where the plan says enough (for studies)
    """

    planner: Planner = "regions"
    budget: int = 8
    threshold: float = 0.06
    set_force_n: float = 3.0
    max_depth_m: float = 0.015
    tip_radius_m: float = 0.01
    thickness_m: float = 0.05
    beta_model: BetaModel = "volume"
    cell_m: float = 0.005
    seed: int = 0
    standoff_m: float = 0.05
    go_on: bool = False
    goal: Goal = "regions"
    inclusion_m: float = INCLUSION_M
    first_m: tuple[float, float] | None = None
    lift_m: float = 0.0
    tangential: Literal["held", "free"] = "held"
    hold_s: float = 0.0
    feel: Feel = "apparent"
    pace: Pace = "careful"
    relief: Relief = "stated"
    border_m: float = BORDER_M
    thickness_stated: bool = True

    def __post_init__(self) -> None:
        if self.budget < 1:
            raise InputError("a budget of one touch or more", f"{self.budget}")
        if not 0.0 <= self.hold_s <= MOST_HOLD_S:
            raise InputError(f"a hold of 0 to {MOST_HOLD_S:g} s", f"{self.hold_s:g} s")
        if self.feel != "apparent" and not self.hold_s:
            what = "relaxed stiffness" if self.feel == "relaxed" else "energy loss"
            raise InputError(f"a hold, from which the {what} is measured", "none", "--hold 5")
        if self.feel == "loss" and self.planner == "thesis":
            raise InputError("a planner whose regions are not those of beta", "thesis", "--planner regions")
        if not 0.0 < self.set_force_n <= SECOND_FORCE_N:
            raise InputError(f"a set force above 0 and up to {SECOND_FORCE_N:g} N", f"{self.set_force_n:g} N")
        if self.goal == "inclusions" and self.feel == "loss":
            raise InputError("lumps that are felt by their stiffness", "--feel loss", "--goal regions")
        if self.goal == "inclusions" and self.planner != "regions":
            raise InputError("the goal's own planner", f"--planner {self.planner}", "leave --planner out")
        lengths = ("max_depth_m", "tip_radius_m", "thickness_m", "cell_m", "standoff_m", "inclusion_m")
        for name in lengths:
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} above 0", f"{getattr(self, name):g}")
        if not 0.0 <= self.threshold < math.inf or self.seed < 0:
            raise InputError("a threshold and a seed of 0 or more", f"{self.threshold:g} and {self.seed}")
        if not LEAST_BORDER_M <= self.border_m <= 0.1:
            raise InputError(f"a border of {LEAST_BORDER_M:g} to 0.1 m", f"{self.border_m:g} m")
        if self.border_m < BORDER_M and not self.thickness_stated:
            raise InputError("a stated thickness, for touches near the edge", "none", "thickness_m in [surface]")
        if self.planner == "thesis" and self.beta_model == "none":
            raise InputError("a beta model for the thesis's planner", "none", "--beta-model thesis")

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
        """What the planner weighs touches by."""
        touch_s, speed_m_s = PLANNED_COSTS[self.pace]
        return PlanOptions(
            planner=self.planner,
            budget=self.budget,
            threshold=self.threshold,
            cell_m=PLAN_CELL_M,
            inclusion_m=self.inclusion_m,
            touch_s=touch_s,
            speed_m_s=speed_m_s,
        )

    @property
    def quantity(self) -> ApparentStiffness:
        """What of a touch is mapped."""
        if not self.hold_s:
            return ApparentStiffness()
        return {"apparent": StiffnessAtReferenceSpeed, "relaxed": RelaxedStiffness, "loss": EnergyLoss}[self.feel]()

    def search(self, grid: MapGrid, error: TouchErrorModel) -> SurfaceSearch:
        """What is sought on a surface, before any touch. error: of touches' stiffness"""
        error = self.quantity.error(error)
        if self.goal == "inclusions":
            prior = LumpPrior(
                smallest_m=self.inclusion_m, tip_radius_m=self.tip_radius_m, set_force_n=self.set_force_n, error=error
            )
            return InclusionSearch(LumpPosterior(grid, prior))
        posterior = RegionPosterior.before_touches(grid, RegionPrior(error=error), seed=self.seed)
        search = ThesisSearch if self.planner == "thesis" else RegionSearch
        return search(posterior, self.seed)

    def first_place(self, size_m: tuple[float, float], search: SurfaceSearch) -> tuple[FloatArray, str] | None:
        """Where to touch first (2,) [m], and why; None = where it says most."""
        if self.first_m is not None:
            return np.array(self.first_m), "as asked for"
        if search.first_share is not None:
            return np.multiply(search.first_share, size_m), "the preset place"
        return None
