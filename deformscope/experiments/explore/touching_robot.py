"""Opened devices that look and touch: on hardware, on doubles, and in the laboratory on one simulated clock."""

from __future__ import annotations

import contextlib
import gc
import queue
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import DRY_RUN, ExplorationStopped, Look, TouchHeld, Wait
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Touch
from deformscope.experiments.measured import UPRIGHT, FrameData, Looked, SetupGeometry, Touched
from deformscope.rig.source import RigSource
from deformscope.robot.advice import where_it_stands
from deformscope.robot.by_hand import touch_by_hand
from deformscope.robot.checks import Preflight
from deformscope.robot.finger import WAITS, press_by_finger
from deformscope.robot.latch import Action
from deformscope.robot.preflight import check
from deformscope.robot.readings import ArmSample
from deformscope.robot.robot import Robot, RobotStopped, Watch
from deformscope.robot.setup import Setup
from deformscope.robot.supervisor import Fault
from deformscope.robot.touch import Phase, TouchEnding, TouchPlan, TouchRecord, run_touch
from deformscope.session import Inline, Moment, Step
from deformscope.stages.map.exploration import ExplorationStop, PhaseStart
from deformscope.stages.map.measured import LookFrames, TouchFrames
from deformscope.stages.regions.touches import MapGrid
from deformscope_drivers.depth_camera.image import DepthImage, Intrinsics
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.manual_arm.config import MANUAL
from deformscope_drivers.priority import STEERING, be_prompt
from deformscope_drivers.subscription import Subscription

