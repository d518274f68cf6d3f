"""What the arm fills: from its base along its links to the tip, wherever the surface lies."""

from itertools import pairwise

import numpy as np
import pytest

from deformscope.rig.rig_file import Tool
from deformscope.robot.description import LINK_RADIUS_M, arm_shape
from deformscope.robot.placement import Placement
from deformscope_drivers.arm.kinematics import rotation_from_rpy, transform
from deformscope_drivers.jaco.chains import J2N6S300

T_BASE_SURFACE = transform(rotation_from_rpy(0.1, -0.2, 2.0), (0.3, -0.5, 0.04))
PLACEMENT = Placement(T_BASE_SURFACE, Tool(radius_m=0.012, stick_radius_m=0.009))


def test_it_goes_from_the_base_to_the_tip_without_a_gap() -> None:
    T_base_ee = J2N6S300.forward(J2N6S300.home_deg)[-1]
    center_m = PLACEMENT.T_surface_center(T_base_ee)[:3, 3]
    shape = arm_shape(PLACEMENT, J2N6S300.forward(J2N6S300.home_deg), center_m)
    *links, stick, ball = shape
    np.testing.assert_allclose(PLACEMENT.point_in_base_m(links[0].start_m), 0.0, atol=1e-12)
    np.testing.assert_allclose(PLACEMENT.point_in_base_m(links[-1].end_m), T_base_ee[:3, 3], atol=1e-12)
    for one, after in pairwise(shape):
        np.testing.assert_array_equal(one.end_m, after.start_m)
    tool = PLACEMENT.tool
    assert np.linalg.norm(stick.end_m - stick.start_m) == pytest.approx(tool.length_m - tool.radius_m)
    np.testing.assert_array_equal(ball.start_m, ball.end_m)
    assert {link.radius_m for link in links} == {LINK_RADIUS_M}
    assert (stick.radius_m, ball.radius_m) == (0.009, 0.012)


def test_margins_go_around_links_and_stick() -> None:
    center_m = np.array([0.1, 0.2, 0.06])
    bare = arm_shape(PLACEMENT, J2N6S300.forward(J2N6S300.home_deg), center_m)
    wide = arm_shape(PLACEMENT, J2N6S300.forward(J2N6S300.home_deg), center_m, link_margin_m=0.01, stick_margin_m=0.004)
    added = [b.radius_m - a.radius_m for a, b in zip(bare, wide, strict=True)]
    np.testing.assert_allclose(added, [0.01] * (len(bare) - 2) + [0.004] * 2)
