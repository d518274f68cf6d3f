"""Finger kinematics against numbers worked out from the lengths: l1 86.5, l2 68.5, d 66, h 17 mm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deformscope_drivers.sdh.kinematics import AXIS_NAMES, FINGERS, finger_points, fingertips

angles = st.tuples(st.floats(0, 90), *[st.floats(-90, 90)] * 6)


def test_straight_up() -> None:
    tips_mm = fingertips((0.0,) * 7) * 1e3
    assert tips_mm == pytest.approx(
        np.array([[33.0, 19.0526, 172.0], [0.0, -38.1051, 172.0], [-33.0, 19.0526, 172.0]]), abs=1e-3
    )


def test_bent_at_right_angles_the_fingers_lie_over_the_palm() -> None:
    """Proximal 90: both links lie flat, 155 mm towards the other side, 17 mm up."""
    tips_mm = fingertips((0.0, 90, 0, 90, 0, 90, 0)) * 1e3
    assert tips_mm == pytest.approx(
        np.array([[33.0, 19.0526 - 155, 17.0], [0.0, -38.1051 + 155, 17.0], [-33.0, 19.0526 - 155, 17.0]]), abs=1e-3
    )


def test_turned_by_60_deg_three_fingers_close_on_the_middle() -> None:
    """At 60 deg all fingers bend towards the centre of the triangle: a threefold symmetry about z."""
    tips = fingertips((60.0, 20, 10, 20, 10, 20, 10))
    radii = np.hypot(tips[:, 0], tips[:, 1])
    assert radii == pytest.approx([radii[0]] * 3)
    assert tips[:, 2] == pytest.approx([tips[0, 2]] * 3)
    assert radii[0] < 0.0382  # leaning inwards
    assert np.diff(np.sort(np.degrees(np.arctan2(tips[:, 1], tips[:, 0])))) == pytest.approx([120.0, 120.0])


def test_turned_by_90_deg_fingers_0_and_2_face_each_other() -> None:
    tips = fingertips((90.0, 10, 0, 0, 0, 10, 0))
    assert tips[0, 1] == pytest.approx(tips[2, 1])
    assert tips[0, 0] == pytest.approx(-tips[2, 0])
    assert tips[0, 0] < 0.033


@settings(derandomize=True, max_examples=100, deadline=None)
@given(angles)
def test_links_keep_their_lengths(position_deg: tuple[float, ...]) -> None:
    for finger in range(3):
        lengths = np.linalg.norm(np.diff(finger_points(position_deg, finger), axis=0), axis=1)
        assert lengths == pytest.approx([0.0865, 0.0685])


def test_axes_belong_to_fingers() -> None:
    assert [(finger.base_axis, finger.proximal_axis, finger.distal_axis) for finger in FINGERS] == [
        (0, 1, 2),
        (None, 3, 4),
        (0, 5, 6),
    ]
    assert len(AXIS_NAMES) == 7
    with pytest.raises(ValueError, match="position_deg"):
        fingertips((0.0,) * 6)
