"""A robot of real drivers: in the laboratory on byte-exact doubles and one simulated clock, or on hardware."""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deformscope.arrays import BoolArray, FloatArray
from deformscope.capsule import Capsule
from deformscope.errors import InputError
from deformscope.experiments.explore import (
    ABOVE_M,
    ExplorationStopped,
    ExploreOptions,
    SurfaceMeasurement,
    TouchMeasurement,
    Truth,
    pinhole,
    sample_box,
)
from deformscope.lab.depth_view import DepthView, DepthViewConfig
from deformscope.lab.scenes import Scene
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import Contact, SlabWorld
from deformscope.lab.touch_lab import T_BASE_SURFACE, TouchLab
from deformscope.rig.driver_table import DRIVERS
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.rig.source import RigMember, RigSource
from deformscope.robot.advice import advice
from deformscope.robot.placement import Placement, best_joints, follow
from deformscope.robot.preflight import Preflight, check
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.shape import arm_shape
from deformscope.robot.supervisor import Action, Fault, Limits, SafetyVerdict
from deformscope.robot.touch import Phase, PhaseSpan, TouchEnding, TouchPlan, TouchRecord, run_touch
from deformscope.stages.map.exploration import ExplorationStop
from deformscope.stages.map.touches import MapGrid
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.see.cloud import Box, Intrinsics, perceive
from deformscope.studies.surface_robot import ARM_DOUBT, ARM_N_PER_M, BORDER_M, VIEW_CELL_M, truth_of
from deformscope_drivers.depth_camera import View
from deformscope_drivers.depth_camera.image import DepthImage
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.jaco.kinematics import J2N6S300
from deformscope_drivers.memory import SimulatedClock
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
CAMERA_HZ = 10.0
CAMERA_AZIMUTH_DEG = -90.0
"""The camera looks across the long edge at y = 0: the arm stands beyond the other, and hides what is behind it."""
BOX_LOW_M, BOX_HIGH_M = (-0.40, -0.66, 0.0), (0.45, 0.10, 0.75)
"""Where the tip may go in the laboratory, in the base frame: above the table, and to where the arm is parked."""


class Bench(Protocol):
    """A robot to be opened, and what is known of it before.

    clock: that its devices stamp by [ns]; truth: what is simulated; simulated: nothing real moves
    runs_itself: its devices go on by themselves, with threads of their own, while something is computed
    calibrated: what has to be known before it moves, by name, and whether it is
    max_force_n: the largest true contact force so far [N], None where only the sensor knows
    """

    size_m: tuple[float, float]
    placement: Placement
    truth: Truth | None
    runs_itself: bool

    @property
    def clock(self) -> Callable[[], int]: ...

    @property
    def arm(self) -> ArmCompliance: ...

    @property
    def simulated(self) -> bool: ...

    @property
    def calibrated(self) -> dict[str, bool]: ...

    @property
    def max_force_n(self) -> float | None: ...

    def source(self) -> AbstractContextManager[RigSource]:
        """All devices, open within the context."""

    def robot(self, on_cycle: Callable[[], None] | None = None) -> AbstractContextManager[TouchingRobot]:
        """The robot over the open devices. on_cycle: called in every control period"""


def highest_m(options: ExploreOptions) -> float:
    """Where the tip's middle is above all that a camera may find on the table [m]."""
    return options.thickness_m + ABOVE_M + options.standoff_m + options.tip_radius_m


