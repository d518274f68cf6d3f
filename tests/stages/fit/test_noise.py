"""The error model: its likelihood is that of the covariance written out, and residuals identify their errors."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.noise import CORRELATIONS, MISFIT_ROUGH, SCALE_SPREAD, ErrorModel, Evidence, Measured, few
from deformscope.stages.gaussian_process import correlation
from tests.stages.bodies import lattice

SPACING = 0.01
HELD = np.array([[-SPACING, 0.0], [-SPACING, SPACING]])


def measured(shape: tuple[int, int] = (4, 5), noise: float | None = 1e-4, held: bool | None = None) -> Measured:
    """A lattice with two prescribed particles beside it."""
    rest = lattice(shape, SPACING)
    given = (None, None) if noise is None else (np.full(len(rest), noise), np.full(2, noise))
    return Measured(rest, HELD, *given, held, SPACING, 1e-12)


def response(count: int, seed: int = 0) -> FloatArray:
    """What steps of the four held coordinates do to the particles: anything."""
    return np.random.default_rng(seed).normal(0.0, 0.4, (count, 2, 4))


def weights(found: Evidence) -> FloatArray:
    """(h,) probability of the hypotheses, for the first residual."""
    return np.asarray(np.exp(found.log_likelihood[:, 0] - logsumexp(found.log_likelihood[:, 0])))


def share(model: ErrorModel, value: FloatArray, act: FloatArray, which: BoolArray) -> float:
    return float(weights(model.evidence(value[None], act))[which].sum())


def written_out(model: ErrorModel, act: FloatArray, h: int) -> FloatArray:
    """P G P^T of one hypothesis, (n d, n d)."""
    some, every = model.measured, model.hypotheses
    assert some.noise is not None
    assert some.held_noise is not None
    n = len(some.rest)
    place = np.concatenate([some.rest, HELD])
    project = np.concatenate([np.eye(2 * n), -act.reshape(2 * n, 4)], axis=1)
    field = correlation(CORRELATIONS[int(every.field[h])], cdist(place, place) / (SPACING * every.length[h]))
    if not every.shared[h]:
        own = (1.0 - MISFIT_ROUGH) * field[:n, :n] + MISFIT_ROUGH * np.eye(n)
        field = block_diag(own, np.zeros((2, 2)))
    field = field * every.size[h] * np.mean(some.noise**2)
    white = np.concatenate([some.noise**2, some.held_noise**2 if every.held[h] else np.zeros(2)])
    return np.asarray(project @ np.kron(np.diag(white) + field, np.eye(2)) @ project.T)


@pytest.mark.parametrize("uneven", [False, True])
def test_the_likelihood_is_that_of_the_covariance_written_out(uneven: bool) -> None:
    """For every hypothesis and at several scales, against scipy on P G P^T; the scale's integral by quadrature."""
    some = measured((3, 3), held=None)
    rng = np.random.default_rng(1)
    if uneven:
        some = dataclasses.replace(some, noise=1e-4 * rng.uniform(0.5, 2.0, 9), held_noise=np.array([5e-5, 3e-4]))
    model = ErrorModel(some)
    act, value = response(9), rng.normal(0.0, 1e-4, (9, 2))
    found = model.evidence(value[None], act)
    every = model.hypotheses
    t = np.linspace(-14.0, 3.0, 1701)
    rows = rng.choice(len(every.size), 12, replace=False)
    expected = []
    for h in rows:
        covariance = written_out(model, act, h)
        one = multivariate_normal(cov=covariance)
        chi2 = value.ravel() @ np.linalg.solve(covariance, value.ravel())
        values = one.logpdf(value.ravel()) + 0.5 * chi2 * (1.0 - np.exp(-2.0 * t)) - 18.0 * t
        level = -0.5 * np.log1p(every.size[h])  # where the statement means all of the noise, not the white alone
        prior = np.exp(-0.5 * ((t - np.clip(t, level, 0.0)) / SCALE_SPREAD) ** 2)
        prior /= np.trapezoid(prior, t)
        expected.append(logsumexp(values + np.log(prior)) + every.log_prior[h])
    got = found.log_likelihood[rows, 0]
    # Laplace's integral is good to some percent for 18 numbers; both lack the same constants
    np.testing.assert_allclose(got - got[0], np.array(expected) - expected[0], atol=0.05)


def test_projections_have_the_covariance_written_out() -> None:
    some = measured((3, 3), held=None)
    assert some.noise is not None
    assert some.held_noise is not None
    model, act = ErrorModel(some), response(9)
    onto = np.random.default_rng(8).normal(0.0, 1.0, (9, 2, 3))
    every = model.hypotheses
    rows = np.random.default_rng(9).choice(len(every.size), 20, replace=False)
    found = model.projected(onto, act, rows, np.zeros((0, 0)))
    for got, h in zip(found, rows, strict=True):
        s = onto.reshape(18, 3)
        expected = s.T @ written_out(model, act, h) @ s
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_white_residuals_of_the_stated_size_need_no_field() -> None:
    model = ErrorModel(measured((8, 8), held=False))
    value = np.random.default_rng(2).normal(0.0, 1e-4, (64, 2))
    assert share(model, value, np.zeros((64, 2, 0)), model.hypotheses.size == 0.0) > 0.6


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
def test_a_wrong_noise_level_is_corrected_by_the_residuals(factor: float) -> None:
    model = ErrorModel(measured((8, 8), noise=1e-4, held=False))
    found = model.evidence(np.random.default_rng(3).normal(0.0, factor * 1e-4, (64, 2))[None], np.zeros((64, 2, 0)))
    best = int(found.log_likelihood[:, 0].argmax())
    assert model.hypotheses.size[best] == 0.0
    assert np.exp(found.log_scale[best, 0]) == pytest.approx(factor, rel=0.15)


