"""Posteriors with known answers, the sets read off them, and verdicts in words."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.stats import norm

from deformscope.stages.fit import estimate
from deformscope.stages.fit.doubts import little_explained
from deformscope.stages.fit.inference import spline_between


def gaussian(mean: float, deviation: float, low: float = 0.0, high: float = 1.0) -> estimate.Posterior:
    grid = np.linspace(low, high, 4001)
    density = norm.pdf(grid, mean, deviation)
    return estimate.Posterior(grid, density / np.trapezoid(density, grid))


def test_the_shortest_set_of_a_gaussian_is_central() -> None:
    low, high = gaussian(0.5, 0.05).shortest(0.9, 0.5)
    assert low == pytest.approx(0.5 - 1.6449 * 0.05, abs=1e-3)
    assert high == pytest.approx(0.5 + 1.6449 * 0.05, abs=1e-3)


def test_a_density_that_falls_from_a_bound_gives_a_one_sided_set() -> None:
    low, high = gaussian(0.0, 0.05).shortest(0.9, 0.01)
    assert low == 0.0
    assert high == pytest.approx(1.6449 * 0.05, abs=1e-3)


@pytest.mark.parametrize("value", [0.3, 0.4, 0.45, 0.5, 0.58, 0.61, 0.9])
def test_the_set_holds_the_estimate_and_its_mass(value: float) -> None:
    posterior = gaussian(0.5, 0.05)
    low, high = posterior.shortest(0.9, value)
    assert low <= value <= high
    assert posterior.rank(high) - posterior.rank(low) == pytest.approx(0.9, abs=0.003)


def test_an_estimate_far_out_begins_or_ends_the_set() -> None:
    low, high = gaussian(0.5, 0.02).shortest(0.9, 0.2)
    assert low == 0.2
    assert high == pytest.approx(norm.ppf(0.9, 0.5, 0.02), abs=1e-3)


@pytest.mark.parametrize("mode", [0.5, 0.5001, 0.50017, 0.5003])
def test_the_mode_lies_between_the_values_of_the_grid(mode: float) -> None:
    grid = np.linspace(0.45, 0.55, 101)
    assert estimate.Posterior(grid, norm.pdf(grid, mode, 0.01)).mode() == pytest.approx(mode, abs=1e-9)


def test_the_mode_may_be_a_bound() -> None:
    assert gaussian(-0.1, 0.1).mode() == 0.0
    assert gaussian(1.2, 0.1).mode() == 1.0


def test_ranks_and_quantiles_are_inverse() -> None:
    posterior = gaussian(0.3, 0.1)
    for mass in (0.05, 0.5, 0.95):
        assert posterior.rank(float(posterior.quantile(mass))) == pytest.approx(mass, abs=1e-6)
    assert posterior.deviation() == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(
    ("ends", "reported", "expected"),
    [
        ((0.4, 0.5), estimate.Identifiability(9.0, 0.9, 0.03, 0.0), "identified"),
        ((0.4, 0.5), estimate.Identifiability(1.0, 0.9, 0.03, 0.0), "unidentified"),
        ((0.4, 0.5), estimate.Identifiability(9.0, 0.1, 0.03, 0.0), "unidentified"),
        ((0.9, 0.99), estimate.Identifiability(9.0, -1.0, 0.03, 0.0), "unidentified"),
        ((0.0, 0.1), estimate.Identifiability(9.0, 0.9, 0.03, 0.0), "at-bound"),
    ],
)
def test_a_verdict_needs_data_that_tell(
    ends: tuple[float, float], reported: estimate.Identifiability, expected: estimate.Verdict
) -> None:
    assert estimate.verdict(ends, (0.0, 0.99), reported) == expected


def test_a_quantity_without_bounds_needs_data_that_tell_too() -> None:
    assert estimate.relative_verdict(10.0, (9.5, 10.5)) == "identified"
    assert estimate.relative_verdict(10.0, (8.0, 13.0)) == "weak"
    assert estimate.relative_verdict(10.0, (8.0, float("inf"))) == "unidentified"
    assert estimate.relative_verdict(10.0, (9.5, 10.5), tuple(little_explained(0.2))) == "unidentified"
    assert estimate.relative_verdict(10.0, (9.5, 10.5), tuple(little_explained(0.5))) == "weak"
    assert estimate.relative_verdict(10.0, (9.5, 10.5), tuple(little_explained(0.9))) == "identified"


def test_little_that_is_explained_comes_with_a_warning() -> None:
    assert estimate.explained_text(0.934) == "93% of the motion beyond a rigid one"
    assert "only 48% of the motion beyond a rigid one: check units" in estimate.explained_text(0.48)
    assert estimate.explained_text(-3.0).startswith("only 0%")


@pytest.mark.parametrize(
    ("ends", "kind", "words"),
    [
        ((0.58, 0.66), "identified", "identified: beta is 0.58 to 0.66"),
        ((0.4, 0.8), "weak", "weak: any beta from 0.4 to 0.8 fits"),
        ((0.6, 0.99), "at-bound", "weak, at the upper bound: any beta above 0.6 fits"),
        ((0.93, 0.99), "at-bound", "at the upper bound: any beta above 0.93 fits"),
        ((0.0, 0.1), "at-bound", "at the lower bound: any beta below 0.1 fits"),
        ((0.0, 0.95), "unidentified", "unidentified: any beta from 0 to 0.95 fits; the data do not identify it"),
    ],
)
def test_verdicts_in_words(ends: tuple[float, float], kind: estimate.Verdict, words: str) -> None:
    reported = estimate.Identifiability(9.0, 0.9, 0.03, 1e-5)
    one = estimate.Estimate(
        parameter="beta",
        value=ends[0],
        interval=ends,
        level=0.9,
        bounds=(0.0, 0.99),
        verdict=kind,
        stiffness_verdict="unidentified",
        aee=1e-4,
        aee_free=1e-4,
        nearest=1e-4,
        unit="m",
        curve=estimate.Curve(np.array([0.0, 0.99]), np.array([1e-4, 2e-4])),
        converged=True,
        settings={},
        posterior=gaussian(0.5, 0.1),
        identifiability=reported,
    )
    assert one.verdict_text() == words
    shown = one.as_json()
    assert shown["verdict_text"] == words
    assert shown["stiffness_text"] == "position alone does not identify stiffness here: give a force"
    assert len(shown["posterior"]["parameter"]) <= 121  # type: ignore[index]


@pytest.mark.parametrize(("knots", "steps"), [(25, 8), (5, 3), (4, 1)])
def test_splines_between_even_knots_are_scipys(knots: int, steps: int) -> None:
    at = np.linspace(0.1, 9.2, knots)
    fine = np.linspace(0.1, 9.2, (knots - 1) * steps + 1)
    np.testing.assert_allclose(spline_between(knots, steps), CubicSpline(at, np.eye(knots))(fine), atol=1e-14)
