"""Errors between simulated and observed particles, by hand."""

import numpy as np

from deformscope.stages.fit.model import distances, nearest_error


def test_distances_by_hand() -> None:
    observed = np.array([[0.0, 0.0], [1.0, 0.0]])
    simulated = np.array([[[3.0, 4.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 2.0]]])
    np.testing.assert_allclose(distances(simulated, observed), [[5.0, 0.0], [0.0, 2.0]])


def test_nearest_error_is_one_sided() -> None:
    simulated = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    observed = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    assert nearest_error(simulated, observed) == 0.5
    assert nearest_error(observed, simulated) > 10.0
