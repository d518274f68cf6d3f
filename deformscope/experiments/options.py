"""How to explore, and the lengths that all of it keeps to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from deformscope.errors import InputError
from deformscope.stages.map.plan import INCLUSION_M, Planner

BetaModel = Literal["volume", "thesis", "layers", "none"]
Feel = Literal["apparent", "relaxed", "loss"]
Relief = Literal["stated", "seen"]
MOST_HOLD_S = 60.0
SECOND_FORCE_N, SECOND_SHARE = 5.0, 5.0 / 3.0
SHALLOW_M = 0.002
BORDER_M = 0.02
"""No touch is made so near the surface's edge."""
VIEW_CELL_M = 0.004
"""Points of the surface before any touch are reduced to one in each cell of this size."""
Goal = Literal["regions", "inclusions"]
Pace = Literal["careful", "quick"]
TRAVEL_M_S = {"careful": 0.05, "quick": 0.15}
"""Between touches in the laboratory, by pace; a rig file says it for a rig."""
PLAN_CELL_M = 0.02
"""Places that are considered for a touch are this far apart."""
DRY_RUN_M = 0.1
"""A dry run is made so far above the surface: the tip stays 8 cm above it, a hand's breadth."""
EDGE_M, ABOVE_M, LOW_SHARE = 0.005, 0.08, 0.5
"""What a camera sees counts as the surface so far from its edges, so far above its thickness, and down to this share of
it."""


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
        if self.planner == "thesis" and self.beta_model == "none":
            raise InputError("a beta model for the thesis's planner", "none", "--beta-model thesis")

    @property
    def second_force_n(self) -> float:
        """Pressed with where the set force makes a small dent: 5 N after 3 N, and in proportion, 5 N at most."""
        return min(SECOND_FORCE_N, SECOND_SHARE * self.set_force_n)
