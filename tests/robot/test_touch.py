"""Touches through the real drivers: they press as told, never harder, the same every time; and they stop."""

import dataclasses
from typing import Literal

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_STIFFNESS_N_M
from deformscope.lab.faults import Injected, inject
from deformscope.robot.checks import Check
from deformscope.robot.preflight import _first_way, check
from deformscope.robot.robot import RobotStopped, TipVelocity
from deformscope.robot.supervisor import Fault
from deformscope.robot.touch import Phase, TouchEnding, TouchPlan, TouchRecord, TouchStateMachine, run_touch
from studies.fault_study import FaultScene, make_scene, run_fault, turned_aside_deg
from tests.cases import slow
from tests.robot.quick_touch import quick_scene

SOFT_N = 8.0


def touched(seed: int, modulus_pa: float, tip: str, tilt_deg: float) -> tuple[FaultScene, TouchRecord]:
    scene = quick_scene(seed, modulus_pa=modulus_pa, tip=tip, tilt_deg=tilt_deg)
    record = run_touch(scene.robot, scene.plan)
    scene.lab.close()
    return scene, record


@pytest.mark.parametrize(
    ("modulus_pa", "tip", "tilt_deg", "force_n"),
    [
        pytest.param(10e3, "sphere", 15.0, 3.0, marks=pytest.mark.slow),  # softer than the record of the foam above
        (1e11, "flat", 12.0, 5.0),
        pytest.param(60e3, "flat", 0.0, 3.0, marks=pytest.mark.slow),  # between these two
        pytest.param(1e11, "sphere", 0.0, 5.0, marks=pytest.mark.slow),
    ],
)
def test_it_presses_as_told_and_never_harder(modulus_pa: float, tip: str, tilt_deg: float, force_n: float) -> None:
    scene, record = touched(3, modulus_pa, tip, tilt_deg)
    assert record.ending is TouchEnding.SET_FORCE
    assert record.settled
    assert scene.lab.contact.max_force_n < 1.1 * force_n < SOFT_N
    assert record.final_force_n is not None
    assert record.final_force_n == pytest.approx(force_n * scene.plan.normal, abs=0.1)
    assert record.center_m is not None
    # the foam's dent, as the joints see it, is less by what the arm gives
    true_m = record.center_m + record.final_force_n / ARM_STIFFNESS_N_M
    assert scene.lab.contact.world.press(true_m) @ scene.plan.normal == pytest.approx(
        force_n, rel=0.2 if modulus_pa < 1e9 else 1e3
    )
    assert len(record.time_s) == len(record.position_m) == len(record.force_n) > record.loading > 100
    assert np.all(np.diff(record.time_s) > 0)


@pytest.mark.parametrize(
    ("higher_m", "most_n"),
    [slow(0.003, 1.1 * 5.0), (0.016, SOFT_N)],  # slow before it is met, and met at 50 mm/s
)
def test_from_low_above_something_rigid_that_is_higher_than_believed(higher_m: float, most_n: float) -> None:
    """It is met before the soft stop's force, wherever it is."""
    scene = quick_scene(3, modulus_pa=1e11, tip="sphere", tilt_deg=0.0)
    low = dataclasses.replace(
        scene.plan,
        point_m=scene.plan.point_m - higher_m * scene.plan.normal,
        set_force_n=3.0,
        standoff_m=0.02,
        slow_within_m=0.005,
        far_speed_m_s=0.05,
        passing_m=0.002,
    )
    record = run_touch(scene.robot, low)
    scene.lab.close()
    spans = {span.phase: span.end_s - span.start_s for span in record.phases}
    assert record.ending is TouchEnding.SET_FORCE
    assert scene.lab.contact.max_force_n < most_n
    assert spans[Phase.APPROACH] < 1.6
    assert spans[Phase.RETREAT] < 1.2


