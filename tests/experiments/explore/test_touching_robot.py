"""The wired laboratory: its camera sees what is touched, beside the arm that touches it."""

import dataclasses
import json
import os
import threading
import time
from functools import partial

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.experiments.explore.depth_pictures import check_center, reported_lens
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.stage_executor import exploration_stages
from deformscope.experiments.explore.touching_robot import TouchingRobot
from deformscope.experiments.measured import SetupGeometry, highest_m
from deformscope.lab.ray_camera import FOAM
from deformscope.lab.scene_lab import SceneLab
from deformscope.lab.scenes import built_in
from deformscope.rig.rig_file import Workspace
from deformscope.robot.description import arm_shape
from deformscope.robot.placement import Placement
from deformscope.robot.setup import CameraView, Setup
from deformscope.robot.touch import STILL_S
from deformscope.stages.regions.touches import GAIN_SD
from deformscope_drivers.images import Intrinsics
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.pacing import STEERING, may_be_prompt
from studies.fault_study import FaultScene, make_scene
from tests.patience import PATIENCE_S

UP = np.array([0.0, 0.0, 1.0])


def setup(scene: FaultScene, workspace: Workspace, doubt_m: float = 0.0) -> Setup:
    """Of a scene whose devices are open."""
    return Setup(
        size_m=(0.6, 0.4),
        placement=scene.robot.placement,
        workspace=workspace,
        camera=CameraView(doubt_m=doubt_m),
        open_source=lambda: pytest.fail("they are open"),
        names=("arm", "tip", "camera"),
        clock=scene.lab.clock,
    )


@pytest.fixture(scope="module")
def lab() -> SceneLab:
    options = ExploreOptions()
    return SceneLab(built_in("homogeneous-60"), tip_radius_m=options.tip_radius_m, parked_m=highest_m(options))


@pytest.mark.parametrize("place", [(0.05, 0.05), (0.3, 0.2), (0.25, 0.22), (0.55, 0.05), (0.05, 0.35), (0.5, 0.3)])
def test_the_arm_does_not_hide_what_it_touches(lab: SceneLab, place: tuple[float, float]) -> None:
    """Of the surface within 4 cm of the tip the camera sees the most: it stands across from the arm."""
    center = np.array([*place, lab.scene.thickness_m + lab.placement.center_offset_m])
    start = lab.lab.arm_double.joints_deg
    found = J2N6S300.inverse(lab.placement.T_base_ee(center, UP), start)
    assert found.converged
    robot = arm_shape(lab.placement, J2N6S300.forward(found.joints_deg), center)
    free, hidden = lab.view.render(), lab.view.render(None, robot)
    around = (np.abs(lab.view.points_m(free.depth_m)[..., :2] - place) < 0.04).all(axis=-1) & (free.seen == FOAM)
    assert around.sum() > 300
    assert (hidden.seen[around] == FOAM).mean() > 0.6


@pytest.mark.parametrize(
    ("set_n", "soft_n", "more_n", "told"),
    [(3.0, 8.0, 5.0, "3 N, 5 N if"), (1.0, 2.0, 1.5, "1 N, 1.5 N if"), (3.0, 3.5, None, "3 N")],
)
def test_it_never_plans_to_press_up_to_the_soft_stop(
    set_n: float, soft_n: float, more_n: float | None, told: str
) -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    workspace = Workspace(target_force_n=set_n, soft_stop_n=soft_n, hard_stop_n=15.0)
    robot = TouchingRobot(lambda watch: scene.robot, setup(scene, workspace), ExploreOptions(set_force_n=set_n))
    plan = robot.geometry.plan(np.array([0.3, 0.2]), 0.05, UP, None, ExploreOptions(set_force_n=set_n))
    scene.lab.close()
    assert plan.more_force_n == more_n
    assert plan.tangential == "held"
    free = ExploreOptions(set_force_n=set_n, tangential="free")
    assert robot.geometry.plan(np.array([0.3, 0.2]), 0.05, UP, None, free).tangential == "free"
    assert robot.format_forces.startswith(told)


def test_more_is_left_out_around_the_stick_where_the_cameras_place_is_in_doubt() -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    radii, pose = [], scene.robot.pose
    for doubt_m in (0.0, 0.004):
        robot = SetupGeometry.of(setup(scene, Workspace(), doubt_m)).posed_robot(pose, J2N6S300)
        radii.append([link.radius_m + robot.margin_m for link in robot.capsules])
    scene.lab.close()
    plain, doubtful = np.array(radii)
    assert doubtful - plain == pytest.approx(0.004)


