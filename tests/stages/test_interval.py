"""The interval's parts: explanations of residuals, draws of repeats, the accepted set; on problems solved by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages import interval
from tests.stages.bodies import lattice

SPACING = 0.01


def residuals(
    value: FloatArray, noise: float | None, held_effect: FloatArray | None = None, measured: bool | None = None
) -> interval.Residuals:
    """Of an 8x8 lattice whose prescribed particle, a spacing beside it, moves the particles by `held_effect`."""
    return interval.Residuals(
        rest=lattice((8, 8), SPACING),
        value=value,
        noise=None if noise is None else np.full(64, noise),
        spacing=SPACING,
        floor=1e-12,
        held_response=np.zeros((64, 2, 2)) if held_effect is None else held_effect,
        held_deviation=np.full(2, noise or 1.0),
        held_rest=np.array([[-SPACING, 0.0]]),
        held_measured=measured,
    )


def added(left: interval.Residuals, model: interval.NoiseModel, count: int, seed: int) -> FloatArray:
    """Draws of what is added to observed - simulated, (count, 64, 2)."""
    repeats = interval.draw(left, model, count, np.random.default_rng(seed))
    return np.asarray(repeats.own - np.tensordot(repeats.held, left.held_response, (1, 2)))


def always(draws: FloatArray) -> Callable[[int], FloatArray]:
    return lambda place: draws


SOFT = np.zeros(64)


def smooth(rng: np.random.Generator, size: float) -> FloatArray:
    rest = lattice((8, 8), SPACING)
    return np.asarray(size * np.sin(rest @ rng.normal(0, 60.0, (2, 2)) + rng.uniform(0, 6, 2)))


def test_white_residuals_of_the_stated_size_need_no_misfit() -> None:
    rng = np.random.default_rng(0)
    model = interval.explain(residuals(rng.normal(0, 1e-4, (64, 2)), 1e-4))
    assert model.weight.sum() == pytest.approx(1.0)
    assert model.weight[model.misfit == 0.0].sum() > 0.6
    np.testing.assert_array_equal(model.scale, 1.0)


def test_unknown_noise_is_read_off_the_residuals() -> None:
    rng = np.random.default_rng(1)
    model = interval.explain(residuals(rng.normal(0, 3e-4, (64, 2)), None))
    assert model.weight @ model.scale == pytest.approx(3e-4, rel=0.15)


def test_smooth_residuals_are_misfit_of_their_own_size() -> None:
    rng = np.random.default_rng(2)
    value = smooth(rng, 1e-3) + rng.normal(0, 1e-5, (64, 2))
    model = interval.explain(residuals(value, 1e-5))
    assert model.weight[model.misfit > 0.0].sum() > 0.999
    assert np.sqrt(model.weight @ model.misfit) == pytest.approx(np.sqrt(np.mean(value**2)), rel=0.9)


def test_held_noise_is_told_from_exact_held_positions() -> None:
    """Noise of one held row shifts everything: the residuals say whether it was there."""
    rng = np.random.default_rng(3)
    effect = np.zeros((64, 2, 2))
    effect[:, 0, 0] = effect[:, 1, 1] = 1.0
    exact = rng.normal(0, 1e-4, (64, 2))
    shifted = exact + np.array([2e-4, -1.5e-4])
    shares = []
    for value in (exact, shifted):
        model = interval.explain(residuals(value, 1e-4, effect))
        shares.append(model.weight[model.held_share > 0].sum())
    assert shares[0] < 0.6
    assert shares[1] > 0.9


def test_draws_have_the_covariance_of_their_model() -> None:
    effect = np.zeros((64, 2, 2))
    effect[:, 0, 0] = 2.0
    left = residuals(np.zeros((64, 2)), 1e-4, effect)
    one = np.array([1.0])
    model = interval.NoiseModel(one, one, one, np.array([9e-8]), np.array([2.5]), np.array([False]))
    draws = added(left, model, 4000, 4)
    variance = draws.var(axis=0).mean(axis=0)
    np.testing.assert_allclose(variance, [1e-8 + 4e-8 + 9e-8, 1e-8 + 9e-8], rtol=0.1)
    # neighbours share the misfit by its correlation, (1 + s) exp(-s) at s = sqrt(3) / 2.5, and all of the held noise
    s = np.sqrt(3.0) / 2.5
    together = np.mean(draws[:, 27, 1] * draws[:, 28, 1])
    assert together == pytest.approx(9e-8 * (1 + s) * np.exp(-s), rel=0.15)
    assert np.mean(draws[:, 0, 0] * draws[:, 63, 0]) == pytest.approx(4e-8, rel=0.5)


def _line(parameter: FloatArray, slope: float) -> FloatArray:
    """64 particles that all move by slope * parameter along x."""
    shift = np.zeros((len(parameter), 64, 2))
    shift[:, :, 0] = slope * parameter[:, None]
    return shift


def test_accepted_set_of_a_shift_is_what_theory_says() -> None:
    """Particles shifted together: the error's minimum is near their mean, and 90 % of repeats lie within 1.645 of its
    deviation, widened by the spatial median's efficiency of pi / 4 in the plane."""
    rng = np.random.default_rng(5)
    parameter = np.linspace(0.2, 0.8, 61)
    simulated = _line(parameter, 1.0)
    clean = _line(np.array([0.5]), 1.0)[0]
    draws = rng.normal(0, 0.3, (600, 64, 2))
    widths, inside = [], []
    for _ in range(40):
        observed = clean + rng.normal(0, 0.3, (64, 2))
        low, high = interval.accepted(parameter, simulated, observed, always(draws), 0.9, SOFT)
        error = np.linalg.norm(simulated - observed, axis=2).mean(axis=1)
        assert low <= parameter[error.argmin()] <= high
        widths.append(high - low)
        inside.append(low <= 0.5 <= high)
    expected = 2 * 1.645 * 0.3 / np.sqrt(64) / np.sqrt(np.pi / 4)
    assert np.mean(widths) == pytest.approx(expected, rel=0.15)
    assert 0.78 <= np.mean(inside) <= 0.97