@pytest.mark.slow
@pytest.mark.parametrize(("tangential", "least_m", "most_m"), [("held", 0.0, 1e-4), ("free", 3e-3, 2e-2)])
def test_a_tip_on_a_slope_stays_or_follows_the_force_across(
    tangential: Literal["held", "free"], least_m: float, most_m: float
) -> None:
    """A slippery plate that leans by 12 degrees, touched from straight above."""
    scene = quick_scene(3, modulus_pa=1e11, tip="sphere", tilt_deg=12.0)
    plan = dataclasses.replace(scene.plan, normal=np.array([0.0, 0.0, 1.0]), tangential=tangential)
    record = run_touch(scene.robot, plan)
    scene.lab.close()
    assert record.center_m is not None
    assert record.contact_m is not None
    across_m = (record.center_m - record.contact_m)[:2]
    assert least_m <= float(np.hypot(*across_m)) < most_m
    assert float(across_m @ record.final_force_n[:2]) >= 0.0 or tangential == "held"


@pytest.fixture(scope="module")
def foam() -> tuple[FaultScene, TouchRecord]:
    return touched(5, 60e3, "sphere", 0.0)


def test_the_record_is_the_foams_own_law(foam: tuple[FaultScene, TouchRecord]) -> None:
    scene, record = foam
    loading = slice(0, record.loading)
    along_n = record.force_n[loading] @ scene.plan.normal
    pressed = along_n > 0.3
    true_m = record.position_m[loading] + record.force_n[loading] / ARM_STIFFNESS_N_M
    expected_n = np.array([scene.lab.contact.world.press(place_m) @ scene.plan.normal for place_m in true_m])
    # while it is loaded at 10 mm/s, force and place belong together within a few milliseconds
    assert np.median(np.abs(along_n - expected_n)[pressed]) < 0.03
    names = [span.phase for span in record.phases]
    assert names == [Phase.TRAVEL, Phase.TARE, Phase.APPROACH, Phase.PRESS, Phase.DWELL, Phase.RETREAT]
    assert all(a.end_s == pytest.approx(b.start_s) for a, b in zip(record.phases[2:], record.phases[3:], strict=False))


@pytest.mark.slow  # two whole touches; replay proves the same
def test_a_touch_whose_energy_is_asked_for_leaves_as_slowly_as_it_came() -> None:
    plan = TouchPlan(np.zeros(3), np.array([0.0, 0.0, 1.0]), slow_back=True)
    for slow_back, deep_m, speed_m_s in ((True, 0.004, 0.01), (True, -0.001, 0.03), (False, 0.004, 0.03)):
        machine = TouchStateMachine(dataclasses.replace(plan, slow_back=slow_back), 0.01, 0.0)
        machine.phase, machine.contact_m = Phase.RETREAT, np.array([0.0, 0.0, 0.01])
        velocity = machine.step(0.0, machine.contact_m - [0.0, 0.0, deep_m], np.zeros(3))
        assert velocity == pytest.approx([0.0, 0.0, speed_m_s])


@pytest.mark.slow
def test_the_same_seed_gives_the_same_touch(foam: tuple[FaultScene, TouchRecord]) -> None:
    (_, one), (_, other) = foam, touched(5, 60e3, "sphere", 0.0)
    assert np.array_equal(one.force_n, other.force_n)
    assert np.array_equal(one.position_m, other.position_m)


@pytest.mark.slow  # two whole touches
def test_it_ends_at_the_greatest_depth_and_where_nothing_is() -> None:
    scene = make_scene(4, modulus_pa=2e3, tip="sphere", tilt_deg=0.0)
    deep = run_touch(scene.robot, scene.plan)
    assert deep.ending is TouchEnding.DEPTH
    assert deep.depth_m < scene.plan.max_depth_m + 5e-4
    away = TouchPlan(
        scene.plan.point_m + np.array([0.0, 0.0, 0.03]), scene.plan.normal, travel_height_m=0.15, miss_m=0.01
    )
    nothing = run_touch(scene.robot, away)
    scene.lab.close()
    assert nothing.ending is TouchEnding.NO_CONTACT
    assert nothing.center_m is None


