"""An arm that nothing guards but the force at its tip: slower, not far below the surface, and a finger first."""

import contextlib
import dataclasses
import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from deformscope.lab.arms import arm_in_lab
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot import finger
from deformscope.robot.finger import press_by_finger
from deformscope.robot.force_alone import MISS_M, ForceAlone, PressWatch
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import FORCE_TURNED, check
from deformscope.robot.readings import ForceSample, RobotObservation
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.supervisor import Fault, Limits, Supervisor
from deformscope.robot.touch import Phase, TouchEnding, TouchPlan, TouchStateMachine
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.kuka import KukaConfig
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.optoforce import OptoforceConfig
from deformscope_drivers.optoforce.double import OMD_20_SE_40N
from studies.rigid_faults import T_BASE_SURFACE, TOP_M, UP
from studies.springy_foam import SpringyFoam
from tests.cases import slow
from tests.robot.quick_touch import quick_scene

POINT_M = np.array([0.3, 0.2, TOP_M])


class Bench:
    """A KUKA over foam."""

    def __init__(self, limits: Limits, rate_hz: float = 1000.0) -> None:
        self.clock = SimulatedClock(1_000_000_000)
        placement = Placement(T_BASE_SURFACE, Tool())
        arm = arm_in_lab("kuka", KukaConfig(), placement, [POINT_M + 0.12 * UP, POINT_M], self.clock)
        foam = SpringyFoam(60e3, POINT_M, UP, placement.tool)
        sensor = OptoforceConfig(sensitivity=OMD_20_SE_40N, rate_hz=rate_hz)
        self.lab = TouchLab(foam, self.clock, T_base_surface=T_BASE_SURFACE, arm=arm, force_config=sensor)
        self.lab.open()
        self.robot = Robot(
            self.lab.arm, self.lab.force, placement, limits, clock=self.clock, wait_until=self.lab.wait_until
        )
        self.plan = TouchPlan(POINT_M, UP, travel_height_m=TOP_M + 0.1)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench(Limits(low_m=(-2.0,) * 3, high_m=(2.0,) * 3))
    with contextlib.closing(made.lab):
        made.robot.cycle()
        yield made


@pytest.mark.parametrize(
    ("pushes_n", "right"),
    [
        ([(0, 0, 8)], True),
        slow([(1, -1, 5.5)], True),
        slow([(0, 0, 11)], True),  # above the soft stop
        slow([(0, 0, 0)], False),  # nobody presses
        ([(0, 0, 5)] * 3, False),  # too little: what saturates below the set force would do as well
        slow([(0, 0, 13)] * 3, False),  # too much
        ([(0, 0, -8)] * 3, False),  # from above: a sign is wrong
        ([(8, 0, 0)] * 3, False),  # from the side: axes are
        slow([(5, 0, 5)] * 3, False),
        ([(0, 0, 1), (0, 0, 8)], True),  # the second time
        slow([(0, 0, 1)] * 3 + [(0, 0, 8)], False),  # no more than three
    ],
)
def test_a_finger_is_felt_from_below_and_about_as_hard_as_asked_for(
    pushes_n: list[tuple[float, float, float]], right: bool, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finger, "PATIENCE_S", 8.0)
    said: list[str] = []
    for number, push_n in enumerate(pushes_n):
        begins_ns = bench.clock() + round(1e9 * (1.0 + 1.5 * number))
        bench.lab.schedule(begins_ns, lambda push_n=push_n: bench.lab.push_tip(np.array(push_n, float)))
        bench.lab.schedule(begins_ns + 1_000_000_000, lambda: bench.lab.push_tip(np.zeros(3)))
    found = press_by_finger(bench.robot, say=said.append)
    assert found.passed == right, found
    assert bool(found.hint) != right
    assert "Press the tip straight up from below" in said[0]
    assert len(said) == 1 + min(len([push for push in pushes_n if any(push)]), 3)
    assert bench.robot.supervisor.verdict.fault is Fault.NONE  # what was pressed too hard is no fault of a touch
    assert np.linalg.norm(bench.robot.cycle().forces[-1].force_n) < 0.3  # and the finger is gone


def test_a_push_is_above_the_set_force_and_what_repeats_under_it_is_refused(bench: Bench) -> None:
    assert not press_by_finger(bench.robot, lambda n: bench.lab.push_tip(0.8 * n), set_n=7.0).passed
    assert press_by_finger(bench.robot, lambda n: bench.lab.push_tip(0.8 * n), set_n=5.0).passed

    def saturates(force_n: FloatArray) -> None:
        bench.lab.push_tip(force_n)
        bench.lab.wire.frozen = bool(np.any(force_n))

    with pytest.raises(RobotStopped, match="same force"):
        press_by_finger(bench.robot, saturates)


def test_a_sensor_slower_than_the_control_period_shows_the_finger_too() -> None:
    """Of three periods, two have no reading: that is no release."""
    made = Bench(Limits(low_m=(-2.0,) * 3, high_m=(2.0,) * 3, force_silent_s=0.2, force_frozen_s=2.0), rate_hz=30.0)
    with contextlib.closing(made.lab):
        made.robot.cycle()
        assert press_by_finger(made.robot, made.lab.push_tip).passed


