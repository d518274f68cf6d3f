"""Collisions in joint torques: seen beside noise and gravity's remainder, explained by what presses the tip."""

import numpy as np
import pytest

from deformscope.robot.advice import advice
from deformscope.robot.clearance import CollisionWatch, CurrentWatch
from deformscope.robot.preflight import check
from deformscope.robot.readings import ArmSample, ForceSample, RobotObservation
from deformscope.robot.robot import RobotStopped
from deformscope.robot.supervisor import Fault, Limits, Supervisor
from deformscope_drivers.arm.kinematics import FloatArray, jacobian_of
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.kuka.config import KR6R900
from deformscope_drivers.kuka.double import COULOMB_NM, UNIT_NM, motor_currents
from tests.cases import slow
from tests.robot.quick_touch import quick_scene

JOINTS_DEG = tuple(J2N6S300.home_deg)
LIMIT_NM = 4.0
PERIOD_NS = 10_000_000
STILL_NM = (0.0,) * 6
TIP = np.eye(4)
TIP[2, 3] = 0.1


def seen(torques_nm: FloatArray, tip_n: float = 0.0, noise_nm: float = 0.1) -> list[int]:
    """Which of torques (k, n), 10 ms apart, are called a collision."""
    random = np.random.default_rng(3)
    watch = CollisionWatch(J2N6S300, TIP)
    noisy = torques_nm + random.normal(0.0, noise_nm, torques_nm.shape)
    told = [watch.look(tuple(one), JOINTS_DEG, tip_n, LIMIT_NM, number * PERIOD_NS) for number, one in enumerate(noisy)]
    return [number for number, reason in enumerate(told) if reason]


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_push_beside_the_tip_is_seen_at_its_second_reading(joint: int, sign: float) -> None:
    torques_nm = np.zeros((60, 6))
    torques_nm[50:, joint] = sign * 6.0
    assert seen(torques_nm)[0] == 51


def test_drift_gravitys_remainder_and_one_outlier_are_no_collision() -> None:
    torques_nm = np.linspace(0.0, 1.0, 600)[:, None] * np.array([6.0, -6.0, 4.0, 3.0, 2.0, 1.0])
    torques_nm[300, 2] += 30.0
    assert seen(torques_nm) == []


def test_what_the_force_at_the_tip_explains_is_no_collision_whatever_its_sign() -> None:
    links = J2N6S300.forward(JOINTS_DEG)
    lever_m = links[-1, :3, :3] @ TIP[:3, 3]
    random = np.random.default_rng(5)
    for _ in range(20):
        force_n = random.normal(size=3)
        force_n *= 12.0 / np.linalg.norm(force_n)
        pressed_nm = jacobian_of(links).T @ np.concatenate([force_n, np.cross(lever_m, force_n)])
        torques_nm = np.zeros((80, 6))
        torques_nm[50:] = float(random.choice([-1.0, 1.0])) * pressed_nm
        assert seen(torques_nm, tip_n=12.0) == []
        if np.abs(pressed_nm).max() > LIMIT_NM + 1.0:
            assert seen(torques_nm, tip_n=0.0)[0] == 51


def test_readings_that_repeat_count_once() -> None:
    watch = CollisionWatch(J2N6S300, TIP)
    still, pushed = (0.1,) * 6, (0.1, 9.0, 0.1, 0.1, 0.1, 0.1)
    for number, torques_nm in enumerate([still, pushed, pushed, pushed]):
        assert watch.look(torques_nm, JOINTS_DEG, 0.0, LIMIT_NM, number * PERIOD_NS) == ""
    found = watch.look((0.1, 9.1, *still[2:]), JOINTS_DEG, 0.0, LIMIT_NM, 9 * PERIOD_NS)
    assert "joint 2 has 9.0 Nm more than before" in found


