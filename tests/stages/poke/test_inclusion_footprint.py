"""What an inclusion below the surface does to touches above it."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.poke.inclusion_footprint import (
    POISSON,
    contact_radius,
    contrast_share,
    energy_density,
    footprint,
    inclusion_shift,
)

CONTACT_M = 0.009


def test_all_foam_stores_the_work_of_hertz() -> None:
    """Twice the energy is force times the mean dent under the pressure, 0.8 of its deepest; the grid leaves out what is
    within a tenth of the contact radius of the surface."""
    along, down = np.geomspace(0.02, 50.0, 300), np.geomspace(0.1, 50.0, 300)
    density = energy_density(*np.meshgrid(along, down, indexing="ij")) * 2.0 * np.pi * along[:, None]
    assert 0.66 < np.trapezoid(np.trapezoid(density, down, axis=1), along) < 0.8


def test_far_away_it_is_a_point_load_s() -> None:
    """Boussinesq's stresses on the axis: sz = 3 / 2 pi z^2, sr = -(1 - 2 nu) / 4 pi z^2, of a unit force."""
    z = 20.0
    upright, aside = 3.0 / (2.0 * np.pi * z**2), -(1.0 - 2.0 * POISSON) / (4.0 * np.pi * z**2)
    twice = (1.0 + POISSON) * (upright**2 + 2.0 * aside**2) - POISSON * (upright + 2.0 * aside) ** 2
    expected = twice / (0.75 * (1.0 - POISSON**2))
    assert float(energy_density(np.array([0.1]), np.array([z]))[0]) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("times", "share"), [(1.0, 0.0), (1e9, 2.0), (0.0, -2.0), (3.0, 1.0), (1.0 / 3.0, -1.0)])
def test_a_contrast_saturates(times: float, share: float) -> None:
    assert contrast_share(times) == pytest.approx(share, abs=1e-6)


def test_it_falls_with_depth_and_aside_and_grows_with_the_lump() -> None:
    felt = footprint(
        CONTACT_M, np.array([0.01, 0.02, 0.03]), np.array([0.01, 0.015, 0.02]), np.array([0.0, 0.01, 0.015])
    )
    assert felt.shape == (3, 3, 3)
    for axis, sign in ((0, 1.0), (1, -1.0), (2, -1.0)):
        assert (sign * np.diff(felt, axis=axis) > 0.0).all()


def test_as_finite_elements_have_it() -> None:
    """A ball of 2 cm radius 1 and 2 cm deep, 10 times as stiff, in 7 cm of foam under 5 N (`buried_world`, on one scene
    for tuning): what touches right above, 1, 2 and 3 cm beside it felt; within 0.3 of the most, and a tenth deep."""
    measured = [[0.2427, 0.1954, 0.0989, 0.0355], [0.0922, 0.0787, 0.0493, 0.0236]]
    felt = footprint(0.01019, np.array([0.02]), np.array([0.01, 0.02]), np.array([0.0, 0.01, 0.02, 0.03]))[0]
    shift = inclusion_shift(contrast_share(10.0), felt)
    np.testing.assert_allclose(shift[0], measured[0], atol=0.3 * measured[0][0])
    np.testing.assert_allclose(shift[1], measured[1], atol=0.1 * measured[1][0])


def test_a_lump_and_its_opposite_shift_by_about_as_much() -> None:
    felt = footprint(CONTACT_M, np.array([0.02]), np.array([0.02]), np.array([0.0]))
    assert inclusion_shift(-1.0, felt) == pytest.approx(-inclusion_shift(1.0, felt), rel=0.1)


def test_it_refuses_what_cannot_be() -> None:
    assert contact_radius(0.01, 0.01) == pytest.approx(0.01)
    with pytest.raises(InputError, match="radius above 0"):
        footprint(0.0, np.array([0.02]), np.array([0.01]), np.array([0.0]))
    with pytest.raises(InputError, match="ratio of moduli"):
        contrast_share(-1.0)