@pytest.mark.parametrize("level", [0.5, 0.9, 0.99])
def test_a_higher_level_gives_a_wider_set(level: float) -> None:
    rng = np.random.default_rng(6)
    parameter = np.linspace(0, 1, 101)
    simulated = _line(parameter, 1.0)
    observed = simulated[50] + rng.normal(0, 0.3, (64, 2))
    draws = rng.normal(0, 0.3, (500, 64, 2))
    low, high = interval.accepted(parameter, simulated, observed, always(draws), level, SOFT)
    wider = interval.accepted(parameter, simulated, observed, always(draws), level + 0.009, SOFT)
    assert wider[0] <= low < high <= wider[1]


def test_a_flat_curve_accepts_everything() -> None:
    rng = np.random.default_rng(7)
    parameter = np.linspace(0, 1, 31)
    simulated = _line(parameter, 1e-9)
    draws = rng.normal(0, 0.3, (200, 64, 2))
    assert interval.accepted(parameter, simulated, rng.normal(0, 0.3, (64, 2)), always(draws), 0.9, SOFT) == (0.0, 1.0)


def test_truth_at_the_bound_is_accepted_as_often_as_stated() -> None:
    rng = np.random.default_rng(8)
    parameter = np.linspace(0, 1, 26)
    simulated = _line(parameter, 1.0)
    draws = rng.normal(0, 0.6, (200, 64, 2))
    inside = []
    for _ in range(100):
        observed = simulated[0] + rng.normal(0, 0.6, (64, 2))
        inside.append(interval.accepted(parameter, simulated, observed, always(draws), 0.9, SOFT)[0] == 0.0)
    assert 0.82 <= np.mean(inside) <= 0.97


def test_a_field_that_all_particles_share_tells_nothing() -> None:
    """One prescribed particle that carries all others along: a constant error of measurement cancels."""
    effect = np.zeros((64, 2, 2))
    effect[:, 0, 0] = effect[:, 1, 1] = 1.0
    left = residuals(np.zeros((64, 2)), 1e-6, effect, measured=True)
    one = np.array([1.0])
    model = interval.NoiseModel(one, one, one, np.array([1e-4]), np.array([1000.0]), np.array([True]))
    draws = added(left, model, 200, 9)
    assert np.abs(draws).max() < 3e-3  # of fields of deviation 1e-2


def test_residuals_far_below_the_stated_noise_tell_no_more_than_it() -> None:
    rng = np.random.default_rng(10)
    parameter = np.linspace(0, 1, 31)
    simulated = _line(parameter, 1e-4)
    observed = simulated[15] + rng.normal(0, 1e-6, (64, 2))
    draws = rng.normal(0, 0.01, (300, 64, 2))
    assert interval.accepted(parameter, simulated, observed, always(draws), 0.9, np.full(64, 0.01)) == (0.0, 1.0)
    sharp = interval.accepted(parameter, simulated, observed, always(rng.normal(0, 1e-6, (300, 64, 2))), 0.9, SOFT)
    assert sharp[1] - sharp[0] < 0.1