DENT_PICTURES = 10
"""Largest number of last pictures of a dent that are combined."""
PREFLIGHT_CELL_M = 0.02
"""The outermost places that can be reached are sought on a grid of this."""
LOOKS = 3
"""Number of pictures of the surface that are combined before any touch."""
OFF_MIDDLE = 0.15
"""Largest distance of the principal point from the image's middle, as a share of width and height. Centres of real
lenses are closer to the middle, those of another resolution are farther."""
LOOK_PERIODS = 1000
"""Number of control periods in which these pictures must come; otherwise the camera counts as silent."""
KEEP_EVERY = 50
"""Control periods of a simulated clock between two portions of the recording: each costs bytes and seconds."""
IDLE_S = 0.02
"""Period at which a robot without permission checks for a command."""
SWITCH_S = 5e-4
"""Time after which a thread that waits for Python's lock gets it. With Python's default of 5 ms, a control period is
late if other threads write and draw, as it waits for the interpreter several times."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckFirst:
    """A command: run all checks before anything moves; its answer is a `Preflight`.

    calibrated: the required calibrations, by name, and whether they are done; places_m: (n, 2) places that will be
    touched, None = any that can be reached; ask_finger: requests that a person presses the tip, if nothing else guards
    the arm; None = not needed"""

    calibrated: Mapping[str, bool] = field(default_factory=dict)
    places_m: FloatArray | None = None
    ask_finger: Callable[[str], None] | None = None


@contextlib.contextmanager
def touching_robot(
    setup: Setup, source: RigSource, options: ExploreOptions, on_cycle: Callable[[], None] = lambda: None
) -> Iterator[TouchingRobot]:
    """The robot over the devices of an open source. With devices on their own clock its control loop runs in a thread
    until the end of the context. on_cycle: called in every control period"""
    robot = TouchingRobot(lambda watch: setup.robot(source, watch), setup, options, on_cycle)
    if not setup.runs_itself:
        yield robot
        return
    with without_long_pauses(), robot.in_a_thread():
        yield robot


@contextlib.contextmanager
def without_long_pauses() -> Iterator[None]:
    """Exempt loaded objects from Python's garbage collection, which would stop all threads for 0.1 s and more, in the
    middle of a motion; and switch threads more often."""
    gc.collect()
    gc.freeze()
    as_before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(as_before_s)
        gc.unfreeze()


class TouchingRobot:
    """Opened devices that look and touch (`deformscope.robot`); a `SessionRobot`.

    on_phase: called with each phase of a touch as it begins, and the touch's number from 1
    reason_to_stand: called in each control period of a motion: a reason to stop and end it, empty = none
    stopped: fails with the reason when the robot stops without a command
    largest_force_n: magnitude that the sensor measured in any touch so far, its tare taken off [N]"""

    def __init__(
        self,
        make: Callable[[Watch], Robot],
        setup: Setup,
        options: ExploreOptions,
        on_cycle: Callable[[], None] = lambda: None,
    ) -> None:
        """make: the robot, with the first command: its devices are recorded meanwhile"""
        self.on_phase: Callable[[Phase, int], None] = lambda phase, touch: None
        self.reason_to_stand: Callable[[], str] = lambda: ""
        self.stopped: Future[None] = Future()
        self.largest_force_n = 0.0
        self.geometry = SetupGeometry.of(setup)
        self._make, self._on_cycle = make, on_cycle
        self._made: Robot | None = None
        self._setup = setup
        self._options = options
        self._pictures: Subscription[DepthImage] | None = None
        self._dwelling = contextlib.ExitStack()
        self._touches = self._begun = 0
        self._phase: Phase | None = None
        self._waits = ""
        self._pressed_m: FloatArray | None = None
        self._reports: list[Step] = []
        self._keep: Callable[[], object] | None = None
        self._periods = 0
        self._commands: queue.SimpleQueue[tuple[object, Future[Any]]] | None = None

    @property
    def _robot(self) -> Robot:
        if self._made is None:
            self._made = self._make(lambda seen, verdict: self._cycled())
            self._made.reason_to_stand = lambda: self.reason_to_stand()
        return self._made

    @property
    def _may_move(self) -> bool:
        return self._made is not None and self._made.may_move

    # Commands ---------------------------------------------------------------------------------------------------------

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        """Begin with a `CheckFirst`, `Look`, `Touch` or `Wait`: in the robot's thread if it has one, else immediately.

        Its answer is a `Preflight`, `Looked`, `Touched` or None; the reason for a stop is an ExplorationStopped."""
        if self._commands is None:
            self._keep = keep
            return Inline().submit(lambda: self._do(command)())
        future: Future[Any] = Future()
        self._commands.put((command, future))
        return future

    def _do(self, command: object) -> Callable[[], Any]:
        """Carry it out; the returned function puts the answer together, and may take longer than a control period."""
        answer: Looked | Preflight | None = None
        match command:
            case Touch(plan=TouchPlan() as plan):
                return self.touch(plan, command.xy_m)
            case Look():
                answer = self.look()
            case CheckFirst():
                answer = self.preflight(command)
            case Wait():
                self._robot.stand_by(command.seconds)
            case _:
                raise TypeError(f"no command of this robot: {command!r}")
        return lambda: answer

    def reports(self) -> list[Step]:
        """The phases that began since the last call."""
        taken, self._reports = self._reports, []
        return taken

    def _cycled(self) -> None:
        """In each control period."""
        self._on_cycle()
        self._periods += 1
        if self._keep is not None and self._periods % KEEP_EVERY == 0:
            self._keep()

    @contextlib.contextmanager
    def in_a_thread(self) -> Iterator[None]:
        """Carry commands out in a thread whose control loop continues between commands, once the robot may move. The
        supervisor checks every period, also during computations and recording."""
        commands: queue.SimpleQueue[tuple[object, Future[Any]]] = queue.SimpleQueue()
        self._commands = commands
        over = threading.Event()

        def work() -> None:
            failed = prompt = False
            while not over.is_set():
                holding = self._may_move and not failed
                asked: tuple[object, Future[Any]] | None = None
                with contextlib.suppress(queue.Empty):
                    asked = commands.get(block=not holding, timeout=IDLE_S)
                if self._may_move and not prompt:  # not before: what can be reached takes seconds to find
                    prompt = True
                    be_prompt(STEERING)
                if asked is None:
                    failed = failed or (holding and not self._held())
                    continue
                command, future = asked
                try:
                    answers.submit(_give, future, self._do(command))
                except TouchHeld as error:
                    future.set_exception(error)
                except BaseException as error:
                    failed = True
                    future.set_exception(error)

        thread = threading.Thread(target=work, name="robot", daemon=True)
        with ThreadPoolExecutor(1, "answers") as answers:
            thread.start()
            try:
                yield
            finally:
                over.set()
                thread.join()

    def _held(self) -> bool:
        """Rest for a control period; returns whether that succeeded."""
        try:
            with self._stopping():
                self._robot.cycle()
        except Exception as error:
            self.stopped.set_exception(error)
            return False
        return True

    # Before it moves --------------------------------------------------------------------------------------------------

    def preflight(self, asked: CheckFirst) -> Preflight:
        """See `CheckFirst`. Raises InputError if no place can be reached."""
        self._robot.rest()  # finding what can be reached takes longer than queues hold
        corners = self._corners() if asked.places_m is None else list(asked.places_m)
        height_m = self._options.thickness_m
        plans = [self.geometry.plan(corner, height_m, UPRIGHT, None, self._options) for corner in corners]
        self._robot.start()
        with self._stopping():
            found = check(
                self._robot,
                plans,
                calibrated=asked.calibrated,
                ages=self._setup.ages,
                lift_m=self._options.lift_m,
                described=self._setup.described,
            )
            if asked.ask_finger is not None and found.passed and self._robot.force_alone:
                self._waits = WAITS
                set_n = max(max(plan.set_force_n, plan.more_force_n or 0.0) for plan in plans)
                felt = press_by_finger(self._robot, self._setup.press, asked.ask_finger, set_n=set_n)
                found = Preflight((*found.checks, felt))
                self._waits = ""
        self._robot.rest()
        return found

    def _corners(self) -> list[FloatArray]:
        """The outermost places that can be reached."""
        grid = MapGrid(self._setup.size_m, PREFLIGHT_CELL_M)
        robot = self._robot
        allowed = self.geometry.reachable(grid, self._options, robot.chain, robot.pose.joints_deg)
        places = grid.centres_m[allowed.ravel()]
        if not len(places):
            raise InputError("a surface that the arm reaches", "none of it", "move the arm, or the surface")
        return [places[int(np.argmax(places @ way))] for way in ((1, 1), (1, -1), (-1, 1), (-1, -1))]

    @property
    def format_forces(self) -> str:
        """Force of a touch, as text."""
        set_n, more_n = self._options.set_force_n, self.geometry.more_force_n(self._options)
        return f"{set_n:g} N" + ("" if more_n is None else f", {more_n:g} N if the dent is below 2 mm")

    def let_move(self, preflight: Preflight) -> None:
        """From now on the robot may move. Raises InputError if a check has failed, and names it."""
        self._robot.start()
        self._robot.let_move(preflight)

    # Looking and touching ---------------------------------------------------------------------------------------------

    def look(self) -> Looked:
        """The newest images of the surface, and the robot's pose."""
        self._robot.start()
        with self._pictures_kept():
            pictures = self._take_pictures(LOOKS)
        pose, camera = self._robot.pose, self._setup.camera
        focal_px, center_px = camera.focal_px, camera.center_px
        if focal_px is None or center_px is None:
            focal_px, center_px = reported_lens(pictures[-1].intrinsics)
        check_center(center_px, pictures[-1].depth.shape)
        arm, _, name = self._setup.names
        chain = self._robot.chain
        model = MANUAL if chain is None else chain.name
        used = LookFrames(name, _times_ns(pictures), arm, pose.time_ns, model, focal_px, center_px)
        return Looked(used, FrameData(_depths_m(pictures), {pose.time_ns: pose}, {}))

    def touch(self, plan: TouchPlan, xy_m: FloatArray) -> Callable[[], Touched]:
        """Go to a place (2,) [m], touch along the normal, store the pictures of the dent, and come back; returns a
        function that assembles the measurement.

        Raises ExplorationStopped, and TouchHeld for a touch that was stopped: the arm is then at rest."""
        robot = self._robot
        robot.start()
        dents: list[tuple[DepthImage, ArmSample]] = []

        def still() -> bool:
            dents.extend((picture, robot.pose) for picture in self._new_pictures())
            return True

        with self._stopping(), contextlib.ExitStack() as self._dwelling:
            person = self._setup.person
            record = (
                run_touch(robot, plan, still, self._begin)
                if person is None
                else touch_by_hand(robot, plan, person, still, self._begin)
            )
        self._phase = None
        self.largest_force_n = max(self.largest_force_n, record.peak_force_n)
        verdict = robot.supervisor.verdict
        if verdict.action is not Action.GO_ON:
            raise self._stop(verdict.fault, verdict.reason, verdict.action, verdict.time_ns)
        if record.ending is TouchEnding.HELD:
            self._pressed_m, self._begun = None, self._begun - 1
            raise TouchHeld(record.reason)
        if self._options.lift_m > 0.0:
            raise self._dry_run(record, xy_m)
        if record.contact_m is None or record.ending in (TouchEnding.NOT_REACHED, TouchEnding.NO_CONTACT):
            where = f"at ({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm"
            raise self._stop(record.ending, f"{where}: {record.reason}" if record.reason else where)
        self._touches += 1
        return partial(self._touched, record, dents, xy_m, robot.pose)

    def _dry_run(self, record: TouchRecord, xy_m: FloatArray) -> ExplorationStopped:
        """No contact, as expected; else the contact."""
        where = f"{100 * self._options.lift_m:g} cm above ({100 * xy_m[0]:.0f}, {100 * xy_m[1]:.0f}) cm"
        if record.ending is not TouchEnding.NO_CONTACT:
            return self._stop(record.ending, f"{where}: {record.reason or 'something was met'}")
        lowest_m = float(record.position_m[:, 2].min()) - self.geometry.placement.center_offset_m
        over_cm = 100.0 * (lowest_m - float(record.plan.point_m[2]) + self._options.lift_m)
        reason = f"the first touch, {where}, made no contact; the tip stayed {over_cm:.1f} cm above the surface"
        return ExplorationStopped(ExplorationStop(DRY_RUN, reason, "", str(Action.GO_ON), 0), self._setup.clock())

    def _touched(
        self, record: TouchRecord, dents: list[tuple[DepthImage, ArmSample]], xy_m: FloatArray, end: ArmSample
    ) -> Touched:
        dwells = [span for span in record.phases if span.phase in (Phase.DWELL, Phase.DWELL_MORE)]
        seen = [
            (picture, pose)
            for picture, pose in dents
            if any(span.start_s <= picture.stamp.host_ns / 1e9 <= span.end_s for span in dwells[-1:])
        ][-DENT_PICTURES:]
        loading = max(record.loading, 10)
        arms = record.arms[:loading]
        held = (*record.arms[loading:], *record.back) if self._options.hold_s > 0.0 else ()
        pictures = [picture for picture, _ in seen]
        arm, wrench, camera = self._setup.names
        used = TouchFrames(
            xy_m=xy_m,
            normal=record.plan.normal,
            reached=record.ending is TouchEnding.SET_FORCE,
            arm=arm,
            arm_ns=np.array([sample.time_ns for sample in arms], np.int64),
            wrench=wrench,
            wrench_ns=np.array([sample.time_ns for sample, _ in record.forces], np.int64),
            wrench_ticks=np.array([sample.ticks for sample, _ in record.forces], np.int64),
            pose_ns=np.array([pose_ns for _, pose_ns in record.forces], np.int64),
            tare_n=record.tare_n,
            camera=camera,
            depth_ns=_times_ns(pictures),
            depth_arm_ns=np.array([pose.time_ns for _, pose in seen], np.int64),
            seen_ns=max((round(span.end_s * 1e9) for span in dwells), default=0),
            end_ns=end.time_ns,
            held_ns=np.array([sample.time_ns for sample in held], np.int64) if held else None,
        )
        poses = {sample.time_ns: sample for sample in (*arms, *held, *record.poses, *(pose for _, pose in seen), end)}
        forces = {(sample.time_ns, sample.ticks): sample.sensor_n for sample, _ in record.forces}
        return Touched(used, FrameData(_depths_m(pictures), poses, forces))

    @property
    def doing(self) -> str:
        """Text of the present action, or of the condition for continuing; empty between touches."""
        if self._phase is None:
            return self._waits
        words = f"touch {self._touches + 1}: {self._phase}"
        if self._pressed_m is not None:
            depth_m = float(self._pressed_m[2] - self._robot.center_m[2])
            forces = self._robot.seen.forces
            force_n = float(np.linalg.norm(forces[-1].force_n)) if forces else np.nan
            words += f" {force_n:.1f} N {1e3 * depth_m:.1f} mm"
        return words

    @property
    def gaps_s(self) -> FloatArray:
        """(n,) times from each check of the supervisor to the next, since the robot may move [s]."""
        return np.zeros(0) if self._made is None else self._made.gaps_s

    def ask_to_stop(self, reason: str) -> None:
        """Stop on a person's request: the arm is at rest within a control period, and the exploration ends."""
        if self._made is not None:
            self._made.ask_to_stop(reason)

    def halt(self, reason: str) -> bool:
        """Erase points that wait in the arm, which accepts no further command; returns whether the arm received this,
        or was never commanded."""
        return self._made is None or self._made.halt(reason)

    def _begin(self, phase: Phase, time_ns: int) -> None:
        self._phase = phase
        self._begun += phase is Phase.TRAVEL
        if phase is Phase.DWELL:
            self._dwelling.enter_context(self._pictures_kept())
        if phase is Phase.PRESS:
            self._pressed_m = self._robot.center_m
        elif phase in (Phase.RETREAT, Phase.BACK_OFF):
            self._pressed_m = None
        self._reports.append(Step((PhaseStart(str(phase), self._begun - 1),), moment=Moment(time_ns, self._begun)))
        self.on_phase(phase, self._begun)

    @contextlib.contextmanager
    def _stopping(self) -> Iterator[None]:
        """That the supervisor has stopped the robot ends the exploration."""
        try:
            yield
        except RobotStopped as error:
            verdict = error.verdict
            raise self._stop(verdict.fault, verdict.reason, verdict.action, verdict.time_ns) from error

    def _stop(
        self, cause: Fault | TouchEnding, reason: str, action: Action = Action.STOP, time_ns: int | None = None
    ) -> ExplorationStopped:
        """The arm is at rest."""
        self._robot.halt(f"{cause}: {reason}")
        self._phase = self._pressed_m = None
        time_ns = self._setup.clock() if time_ns is None else time_ns
        stop = ExplorationStop(str(cause), reason, where_it_stands(cause, self._robot), str(action), self._touches)
        return ExplorationStopped(stop, time_ns)

    def _new_pictures(self) -> list[DepthImage]:
        with contextlib.suppress(DeviceError):  # what becomes of a lost camera, the supervisor decides
            return [] if self._pictures is None else self._pictures.take()
        return []

    @contextlib.contextmanager
    def _pictures_kept(self) -> Iterator[None]:
        """From now on new pictures wait in the queue; at other times no caller takes them, and they would count as
        lost."""
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
            with self._stopping():
                self._robot.cycle()
            taken += self._new_pictures()
            if len(taken) >= count:
                return taken[-count:]
        raise self._stop(Fault.CAMERA_SILENT, f"{len(taken)} depth images in {LOOK_PERIODS / 100:g} s")


