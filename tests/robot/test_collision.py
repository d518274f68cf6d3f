"""Collisions in joint torques: seen beside noise and gravity's remainder, explained by what presses the tip."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.robot.collision import CollisionWatch
from deformscope.robot.preflight import check
from deformscope.robot.robot import RobotStopped
from deformscope.robot.supervisor import Fault
from deformscope_drivers.arm.kinematics import FloatArray, jacobian_of
from deformscope_drivers.jaco.chains import J2N6S300
from tests.robot.quick_touch import quick_scene

JOINTS_DEG = tuple(J2N6S300.home_deg)
LIMIT_NM = 4.0
PERIOD_NS = 10_000_000
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


def test_readings_that_repeat_count_once_and_what_is_no_number_not_at_all() -> None:
    watch = CollisionWatch(J2N6S300, TIP)
    still, pushed = (0.1,) * 6, (0.1, 9.0, 0.1, 0.1, 0.1, 0.1)
    for number, torques_nm in enumerate([still, pushed, pushed, pushed, (float("nan"),) * 6, pushed]):
        assert watch.look(torques_nm, JOINTS_DEG, 0.0, LIMIT_NM, number * PERIOD_NS) == ""
    assert "joint 2 feels 9.0 Nm" in watch.look((0.1, 9.1, *still[2:]), JOINTS_DEG, 0.0, LIMIT_NM, 9 * PERIOD_NS)


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