def test_what_is_known_of_the_surface_says_how_low_and_how_slowly() -> None:
    geometry = SetupGeometry.of(SceneLab(built_in("homogeneous-60"), tip_radius_m=0.01, parked_m=0.2).setup)
    place, quick = np.array([0.3, 0.2]), ExploreOptions(pace="quick")
    careful = geometry.plan(place, 0.05, UP, 0.051, ExploreOptions(), 0.0)
    unknown, sure, doubtful, lost = (geometry.plan(place, 0.05, UP, 0.051, quick, m) for m in (None, 0, 0.008, 0.011))
    assert (careful.standoff_m, careful.slow_within_m) == (0.05, 0.03)
    assert (unknown.standoff_m, unknown.slow_within_m) == (0.05, 0.015), "high, until a touch has met it"
    assert (sure.standoff_m, sure.slow_within_m) == (0.02, 0.005)
    assert doubtful.slow_within_m == pytest.approx(0.013), "slow from 5 mm above the highest that it may be"
    assert (lost.standoff_m, lost.slow_within_m) == (0.05, 0.03)
    assert sure.travel_height_m == pytest.approx(careful.travel_height_m - 0.03)
    assert {one.contact_speed_m_s for one in (careful, unknown, sure, doubtful)} == {0.01}
    without_pictures = geometry.plan(place, 0.05, UP, 0.051, ExploreOptions(pace="quick", beta_model="none"), 0.0)
    assert (without_pictures.dwell_s, sure.dwell_s) == (STILL_S, careful.dwell_s)


def test_a_geometry_survives_its_settings() -> None:
    made = SetupGeometry.of(SceneLab(built_in("homogeneous-60"), tip_radius_m=0.01, parked_m=0.2).setup)
    back = SetupGeometry.from_json(json.loads(json.dumps(made.as_json())))
    np.testing.assert_array_equal(back.placement.T_base_surface, made.placement.T_base_surface)
    np.testing.assert_array_equal(np.array(back.camera.T_surface_camera), np.array(made.camera.T_surface_camera))
    assert back.camera.focal_px == made.camera.focal_px
    assert (back.placement.tool, back.workspace, back.arm) == (made.placement.tool, made.workspace, made.arm)
    with pytest.raises(InputError, match="a recording with its setup"):
        SetupGeometry.from_json({})


def test_what_is_known_of_the_force_s_gain_comes_from_the_rig_file() -> None:
    """Of the geometry that is recorded, so that a replay computes the same."""
    made = SetupGeometry.of(SceneLab(built_in("homogeneous-60"), tip_radius_m=0.01, parked_m=0.2).setup)
    known = dataclasses.replace(made.placement.tool, force_gain=1.02, force_gain_sd=0.004)
    placement = dataclasses.replace(made.placement, tool=known)
    for geometry, expected in ((made, GAIN_SD), (dataclasses.replace(made, placement=placement), 0.004)):
        back = SetupGeometry.from_json(json.loads(json.dumps(geometry.as_json())))
        stages = exploration_stages(back, ExploreOptions(), None)
        assert stages.unseen.search.posterior.prior.error.gain_sd == expected
    force_n, T_base_ee = np.array([0.3, -0.2, 3.0]), np.eye(4)
    felt_n = made.placement.force_on_tip_n(force_n, T_base_ee)
    np.testing.assert_allclose(placement.force_on_tip_n(1.02 * force_n, T_base_ee), felt_n)


@pytest.mark.parametrize(("center_px", "shape"), [((160.0, 120.0), (240, 320)), ((331.0, 221.0), (480, 640))])
def test_a_principal_point_near_the_middle_is_taken(center_px: tuple[float, float], shape: tuple[int, int]) -> None:
    check_center(center_px, shape)


def test_the_principal_point_of_another_resolution_is_refused() -> None:
    with pytest.raises(InputError, match=r"\(319.5, 239.5\) in images of 320 x 240 px.*neither"):
        check_center((319.5, 239.5), (240, 320))


def test_a_lens_that_the_pictures_report_is_taken_where_it_has_no_distortion() -> None:
    assert reported_lens(Intrinsics(570.0, 571.0, 320.0, 240.0)) == ((570.0, 571.0), (320.0, 240.0))
    with pytest.raises(InputError, match="focal_px and center_px; got none"):
        reported_lens(None)
    with pytest.raises(InputError, match=r"and distortion; got .* \[0.1, 0.0, 0.0, 0.0, 0.0\] .*calibrate camera"):
        reported_lens(Intrinsics(570.0, 571.0, 320.0, 240.0, (0.1, 0.0, 0.0, 0.0, 0.0)))


@pytest.mark.skipif(not may_be_prompt(), reason="this user may not have real-time threads")
def test_a_robot_that_may_move_is_steered_by_a_real_time_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not before it may: what is computed until then would hold up everything else."""

    class Standing:
        may_move = False

        def cycle(self) -> None:
            seen.append(os.sched_getparam(0).sched_priority)
            cycled.set()
            time.sleep(0.01)

    seen, cycled, standing = list[int](), threading.Event(), Standing()
    placement, workspace = Placement(np.eye(4)), Workspace()
    nothing_opens = lambda: pytest.fail("nothing opens")  # noqa: E731
    made = Setup((0.6, 0.4), placement, workspace, CameraView(), nothing_opens, ("arm", "tip", "camera"))
    robot = TouchingRobot(lambda watch: standing, made, ExploreOptions())  # type: ignore[arg-type,return-value]
    monkeypatch.setattr(robot, "_made", standing)
    monkeypatch.setattr(robot, "_do", lambda command: partial(int, os.sched_getparam(0).sched_priority))
    with robot.in_a_thread():
        assert robot.carry_out("check", lambda: None).result(PATIENCE_S) == 0
        standing.may_move = True
        assert robot.carry_out("look", lambda: None).result(PATIENCE_S) == STEERING  # the very first one
        assert cycled.wait(PATIENCE_S)
    assert set(seen) == {STEERING}
