"""Opened devices that look and touch: on hardware, on doubles, and in the laboratory on one simulated clock."""

from __future__ import annotations

import contextlib
import gc
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.capsule import Capsule
from deformscope.errors import InputError
from deformscope.experiments.explore import (
    ABOVE_M,
    BORDER_M,
    VIEW_CELL_M,
    ExplorationStopped,
    ExploreOptions,
    SurfaceMeasurement,
    TouchMeasurement,
    pinhole,
    sample_box,
)
from deformscope.rig.source import RigSource
from deformscope.robot.advice import advice
from deformscope.robot.placement import follow
from deformscope.robot.preflight import Preflight, check
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.setup import Setup
from deformscope.robot.shape import arm_shape
from deformscope.robot.supervisor import Action, Fault
from deformscope.robot.touch import Phase, PhaseSpan, TouchEnding, TouchPlan, TouchRecord, run_touch
from deformscope.stages.map.exploration import ExplorationStop
from deformscope.stages.map.touches import MapGrid
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.see.cloud import Box, Intrinsics, perceive
from deformscope_drivers.depth_camera.image import DepthImage
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.subscription import Subscription

LINK_MARGIN_M, STICK_MARGIN_M = 0.012, 0.005
"""What is taken away around the arm's links, whose shape is rough, and around stick and ball: there four deviations of
a depth at 0.8 m (0.9 mm), as points on the stick itself have, and what the arm gives way (0.6 mm). A dent tells most
within 2 cm of the ball."""
DENT_M, DENT_PICTURES = 0.08, 10
"""Of a dent: half the side of what is looked at around it; its last pictures that are taken together, at most."""
SOFT_STOP_SHARE = 0.75
"""Of the soft stop, at most this share is pressed with: noise and overshoot must not reach it."""
PREFLIGHT_CELL_M = 0.02
COARSE_M = 0.03
"""Reach is asked at places so far apart, and taken for the cells around."""
UPRIGHT = np.array([0.0, 0.0, 1.0])
LOOKS = 3
LOOK_PERIODS = 1000


def highest_m(options: ExploreOptions) -> float:
    """Where the tip's middle is above all that a camera may find on the table [m]."""
    return options.thickness_m + ABOVE_M + options.standoff_m + options.tip_radius_m


@contextlib.contextmanager
def touching_robot(
    setup: Setup, source: RigSource, options: ExploreOptions, on_cycle: Callable[[], None] = lambda: None
) -> Iterator[TouchingRobot]:
    """The robot over the devices of an open source. on_cycle: called in every control period"""
    robot = setup.robot(source, lambda seen, verdict: on_cycle())
    with _without_long_pauses() if setup.runs_itself else contextlib.nullcontext():
        yield TouchingRobot(robot, setup, options)


