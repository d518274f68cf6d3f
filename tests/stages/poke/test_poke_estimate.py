"""What is concluded from a fit of pokes, for any range of beta and any best value in it."""

import dataclasses
import types
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deformscope.arrays import FloatArray
from deformscope.stages.fit.search import beta_of
from deformscope.stages.msm.poke import Law, Tip
from deformscope.stages.msm.solver import Precision
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_estimate import Profile, conclude, neighbouring_values
from deformscope.stages.poke.poke_fit import PokesFit, SeenPoke, ShapeFit, fit_pokes, seen_poke
from tests.stages.pokes import SPACING, poked, surface

PRECISIONS: tuple[Precision, ...] = ("float32", "float64")
POINTS = np.column_stack([np.linspace(0.0, 0.05, 6), np.zeros(6), np.zeros(6)])


class LinearPoke:
    """A posed poke whose surface error is proportional to how far beta is from the best one."""

    def __init__(self, best: float, slope: float) -> None:
        moved = np.tile([0.0, 0.0, -0.001], (len(POINTS), 1))
        self.poke = SeenPoke(
            POINTS[0], Tip("flat", (0.02, 0.02)), 0.002, POINTS[:1], moved[:1], POINTS, moved, None, None
        )
        self.places, self.best, self.slope = POINTS, best, slope
        self.asked: list[float] = []

    def settle(self, laws: Sequence[Law]) -> Any:
        self.asked += [law.beta for law in laws]
        return types.SimpleNamespace(law=laws)

    def residual(self, state: Any) -> FloatArray:
        away = np.array([law.beta - self.best for law in state.law]) * self.slope + 0.01
        return np.asarray(away[:, None, None] * np.ones((1, *POINTS.shape)))

    def moved(self, state: Any) -> FloatArray:
        return np.asarray(self.residual(state) * self.poke.depth + self.poke.moved)

    def reaction(self, state: Any) -> FloatArray:
        return np.array([1.0 - 0.5 * law.beta for law in state.law])


def fit_of(best: float, beta_range: tuple[float, float], slope: float) -> PokesFit:
    posed: Any = LinearPoke(best, slope)
    shape = ShapeFit(Law(best, 0.5, 3), np.array([0.01]), np.array([np.nan]), np.array([1.0]), True)
    found = MeasuredSurface(np.array([[0.0, 0.0, 0.03], [0.1, 0.0, 0.03], [0.0, 0.1, 0.03], [0.1, 0.1, 0.03]]), 0.03)
    return PokesFit(found, (posed.poke,), 0.01, (shape,), np.array([0]), (posed,), beta_range, False)


@settings(max_examples=100, deadline=None)
@given(
    ends=st.tuples(st.floats(0.0, 0.99), st.floats(0.0, 0.99)).filter(lambda ends: abs(ends[1] - ends[0]) > 1e-6),
    share=st.floats(0.0, 1.0),
    slope=st.sampled_from([0.0, 0.005, 0.02, 20.0]),
)
@example(ends=(0.0, 0.9), share=0.95, slope=0.005)  # of the low end and then of the high one
@example(ends=(0.0, 0.99), share=0.9755 / 0.99, slope=0.005)
@example(ends=(0.0, 0.99), share=1.0, slope=0.005)
def test_any_range_with_any_best_value_has_a_posterior_over_that_range(
    ends: tuple[float, float], share: float, slope: float
) -> None:
    low, high = min(ends), max(ends)
    profile = Profile(fit_of(float(np.clip(low + share * (high - low), low, high)), (low, high), slope))
    assert np.all(np.diff(profile.stretched) > 1e-9)
    assert np.all((low <= profile.beta) & (profile.beta <= high))
    posterior, rise = profile.posterior()
    assert np.isfinite(posterior.density).all()
    assert np.isfinite(rise)
    assert np.trapezoid(posterior.density, posterior.parameter) == pytest.approx(1.0)
    if slope == 0.0:  # where the data say nothing every value of the range is looked at
        assert (posterior.parameter[0], posterior.parameter[-1]) == (low, high)


def test_no_value_is_simulated_twice() -> None:
    fit = fit_of(0.9755, (0.0, 0.99), 0.005)
    profile = Profile(fit)
    posed: Any = fit.posed[0]
    for beta in np.setdiff1d(profile.beta, fit.best.law.beta):
        assert posed.asked.count(float(beta)) == 1


def test_values_beside_keep_off_the_ends() -> None:
    np.testing.assert_allclose(
        neighbouring_values(1.0, 0.0, 3.0), 1.0 + np.array([-0.9, -0.45, -0.2, 0.0, 0.2, 0.45, 0.9])
    )
    for at in (0.45, 0.45 + 1e-15, 2.1 - 1e-12):
        assert np.diff(neighbouring_values(at, 0.0, 2.3)).min() > 0.009
    np.testing.assert_array_equal(neighbouring_values(0.5, 0.4999, 0.5001)[[0, -1]], [0.4999, 0.5001])


def test_bounds_are_met_exactly() -> None:
    """Of the hundredths, 1 - exp(log(1 - beta)) is not beta for 0.23, 0.24, 0.25, 0.31, 0.33, 0.45 and 0.67."""
    for low, high in zip(np.arange(0, 60) / 100, np.arange(1, 61) / 100, strict=True):
        stretched = np.linspace(-np.log1p(-low), -np.log1p(-high), 7)
        found = beta_of(stretched, (low, high))
        assert (found[0], found[-1]) == (low, high)
        np.testing.assert_allclose(found, -np.expm1(-stretched), rtol=1e-12)


def test_beta_is_sought_in_the_range_that_is_asked_for() -> None:
    """The best value of a range that does not hold the truth is at the end next to it, and the verdict says so."""
    seen = seen_poke(poked((0.09, 0.08)))  # of beta 0.45
    found = fit_pokes(surface(), [seen], spacing=SPACING, cluster_sizes=[3], theta=0.7, beta_range=(0.0, 0.3))
    assert found.best.law.beta == pytest.approx(0.3, abs=2e-3)
    estimate = conclude(found, level=0.9, settings={}, provenance={}).estimate
    assert estimate.bounds == (0.0, 0.3)
    assert estimate.interval[1] == 0.3
    assert estimate.verdict in ("at-bound", "unidentified")


def test_an_interval_from_beta_0_on_does_not_hang_on_rounding() -> None:
    """At beta = 0 theta does nothing: next to it what theta does is rounding alone."""
    seen = seen_poke(poked((0.09, 0.08), law=Law(0.0, 0.0, 3), noise=1e-4))
    ends = []
    for precision in PRECISIONS:
        fit = fit_pokes(surface(), [seen], spacing=SPACING, cluster_sizes=[3], precision=precision)
        assert fit.best.law.beta < 1e-3
        fit = dataclasses.replace(fit, tried=(dataclasses.replace(fit.best, law=Law(5e-7, 1.0, 3)),))
        ends.append(conclude(fit, level=0.9, settings={}, provenance={}).estimate.interval)
    assert 0.01 < ends[1][1] < 0.6
    assert ends[0] == pytest.approx(ends[1], rel=0.02, abs=1e-3)
