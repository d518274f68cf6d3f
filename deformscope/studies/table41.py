"""Thesis table 4.1, and scenes beyond it, in the laboratory: how good the map is after how many touches, over seeds.

Touches are pressed into finite elements and estimated as the robot's are, without wires (`explore_lab`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.errors import InputError
from deformscope.experiments.explore import AtOnce, Exploration, ExplorationStopped, explore, within_loop
from deformscope.experiments.explorer import AsMeasured, ExplorationStages, Explorer
from deformscope.experiments.options import ExploreOptions
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.plain import plain
from deformscope.session import run
from deformscope.stages.map.exploration import PlannedTouch, TouchEstimate
from deformscope.stages.map.map_score import MapScore, TrueMap, score_map
from deformscope.stages.map.plan import Planner, PlanOptions
from deformscope.studies.surface_robot import LabRobot, true_map


@dataclass(frozen=True, slots=True)
class TableJob:
    """One exploration. go_on: to the last touch, also after the plan has said enough, so that planners compare; clean:
    the laboratory keeps nothing from the estimator"""

    scene: str
    seed: int
    planner: Planner = "regions"
    touches: int = 8
    go_on: bool = False
    clean: bool = False


@dataclass(frozen=True, slots=True)
class MapAfter:
    """The map after some touches.

    travel_m: of the tip over the surface, from its corner; robot_s: what that and the touches take, as the planner
    reckons; compute_s: from this touch to the next target
    log_stiffness, log_sd, rigid: what the last touch measured [N/mm], at `xy_m`; felt_log_stiffness: what it would have
    measured without noise; touch_covered: whether its 90 % interval holds that, None where it is rigid
    """

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


@dataclass(frozen=True, slots=True)
class TableRun:
    """What one exploration gave. region_count: the true one, 0 where there are no regions; stop_after: touches after
    which the plan said enough, None where it never did; max_force_n: largest true contact force; seconds: that all of
    it took to compute and simulate"""

    job: TableJob
    region_count: int
    after: tuple[MapAfter, ...]
    max_force_n: float
    stop_after: int | None
    seconds: float

    def at(self, touches: int) -> MapAfter:
        """The map that the robot has with so many touches at most: it stops where the plan says enough."""
        last = len(self.after) if self.stop_after is None else self.stop_after
        return self.after[min(touches, last) - 1]


def run_table(job: TableJob) -> TableRun:
    """Explore one scene."""
    began = time.perf_counter()
    with threadpool_limits(1):
        scene = built_in(job.scene, job.seed)
        options = ExploreOptions(
            planner=job.planner,
            budget=job.touches,
            beta_model="none",
            seed=job.seed,
            thickness_m=scene.thickness_m,
            go_on=job.go_on,
        )
        robot = LabRobot(scene, options, sees=False, errors=LabErrors.none() if job.clean else LabErrors())
        explorer = Explorer(scene.size_m, options, robot.arm, robot.truth)
        truth = true_map(robot.scene, options)
        found = Exploration()
        scores = _Scores(found, explorer, robot, truth)
        stages = ExplorationStages(explorer, AsMeasured(scene.size_m, robot.reachable))
        run([], explore(lambda: 0, within_loop(stages), found), scores, AtOnce(robot))
        if found.stop is not None:
            raise ExplorationStopped(found.stop, found.stop_ns)
    after, stop_after = tuple(scores.after), scores.stop_after
    return TableRun(job, scene.region_count, after, robot.most_force_n, stop_after, time.perf_counter() - began)


class _Scores:
    """Scores each map once the plan after it is there; the session's recorder.

    stop_after: touches after which the plan said enough, though it went on
    """

    def __init__(self, found: Exploration, explorer: Explorer, robot: LabRobot, truth: TrueMap) -> None:
        self.after: list[MapAfter] = []
        self.stop_after: int | None = None
        self._found, self._explorer, self._robot, self._truth = found, explorer, robot, truth
        self._computed_s = 0.0

    def write(self, items: object) -> None:
        for plan in (one for one in getattr(items, "results", ()) if isinstance(one, PlannedTouch)):
            spent_s, self._computed_s = self._found.compute_s - self._computed_s, self._found.compute_s
            if self._found.touches:
                newest, felt = self._found.touches[-1], self._robot.felt[-1]
                self.after.append(_after(spent_s, self._explorer, newest, felt, self._truth))
                if plan.stop_reason not in ("", "budget") and self.stop_after is None:
                    self.stop_after = len(self.after)


def _after(compute_s: float, explorer: Explorer, measured: TouchEstimate, felt: float, truth: TrueMap) -> MapAfter:
    count, plan, regions = len(explorer.touches), PlanOptions(), explorer.region_map()
    touch = explorer.posterior.touches[-1]
    low, high = measured.stiffness_interval
    return MapAfter(
        touches=count,
        travel_m=explorer.travel_m,
        robot_s=explorer.travel_m / plan.speed_m_s + count * plan.touch_s,
        compute_s=compute_s,
        xy_m=(float(touch.xy_m[0]), float(touch.xy_m[1])),
        log_stiffness=touch.log_stiffness,
        log_sd=touch.log_sd,
        rigid=touch.rigid,
        felt_log_stiffness=felt,
        touch_covered=None if measured.rigid else bool(low <= np.exp(felt) <= high),
        score=score_map(regions, truth),
        probability=dict(regions.probability),
    )


# Runs in a file, a line each, so that none is lost where the rest is cut off ------------------------------------------


def add_run(path: Path, run: TableRun) -> None:
    """Add a run to a file."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(plain(run), allow_nan=False) + "\n")


def read_runs(path: Path) -> Iterator[TableRun]:
    """The runs in a file. Raises InputError where it holds anything else; a last line that was cut off is left out."""
    with path.open(encoding="utf-8") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith("\n"):
                return
            try:
                read = json.loads(line)
                after = [
                    MapAfter(**{**one, "xy_m": tuple(one["xy_m"]), "score": MapScore(**one["score"])})
                    for one in read["after"]
                ]
                yield TableRun(**{**read, "job": TableJob(**read["job"]), "after": tuple(after)})
            except (ValueError, TypeError, KeyError) as error:
                raise InputError(
                    "runs of this version", str(error), "leave --resume out", f"{path}:{number}"
                ) from error