def test_a_finger_above_the_hard_stop_ends_it(bench: Bench) -> None:
    with pytest.raises(RobotStopped):
        press_by_finger(bench.robot, lambda force_n: bench.lab.push_tip(2.5 * force_n))
    assert not np.any(bench.lab.contact.finger_n)


def test_calibrate_force_and_the_force_at_contact_are_looked_at_where_nothing_else_guards_the_arm(bench: Bench) -> None:
    found = {one.name: one for one in check(bench.robot, [bench.plan], calibrated={FORCE_TURNED: False}).checks}
    missing = found[f"calibration: {FORCE_TURNED}"]
    assert not missing.passed
    assert missing.hint == "deformscope calibrate force RIG"
    contact = found["tip: force at contact"]
    assert contact.passed
    assert contact.came.startswith("9.0 N, by 100 N/mm and 48 ms until the arm rests; 509 N if the sensor fails")
    assert contact.came.endswith("at most 2009 N if it then measures only a small part")
    scene = quick_scene(12)
    guarded = check(scene.robot, [scene.plan], calibrated={FORCE_TURNED: False})
    scene.lab.close()
    assert guarded.passed, guarded.table()
    assert not scene.robot.force_alone


def test_an_arm_too_stiff_to_be_stopped_in_time_is_refused_with_the_reason(bench: Bench) -> None:
    limits = bench.robot.supervisor.limits
    bench.robot.supervisor.limits = dataclasses.replace(limits, hard_force_n=4.0, soft_force_n=3.5)
    row, soft = (
        next(one for one in check(bench.robot, [bench.plan], calibrated={}).checks if "contact" in one.name)
        for bench.robot.compliance_m_per_n in (0.0, 2e-4)
    )
    assert not row.passed
    assert row.came.startswith("4.8 N, by 100 N/mm and 48 ms")
    assert "filter_hz = 150" in row.hint
    assert soft.passed


@pytest.mark.parametrize("stiffness_n_m", [1e3, 5e3, 2e4, 1e5])
@pytest.mark.parametrize("late_s", [0.02, 0.05])
def test_speeds_keep_a_contact_below_their_share_of_the_hard_stop(stiffness_n_m: float, late_s: float) -> None:
    plan = TouchPlan(POINT_M, UP)
    slowed = plan.slowed_for(ForceAlone(stiffness_n_m, late_s, 15.0, 0.003, False))
    assert slowed.contact_speed_m_s * stiffness_n_m * late_s <= 5.0 + 1e-9
    assert slowed.far_speed_m_s * stiffness_n_m * late_s <= 9.0 + 1e-9
    assert slowed.contact_speed_m_s <= plan.contact_speed_m_s
    assert slowed.far_speed_m_s <= plan.far_speed_m_s
    assert slowed.miss_m == 0.003 + MISS_M
    assert slowed.rigid_n_m >= stiffness_n_m


@pytest.mark.parametrize("axis", [0, 1, 2, None])
def test_one_axis_that_sticks_stops(axis: int | None) -> None:
    random, supervisor = np.random.default_rng(4), Supervisor(Limits(arm_silent_s=9.0), 0)
    supervisor.axes_frozen_s = np.array([0.02, 0.02, 0.06])
    limit_s = 0.03 if axis in (0, 1) else 0.06
    for period in itertools.count(1):
        forces = []
        for ms in range(10 * period - 9, 10 * period + 1):
            sensor_n = np.round(random.normal(0.0, 3.0, 3)) / 400
            sensor_n[[] if axis is None else axis] = 0.005
            forces.append(ForceSample(ms * 1_000_000, sensor_n, ms, sensor_n=sensor_n))
        verdict = supervisor.judge(RobotObservation(10_000_000 * period, tuple(forces)))
        if verdict.fault is not Fault.NONE or period == 100:
            break
    if axis is None:
        assert verdict.fault is Fault.NONE
    else:
        assert verdict.fault is Fault.FORCE_FROZEN
        assert f"along {'xyz'[axis]}" in verdict.reason
        assert limit_s < verdict.time_ns / 1e9 <= limit_s + 0.02


def test_the_checks_learn_how_long_an_axis_may_repeat(bench: Bench) -> None:
    check(bench.robot, [bench.plan], calibrated={})
    limits_s = bench.robot.supervisor.axes_frozen_s
    assert ((limits_s > 0.0) & (limits_s < 0.1)).all()  # chance repeats of a count, some ms long, several times over