def test_an_arm_that_is_pushed_from_the_side_stops_and_one_whose_torques_are_noise_does_not_begin() -> None:
    scene = quick_scene(12)
    before = check(scene.robot, [scene.plan], calibrated={})
    double, lab = scene.lab.arm_double, scene.lab
    lab.schedule(lab.clock() + 200_000_000, lambda: double.push_link(2, (25.0, 20.0, 0.0)))
    with pytest.raises(RobotStopped) as stopped:
        check(scene.robot, [scene.plan], calibrated={})
    scene.robot.resume()
    double.push_link(2, None)
    double.blur_torques(0.8, 0.0)
    noisy = check(scene.robot, [scene.plan], calibrated={})
    scene.lab.close()
    assert stopped.value.verdict.fault is Fault.COLLISION
    assert before.passed, before.table()
    assert [one.name for one in noisy.checks if not one.passed] == ["arm: joint torques"]
    assert "collision_nm" in noisy.table()


@pytest.mark.parametrize("joint", [0, 5])
def test_an_arm_whose_torques_are_no_numbers_stops_and_does_not_begin(joint: int) -> None:
    """Collisions would not be seen any more: as any other loss of what safety rests on."""
    scene = quick_scene(12)
    double, lab = scene.lab.arm_double, scene.lab
    broken = np.where(np.arange(6) == joint, np.nan, 0.0)
    lab.schedule(lab.clock() + 200_000_000, lambda: double.bias(broken))
    with pytest.raises(RobotStopped) as stopped:
        check(scene.robot, [scene.plan], calibrated={})
    scene.robot.resume()
    with pytest.raises(RobotStopped):
        check(scene.robot, [scene.plan], calibrated={})
    double.bias(np.zeros(6))
    scene.robot.resume()
    mended = check(scene.robot, [scene.plan], calibrated={})
    scene.lab.close()
    assert stopped.value.verdict.fault is Fault.TORQUES
    assert "nan" in stopped.value.verdict.reason
    assert "collision_nm = 0" in advice(Fault.TORQUES)
    assert mended.passed, mended.table()


def torqued(time_ns: int, torques_nm: tuple[float, ...]) -> RobotObservation:
    arm = ArmSample(time_ns, np.eye(4), JOINTS_DEG, 0, torques_nm)
    return RobotObservation(time_ns, (ForceSample(time_ns, np.zeros(3), time_ns),), (arm,))


@pytest.mark.parametrize(
    ("limit_nm", "first_nm", "then_nm", "fault"),
    [
        (4.0, STILL_NM, (), Fault.TORQUES),  # an arm that reports them no more
        (4.0, STILL_NM, (0.0, np.inf, 0.0, 0.0, 0.0, 0.0), Fault.TORQUES),
        (4.0, (), (), Fault.NONE),  # one that never has
        (0.0, STILL_NM, (), Fault.NONE),  # they are not looked at
    ],
)
def test_torques_that_are_lost_stop_an_arm_that_had_them(
    limit_nm: float, first_nm: tuple[float, ...], then_nm: tuple[float, ...], fault: Fault
) -> None:
    supervisor = Supervisor(Limits(collision_nm=limit_nm), 0, chain=J2N6S300)
    assert supervisor.judge(torqued(PERIOD_NS, first_nm)).fault is Fault.NONE
    assert supervisor.judge(torqued(2 * PERIOD_NS, then_nm)).fault is fault
    supervisor.acknowledge(2 * PERIOD_NS)  # and not once alone
    assert supervisor.judge(torqued(3 * PERIOD_NS, then_nm)).fault is fault


def watched(rates_deg_s: FloatArray, wrenches: FloatArray, tip_n: float, seed: int, unit: float = 1.0) -> list[int]:
    """In which cycles of 12 ms a KUKA that turns at (k, 6), (k, 6) on its flange, is said to have met something."""
    random, watch, found = np.random.default_rng(seed), CurrentWatch(), []
    joints_deg = np.array([10.0, -70.0, 100.0, 5.0, 50.0, 0.0])
    for number, (rates, wrench) in enumerate(zip(rates_deg_s, wrenches, strict=True)):
        joints_deg = joints_deg + 0.012 * rates
        said = np.round(unit * motor_currents(KR6R900, joints_deg, rates, wrench, random), 4)
        arrived_ns = round(1e9 * (0.012 * number + random.uniform(0.0, 2e-3)))
        if watch.look(tuple(said), tuple(np.round(joints_deg, 4)), tip_n, arrived_ns):
            found.append(number)
    return found


