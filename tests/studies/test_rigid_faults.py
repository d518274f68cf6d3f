"""A rigid surface and a force sensor that is wrong: some cases; `deformscope coverage safety` has all."""

import itertools

import pytest

from deformscope.robot.supervisor import Limits
from deformscope.robot.touch import Phase
from studies.rigid_faults import CASES, FELT, PHASES, STIFFNESSES_N_M, RigidRun, SensorFault, run_rigid
from tests.cases import slow, slow_but

KUKA, CURRENTS, JACO = "kuka", "kuka with motor currents", "jaco"
JACO_MOST_N = 16.0
"""What joint torques kept such faults to before an arm without them was looked at."""


def run(arm: str, fault: SensorFault, stiffness_n_m: float = 2e4, when: Phase | None = None) -> RigidRun:
    return run_rigid(CASES.index((arm, fault, stiffness_n_m, when)))


@pytest.mark.parametrize("stiffness_n_m", slow_but([2e4], STIFFNESSES_N_M))
@pytest.mark.parametrize("fault", [one for one in FELT if one in SensorFault])
def test_a_sensor_that_feels_wrongly_is_refused_before_anything_moves(fault: SensorFault, stiffness_n_m: float) -> None:
    found = run(KUKA, fault, stiffness_n_m)
    assert found.refused.startswith("force sensor: finger")
    assert found.max_force_n == 0.0


@pytest.mark.parametrize("fault", [SensorFault.FROZEN, slow(SensorFault.STUCK)])
def test_a_sensor_that_freezes_stops_the_arm_before_it_meets_anything(fault: SensorFault) -> None:
    found = run(KUKA, fault, 1e5)
    assert "force sensor frozen" in found.ended or "the same force" in found.ended
    assert found.max_force_n == 0.0


@pytest.mark.parametrize(
    ("fault", "stiffness_n_m"),
    [
        *(slow(SensorFault.RIGHT, n_m) for n_m in (5e3, 2e4, 1e5)),
        slow(SensorFault.HIGHER, 2e4),
        slow(SensorFault.HIGHER, 1e5),
    ],
)
def test_a_sensor_that_is_right_touches_something_rigid_below_the_hard_stop(
    fault: SensorFault, stiffness_n_m: float
) -> None:
    found = run(KUKA, fault, stiffness_n_m)
    assert found.ended.startswith("set force reached")
    assert found.max_force_n < 8.0


@pytest.mark.slow
@pytest.mark.parametrize("stiffness_n_m", STIFFNESSES_N_M)
def test_motor_currents_stop_an_arm_whose_sensor_dies_on_its_way_down(stiffness_n_m: float) -> None:
    seen = run(CURRENTS, SensorFault.DIES, stiffness_n_m)
    assert "the motor of joint" in seen.ended
    assert seen.max_force_n <= Limits().hard_force_n


@pytest.mark.slow
@pytest.mark.parametrize("stiffness_n_m", STIFFNESSES_N_M)
def test_without_motor_currents_a_sensor_that_dies_costs_no_more_than_is_said(stiffness_n_m: float) -> None:
    unseen = run(KUKA, SensorFault.DIES, stiffness_n_m)
    assert Limits().hard_force_n < unseen.max_force_n <= unseen.unavoidable_n
    assert unseen.unavoidable_n == pytest.approx(stiffness_n_m * 5e-3 + 9.0)  # and that is said


@pytest.mark.parametrize(
    ("fault", "when", "stiffness_n_m"),
    slow_but(
        [(SensorFault.CLIPPED, Phase.PRESS, 2e4)],  # `robot/test_force_alone.py` has each on a simple arm
        itertools.product((SensorFault.DEAD, SensorFault.CLIPPED, SensorFault.REVERSED), PHASES[1:], STIFFNESSES_N_M),
    ),
)
def test_a_sensor_that_fails_in_a_touch_is_noticed_by_force_and_depth(
    fault: SensorFault, when: Phase, stiffness_n_m: float
) -> None:
    found = run(KUKA, fault, stiffness_n_m, when)
    assert found.max_force_n <= Limits().hard_force_n
    assert found.ended.startswith("stopped: ") or when is Phase.RETREAT


@pytest.mark.slow
@pytest.mark.parametrize("fault", [SensorFault.DEAD, SensorFault.SATURATED, SensorFault.SCALE])
def test_joint_torques_stop_an_arm_whose_sensor_is_wrong(fault: SensorFault) -> None:
    found = run(JACO, fault)
    assert found.ended.startswith("stopped: joint")
    assert found.max_force_n <= JACO_MOST_N


@pytest.mark.slow
def test_all_cases_are_in_time() -> None:
    late = [found for found in map(run_rigid, range(len(CASES))) if not found.in_time]
    assert late == []