def pressed(
    stiffness_n_m: float,
    modulus_pa: float,
    measured: Callable[[float, Phase], float] = lambda true_n, phase: true_n,
    *,
    creeps: float = 0.0,
    noise_n: float = 0.02,
    seed: int = 0,
) -> tuple[str, float, TouchStateMachine]:
    """Why the watch stopped a touch, the greatest true force [N], and the touch.

    A spherical tip of 1 cm behind a stiffness in series, on an elastic half-space (Johnson 1985, 4.2) that yields with
    1 s by a share of its depth; the arm follows 40 ms late, as `ForceAlone` reckons, and the force is of now."""
    alone = ForceAlone(stiffness_n_m, 0.048, 15.0, 0.0, False)
    plan = TouchPlan(np.zeros(3), UP).slowed_for(alone)
    watch, machine = PressWatch(alone, plan.contact_force_n), TouchStateMachine(plan, 0.0, 0.0)
    random, late = np.random.default_rng(seed), deque([0.0] * 4)
    down_m, yielded_m, true_n, felt_n, most_n, why = -0.005, 0.0, 0.0, 0.0, 0.0, ""
    for period in range(3000):
        late.append(float(machine.step(0.01 * period, -down_m * UP, felt_n * UP)[2]))
        if machine.phase in (Phase.RETREAT, Phase.DONE):
            break
        if machine.pressing or machine.phase is Phase.APPROACH:
            why = watch.look(down_m, felt_n, in_contact=machine.pressing)
        if why:
            most_n = max(most_n, true_n - 0.01 * sum(late) * stiffness_n_m)
            break
        down_m -= 0.01 * late.popleft()
        low_m, high_m = 0.0, max(0.0, down_m - yielded_m)
        for _ in range(40):  # the dent at which tip and arm are in balance
            dent_m = 0.5 * (low_m + high_m)
            true_n = 4.0 / 3.0 * modulus_pa / 0.91 * 0.1 * dent_m**1.5
            low_m, high_m = (
                (low_m, dent_m) if dent_m + true_n / stiffness_n_m > down_m - yielded_m else (dent_m, high_m)
            )
        yielded_m += 0.01 * (creeps * dent_m - yielded_m)
        most_n = max(most_n, true_n)
        felt_n = measured(true_n, machine.phase) + float(random.normal(0.0, noise_n))
    return why, most_n, machine


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e5])
@pytest.mark.parametrize("modulus_pa", [5e3, 2e4, 6e4, 3e5, 1e7, 1e9])
@pytest.mark.parametrize("creeps", [0.0, 0.5])
def test_a_sensor_that_is_right_is_not_stopped_by_any_foam(
    modulus_pa: float, stiffness_n_m: float, creeps: float
) -> None:
    for seed in range(4):
        why, most_n, machine = pressed(stiffness_n_m, modulus_pa, creeps=creeps, noise_n=0.025, seed=seed)
        assert why == ""
        assert machine.ending in (TouchEnding.SET_FORCE, TouchEnding.DEPTH, TouchEnding.NOT_SETTLED)
        assert most_n < 6.0


FAULTS: dict[str, Callable[[float], float]] = {
    "dead": lambda true_n: 0.0,
    "saturated": lambda true_n: min(true_n, 4.0),
    "a fifth": lambda true_n: 0.2 * true_n,
    "reversed": lambda true_n: -true_n,
    "saturated at 0.4 N": lambda true_n: min(true_n, 0.4),
    "saturated at 1 N": lambda true_n: min(true_n, 1.0),
}


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e5])
@pytest.mark.parametrize("modulus_pa", [6e4, 3e5, 1e9])
@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.PRESS, Phase.DWELL])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_force_that_does_not_follow_the_depth_stops_below_the_hard_stop(
    fault: str, phase: Phase, modulus_pa: float, stiffness_n_m: float
) -> None:
    struck: list[Phase] = []

    def measured(true_n: float, now: Phase) -> float:
        struck.extend([now] if now is phase else [])
        return FAULTS[fault](true_n) if struck else true_n

    _, most_n, machine = pressed(stiffness_n_m, modulus_pa, measured)
    if fault == "dead" and phase is Phase.APPROACH:  # nothing shows it
        assert machine.contact_m is None
        assert most_n <= stiffness_n_m * MISS_M + 9.0
    elif fault == "a fifth" and phase is not Phase.DWELL:  # it looks like a softer thing
        assert most_n <= 1.03 * 3.0 / 0.2
    else:
        assert most_n <= 15.0


def drifting(drift_n: float, most_n: float = math.inf) -> Callable[[float, Phase], float]:
    """A sensor that drifts by so much in 0.5 s after its tare, and saturates at a true force [N]."""
    periods = itertools.count()
    return lambda true_n, phase: min(true_n, most_n) + drift_n * min(next(periods) / 50, 1.0)


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e5])
@pytest.mark.parametrize("drift_n", [-0.05, 0.05])
@pytest.mark.parametrize("modulus_pa", [5e3, 2e4, 6e4, 1e9])
def test_a_sensor_that_drifts_before_contact_is_watched_as_well(
    modulus_pa: float, drift_n: float, stiffness_n_m: float
) -> None:
    for creeps in (0.0, 0.5):
        why, _, machine = pressed(stiffness_n_m, modulus_pa, drifting(drift_n), creeps=creeps, noise_n=0.016)
        assert why == ""
        assert machine.ending in (TouchEnding.SET_FORCE, TouchEnding.DEPTH, TouchEnding.NOT_SETTLED)
    _, most_n, _ = pressed(stiffness_n_m, modulus_pa, drifting(drift_n, 1.0), noise_n=0.016)
    assert most_n <= 15.0
