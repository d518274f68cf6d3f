"""Explorations of table 4.1: their options and their outcome."""

from dataclasses import dataclass

from deformscope.config.explore import Pace
from studies.map_score import MapScore


@dataclass(frozen=True, slots=True)
class TableJob:
    """One exploration. go_on: touch until the last touch, even after the end of the plan, so that planners compare
    closed_form: touches are contacts in closed form, instead of finite elements; clean: no hidden errors in the
    laboratory; pace: as in `ExploreOptions`"""

    scene: str
    seed: int
    planner: str = "regions"
    touches: int = 8
    go_on: bool = False
    closed_form: bool = False
    clean: bool = False
    pace: Pace = "careful"

    @property
    def way(self) -> str:
        """Planner and pace, as text: the compared pair."""
        return self.planner if self.pace == "careful" else f"{self.planner} {self.pace}"


@dataclass(frozen=True, slots=True)
class MapAfter:
    """The map after some touches.

    travel_m: travel of the tip over the surface, from its corner; robot_s: time of the robot for the touches
    (`touch_clock`; in closed; form: the planner's estimate); compute_s: computing time from this touch to the next
    target; log_stiffness, log_sd, rigid: measurement of the last touch [N/mm], at `xy_m`; felt_log_stiffness: its
    measurement without noise; touch_covered: whether its 90 % interval holds the truth, None if it is rigid
    unseen: probability of undetected inclusions of the searched size, None if not computed"""

    touches: int
    travel_m: float
    robot_s: float
    compute_s: float
    xy_m: tuple[float, float]
    log_stiffness: float
    log_sd: float
    rigid: bool
    felt_log_stiffness: float
    touch_covered: bool | None
    score: MapScore
    probability: dict[str, float]
    unseen: float | None = None


@dataclass(frozen=True, slots=True)
class TableRun:
    """Results of one exploration. region_count: true number of regions, 0 without regions; stop_after: touches at the
    end of the plan, None if it did not end; max_force_n: largest true contact force; seconds: time to compute and
    simulate the run"""

    job: TableJob
    region_count: int
    after: tuple[MapAfter, ...]
    max_force_n: float
    stop_after: int | None
    seconds: float

    def at(self, touches: int) -> MapAfter:
        """The map of the robot after at most this many touches: it stops at the end of its plan."""
        last = len(self.after) if self.stop_after is None else self.stop_after
        return self.after[min(touches, last) - 1]