def test_no_preflight_no_motion() -> None:
    scene = make_scene(6, modulus_pa=60e3)
    scene.robot.resume()
    before = scene.lab.arm_double.joints_deg
    with pytest.raises(InputError, match="preflight"):
        scene.robot.cycle(TipVelocity(np.array([0.0, 0.0, 0.01])))
    outside = TouchPlan(scene.plan.point_m + np.array([0.0, -0.9, 0.0]), scene.plan.normal)
    report = check(scene.robot, [outside], calibrated={"tool": False})
    with pytest.raises(InputError, match="workspace: plan inside"):
        scene.robot.let_move(report)
    scene.lab.close()
    failed = {one.name for one in report.checks if not one.passed}
    assert failed == {"calibration: tool", "workspace: plan inside", "arm: reach"}
    assert all(name in report.table() for name in failed)
    assert np.array_equal(scene.lab.arm_double.joints_deg, before)


def test_no_tare_in_contact() -> None:
    scene = make_scene(8, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    tare_n = scene.robot.tare_n.copy()
    scene.lab.schedule(scene.lab.clock(), lambda: scene.lab.contact.hit((0.0, 0.0, 2.0), 60.0))
    record = run_touch(scene.robot, scene.plan)
    scene.lab.close()
    assert record.ending is TouchEnding.NOT_REACHED
    assert "tare" in record.reason
    assert np.array_equal(scene.robot.tare_n, tare_n)


def test_a_soft_stop_stands_and_then_backs_away() -> None:
    scene = quick_scene(9)
    scene.lab.schedule(scene.lab.clock() + 4_000_000_000, lambda: scene.lab.contact.hit((0.0, 0.0, 9.5), 0.1))
    record = run_touch(scene.robot, scene.plan)
    height_m = float(scene.robot.center_m[2] - scene.plan.point_m[2])
    assert record.ending is TouchEnding.SOFT_STOP
    assert record.fault is Fault.FORCE_SOFT
    assert height_m > 0.9 * scene.plan.standoff_m
    with pytest.raises(RobotStopped):
        run_touch(scene.robot, scene.plan)
    scene.lab.close()


AS_OTHERS = (
    Injected.FORCE_CABLE,
    Injected.FORCE_FROZEN,
    Injected.FORCE_BROKEN,
    Injected.STORM,
    Injected.ARM_SILENT,
    Injected.ARM_INVALID,
    Injected.ARM_LATE,
    Injected.CAMERA_SILENT,
    Injected.CAMERA_FROZEN,
    Injected.CAMERA_CABLE,
)
"""Noticed as others are; what the supervisor says of each is in `test_supervisor`."""


@pytest.mark.parametrize(
    "injected", [pytest.param(one, marks=pytest.mark.slow if one in AS_OTHERS else ()) for one in Injected]
)
def test_a_fault_is_noticed_in_time_and_the_arm_stands(injected: Injected) -> None:
    run = run_fault(20_000 + list(Injected).index(injected), injected)
    assert run.in_time, run
    assert run.max_force_n < SOFT_N


def test_a_tip_that_may_touch_is_not_taken_for_free() -> None:
    """What presses when the sensor is zeroed reads as zero: where the arm stands tells."""
    scene = make_scene(6, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    low = scene.robot.center_m - np.array([0.0, 0.0, scene.robot.placement.center_offset_m + 0.002])
    report = check(scene.robot, [TouchPlan(low, scene.plan.normal)], calibrated={})
    scene.lab.close()
    (found,) = (one for one in report.checks if one.name == "tip: in free air")
    assert not found.passed
    assert found.came == "0.2 cm"
    assert "tip: in free air: lift the tip" in report.table()


def test_a_camera_that_repeats_itself_is_found_before_anything_moves() -> None:
    scene = make_scene(6, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    before = check(scene.robot, [scene.plan], calibrated={})
    inject(scene.lab, Injected.CAMERA_FROZEN, np.random.default_rng(0))
    report = check(scene.robot, [scene.plan], calibrated={})
    scene.lab.close()
    assert before.passed
    assert {one.name for one in report.checks if not one.passed} == {"camera: alive"}
    assert "camera: alive: reconnect the camera" in report.table()


@pytest.mark.slow  # whole touches; the jaco device's own tests have the rates of its states
@pytest.mark.parametrize("call_ms", [1.0, 2.8, 4.0])
def test_a_slow_link_to_the_arm_is_no_fault(call_ms: float) -> None:
    """What a call over USB takes (kinova-ros issues 281, 372): the preflight passes, and a touch is as it was."""
    scene = quick_scene(6)
    scene.lab.call_s = call_ms / 1e3
    report = check(scene.robot, [scene.plan], calibrated={})
    aside_deg = [0.0]
    scene.robot.watch = lambda *_: aside_deg.append(turned_aside_deg(scene.robot, scene.lab))
    record = run_touch(scene.robot, scene.plan)
    scene.lab.close()
    assert report.passed, report.table()
    assert record.ending is TouchEnding.SET_FORCE
    assert np.linalg.norm(record.force_n, axis=1).max() < scene.plan.set_force_n + 0.5
    assert len(aside_deg) > 100
    assert max(aside_deg) < 1.0


def test_a_link_that_is_too_slow_for_the_control_cycle_is_found_before_anything_moves() -> None:
    scene = make_scene(6, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    scene.lab.call_s = 0.01
    report = check(scene.robot, [scene.plan], calibrated={})
    scene.lab.close()
    (found,) = (one for one in report.checks if one.name == "arm: link")
    assert not found.passed
    assert found.came == "10.0 ms"
    assert "arm: link: the arm's cable" in report.table()


def test_an_arm_that_begins_at_a_joints_limit_is_found_before_anything_moves() -> None:
    scene = make_scene(6, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    supervisor, double = scene.robot.supervisor, scene.lab.arm_double
    supervisor.limits = dataclasses.replace(supervisor.limits, low_m=(-1.0, -1.0, -1.0), high_m=(1.0, 1.0, 1.0))
    double._arm.joints_deg = double.joints_deg.copy()
    double._arm.joints_deg[2] = double.chain.lower_deg[2] + 3.0
    double._arm.links = double.chain.forward(double._arm.joints_deg)
    report = check(scene.robot, [scene.plan], calibrated={})
    scene.lab.close()
    (found,) = (one for one in report.checks if one.name == "arm: joints")
    assert not found.passed
    assert found.came == "joint 3 3.0 deg"
    assert "arm: joints: turn the joint away" in report.table()


def test_a_way_that_the_arm_cannot_be_led_is_refused_before_it_moves() -> None:
    scene = make_scene(6, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    before_deg = scene.lab.arm_double.joints_deg
    far = TouchPlan(np.array([0.3, -0.35, 0.08]), np.array([0.0, 0.0, 1.0]), travel_height_m=0.15)
    record = run_touch(scene.robot, far)
    scene.lab.close()
    assert record.ending is TouchEnding.NOT_REACHED
    assert "singularity" in record.reason
    assert np.array_equal(scene.lab.arm_double.joints_deg, before_deg)


def test_a_first_way_that_leads_below_the_surface_is_refused() -> None:
    scene = make_scene(6, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    turned_deg = np.array(scene.lab.arm_double.joints_deg) + np.array([0.0, 0.0, 0.0, 0.0, 90.0, 0.0])
    scene.robot._pose = dataclasses.replace(
        scene.robot.pose, joints_deg=tuple(turned_deg), T_base_ee=scene.robot.arm.chain.forward(turned_deg)[-1]
    )
    (passed,) = _first_ways(scene, 0.0)
    (failed,) = _first_ways(scene, 0.3)
    scene.lab.close()
    assert passed.passed
    assert not failed.passed
    assert "joystick" in failed.hint


def _first_ways(scene: FaultScene, height_m: float) -> list[Check]:
    return [_first_way(scene.robot, np.array(scene.lab.arm_double.joints_deg), height_m)]