def test_the_statement_counts_where_residuals_are_few() -> None:
    """One particle at 0.3 of the stated noise: the likeliest t solves 2 (0.09 exp(-2 t) - 1) = t, by hand -0.90."""
    found = ErrorModel(measured((1, 1), held=False)).evidence(np.full((1, 1, 2), 3e-5), np.zeros((1, 2, 0)))
    assert found.log_scale[0, 0] == pytest.approx(-0.90, abs=0.02)  # the residuals alone would say log(0.3) = -1.20
    assert found.log_scale_deviation[0, 0] > 0.4


def test_residuals_far_below_the_statement_do_not_correct_it() -> None:
    model = ErrorModel(measured((6, 6), held=False))
    found = model.evidence(np.random.default_rng(4).normal(0.0, 1e-7, (1, 36, 2)), np.zeros((36, 2, 0)))
    np.testing.assert_array_equal(found.log_scale, 0.0)


def test_unknown_noise_is_read_off_the_residuals() -> None:
    model = ErrorModel(measured((8, 8), noise=None, held=False))
    found = model.evidence(np.random.default_rng(5).normal(0.0, 3e-4, (1, 64, 2)), np.zeros((64, 2, 0)))
    assert weights(found) @ np.exp(found.log_scale[:, 0]) == pytest.approx(3e-4, rel=0.2)


@pytest.mark.parametrize("field", [0, 1, 2])
def test_noise_that_neighbours_share_is_recognised(field: int) -> None:
    some = measured((8, 8), held=False)
    covariance = correlation(CORRELATIONS[field], cdist(some.rest, some.rest) / (1.5 * SPACING)) + 1e-3 * np.eye(64)
    value = 1e-4 * np.linalg.cholesky(covariance) @ np.random.default_rng(6).standard_normal((64, 2))
    model = ErrorModel(some)
    assert share(model, value, np.zeros((64, 2, 0)), model.hypotheses.size > 0.0) > 0.99


def test_held_noise_is_reported_from_exact_held_positions() -> None:
    """Noise of held positions moves all particles together: the residuals say whether it was there."""
    rng = np.random.default_rng(7)
    act = np.zeros((64, 2, 4))
    act[:, 0, 0] = act[:, 1, 1] = 1.0
    act[:, 0, 2] = act[:, 1, 3] = np.linspace(-1.0, 1.0, 64)
    exact = rng.normal(0.0, 1e-4, (64, 2))
    model = ErrorModel(measured((8, 8)))
    assert share(model, exact, act, model.hypotheses.held) < 0.4
    assert share(model, exact + np.array([2e-4, -1.5e-4]), act, model.hypotheses.held) > 0.9


def test_a_field_that_all_share_tells_nothing_of_what_follows_the_held_ones() -> None:
    """A common shift of free and held particles, the latter carrying the former along, leaves no residual: likely under
    a shared field however large, whereas the same shift of the free ones alone is not."""
    act = np.zeros((20, 2, 4))
    act[:, 0, [0, 2]] = act[:, 1, [1, 3]] = 0.5
    model = ErrorModel(measured(held=True))
    every = model.hypotheses
    found = model.evidence(np.zeros((1, 20, 2)), act)
    long = (every.length == 5.0) & (every.size > 50.0) & (every.size < 200.0)
    shared, alone = (found.log_likelihood[long & kind, 0].max() for kind in (every.shared, ~every.shared))
    assert shared > alone + 1.0


@pytest.mark.parametrize("held", [None, False])
def test_sums_of_residuals_are_judged_as_residuals(held: bool | None) -> None:
    """And so are the fewer that they are made of."""
    rng = np.random.default_rng(10)
    model, act = ErrorModel(measured((3, 3), held=held)), response(9)
    mix = rng.normal(0.0, 1.0, (6, 5))
    residual = 1e-4 * np.tensordot(rng.normal(0.0, 1.0, (5, 3)), rng.normal(0.0, 1.0, (3, 9, 2)), 1)
    expected = model.evidence(np.tensordot(mix, residual, 1), act)
    fewer, shares = few(residual, mix)
    assert len(fewer) == 3
    for some, by in ((residual, mix), (fewer, shares)):
        found = model.evidence(some, act, mix=by)
        np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, rtol=1e-8, atol=1e-6)
        np.testing.assert_allclose(found.log_scale, expected.log_scale, atol=1e-8)
