"""Pressure, force, contact area, centre of pressure where the answer is known; pads' names; the thesis's feature."""

import numpy as np
import pytest

from deformscope_drivers.dsa.messages import MatrixInfo
from deformscope_drivers.dsa.pads import CONTACT_COUNTS, Curve, Pad, pad_contact, to_pressure

ZERO = (0.0, 0.0, 0.0)
MATRIX = MatrixInfo(0, 3.0, 4.0, 6, 13, bytes(6), bytes(2), 1, ZERO, ZERO, 0.0, 0)
TEXEL_M2 = 12e-6


def pad(**pressed: int) -> np.ndarray:
    """A distal pad; `r2c3=500` presses row 2, column 3."""
    counts = np.zeros((13, 6), np.uint16)
    for place, count in pressed.items():
        row, column = place[1:].split("c")
        counts[int(row), int(column)] = count
    return counts


def test_schunks_scale() -> None:
    """592.1 counts are 0.000473 N/mm2."""
    (pressure_pa,) = to_pressure([np.array([[5921]])])
    assert pressure_pa[0, 0] == pytest.approx(4730.0)


def test_a_scale_for_each_matrix() -> None:
    first, second = to_pressure([np.full((2, 2), 10, np.uint16), np.full((3, 2), 10, np.uint16)], (2.0, 3.0))
    assert (first == 20.0).all()
    assert (second == 30.0).all()
    assert second.shape == (3, 2)


def test_a_curve() -> None:
    curve = Curve((10.0, 110.0, 210.0), (0.0, 1000.0, 5000.0))
    (pressure_pa,) = to_pressure([np.array([[0, 10, 60, 110, 160, 4095]], np.uint16)], (curve,))
    assert pressure_pa[0].tolist() == [0.0, 0.0, 500.0, 1000.0, 3000.0, 5000.0]


@pytest.mark.parametrize(
    ("counts", "pressure_pa"),
    [
        ((1.0,), (1.0,)),
        ((1.0, 2.0), (1.0,)),
        ((2.0, 1.0), (0.0, 1.0)),
        ((1.0, 2.0), (1.0, 0.0)),
        ((0.0, np.nan), (0.0, 1.0)),
    ],
)
def test_curves_that_are_none(counts, pressure_pa) -> None:
    with pytest.raises(ValueError, match="expected"):
        Curve(counts, pressure_pa)


def test_a_calibration_for_other_matrices() -> None:
    with pytest.raises(ValueError, match="each of 3 matrices"):
        to_pressure([pad()] * 3, (1.0, 2.0))


def test_force_is_the_sum_of_pressure_times_area_counted_once() -> None:
    counts = pad(r2c3=500, r2c4=500, r9c0=1000)
    contact = pad_contact(counts, counts * 100.0, MATRIX)
    assert contact.area_m2 == pytest.approx(3 * TEXEL_M2)
    assert contact.force_n == pytest.approx(200_000 * TEXEL_M2)
    assert contact.peak_pa == 100_000.0


def test_uniform_pressure_is_force_over_area() -> None:
    contact = pad_contact(np.full((13, 6), 50, np.uint16), np.full((13, 6), 2000.0), MATRIX)
    assert contact.force_n / contact.area_m2 == pytest.approx(2000.0)
    assert contact.center_m == pytest.approx((0.0, 0.0), abs=1e-12)


def test_the_centre_of_pressure_is_in_the_pads_frame() -> None:
    """x along a row from its middle, y along a column from its middle."""
    one = pad_contact(pad(r12c5=100), pad(r12c5=100) * 1.0, MATRIX)
    two = pad_contact(counts := pad(r6c0=100, r6c1=300), counts * 1.0, MATRIX)
    assert one.center_m == pytest.approx((2.5 * 0.003, 6 * 0.004))
    assert two.center_m == pytest.approx(((-2.5 * 0.25 - 1.5 * 0.75) * 0.003, 0.0))


@pytest.mark.parametrize(("count", "touches"), [(CONTACT_COUNTS, False), (CONTACT_COUNTS + 1, True)])
def test_what_counts_as_contact(count: int, touches: bool) -> None:
    counts = pad(r1c1=count)
    contact = pad_contact(counts, counts * 1.0, MATRIX)
    assert (contact.area_m2 > 0) == (contact.force_n > 0) == touches
    assert np.isnan(contact.center_m).all() == (not touches)


def test_pads_by_name() -> None:
    assert [Pad.of_matrix(matrix).name for matrix in range(6)] == [
        "finger_0_proximal",
        "finger_0_distal",
        "thumb_proximal",
        "thumb_distal",
        "finger_2_proximal",
        "finger_2_distal",
    ]
    assert [Pad.of_matrix(matrix).matrix for matrix in range(6)] == list(range(6))
    ipa_order = (2, 3, 4, 5, 0, 1)  # matrices in IPA's ROS messages: thumb, finger 1, finger 2, each proximal, distal
    assert [Pad.of_matrix(matrix).finger for matrix in ipa_order] == [1, 1, 2, 2, 0, 0]
