"""`deformscope arm where`, `home`, `go` and `jog`."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.lab.rig_members import member_of
from deformscope.rig.rig_file import load_rig
from deformscope.robot.advice import where_it_stands
from deformscope.robot.checks import Preflight
from deformscope.robot.finger import press_by_finger
from deformscope.robot.jogging import HELP, LEAVE, Jog
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import check
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.setup import RigParts, Setup, only_device, open_rig
from deformscope.robot.travel import to_above
from deformscope.runs.opened_devices import setup_of, table_of
from deformscope.runs.skeleton import POLL_S, Keys, RunOperator, leave_arm, open_rig_run, signal_word, terminal_keys
from deformscope.session import BATCH_S, Inline
from deformscope.stages.map.exploration import ExplorationStop
from deformscope.terminal import Interruption, say, until_interrupted
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.pacing import STEERING, be_prompt

if TYPE_CHECKING:
    from deformscope.config import HomeConfig, MovingOptions, WhereConfig
    from deformscope.recording.recorder import Recorder

UPRIGHT = np.array([0.0, 0.0, 1.0])
NOT_YET = ("plan", "workspace", "calibration", "age", "camera", "tip: in free air", "arm: reach", "arm: first way")
"""Rows of the table of checks without importance for an arm that a person moves in small steps before any calibration.
Rows of arm, force sensor and this computer remain."""


@dataclass(frozen=True, slots=True, eq=False)
class WhereArm:
    """joints_deg: (n,); to_limits_deg: (n,) distance of each joint from the nearer end of its range, inf = no end;
    homed; T_base_ee: (4, 4) pose of the arm's end; tip_base_m, tip_surface_m: (3,) the tip's lowest point [m], None if
    the rig file does not have the tip or the surface yet"""

    joints_deg: FloatArray
    to_limits_deg: FloatArray
    homed: bool
    T_base_ee: FloatArray
    tip_base_m: FloatArray
    tip_surface_m: FloatArray | None


def where(config: "WhereConfig") -> WhereArm:
    """Pose of a rig's arm."""
    with _arm_of(config.rig, trusted=config.trust_rig) as (arm, placement):
        state = arm.next(5.0)
        T_base_ee = np.asarray(state.T_base_end_effector)
        joints_deg = np.asarray(state.joints_deg)
        known = placement is not None
        used = placement if placement is not None else Placement(np.eye(4), load_rig(config.rig, trusted=True).tool)
        lowest = used.T_surface_center(T_base_ee)[:3, 3] - used.center_offset_m * UPRIGHT
        base = T_base_ee @ used.T_ee_center
        return WhereArm(
            joints_deg,
            arm.chain.to_limits_deg(joints_deg),
            arm.homed,
            T_base_ee,
            base[:3, 3] + used.center_offset_m * base[:3, 2],
            lowest if known else None,
        )


def home(config: "HomeConfig") -> None:
    """Send the arm home; the end of the command stops it. Raises InputError for an arm without a home pose."""
    with until_interrupted() as asked, _arm_of(config.rig, trusted=config.trust_rig) as (arm, _):
        if not arm.goes_home:
            raise InputError("an arm with a home pose of its own", arm.name, "bring it there by hand")
        if not config.yes:
            _ask("The arm will now move to its home pose on its own path: is the way free? Type yes: ", asked)
        say("the arm goes home: Ctrl-C stops it")
        with ThreadPoolExecutor(1, "home") as worker:
            going = worker.submit(arm.home)
            while not wait([going], POLL_S).done:
                if asked.is_set() and not arm.stopped_because:
                    arm.halt(signal_word(asked.signal_number))
        if asked.is_set():
            leave_arm(None, 0, asked, None)
        going.result()


@contextlib.contextmanager
def _arm_of(name: str, *, trusted: bool) -> Iterator[tuple[Any, Placement | None]]:
    """The arm of a rig alone, open, and where the surface is, if that is known. Raises InputError for its errors."""
    rig = load_rig(name, trusted=trusted)
    entry = only_device(rig, "arm", "to move")
    given = rig.surface.T_arm_surface
    placement = None if given is None else Placement(np.array(given, np.float64), rig.tool)
    try:
        if rig.surface.scene:
            parts = RigParts.of(rig)
            table, _ = table_of(parts)
            with open_rig(rig, member_of, table, parts.devices) as source:
                yield source.device(entry.name), placement
        else:
            with member_of(entry) as member, member.device as arm:
                yield arm, placement
    except DeviceError as error:
        raise InputError.about(error, f"device {entry.name}") from error


