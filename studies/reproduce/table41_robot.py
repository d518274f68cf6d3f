"""Thesis table 4.1 and other scenes in the laboratory: the quality of the map over the number of touches, for several
seeds.

Touches are pressed into finite elements and estimated like those of a robot, without wires (`explore_lab`)."""

import time

import numpy as np
from threadpoolctl import threadpool_limits

from deformscope.experiments.explore.explore import Exploration, PlannedBy
from deformscope.experiments.explore.explorer import ExplorationStages, Explorer, UnseenSurface
from deformscope.experiments.explore.options import TRAVEL_M_S, ExploreOptions
from deformscope.experiments.measured import SetupGeometry, highest_m
from deformscope.lab.arm_contact import ARM_DOUBT, ARM_STIFFNESS_N_M
from deformscope.lab.scenes import Scene, built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.placement import Placement
from deformscope.robot.setup import CameraView
from deformscope.stages.map.exploration import PlannedTouch, TouchEstimate
from studies.map_score import TrueMap, score_map
from studies.planners import PLANNERS
from studies.reproduce.surface_robot import LabRobot, explore_at_once, true_map
from studies.reproduce.table41_runs import MapAfter, TableJob, TableRun
from studies.reproduce.touch_clock import PlannedTouches, TouchClock


def run_table(job: TableJob) -> TableRun:
    """Explore one scene."""
    began = time.perf_counter()
    with threadpool_limits(1):
        scene = built_in(job.scene, job.seed)
        options = ExploreOptions(
            budget=job.touches,
            beta_model="none",
            seed=job.seed,
            thickness_m=scene.thickness_m,
            go_on=job.go_on,
            pace=job.pace,
        )
        errors = LabErrors.none() if job.clean else LabErrors()
        setup = _setup(scene, options)
        offset_m = setup.placement.center_offset_m
        clock = TouchClock(np.array([*(0.5 * np.asarray(scene.size_m)), highest_m(options)]), offset_m)
        robot = LabRobot(scene, options, sees=False, errors=errors, clock=clock)
        unseen = UnseenSurface(scene.size_m, options, robot.arm, robot.truth)
        stages = ExplorationStages(unseen, PlannedTouches(setup, options, robot.reachable))
        truth = true_map(robot.scene, options)
        found = Exploration()
        scores = _Scores(found, stages, robot, truth, clock)
        planner = PLANNERS[job.planner](job.seed)
        explore_at_once(robot, stages, scores, found, None if planner is None else PlannedBy(planner, found))
    after, stop_after = tuple(scores.after), scores.stop_after
    return TableRun(job, scene.region_count, after, robot.most_force_n, stop_after, time.perf_counter() - began)


def _setup(scene: Scene, options: ExploreOptions) -> SetupGeometry:
    """The laboratory's, as far as a touch's plan depends on it: arm and camera stand nowhere."""
    return SetupGeometry(
        scene.size_m,
        Placement(np.eye(4), Tool(radius_m=options.tip_radius_m)),
        Workspace(travel_speed_m_s=TRAVEL_M_S[options.pace]),
        CameraView((1.0, 1.0), (0.0, 0.0)),
        1.0 / ARM_STIFFNESS_N_M,
        ARM_DOUBT / ARM_STIFFNESS_N_M,
    )


class _Scores:
    """Scores each map once the plan after it is there; the session's recorder.

    stop_after: touches at the end of the plan, though it continued"""

    def __init__(
        self, found: Exploration, stages: ExplorationStages, robot: LabRobot, truth: TrueMap, clock: TouchClock
    ) -> None:
        self.after: list[MapAfter] = []
        self.stop_after: int | None = None
        self._found, self._stages, self._robot, self._truth = found, stages, robot, truth
        self._clock, self._computed_s = clock, 0.0

    def write(self, items: object) -> None:
        for plan in (one for one in getattr(items, "results", ()) if isinstance(one, PlannedTouch)):
            spent_s, self._computed_s = self._found.compute_s - self._computed_s, self._found.compute_s
            if self._found.touches:
                newest, felt = self._found.touches[-1], self._robot.felt[-1]
                self.after.append(
                    _after(spent_s, self._clock.seconds, self._stages.explorer, newest, felt, self._truth, plan)
                )
                if plan.stop_reason not in ("", "budget") and self.stop_after is None:
                    self.stop_after = len(self.after)


def _after(
    compute_s: float,
    robot_s: float,
    explorer: Explorer,
    measured: TouchEstimate,
    felt: float,
    truth: TrueMap,
    planned: PlannedTouch,
) -> MapAfter:
    count, regions = len(explorer.touches), explorer.region_map
    touch = explorer.search.posterior.touches[-1]
    low, high = measured.stiffness_interval
    return MapAfter(
        touches=count,
        travel_m=explorer.travel_m,
        robot_s=robot_s,
        compute_s=compute_s,
        xy_m=(float(touch.xy_m[0]), float(touch.xy_m[1])),
        log_stiffness=touch.log_stiffness,
        log_sd=touch.log_sd,
        rigid=touch.rigid,
        felt_log_stiffness=felt,
        touch_covered=None if measured.rigid else bool(low <= np.exp(felt) <= high),
        score=score_map(regions, truth),
        probability=dict(regions.probability),
        unseen=None if planned.missed is None else planned.missed.probability(explorer.options.inclusion_m),
    )