def check_center(center_px: tuple[float, ...], shape: tuple[int, ...]) -> None:
    """Raises InputError for a principal point (x, y) [px] that is not near the middle of images (rows, columns). A
    wrong centre belongs to another resolution, and would displace all measured points."""
    rows, columns = shape[:2]
    off = np.abs(np.asarray(center_px) - (0.5 * columns, 0.5 * rows)) / (columns, rows)
    if (off > OFF_MIDDLE).any():
        came = f"({center_px[0]:g}, {center_px[1]:g}) in images of {columns} x {rows} px"
        try_this = "focal_px and center_px for this resolution, or neither: then the camera's own values are used"
        raise InputError("[camera] center_px near the middle of its images", came, try_this)


def reported_lens(reported: Intrinsics | None) -> tuple[tuple[float, float], tuple[float, float]]:
    """Focal length and centre [px] that pictures report. Raises InputError if the rig file has to state them."""
    if reported is None:
        raise InputError("[camera] focal_px and center_px", "none, and a camera that reports none")
    if any(reported.distortion):
        came = f"none, and a camera whose images have distortion = {list(reported.distortion)}"
        raise InputError("[camera] focal_px, center_px and distortion", came, "deformscope calibrate camera")
    return (reported.fx_px, reported.fy_px), (reported.cx_px, reported.cy_px)


def _times_ns(pictures: list[DepthImage]) -> IntArray:
    return np.array([picture.stamp.host_ns for picture in pictures], np.int64)


def _depths_m(pictures: list[DepthImage]) -> dict[int, Any]:
    return {picture.stamp.host_ns: picture.depth_m() for picture in pictures}


def _give(future: Future[Any], answer: Callable[[], Any]) -> None:
    try:
        future.set_result(answer())
    except BaseException as error:
        future.set_exception(error)
