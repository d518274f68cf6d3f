"""Where the fingers touch a container, and where on it the hand is to stand."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.rig.sections import ContainerSection, SqueezeSection
from deformscope.robot.squeeze_plan import PAD_ALONG_M, PAD_M, GripShape, draw_grasp, grasp_middle
from deformscope_drivers.sdh.kinematics import DISTAL_LINK_M, finger_points, fingertips

SQUEEZE = SqueezeSection()


@pytest.mark.parametrize("width_m", [0.03, 0.06, 0.12])
def test_both_fingertips_touch_the_container_upright(width_m: float) -> None:
    shape = GripShape.of(ContainerSection(size_m=(width_m, 0.09, 0.16)), SQUEEZE)
    tips = fingertips(shape.contact_deg)
    assert tips[0, 0] - PAD_M == pytest.approx(width_m / 2, abs=1e-6)
    assert tips[2, 0] + PAD_M == pytest.approx(-width_m / 2, abs=1e-6)
    assert shape.contact_deg[1] + shape.contact_deg[2] == pytest.approx(0.0)
    assert fingertips(shape.open_deg)[0, 0] - tips[0, 0] > 0.02


def test_a_given_distal_angle_is_kept() -> None:
    shape = GripShape.of(ContainerSection(), SqueezeSection(distal_deg=20.0))
    assert shape.contact_deg[2] == 20.0
    assert fingertips(shape.contact_deg)[0, 0] - PAD_M == pytest.approx(0.03, abs=1e-6)
    assert fingertips(shape.open_deg)[0, 0] - PAD_M > 0.05  # as far from the container as with upright fingertips


def test_what_the_fingers_cannot_close_on_is_refused() -> None:
    with pytest.raises(InputError, match=r"a container up to 0\.208 m wide"):
        GripShape.of(ContainerSection(size_m=(0.3, 0.1, 0.2)), SQUEEZE)


def test_a_grasp_is_drawn_from_the_seed_around_the_middle_of_the_longest_edge() -> None:
    container = ContainerSection()
    drawn = [draw_grasp(container, SQUEEZE, seed) for seed in range(200)]
    np.testing.assert_array_equal(drawn[3].T_hand_container, draw_grasp(container, SQUEEZE, 3).T_hand_container)
    along_m = np.array([one.along_m for one in drawn])
    assert np.abs(along_m).max() <= 2 * SQUEEZE.spread_m
    assert along_m.std() == pytest.approx(SQUEEZE.spread_m, rel=0.2)
    pads = pads_at_contact(container)
    for one in drawn[:20]:
        at = (np.linalg.inv(one.T_hand_container) @ pads.T).T[:, :3]  # of the pads, in the container's frame
        np.testing.assert_allclose(at, [[0.03, 0.0, one.along_m], [-0.03, 0.0, one.along_m]], atol=1e-9)


@pytest.mark.parametrize("squeeze", [SQUEEZE, SqueezeSection(distal_deg=10.0)])
def test_the_middle_grasp_has_the_pads_on_the_middle_of_both_walls(squeeze: SqueezeSection) -> None:
    container = ContainerSection(size_m=(0.07, 0.05, 0.2))
    at = (np.linalg.inv(grasp_middle(container, squeeze)) @ pads_at_contact(container, squeeze).T).T
    np.testing.assert_allclose(at[:, 1:3], 0.0, atol=1e-9)
    # both fingers stand there in another model of the hand: ipa320/schunk_modular_robotics, sdh.urdf.xacro
    assert GripShape.of(container, squeeze).middle_m[:2] == pytest.approx((0.0, 0.01905), abs=1e-5)


def pads_at_contact(container: ContainerSection, squeeze: SqueezeSection = SQUEEZE) -> FloatArray:
    """(2, 4) the middles of both squeezing pads by the hand's kinematics, hand frame [m], homogeneous."""
    angles, found = GripShape.of(container, squeeze).contact_deg, []
    for finger, inwards in ((0, -1.0), (2, 1.0)):
        _, joint, tip = finger_points(angles, finger)
        x, y, z = joint + PAD_ALONG_M / DISTAL_LINK_M * (tip - joint)
        found.append([x + inwards * PAD_M, y, z, 1.0])
    return np.array(found)
