"""The wired laboratory: its camera sees what is touched, beside the arm that touches it."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.experiments.explore import ExploreOptions
from deformscope.experiments.explore_wired import LabBench, TouchingRobot
from deformscope.lab.depth_view import FOAM
from deformscope.lab.scenes import built_in
from deformscope.rig.rig_file import Workspace
from deformscope.robot.shape import arm_shape
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.studies.fault_study import make_scene
from deformscope_drivers.jaco.kinematics import J2N6S300

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def bench() -> LabBench:
    return LabBench(built_in("homogeneous-60"), ExploreOptions())


@pytest.mark.parametrize("place", [(0.05, 0.05), (0.3, 0.2), (0.25, 0.22), (0.55, 0.05), (0.05, 0.35), (0.5, 0.3)])
def test_the_arm_does_not_hide_what_it_touches(bench: LabBench, place: tuple[float, float]) -> None:
    """Of the surface within 4 cm of the tip the camera sees the most: it stands across from the arm."""
    center = np.array([*place, bench.scene.thickness_m + bench.placement.center_offset_m])
    start = bench.lab.arm_double.joints_deg
    found = J2N6S300.inverse(bench.placement.T_base_ee(center, UP), start)
    assert found.converged
    robot = arm_shape(bench.placement, J2N6S300, found.joints_deg, center)
    free, hidden = bench.view.render(), bench.view.render(None, robot)
    around = (np.abs(bench.view.points_m(free.depth_m)[..., :2] - place) < 0.04).all(axis=-1) & (free.seen == FOAM)
    assert around.sum() > 300
    assert (hidden.seen[around] == FOAM).mean() > 0.6


@pytest.mark.parametrize(
    ("set_n", "soft_n", "more_n", "told"),
    [(3.0, 8.0, 5.0, "3 N, 5 N where"), (1.0, 2.0, 1.5, "1 N, 1.5 N where"), (3.0, 3.5, None, "3 N")],
)
def test_it_never_plans_to_press_up_to_the_soft_stop(
    set_n: float, soft_n: float, more_n: float | None, told: str
) -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    robot = TouchingRobot(
        scene.robot,
        (0.6, 0.4),
        ExploreOptions(set_force_n=set_n),
        (None, None),
        arm=ArmCompliance(),
        clock=scene.lab.clock,
        workspace=Workspace(target_force_n=set_n, soft_stop_n=soft_n, hard_stop_n=15.0),
    )
    plan = robot._plan(np.array([0.3, 0.2]), 0.05, UP, None)
    scene.lab.close()

    assert plan.more_force_n == more_n
    assert robot.forces_told.startswith(told)


def test_more_is_left_out_around_the_stick_where_the_cameras_place_is_in_doubt() -> None:
    scene = make_scene(3, modulus_pa=60e3, tip="sphere", tilt_deg=0.0)
    radii = []
    for doubt_m in (0.0, 0.004):
        robot = TouchingRobot(
            scene.robot,
            (0.6, 0.4),
            ExploreOptions(),
            (None, None),
            arm=ArmCompliance(),
            clock=scene.lab.clock,
            workspace=Workspace(),
            doubt_m=doubt_m,
        )
        radii.append([link.radius_m for link in robot._links()])
    scene.lab.close()
    plain, doubtful = np.array(radii)

    assert doubtful - plain == pytest.approx(0.004)
