"""How sure several parameters are: known covariances, and no knowledge of what does nothing."""

import numpy as np

from deformscope.stages.fit.least_squares import Noise
from deformscope.stages.fit.noise import independent, shared_over

NONE_HELD = np.zeros((0, 40))


def test_the_covariance_is_that_of_least_squares() -> None:
    jacobian = np.random.default_rng(0).normal(size=(40, 3)) * [1.0, 1e-3, 50.0]
    found = Noise(0.2, NONE_HELD).covariance(jacobian)
    np.testing.assert_allclose(found, 0.04 * np.linalg.inv(jacobian.T @ jacobian), rtol=1e-9)
    np.testing.assert_allclose(Noise(0.2, NONE_HELD, 5.0).covariance(jacobian), 5.0 * found, rtol=1e-9)


def test_a_parameter_that_does_nothing_is_not_known_and_leaves_the_others_as_they_are() -> None:
    rng = np.random.default_rng(1)
    jacobian = rng.normal(size=(40, 3))
    jacobian[:, 1] = 0.0
    held = 1e-3 * rng.normal(size=(20, 40))
    found = Noise(1e-6, held).covariance(jacobian)
    others = Noise(1e-6, held).covariance(jacobian[:, [0, 2]])
    assert found[1, 1] > 1e12
    np.testing.assert_allclose(found[np.ix_([0, 2], [0, 2])], others, rtol=1e-6)
    assert np.all(np.diag(Noise(1e-6, NONE_HELD).covariance(np.zeros((40, 2)))) > 1e3)


def test_two_parameters_that_do_the_same_are_both_unknown() -> None:
    rng = np.random.default_rng(2)
    one = rng.normal(size=40)
    found = Noise(1e-6, NONE_HELD).covariance(np.column_stack([one, -2.0 * one, rng.normal(size=40)]))
    assert np.diag(found)[:2].min() > 10.0
    assert found[2, 2] < 1e-12


def test_errors_are_shared_over_the_length_of_their_field_and_noise_over_none() -> None:
    rng = np.random.default_rng(3)
    points = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    away = np.linalg.norm(points[:, None] - points, axis=2)
    smooth = np.linalg.cholesky(np.exp(-away / 3.0) + 1e-9 * np.eye(400)) @ rng.normal(size=(400, 2))
    assert 1.5 < shared_over(points, smooth, 1.0) < 5.0
    assert sum(shared_over(points, rng.normal(size=(400, 2)), 1.0) > 0.0 for _ in range(40)) <= 6
    assert independent(points, 3.0) < 40.0
    assert shared_over(points, np.zeros((400, 2)), 1.0) == 0.0
