"""What is taken for granted of a touch's error."""

import numpy as np
import pytest
from scipy.stats import lognorm

from deformscope.errors import InputError
from deformscope.stages.regions.touches import LAW_SD, TouchErrorModel


def test_the_scatters_that_are_summed_over_are_the_prior_s() -> None:
    """Mean and mean square of the grid against the log-normal distribution it stands for."""
    model = TouchErrorModel(0.05, 0.5, 0.0)
    scatter, weight = model.scatters()
    expected = lognorm(0.5, scale=0.05)
    assert weight.sum() == pytest.approx(1.0)
    assert weight @ scatter == pytest.approx(expected.mean(), rel=0.03)
    assert weight @ scatter**2 == pytest.approx(expected.moment(2), rel=0.1)
    assert model.touch_sd == pytest.approx(np.sqrt(LAW_SD**2 + weight @ scatter**2))
    known, one = TouchErrorModel(0.05, 0.0).scatters()
    assert (known.tolist(), one.tolist()) == ([0.05], [1.0])


def test_deviations_that_make_no_sense_are_refused() -> None:
    for wrong in ({"scatter_median": 0.0}, {"scatter_spread": -0.1}, {"gain_sd": -0.1}):
        with pytest.raises(InputError, match="scatter above 0"):
            TouchErrorModel(**wrong)