@contextlib.contextmanager
def _without_long_pauses() -> Iterator[None]:
    """Keep what was loaded until now out of Python's search for garbage, which would hold all threads up for 0.1 s and
    more, in the middle of a motion."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class TouchingRobot:
    """Opened devices that look and touch (`deformscope.robot`), as `explore` wants them.

    on_phase: told each phase of a touch as it begins, and when on the robot's clock [ns]
    """

    def __init__(self, robot: Robot, setup: Setup, options: ExploreOptions) -> None:
        self.size_m = setup.size_m
        self.arm = ArmCompliance(setup.compliance_m_per_n, setup.compliance_sd)
        self._robot = robot
        self._setup = setup
        self._options = options
        self._pictures: Subscription[DepthImage] | None = None
        self.on_phase: Callable[[Phase, int], None] = lambda phase, time_ns: None
        self._dwelling = contextlib.ExitStack()
        self._touches = 0
        self._phase: Phase | None = None
        self._pressed_m: FloatArray | None = None

    def now_ns(self) -> int:
        return self._setup.clock()

    def preflight(self, calibrated: Mapping[str, bool], places_m: FloatArray | None = None) -> Preflight:
        """Look at everything before anything moves.

        calibrated: what has to be, by name, and whether it is; places_m: (n, 2) that will be touched, None = any that
        can be reached. Raises InputError where nothing can be reached.
        """
        corners = self._corners() if places_m is None else list(places_m)
        height_m = self._options.thickness_m
        plans = [self._plan(corner, height_m, UPRIGHT, None) for corner in corners]
        with self._telling():
            found = check(self._robot, plans, calibrated=calibrated)
        self._robot.rest()
        return found

    def _corners(self) -> list[FloatArray]:
        """The outermost places that can be reached."""
        allowed = self.reachable(MapGrid(self.size_m, PREFLIGHT_CELL_M))
        places = MapGrid(self.size_m, PREFLIGHT_CELL_M).centres_m[allowed.ravel()]
        if not len(places):
            raise InputError("a surface that the arm reaches", "none of it", "move the arm, or the surface")
        return [places[int(np.argmax(places @ way))] for way in ((1, 1), (1, -1), (-1, 1), (-1, -1))]

    @property
    def forces_told(self) -> str:
        """What a touch presses with, in words."""
        set_n, more_n = self._options.set_force_n, self._more_force_n
        return f"{set_n:g} N" + ("" if more_n is None else f", {more_n:g} N where that makes a dent below 2 mm")

    @property
    def _more_force_n(self) -> float | None:
        """Pressed with where the dent stays small; None where the soft stop leaves no room for it."""
        more_n = min(self._options.second_force_n, SOFT_STOP_SHARE * self._setup.workspace.soft_stop_n)
        return more_n if more_n > self._options.set_force_n else None

    def let_move(self, preflight: Preflight) -> None:
        """From now on the robot may move. Raises InputError where a check has failed, with which."""
        self._robot.let_move(preflight)

    def reachable(self, grid: MapGrid) -> BoolArray:
        """Cells that the tip can be led down to with the stick upright, as deep as a touch goes, all but a margin at
        the border."""
        rows, columns = grid.shape
        every = max(1, round(COARSE_M / grid.cell_m))
        row, column = np.arange(0, rows, every), np.arange(0, columns, every)
        x, y = np.meshgrid((column + 0.5) * grid.cell_m, (row + 0.5) * grid.cell_m)
        height_m = self._options.thickness_m
        plans = [self._plan(np.array(xy), height_m, UPRIGHT, None) for xy in zip(x.flat, y.flat, strict=True)]
        good = np.array([self._leads(plan) for plan in plans]).reshape(x.shape)
        inside = np.repeat(np.repeat(good, every, 0), every, 1)[:rows, :columns]
        places = grid.centres_m
        within = ((places > BORDER_M) & (places < np.asarray(self.size_m) - BORDER_M)).all(axis=1).reshape(grid.shape)
        return np.asarray(inside & within)

    def _leads(self, plan: TouchPlan) -> bool:
        """Whether the arm can be led straight down from above, as deep as a touch goes at most."""
        robot = self._robot
        down_m = plan.places_m(robot.placement.center_offset_m)[1:]
        start_deg = robot.pose.joints_deg
        return bool(follow(robot.arm.chain, robot.placement, down_m, plan.normal, start_deg=start_deg).all())

    def look(self) -> SurfaceMeasurement:
        """The surface from the newest pictures, without the robot."""
        self._robot.start()
        with self._pictures_kept():
            pictures = self._take_pictures(LOOKS)
        links = self._links()
        self._robot.rest()
        box = sample_box(self.size_m, self._options.thickness_m)
        clouds = [self._seen(picture, links, box) for picture in pictures]
        return SurfaceMeasurement(
            np.concatenate([c.points_m for c in clouds]), np.concatenate([c.noise_m for c in clouds])
        )

    def touch(self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None) -> TouchMeasurement:
        """Go there, touch along the normal, or upright where the arm cannot be led along it, look at the dent, come
        back. Raises ExplorationStopped."""
        plan = self._plan(xy_m, height_m, normal, over_m)
        if not self._leads(plan):  # joint limits and singularities depend on the tilt
            plan = self._plan(xy_m, height_m, UPRIGHT, over_m)
        self._robot.start()  # nobody looked while the plan was made
        dents: list[tuple[DepthImage, tuple[Capsule, ...]]] = []

        def still() -> bool:
            dents.extend((picture, self._links()) for picture in self._new_pictures())
            return True

        with self._telling(), contextlib.ExitStack() as self._dwelling:
            record = run_touch(self._robot, plan, still, self._begin)
        self._phase = None
        self._robot.rest()
        verdict = self._robot.supervisor.verdict
        if verdict.action is not Action.GO_ON:
            raise self._stopped(verdict.fault, verdict.reason, verdict.action, verdict.time_ns)
        if record.contact_m is None or record.ending in (TouchEnding.NOT_REACHED, TouchEnding.NO_CONTACT):
            where = f"at ({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm"
            raise self._stopped(record.ending, f"{where}: {record.reason}" if record.reason else where)
        self._touches += 1
        after: FloatArray = np.zeros((0, 3))
        unseen = ""
        try:
            after = self._dent(record, dents, xy_m)
        except Exception:  # the touch is made, and its force and depth do not hang on the camera
            unseen = traceback.format_exc()
        kept = slice(0, max(record.loading, 10))
        return TouchMeasurement(
            xy_m,
            plan.normal,
            record.time_s[kept],
            record.position_m[kept],
            record.force_n[kept],
            after,
            record.ending is TouchEnding.SET_FORCE,
            max((round(span.end_s * 1e9) for span in _dwells(record)), default=0),
            unseen,
        )

    @property
    def doing(self) -> str:
        """What it does now, in words; empty between touches."""
        if self._phase is None:
            return ""
        told = f"touch {self._touches + 1}: {self._phase}"
        if self._pressed_m is not None:
            depth_m = float(self._pressed_m[2] - self._robot.center_m[2])
            forces = self._robot.seen.forces
            force_n = float(np.linalg.norm(forces[-1].force_n)) if forces else np.nan
            told += f" {force_n:.1f} N {1e3 * depth_m:.1f} mm"
        return told

    def ask_to_stop(self, reason: str) -> None:
        """A person wants it to stop: the arm stands within a control period, and the exploration ends."""
        self._robot.ask_to_stop(reason)

    def halt(self, reason: str) -> bool:
        """Erase what waits in the arm, which takes no further command; whether it was reached."""
        return self._robot.halt(reason)

    def look_on(self, duration_s: float) -> None:
        """Stand still and let the devices be recorded, stopped or not."""
        self._robot.look_on(duration_s)

    def _plan(self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None) -> TouchPlan:
        """As high as nothing can stand where it is not known what the way leads over."""
        options = self._options
        highest = highest_m(options)
        if over_m is not None:
            offset_m = self._robot.placement.center_offset_m
            highest = min(over_m + options.standoff_m + offset_m, highest)
        plan = TouchPlan(
            np.append(xy_m, height_m),
            np.asarray(normal, np.float64),
            set_force_n=options.set_force_n,
            more_force_n=self._more_force_n,
            max_depth_m=options.max_depth_m,
            standoff_m=options.standoff_m,
            travel_height_m=highest,
        )
        return plan.no_faster(self._setup.workspace.contact_speed_m_s, self._setup.workspace.travel_speed_m_s)

    def _begin(self, phase: Phase, time_ns: int) -> None:
        self._phase = phase
        if phase is Phase.DWELL:
            self._dwelling.enter_context(self._pictures_kept())
        if phase is Phase.PRESS:
            self._pressed_m = self._robot.center_m
        elif phase in (Phase.RETREAT, Phase.BACK_OFF):
            self._pressed_m = None
        self.on_phase(phase, time_ns)

    @contextlib.contextmanager
    def _telling(self) -> Iterator[None]:
        """That the supervisor has stopped the robot is told as why the exploration ends."""
        try:
            yield
        except RobotStopped as error:
            verdict = error.verdict
            raise self._stopped(verdict.fault, verdict.reason, verdict.action, verdict.time_ns) from error

    def _stopped(
        self, cause: Fault | TouchEnding, reason: str, action: Action = Action.STOP, time_ns: int | None = None
    ) -> ExplorationStopped:
        """The arm stands, and whoever explores is told why."""
        self._robot.halt(f"{cause}: {reason}")
        self._phase = self._pressed_m = None
        told = ExplorationStop(str(cause), reason, advice(cause), str(action), self._touches)
        return ExplorationStopped(told, self._setup.clock() if time_ns is None else time_ns)

    def _dent(
        self, record: TouchRecord, pictures: Sequence[tuple[DepthImage, tuple[Capsule, ...]]], xy_m: FloatArray
    ) -> FloatArray:
        """Points seen around a place while it pressed still, of all pictures. pictures: each with the robot as it stood
        then"""
        dwell = _dwells(record)[-1:]
        within = [
            (picture, links)
            for picture, links in pictures
            if any(span.start_s <= picture.stamp.host_ns / 1e9 <= span.end_s for span in dwell)
        ]
        box = sample_box(self.size_m, self._options.thickness_m)
        low = (*np.maximum(box.low_m[:2], xy_m - DENT_M), box.low_m[2])
        high = (*np.minimum(box.high_m[:2], xy_m + DENT_M), box.high_m[2])
        seen = []
        for picture, links in within[-DENT_PICTURES:]:
            with contextlib.suppress(InputError):  # nothing but the robot is there
                seen.append(self._seen(picture, links, Box(low, high), cell_m=None).points_m)
        return np.concatenate(seen) if seen else np.zeros((0, 3))

    def _seen(
        self, picture: DepthImage, links: tuple[Capsule, ...], box: Box, cell_m: float | None = VIEW_CELL_M
    ) -> SurfaceMeasurement:
        camera = self._setup.camera
        if camera.focal_px is not None and camera.center_px is not None:
            intrinsics = Intrinsics(camera.focal_px, camera.center_px, camera.distortion)
        elif picture.intrinsics is not None:
            intrinsics = pinhole(picture.intrinsics)
        else:
            raise InputError("[camera] focal_px and center_px", "none, and a camera that reports none")
        if camera.T_surface_camera is None:
            raise InputError("[camera] T_arm_camera", "none", "where the camera stands")
        T_surface_camera = camera.T_surface_camera
        found = perceive(picture.depth_m(), intrinsics, T_surface_camera, box, links=links, margin_m=0.0, cell_m=cell_m)
        return SurfaceMeasurement(found.points_m, found.noise_m)

    def _links(self) -> tuple[Capsule, ...]:
        """What arm and stick may fill where the arm says they are, surface frame."""
        return arm_shape(
            self._robot.placement,
            self._robot.arm.chain,
            self._robot.pose.joints_deg,
            self._robot.center_m,
            link_margin_m=LINK_MARGIN_M + self._setup.camera.doubt_m,
            stick_margin_m=STICK_MARGIN_M + self._setup.camera.doubt_m,
        )

    def _new_pictures(self) -> list[DepthImage]:
        with contextlib.suppress(DeviceError):  # what becomes of a lost camera, the supervisor decides
            return [] if self._pictures is None else self._pictures.take()
        return []

    @contextlib.contextmanager
    def _pictures_kept(self) -> Iterator[None]:
        """From now on new pictures wait to be taken; at other times nobody takes them, and they would count as lost."""
        if self._robot.camera is None:
            yield
            return
        with self._robot.camera.readings() as self._pictures:
            yield
        self._pictures = None

    def _take_pictures(self, count: int) -> list[DepthImage]:
        """The next pictures, the robot standing still."""
        taken: list[DepthImage] = []
        for _ in range(LOOK_PERIODS):
            with self._telling():
                self._robot.cycle()
            taken += self._new_pictures()
            if len(taken) >= count:
                return taken[-count:]
        raise self._stopped(Fault.CAMERA_SILENT, f"{len(taken)} depth images in {LOOK_PERIODS / 100:g} s")


def _dwells(record: TouchRecord) -> list[PhaseSpan]:
    """When it pressed still: once, or with the set force and then with more."""
    return [span for span in record.phases if span.phase in (Phase.DWELL, Phase.DWELL_MORE)]
