"""Fields from a few touches: an exact process, sure of no more than its touches allow."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from deformscope.errors import InputError
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.map.field import FieldPrior, _Fit, fit_field
from deformscope.stages.regions.touches import MapGrid

SIZE = np.array([0.6, 0.4])


def test_mean_and_deviation_are_those_of_another_library() -> None:
    rng = np.random.default_rng(0)
    places, value, sd = rng.uniform(size=(30, 2)) * SIZE, rng.normal(size=30), rng.uniform(0.05, 0.2, 30)
    nugget, fit = 0.1, _Fit(places, value, sd, FieldPrior(level_sd=1.5))
    x = np.log([0.6, 0.12, nugget])
    field = fit.field(x, [(x, 1.0)])
    theirs = GaussianProcessRegressor(
        ConstantKernel(0.36) * RBF(0.12) + ConstantKernel(1.5**2), alpha=sd**2 + nugget**2, optimizer=None
    ).fit(places, value - field.level)
    grid = MapGrid((0.6, 0.4), 0.02)
    mean, deviation = theirs.predict(grid.centres_m, return_std=True)
    found = field.on(grid)
    np.testing.assert_allclose(found.mean.ravel(), mean + field.level, atol=1e-9)
    np.testing.assert_allclose(found.deviation.ravel(), deviation, rtol=1e-6)
    assert fit.likelihood(x)[0] == pytest.approx(theirs.log_marginal_likelihood_value_, rel=1e-9)


def test_slopes_of_the_likelihood_are_its_differences() -> None:
    rng = np.random.default_rng(1)
    fit = _Fit(rng.uniform(size=(12, 2)) * SIZE, rng.normal(size=12), rng.uniform(0.05, 0.2, 12), FieldPrior())
    x = np.log([0.5, 0.1, 0.2])
    differences = [(fit.likelihood(x + e)[0] - fit.likelihood(x - e)[0]) / 2e-5 for e in np.eye(3) * 1e-5]
    np.testing.assert_allclose(fit.likelihood(x)[1], differences, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("touches", [3, 8, 30])
def test_nine_in_ten_true_values_lie_in_the_90_per_cent_bands_however_few_the_touches(touches: int) -> None:
    """Truth drawn from the priors, hyper-parameters too."""
    prior = FieldPrior()
    inside, likeliest = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        sigma_e, length, nugget = np.exp(prior.median() + prior.spread() * rng.normal(size=3))
        every = rng.uniform(size=(touches + 80, 2)) * SIZE
        covariance = Kernel.of_length(sigma_e, length).between(every, every) + 1e-9 * np.eye(len(every))
        truth = 1.3 + np.linalg.cholesky(covariance) @ rng.normal(size=len(every))
        sd = rng.uniform(0.03, 0.1, touches)
        value = truth[:touches] + rng.normal(size=touches) * np.hypot(sd, nugget)
        averaged = fit_field(every[:touches], value, sd, prior)
        x = np.log([averaged.kernel.sigma_e, averaged.kernel.length_m, averaged.nugget])
        mode = _Fit(every[:touches], value, sd, prior).field(x, [(x, 1.0)])
        for field, into in ((averaged, inside), (mode, likeliest)):
            found = field.at(every[touches:])
            into.append(np.mean(np.abs(found.mean - truth[touches:]) < 1.645 * found.deviation))
    assert 0.85 < np.mean(inside) < 0.95
    assert np.mean(likeliest) < np.mean(inside)  # what averaging is for


def test_known_hyper_parameters_come_back_from_many_touches() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(size=(250, 2)) * SIZE
    covariance = Kernel.of_length(0.8, 0.08).between(places, places) + 1e-9 * np.eye(250)
    value = np.linalg.cholesky(covariance) @ rng.normal(size=250) + rng.normal(size=250) * np.hypot(0.05, 0.15)
    field = fit_field(places, value, np.full(250, 0.05), FieldPrior())
    assert field.kernel.length_m == pytest.approx(0.08, rel=0.15)
    assert field.kernel.sigma_e == pytest.approx(0.8, rel=0.35)
    assert field.nugget == pytest.approx(0.15, rel=0.2)


def test_replicates_tell_the_nugget() -> None:
    rng = np.random.default_rng(4)
    places = np.repeat([[0.1, 0.1], [0.5, 0.3]], 20, axis=0)
    value = rng.normal(size=40) * 0.3
    within = np.sqrt(value.reshape(2, 20).var(axis=1, ddof=1).mean())
    scatter = fit_field(places, value, np.full(40, 0.01), FieldPrior())
    steady = fit_field(places, rng.normal(size=40) * 0.01, np.full(40, 0.01), FieldPrior())
    assert scatter.nugget == pytest.approx(within, rel=0.1)
    assert steady.nugget < 0.03


def test_a_touch_with_a_large_deviation_counts_little() -> None:
    places = np.array([[0.3, 0.2], [0.301, 0.2]])
    value = np.array([0.0, 1.0])
    sure_of_the_first = fit_field(places, value, np.array([0.02, 0.6]), FieldPrior()).at(places[:1]).mean[0]
    sure_of_the_second = fit_field(places, value, np.array([0.6, 0.02]), FieldPrior()).at(places[:1]).mean[0]
    assert sure_of_the_first < 0.2
    assert sure_of_the_second > 0.8


def test_one_touch_makes_a_field_that_knows_how_little_it_knows() -> None:
    field = fit_field(np.array([[0.3, 0.2]]), np.array([0.7]), np.array([0.05]), FieldPrior())
    here, far = field.at(np.array([[0.3, 0.2], [0.0, 0.0]])).deviation
    assert field.at(np.array([[0.3, 0.2]])).mean[0] == pytest.approx(0.7, abs=0.01)
    assert here < 0.2
    assert far > 0.4


@pytest.mark.parametrize(
    ("places", "value", "sd"),
    [
        (np.zeros((0, 2)), np.zeros(0), np.zeros(0)),
        (np.zeros((2, 2)), np.zeros(3), np.zeros(3)),
        (np.zeros((2, 2)), np.array([0.0, np.nan]), np.ones(2)),
        (np.zeros((2, 2)), np.zeros(2), np.array([1.0, np.inf])),
    ],
)
def test_what_makes_no_field_is_refused(places: np.ndarray, value: np.ndarray, sd: np.ndarray) -> None:
    with pytest.raises(InputError):
        fit_field(places, value, sd, FieldPrior())