def go(
    config: "MovingOptions",
    above: tuple[float, float] | None,
    height_m: float,
    recording: "AbstractContextManager[Recorder]",
) -> FloatArray:
    """Bring the tip over a place (x, y) [m] at a height [m]; returns the final place (3,) of its centre, surface frame
    [m]."""

    def work(robot: Robot, setup: Setup) -> None:
        xy_m = np.array(above) if above is not None else 0.5 * np.array(setup.size_m)
        goal_m = np.array([*xy_m, thickness_m + height_m + robot.placement.center_offset_m])
        crossing_m = max(float(goal_m[2]), float(robot.center_m[2]))
        speed_m_s = setup.workspace.travel_speed_m_s
        to_above(robot, goal_m, UPRIGHT, height_m=crossing_m, deepest_m=goal_m, speed_m_s=speed_m_s)

    thickness_m = load_rig(config.rig, trusted=config.trust_rig).surface.top_m
    return _moved(config, recording, work, ("plan", "arm: reach"))


def jog(config: "MovingOptions", recording: "AbstractContextManager[Recorder]", keys: Keys | None = None) -> FloatArray:
    """Move the tip by keys until the person leaves; returns the final place (3,) of its centre, surface frame [m].
    keys: default: the terminal's keys"""

    def work(robot: Robot, setup: Setup) -> None:
        say(HELP)
        jogging = Jog()
        with contextlib.nullcontext(keys) if keys is not None else terminal_keys() as pressed:
            while True:
                for key in pressed():
                    if key == LEAVE:
                        return
                    jogging.press(key, setup.clock())
                robot.cycle(jogging.command(setup.clock()))

    return _moved(config, recording, work, NOT_YET)


@dataclass(frozen=True, slots=True)
class _Moved:
    """A robot with the attributes that a `Watch` needs."""

    robot: Robot

    @property
    def doing(self) -> str:
        x, y, z = 1e3 * self.robot.center_m
        return f"tip at {x:.0f}, {y:.0f}, {z:.0f} mm"

    def ask_to_stop(self, reason: str) -> None:
        self.robot.ask_to_stop(reason)

    def halt(self, reason: str) -> bool:
        return self.robot.halt(reason)


def _moved(
    config: "MovingOptions",
    recording: "AbstractContextManager[Recorder]",
    work: Callable[[Robot, Setup], None],
    leave_out: tuple[str, ...],
) -> FloatArray:
    """Open the devices, run the checks, ask, and carry out the motion of a robot, which is halted in the end.

    For devices with threads, the robot has one too: their items are recorded in this one."""
    setup = setup_of(config.rig, ExploreOptions(), None, trusted=config.trust_rig).setup
    with until_interrupted() as asked, recording as recorder, open_rig_run(setup.open_source(), recorder) as opened:
        watch = opened.watch(asked)
        robot = setup.robot(opened.source, lambda seen, verdict: watch())
        with watch.halts(_Moved(robot)), ThreadPoolExecutor(1, "robot") as worker:
            pool = worker if setup.runs_itself else Inline()
            moving = pool.submit(_carried_out, config, setup, robot, work, leave_out, asked)
            while not moving.done():
                recorder.write(opened.source.take(BATCH_S))
            stop = moving.result()
        if stop is not None:
            recorder.stopped_because(f"{stop.kind}: {stop.reason}")
    if stop is not None:
        leave_arm(stop, 0, asked, recorder.summary().path, arm_stopped=watch.arm_stopped)
    return robot.center_m


def _carried_out(
    config: "MovingOptions",
    setup: Setup,
    robot: Robot,
    work: Callable[[Robot, Setup], None],
    leave_out: tuple[str, ...],
    asked: Interruption,
) -> ExplorationStop | None:
    """Why it was stopped; None = it came to its end."""
    try:
        found = check(robot, [], calibrated=setup.calibrated, ages=setup.ages)
        preflight = Preflight(tuple(one for one in found.checks if not one.name.startswith(leave_out)))
        if preflight.passed and robot.force_alone and "calibration" not in leave_out:
            preflight = Preflight((*preflight.checks, press_by_finger(robot, setup.press, say)))
        say(preflight.table())
        if preflight.passed and not setup.simulated and not config.yes:
            robot.rest()
            _ask("The arm will now move: keep the emergency stop in your hand. Type yes: ", asked)
        robot.start()
        robot.let_move(preflight)
        if setup.runs_itself:  # in a thread of its own
            be_prompt(STEERING)
        work(robot, setup)
    except RobotStopped as error:
        verdict = error.verdict
        what_to_do = where_it_stands(verdict.fault, robot)
        return ExplorationStop(str(verdict.fault), verdict.reason, what_to_do, str(verdict.action), 0)
    return None


def _ask(prompt: str, asked: Interruption) -> None:
    for _ in RunOperator(asked).confirm(prompt):
        pass  # no experiment takes frames meanwhile
