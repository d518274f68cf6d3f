"""The wired laboratory: its camera sees what is touched, beside the arm that touches it."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.experiments.explore import ExploreOptions
from deformscope.experiments.explore_wired import LabBench
from deformscope.lab.depth_view import FOAM
from deformscope.lab.scenes import built_in
from deformscope.robot.shape import arm_shape
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
