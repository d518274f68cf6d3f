"""Experiment 3.B on one foam, coarsely, and what is said of a trend."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import spearmanr

from studies.reproduce import foam_fits
from studies.reproduce import foam_fits as foams
from studies.reproduce.virtual_foams import FOAMS

COARSE = foam_fits.FoamSetup(foams=FOAMS[:1], depth_m=0.008, images=2, element_m=0.014, cluster_sizes=(2,))


@pytest.fixture(scope="module")
def seen() -> foam_fits.FoamResult:
    return foam_fits.measure(foam_fits.FoamCase(FOAMS[0], COARSE))


@pytest.mark.slow  # images of five foams
def test_flow_finds_the_true_positions(seen: foam_fits.FoamResult) -> None:
    assert seen.lost == 0
    assert np.sqrt(np.mean(seen.error_px**2)) < 0.2
    assert seen.image.shape == (COARSE.view.height, COARSE.view.width)


@pytest.mark.slow  # images of two foams
def test_flow_and_truth_agree_on_beta(seen: foam_fits.FoamResult) -> None:
    for held in foams.HELD:
        flow, true = (seen.fit(source, held, 2).estimate for source in foams.SOURCES)
        assert true.interval[0] <= flow.value <= true.interval[1]
        assert flow.converged
        assert true.converged


@pytest.mark.slow
def test_every_way_of_fitting_holds_what_it_says(seen: foam_fits.FoamResult) -> None:
    for fit in seen.fits:
        shape = fit.calibration.comparisons[0]
        top = shape.held[shape.held < COARSE.grid[1]]
        assert list(top) == ([7] if fit.held == "one" else [6, 7, 8])
        assert len(shape.held) - len(top) == COARSE.grid[1]  # all of the ground


@pytest.mark.slow
def test_force_gives_the_models_stiffness(seen: foam_fits.FoamResult) -> None:
    for fit in seen.fits:
        reported = fit.calibration.estimate.stiffness
        assert reported[1][0] <= reported[0] <= reported[1][1]
    assert seen.stiffness == pytest.approx(seen.force_n[-1] / 0.008)


@pytest.mark.slow
def test_hardness_alone_moves_nothing_and_scales_k(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foams, "CHANGES", {"hardness": (75.0, 300.0)})
    base, softer, firmer = map(foam_fits.measure_control, foam_fits.controls(COARSE))
    assert base.foam.hardness == 150.0
    assert max(softer.moved_mm(base), firmer.moved_mm(base)) < 1e-6
    assert firmer.force_n == pytest.approx(4 * softer.force_n, rel=1e-6)
    for one, two in zip(softer.fits, firmer.fits, strict=True):
        a, b = one.calibration.estimate, two.calibration.estimate
        assert b.value == pytest.approx(a.value, abs=1e-4)
        assert b.stiffness[0] == pytest.approx(4 * a.stiffness[0], rel=1e-3)


def made(seen: foam_fits.FoamResult, betas: list[tuple[float, float, float]]) -> list[foam_fits.FoamResult]:
    """The five foams with these values and intervals."""
    results = []
    for foam, (value, low, high) in zip(sorted(FOAMS, key=lambda foam: foam.hardness), betas, strict=True):
        base = seen.fit("flow", "one", 2).estimate
        estimate = dataclasses.replace(base, value=value, least_aee=(value, 0.0), interval=(low, high))
        found = dataclasses.replace(seen.fits[0].calibration, estimate=estimate, comparisons=())
        fit = dataclasses.replace(seen.fits[0], calibration=found)
        results.append(dataclasses.replace(seen, foam=foam, fits=(fit,)))
    return results


@pytest.mark.parametrize(
    ("values", "half", "reported", "correlation"),
    [
        ((0.9, 0.8, 0.7, 0.6, 0.5), 0.02, "falls with firmness", -1.0),
        ((0.5, 0.6, 0.7, 0.8, 0.9), 0.02, "rises with firmness", 1.0),
        ((0.9, 0.6, 0.7, 0.8, 0.5), 0.02, "differs, but not in the order of firmness", -0.6),
        ((0.9, 0.8, 0.7, 0.6, 0.5), 0.3, "no trend: any beta from 0.60 to 0.80 fits all", -1.0),
        ((0.0, 0.0, 0.0, 0.0, 0.0), 0.3, "no trend: any beta from -0.30 to 0.30 fits all", None),
    ],
)
def test_trend_says_no_more_than_the_intervals_allow(
    seen: foam_fits.FoamResult, values: tuple[float, ...], half: float, reported: str, correlation: float | None
) -> None:
    found = foam_fits.trend(made(seen, [(v, v - half, v + half) for v in values]), "flow", "one", 2)
    assert found.told == reported
    assert found.drop == pytest.approx(values[0] - values[-1])
    assert found.rank_correlation == (None if correlation is None else pytest.approx(correlation))


def test_rank_correlation_is_spearmans() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 9))
    assert foam_fits.rank_correlation(a, b) == pytest.approx(spearmanr(a, b).statistic)
    assert foam_fits.rank_correlation(a, np.ones(9)) is None
    assert foam_fits.rank_correlation(a[:2], b[:2]) is None
