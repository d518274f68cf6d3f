"""The control period: a person's wish to stop, a watcher that fails, and a look at what comes after a stop."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.robot.advice import advice
from deformscope.robot.latch import Action
from deformscope.robot.preflight import check
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import Robot, RobotStopped, TipVelocity
from deformscope.robot.supervisor import Fault, Limits, SafetyDecision
from deformscope.robot.travel import step
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.kinematics import FloatArray
from studies.fault_study import FaultScene, make_scene

UP = TipVelocity(np.array([0.0, 0.0, 0.02]))


def moving() -> FaultScene:
    """An arm on its way."""
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    for _ in range(20):
        scene.robot.cycle(UP)
    return scene


def upwards(scene: FaultScene, count: int) -> None:
    for _ in range(count):
        scene.robot.cycle(UP)


def cycles(scene: FaultScene, count: int) -> None:
    for _ in range(count):
        scene.robot.cycle()


def way_m(scene: FaultScene, seconds: float) -> float:
    """How far the arm still goes."""
    before = scene.lab.contact.center_m
    scene.lab.wait_until(scene.lab.clock() + round(seconds * 1e9))
    return float(np.linalg.norm(scene.lab.contact.center_m - before))


def test_who_asks_to_stop_is_heard_in_the_same_period() -> None:
    scene = moving()

    def ask(seen: RobotObservation, verdict: SafetyDecision) -> None:
        scene.robot.ask_to_stop("Ctrl-C")

    scene.robot.watch = ask
    with pytest.raises(RobotStopped, match="a person asked: Ctrl-C"):
        scene.robot.cycle(UP)
    assert scene.robot.supervisor.verdict.fault is Fault.ASKED
    assert scene.lab.arm_double.fifo_count == 0
    assert way_m(scene, 0.02) < 5e-4
    assert way_m(scene, 0.5) == 0.0
    scene.lab.close()


def test_what_takes_long_is_interrupted_by_a_period_as_soon_as_one_is_due() -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    looks: list[int] = []
    scene.robot.watch = lambda seen, verdict: looks.append(seen.now_ns)
    scene.robot.cycle()
    scene.robot.keep_up()  # no time has passed
    assert len(looks) == 1
    for _ in range(25):  # 0.1 s, in pieces of 4 ms
        scene.lab.wait_until(scene.lab.clock() + 4_000_000)
        scene.robot.keep_up()
    scene.lab.close()
    assert max(np.diff(looks)) <= 20_000_000


def test_a_fault_is_not_covered_by_a_wish_to_stop() -> None:
    scene = moving()
    scene.lab.sensor_double.silent = True
    with pytest.raises(RobotStopped):
        cycles(scene, 10)
    scene.robot.ask_to_stop("Ctrl-C")
    assert scene.robot.supervisor.verdict.fault is Fault.FORCE_SILENT
    scene.lab.close()


def test_the_arm_is_halted_before_a_failing_watcher_is_heard() -> None:
    scene = moving()

    def fail(seen: RobotObservation, verdict: SafetyDecision) -> None:
        raise OSError("the disk is full")

    scene.robot.watch = fail
    with pytest.raises(OSError, match="disk"):
        scene.robot.cycle(UP)
    assert "OSError" in scene.lab.arm.stopped_because
    assert scene.lab.arm_double.fifo_count == 0
    assert way_m(scene, 0.5) < 5e-4
    scene.lab.close()


def test_what_comes_after_a_stop_is_seen_and_moves_nothing() -> None:
    scene = moving()
    scene.robot.ask_to_stop("enough")
    with pytest.raises(RobotStopped):
        scene.robot.cycle(UP)
    seen: list[tuple[RobotObservation, SafetyDecision]] = []
    scene.robot.watch = lambda observation, verdict: seen.append((observation, verdict))
    began_ns = scene.lab.clock()
    scene.robot.stand_by(0.5)
    assert scene.lab.clock() - began_ns == 500_000_000
    assert len(seen) == 50
    assert sum(len(one.forces) for one, _ in seen) > 400
    assert {verdict.action for _, verdict in seen} == {Action.STOP}
    with pytest.raises(RobotStopped):
        scene.robot.cycle(UP)
    scene.lab.close()


def test_halting_says_whether_the_arm_was_reached() -> None:
    scene = moving()
    assert scene.robot.halt("enough")
    scene.lab.arm_double.unplug()
    assert not scene.robot.halt("enough")
    scene.lab.arm_double.plug()
    scene.lab.close()


def test_an_arm_that_its_driver_has_stopped_stops_the_robot() -> None:
    """As after a cycle that came too late: no command goes through any more, and nobody tries for ever."""
    scene = moving()
    scene.lab.arm.halt("the cycle was 244 ms late")
    with pytest.raises(RobotStopped, match=r"takes no commands.*244 ms late"):
        scene.robot.cycle(UP)
    assert scene.robot.supervisor.verdict.fault is Fault.REFUSED
    assert scene.lab.arm_double.fifo_count == 0
    scene.lab.close()


def test_an_arm_that_follows_100_ms_late_has_its_own_key() -> None:
    """Without it that is an arm that does not follow, and the advice begins with homing it."""
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    scene.lab.arm_double.late(0.1)
    with pytest.raises(RobotStopped, match="arm frozen") as caught:
        upwards(scene, 30)
    assert advice(caught.value.verdict.fault).startswith("whether the arm was homed")
    scene.lab.wait_until(scene.lab.clock() + 300_000_000)  # until it stands
    scene.robot.resume()
    limits = scene.robot.supervisor.limits
    scene.robot.supervisor.limits = dataclasses.replace(
        limits, arm_frozen_s=Limits.of(Workspace(arm_frozen_s=0.2)).arm_frozen_s
    )
    assert limits.arm_silent_s == scene.robot.supervisor.limits.arm_silent_s
    scene.robot.let_move(check(scene.robot, [scene.plan], calibrated={}))
    before_m = scene.robot.center_m
    upwards(scene, 50)
    cycles(scene, 20)
    assert scene.robot.center_m[2] - before_m[2] == pytest.approx(0.01, abs=5e-4)
    scene.lab.close()


def test_nothing_counts_as_lost_while_nobody_has_to_look() -> None:
    """While something is computed, or a person asked: longer than any queue holds."""
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    cycles(scene, 5)
    scene.robot.rest()
    scene.lab.wait_until(scene.lab.clock() + 9_000_000_000)
    scene.robot.start()
    cycles(scene, 20)
    scene.robot.cycle(UP)
    assert scene.lab.force.health().dropped == 0
    assert len(scene.robot.seen.forces) > 0
    scene.lab.close()


def test_a_way_that_was_checked_is_not_begun_after_a_push() -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    cycles(scene, 5)
    scene.lab.contact.hit([0.0, 0.0, 9.0], 1.0)
    for _ in range(5):
        scene.lab.wait_until(scene.lab.clock() + 10_000_000)
        scene.robot.keep_up()
    assert scene.robot.supervisor.verdict.action is Action.BACK_OFF
    del scene.robot.commanded[:]
    with pytest.raises(InputError, match="nothing in the way"):
        step(scene.robot, UP)
    assert not any(scene.robot.commanded)
    scene.lab.close()


class Nothing:
    """A world without anything."""

    def press(self, center_m: FloatArray) -> FloatArray:
        return np.zeros(3)


@pytest.mark.parametrize("known", [True, False])
def test_the_weight_of_the_tool_is_taken_out_as_the_arm_turns(known: bool) -> None:
    weight_n = np.array([0.0, 0.0, -2.0])
    labs: list[TouchLab] = []

    def sensed(load_n: FloatArray, time_s: float) -> FloatArray:
        lab = labs[0]
        return load_n - weight_n @ (lab.body.T_base_end_effector @ lab.placement.T_ee_center)[:3, :3]

    tool = Tool(weight_n=tuple(weight_n.tolist()) if known else None)
    labs.append(TouchLab(Nothing(), tool=tool, sensed=sensed))
    lab = labs[0]
    with lab:
        limits = Limits(low_m=(-2.0,) * 3, high_m=(2.0,) * 3)
        robot = Robot(lab.arm, lab.force, lab.placement, limits, clock=lab.clock, wait_until=lab.wait_until)
        robot.stand_by(0.1)
        lab.arm.set_velocity(JointVelocity((0.0, 0.0, 0.0, 0.0, 15.0, 0.0)), 2.0)
        robot.stand_by(2.5)
        force_n = np.mean([one.force_n for one in robot.seen.forces], axis=0)
    assert (np.linalg.norm(force_n) < 0.05) == known, force_n
