"""Opened devices that look and touch: on hardware, on doubles, and in the laboratory on one simulated clock."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.commanded_robot import CommandedRobot, without_long_pauses
from deformscope.experiments.explore.depth_pictures import LOOKS, DepthPictures, dent_pictures, depths_m, lens, times_ns
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
from deformscope.session import Moment, Step
from deformscope.stages.map.exploration import ExplorationStop, PhaseStart
from deformscope.stages.map.measured import LookFrames, TouchFrames
from deformscope.stages.regions.touches import MapGrid
from deformscope_drivers.images import DepthImage
from deformscope_drivers.manual_arm.device import MANUAL

PREFLIGHT_CELL_M = 0.02
"""The outermost places that can be reached are sought on a grid of this."""
LOOK_PERIODS = 1000
"""Number of control periods in which these pictures must come; otherwise the camera counts as silent."""
KEEP_EVERY = 50
"""Control periods of a simulated clock between two portions of the recording: each costs bytes and seconds."""


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
) -> "Iterator[TouchingRobot]":
    """The robot over the devices of an open source. With devices on their own clock its control loop runs in a thread
    until the end of the context. on_cycle: called in every control period"""
    robot = TouchingRobot(lambda watch: setup.robot(source, watch), setup, options, on_cycle)
    if not setup.runs_itself:
        yield robot
        return
    with without_long_pauses(), robot.in_a_thread():
        yield robot


class TouchingRobot(CommandedRobot):
    """Opened devices that look and touch (`deformscope.robot`), in the order of its commands: a `CheckFirst`, `Look`,
    `Touch` or `Wait`, answered by a `Preflight`, `Looked`, `Touched` or None. A stop raises ExplorationStopped.

    on_phase: called with each phase of a touch as it begins, and the touch's number from 1
    reason_to_stand: called in each control period of a motion: a reason to stop and end it, empty = none
    largest_force_n: magnitude that the sensor measured in any touch so far, its tare taken off [N]"""

    def __init__(
        self,
        make: Callable[[Watch], Robot],
        setup: Setup,
        options: ExploreOptions,
        on_cycle: Callable[[], None] = lambda: None,
    ) -> None:
        """make: the robot, with the first command: its devices are recorded meanwhile"""
        super().__init__("robot", KEEP_EVERY)
        self.on_phase: Callable[[Phase, int], None] = lambda phase, touch: None
        self.reason_to_stand: Callable[[], str] = lambda: ""
        self.largest_force_n = 0.0
        self.geometry = SetupGeometry.of(setup)
        self._make, self._on_cycle = make, on_cycle
        self._made: Robot | None = None
        self._setup = setup
        self._options = options
        self._pictures = DepthPictures()
        self._failed = False
        self._dwelling = contextlib.ExitStack()
        self._touches = self._begun = 0
        self._phase: Phase | None = None
        self._waits = ""
        self._pressed_m: FloatArray | None = None

    @property
    def _robot(self) -> Robot:
        if self._made is None:
            self._made = self._make(lambda seen, verdict: self.cycled())
            self._made.reason_to_stand = lambda: self.reason_to_stand()
        return self._made

    @property
    def may_move(self) -> bool:
        """Whether the arm may move. Not before: what can be reached takes seconds to find."""
        return self._made is not None and self._made.may_move

    # Commands ---------------------------------------------------------------------------------------------------------

    def perform(self, command: object) -> Callable[[], Any]:
        """Carry a command out; after a stop the robot does not rest in control periods any more."""
        try:
            return self._do(command)
        except TouchHeld:
            raise
        except BaseException:
            self._failed = True
            raise

    def _do(self, command: object) -> Callable[[], Any]:
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

    def cycled(self) -> None:
        """In each control period."""
        self._on_cycle()
        super().cycled()

    def rest(self) -> bool:
        """Rest for a control period, once the robot may move: the supervisor checks every period, also during
        computations and recording. Returns whether it did."""
        if not self.may_move or self._failed:
            return False
        try:
            with self._stopping():
                self._robot.cycle()
        except Exception as error:
            self._failed = True
            self.stopped.set_exception(error)
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
                pressed = press_by_finger(self._robot, self._setup.press, asked.ask_finger, set_n=set_n)
                found = Preflight((*found.checks, pressed))
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
        pictures: list[DepthImage] = []
        with self._pictures.gathered(self._robot.camera):
            for _ in range(LOOK_PERIODS):
                with self._stopping():
                    self._robot.cycle()
                pictures += self._pictures.new()
                if len(pictures) >= LOOKS:
                    break
            else:
                raise self._stop(Fault.CAMERA_SILENT, f"{len(pictures)} depth images in {LOOK_PERIODS / 100:g} s")
        pictures, pose = pictures[-LOOKS:], self._robot.pose
        focal_px, center_px = lens(self._setup.camera, pictures[-1])
        arm, _, name = self._setup.names
        chain = self._robot.chain
        model = MANUAL if chain is None else chain.name
        used = LookFrames(name, times_ns(pictures), arm, pose.time_ns, model, focal_px, center_px)
        return Looked(used, FrameData(depths_m(pictures), {pose.time_ns: pose}, {}))

    def touch(self, plan: TouchPlan, xy_m: FloatArray) -> Callable[[], Touched]:
        """Go to a place (2,) [m], touch along the normal, store the pictures of the dent, and come back; returns a
        function that assembles the measurement.

        Raises ExplorationStopped, and TouchHeld for a touch that was stopped: the arm is then at rest."""
        robot = self._robot
        robot.start()
        dents: list[tuple[DepthImage, ArmSample]] = []

        def still() -> bool:
            dents.extend((picture, robot.pose) for picture in self._pictures.new())
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
            if not (self._options.go_on and record.ending is TouchEnding.NO_CONTACT):
                raise self._dry_run(record, xy_m)
        elif record.contact_m is None or record.ending in (TouchEnding.NOT_REACHED, TouchEnding.NO_CONTACT):
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
        seen = dent_pictures(dents, dwells)
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
            depth_ns=times_ns(pictures),
            depth_arm_ns=np.array([pose.time_ns for _, pose in seen], np.int64),
            seen_ns=max((round(span.end_s * 1e9) for span in dwells), default=0),
            end_ns=end.time_ns,
            held_ns=np.array([sample.time_ns for sample in held], np.int64) if held else None,
        )
        poses = {sample.time_ns: sample for sample in (*arms, *held, *record.poses, *(pose for _, pose in seen), end)}
        forces = {(sample.time_ns, sample.ticks): sample.sensor_n for sample, _ in record.forces}
        return Touched(used, FrameData(depths_m(pictures), poses, forces))

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
            self._dwelling.enter_context(self._pictures.gathered(self._robot.camera))
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
