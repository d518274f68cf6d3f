"""Pressures whose centre, area and force are known by arithmetic."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.see.tactile import tactile_contact

TEXEL = (3.4e-3, 2.0e-3)
"""Width, height [m]."""


def test_even_pressure_acts_in_the_middle() -> None:
    found = tactile_contact([np.full((14, 6), 1000.0)], [TEXEL])
    area = 14 * 6 * 3.4e-3 * 2.0e-3
    np.testing.assert_allclose(found.center_m, [[3 * 3.4e-3, 7 * 2.0e-3]])
    np.testing.assert_allclose(found.area_m2, [area])
    np.testing.assert_allclose(found.force_n, [1000.0 * area])
    assert found.peak_pa.tolist() == [1000.0]


def test_one_texel_is_where_it_is() -> None:
    pressure = np.zeros((5, 4))
    pressure[3, 1] = 2500.0
    found = tactile_contact([pressure], [TEXEL])
    np.testing.assert_allclose(found.center_m, [[1.5 * 3.4e-3, 3.5 * 2.0e-3]])
    np.testing.assert_allclose(found.force_n, [2500.0 * 3.4e-3 * 2.0e-3])


def test_two_texels_balance_like_weights() -> None:
    pressure = np.zeros((1, 5))
    pressure[0, 0], pressure[0, 4] = 300.0, 100.0
    np.testing.assert_allclose(tactile_contact([pressure], [(1.0, 1.0)]).center_m, [[0.5 + 4 * 0.25, 0.5]])


def test_pads_are_apart_and_noise_is_no_contact() -> None:
    felt, noisy = np.zeros((2, 2)), np.full((3, 3), 9.0)
    felt[0, 0] = 500.0
    found = tactile_contact([felt, noisy], [(1.0, 1.0), (1.0, 1.0)], threshold_pa=10.0)
    assert found.area_m2.tolist() == [1.0, 0.0]
    assert found.force_n.tolist() == [500.0, 0.0]
    assert np.isnan(found.center_m).tolist() == [[False, False], [True, True]]
    assert found.peak_pa.tolist() == [500.0, 9.0]


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="texel size for each of 1 pads"):
        tactile_contact([np.zeros((2, 2))], [])
    with pytest.raises(InputError, match="finite pressures"):
        tactile_contact([np.array([[np.nan]])], [TEXEL])