RATES_DEG_S = np.array([0.5, 1.0, -0.8, 0.1, -0.3, 0.0])


@pytest.mark.parametrize("unit", [1.0, 0.01, -30.0])  # whatever a controller counts currents in
@pytest.mark.parametrize("speed", [0.0, 0.1, 1.0, 4.0])
def test_a_force_that_grows_shows_in_the_motors_currents_before_the_hard_stop(speed: float, unit: float) -> None:
    cycles = 200
    ramp_n = np.clip(100.0 * 0.012 * (np.arange(cycles) - 120), 0.0, None)  # 100 N/s
    wrenches = np.outer(ramp_n, (0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    first = watched(np.tile(speed * RATES_DEG_S, (cycles, 1)), wrenches, 0.0, 2, unit)[0]
    assert first > 120
    assert ramp_n[first] < 15.0
    assert watched(np.tile(speed * RATES_DEG_S, (cycles, 1)), wrenches, 1.0, 2, unit) == []  # the force sensor feels it


@pytest.mark.parametrize("cycles", [5_000, slow(20_000)])  # one and four minutes
def test_motion_in_free_air_is_no_collision(cycles: int) -> None:
    """Starts, stops, turns and slow drifts: gravity, friction, ripple and noise change the currents all the while."""
    random = np.random.default_rng(8)
    rates_deg_s, rate = np.zeros((cycles, 6)), np.zeros(6)
    wanted = rate
    for number in range(cycles):
        if random.random() < 0.01:
            wanted = random.choice([0.0, 0.05, 0.5, 5.0]) * random.uniform(-1.0, 1.0, 6)
        rate = rate + np.clip(wanted - rate, -2.0, 2.0)
        rates_deg_s[number] = rate
    assert watched(rates_deg_s, np.zeros((cycles, 6)), 0.0, 3) == []
    assert (COULOMB_NM / UNIT_NM).max() > 5.0  # friction alone is more than what a contact makes


def test_an_arm_stops_by_its_motors_currents_and_not_where_collisions_are_not_looked_at() -> None:
    for collision_nm, fault in ((4.0, Fault.COLLISION), (0.0, Fault.NONE)):
        supervisor, random = Supervisor(Limits(collision_nm=collision_nm), 0, chain=KR6R900), np.random.default_rng(1)
        for number in range(1, 160):
            now_ns = number * PERIOD_NS
            currents = tuple(random.normal(0.0, 0.3, 6) + 2.0 * max(0, number - 120))
            arm = ArmSample(now_ns, np.eye(4), (0.0, -90.0, 90.0, 0.0, 45.0, 0.0), currents=currents)
            verdict = supervisor.judge(RobotObservation(now_ns, (ForceSample(now_ns, np.zeros(3), now_ns),), (arm,)))
        assert verdict.fault is fault
        assert not supervisor.sees_torques


def test_motor_currents_that_come_no_more_stop_an_arm() -> None:
    supervisor = Supervisor(Limits(), 0, chain=KR6R900)
    for number, currents, fault in ((1, (0.1,) * 6, Fault.NONE), (2, (), Fault.TORQUES)):
        arm = ArmSample(number * PERIOD_NS, np.eye(4), (0.0, -90.0, 90.0, 0.0, 45.0, 0.0), currents=currents)
        forces = (ForceSample(number * PERIOD_NS, np.zeros(3), number),)
        assert supervisor.judge(RobotObservation(number * PERIOD_NS, forces, (arm,))).fault is fault
