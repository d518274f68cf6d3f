"""The 72 cells, from either end of the arrays."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.squeeze.physical import series_of, tactile_feature


def test_the_first_36_cells_are_those_of_the_thesis_and_the_last_ones_can_be_chosen() -> None:
    one, other = np.arange(78, dtype=np.uint16).reshape(13, 6), 100 + np.arange(78, dtype=np.uint16).reshape(13, 6)
    np.testing.assert_array_equal(tactile_feature([one, other]), [*range(36), *range(100, 136)])
    np.testing.assert_array_equal(tactile_feature([one, other], "last"), [*range(42, 78), *range(142, 178)])
    assert tactile_feature([one]).dtype == np.float64


def test_an_array_without_36_cells_is_refused() -> None:
    with pytest.raises(InputError, match="36 cells or more; got 30"):
        tactile_feature([np.zeros((5, 6))])


def test_a_series_has_the_newest_features_every_tenth_of_a_second() -> None:
    found_s, found = series_of(np.array([0.0, 0.04, 0.08, 0.12, 0.16, 0.25]), np.arange(6.0)[:, None])
    np.testing.assert_allclose(found_s, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(found[:, 0], [0.0, 2.0, 4.0])
