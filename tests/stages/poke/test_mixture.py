"""Quantiles of mixtures against closed forms and a root finder."""

from functools import partial

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr, stdtr
from scipy.stats import norm, t

from deformscope.stages.poke.stiffness_field import quantile


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_one_component_has_its_own_quantiles(share: float) -> None:
    mean, deviation = np.array([[1.0, -2.0]]), np.array([[0.5, 3.0]])
    found = quantile(mean, deviation, np.ones(1), share)
    np.testing.assert_allclose(found, norm.ppf(share, mean[0], deviation[0]), atol=1e-6)
    heavy = quantile(mean, deviation, np.ones((1, 2)), share, below=partial(stdtr, 4.0))
    np.testing.assert_allclose(heavy, t.ppf(share, 4.0, mean[0], deviation[0]), atol=1e-6)


def test_of_several_components_the_shares_add_up() -> None:
    mean, deviation, weight = np.array([0.0, 5.0, 6.0]), np.array([1.0, 0.2, 2.0]), np.array([0.3, 0.5, 0.2])
    found = quantile(mean[:, None], deviation[:, None], weight, 0.4)
    wanted = brentq(lambda x: float(weight @ ndtr((x - mean) / deviation)) - 0.4, -9.0, 9.0)
    assert found[0] == pytest.approx(wanted, abs=1e-6)


def test_weights_may_differ_from_value_to_value() -> None:
    mean, deviation = np.array([[0.0, 0.0], [10.0, 10.0]]), np.full((2, 2), 0.1)
    found = quantile(mean, deviation, np.array([[1.0, 0.0], [0.0, 1.0]]), 0.5)
    np.testing.assert_allclose(found, [0.0, 10.0], atol=1e-6)


def test_quantiles_of_a_mixture_are_those_of_its_draws() -> None:
    rng = np.random.default_rng(0)
    mean, deviation = rng.normal(0.0, 1.0, (3, 2, 2)), rng.uniform(0.2, 1.0, (3, 2, 2))
    weight = np.array([0.5, 0.3, 0.2])
    which = rng.choice(3, 40_000, p=weight)
    draws = mean[which] + deviation[which] * rng.standard_normal((40_000, 2, 2))
    for share in (0.05, 0.5, 0.9):
        np.testing.assert_allclose(
            quantile(mean, deviation, weight, share), np.quantile(draws, share, axis=0), atol=0.04
        )