class TouchingRobot:
    """Opened devices that look and touch (`deformscope.robot`), as `explore` wants them.

    on_phase: told each phase of a touch as it begins, and when on the robot's clock [ns]
    """

    def __init__(
        self,
        robot: Robot,
        size_m: tuple[float, float],
        options: ExploreOptions,
        camera: tuple[Intrinsics | None, FloatArray | None],
        *,
        arm: ArmCompliance,
        clock: Callable[[], int],
        workspace: Workspace,
        doubt_m: float = 0.0,
    ) -> None:
        """doubt_m: how far off camera and arm may be to one another [m]
        camera: its intrinsics, None = as its pictures say; and T_surface_camera (4, 4), None = not known"""
        self.size_m = size_m
        self.arm = arm
        self._robot = robot
        self._options = options
        self._camera = camera
        self._clock = clock
        self._workspace = workspace
        self._doubt_m = doubt_m
        self._pictures: Subscription[DepthImage] | None = None
        self.on_phase: Callable[[Phase, int], None] = lambda phase, time_ns: None
        self._dwelling = contextlib.ExitStack()
        self._touches = 0
        self._phase: Phase | None = None
        self._pressed_m: FloatArray | None = None

    def now_ns(self) -> int:
        return self._clock()

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
        more_n = min(self._options.second_force_n, SOFT_STOP_SHARE * self._workspace.soft_stop_n)
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
        return plan.no_faster(self._workspace.contact_speed_m_s, self._workspace.travel_speed_m_s)

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
        return ExplorationStopped(told, self._clock() if time_ns is None else time_ns)

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
        intrinsics, T_surface_camera = self._camera
        if intrinsics is None:
            told = picture.intrinsics
            if told is None:
                raise InputError("[camera] focal_px and center_px", "none, and a camera that tells none")
            intrinsics = pinhole(told)
        if T_surface_camera is None:
            raise InputError("[camera] T_arm_camera", "none", "where the camera stands")
        found = perceive(picture.depth_m(), intrinsics, T_surface_camera, box, links=links, margin_m=0.0, cell_m=cell_m)
        return SurfaceMeasurement(found.points_m, found.noise_m)

    def _links(self) -> tuple[Capsule, ...]:
        """What arm and stick may fill where the arm says they are, surface frame."""
        return arm_shape(
            self._robot.placement,
            self._robot.arm.chain,
            self._robot.pose.joints_deg,
            self._robot.center_m,
            link_margin_m=LINK_MARGIN_M + self._doubt_m,
            stick_margin_m=STICK_MARGIN_M + self._doubt_m,
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


class LabBench:
    """The laboratory with a scene in it: slab, camera, arm and force sensor, closed; a `Bench`."""

    simulated = True
    runs_itself = False

    def __init__(self, scene: Scene, options: ExploreOptions, *, camera_width: int = 320) -> None:
        self.scene = scene
        self.size_m = scene.size_m
        self.truth: Truth | None = truth_of(scene)
        self.calibrated = {"camera to surface": True, "arm's compliance": True}
        self.clock = SimulatedClock(1_000_000_000)
        self._world = SlabWorld(scene)
        self._tip = RigidTip(radius=options.tip_radius_m)
        self._contact: Contact | None = None
        view = DepthViewConfig(width=camera_width, height=camera_width * 3 // 4, azimuth_deg=CAMERA_AZIMUTH_DEG)
        self.view = DepthView(scene, view)
        self.tool = Tool(radius_m=options.tip_radius_m)
        T_base_surface = T_BASE_SURFACE
        self.placement = Placement(T_base_surface, self.tool)
        parked = np.array([scene.size_m[0] / 2, scene.size_m[1] / 2, highest_m(options)])
        touching = np.array([*parked[:2], scene.thickness_m])
        self.lab = TouchLab(
            self,
            self.clock,
            tool=self.tool,
            T_base_surface=T_base_surface,
            arm_stiffness_n_m=ARM_N_PER_M,
            view=self._see,
            camera_config=SyntheticDepthConfig(rate_hz=CAMERA_HZ, missing=0.02, seed=options.seed),
            start_deg=best_joints(J2N6S300, [self.placement.T_base_ee(place, UPRIGHT) for place in (parked, touching)]),
            seed=options.seed,
        )
        self._options = options

    def press(self, center_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """The slab's force on the tip: what `TouchLab` asks of its world."""
        self._contact = self._world.press(self._tip, center_m)
        return np.asarray(self._contact.force_n, np.float64)

    @property
    def max_force_n(self) -> float:
        """The largest true contact force so far [N]."""
        return self.lab.contact.max_force_n

    @property
    def arm(self) -> ArmCompliance:
        """As a calibration on a rigid block would give it: 10 % off is taken into account."""
        return ArmCompliance(1.0 / ARM_N_PER_M, ARM_DOUBT / ARM_N_PER_M)

    def source(self) -> RigSource:
        """The devices as a source; entering it opens the laboratory."""
        devices: dict[str, tuple[str, Device[Any]]] = {
            "arm": ("jaco", self.lab.arm),
            "tip": ("optoforce", self.lab.force),
        }
        if self.lab.camera is not None:
            devices["camera"] = ("depth_camera", self.lab.camera)
        members = [RigMember(name, DRIVERS[driver], device, True) for name, (driver, device) in devices.items()]
        return RigSource(members, clock=self.clock, opener=self.lab.open)

    @contextlib.contextmanager
    def robot(self, on_cycle: Callable[[], None] | None = None) -> Iterator[TouchingRobot]:
        """The robot over the opened laboratory. on_cycle: called in every control period"""

        def watch(seen: RobotObservation, verdict: SafetyVerdict) -> None:
            if on_cycle is not None:
                on_cycle()

        workspace = Workspace(low_m=BOX_LOW_M, high_m=BOX_HIGH_M)
        robot = Robot(
            self.lab.arm,
            self.lab.force,
            self.placement,
            Limits.of(workspace, camera_hz=CAMERA_HZ),
            camera=self.lab.camera,
            clock=self.clock,
            wait_until=self.lab.wait_until,
            watch=watch,
        )
        robot.cycle()
        yield TouchingRobot(
            robot,
            self.scene.size_m,
            self._options,
            (pinhole(self.view.intrinsics), self.view.surface_from_camera),
            arm=self.arm,
            clock=self.clock,
            workspace=workspace,
        )

    def _see(self, time_s: float) -> View:
        """What the camera sees now: the slab as it is pressed, the arm in its pose."""
        moved = None
        if self._contact is not None and len(self._contact.node):
            moved = self._world.displaced_m(self._contact, self.view.places_m)
        arm = self.lab.arm_double
        exact = self.view.render(moved, arm_shape(self.placement, arm.chain, arm.joints_deg, self.lab.contact.center_m))
        return View(exact.depth_m, exact.color)  # the camera adds its own noise
