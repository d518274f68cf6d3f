"""Relaxation from creep, the force that is kept, and draws of many models, against closed forms."""

import numpy as np
import pytest

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.creep_spectra import Branches, Endless
from deformscope.stages.fit.relaxation import (
    DrawnModel,
    RelaxationDraws,
    draw_about_each,
    force_kept,
    kept_of,
    mean_relaxation_s,
    relaxing,
)


def draws_of(strength: FloatArray, retarded_s: FloatArray, endless: BoolArray, weight: FloatArray) -> RelaxationDraws:
    mean_s = mean_relaxation_s(strength, retarded_s)
    return RelaxationDraws(weight, strength, retarded_s, mean_s, (strength > 0.0).sum(axis=1), endless)


def test_relaxation_follows_from_creep() -> None:
    """One branch: l / (1 + j) and j / (1 + j) (Zener 1948); several: the product of transforms of E and J is 1."""
    share, time_s = relaxing(np.array([[0.5]]), np.array([[3.0]]))
    assert share[0, 0] == pytest.approx(0.5 / 1.5)
    assert time_s[0, 0] == pytest.approx(3.0 / 1.5)
    strength, retarded_s = np.array([[0.2, 0.4, 0.1, 0.0]]), np.array([[0.3, 2.0, 9.0, 1.0]])
    share, time_s = relaxing(strength, retarded_s)
    for rate in (0.05, 0.7, 4.0):
        modulus = 1.0 - share.sum() + (share * rate * time_s / (1.0 + rate * time_s)).sum()
        compliance = 1.0 + (strength / (1.0 + rate * retarded_s)).sum()
        assert modulus * compliance == pytest.approx(1.0)
    mean_s = (share * time_s).sum() / share.sum()
    assert mean_relaxation_s(strength, retarded_s)[0] == pytest.approx(mean_s)


def test_the_force_kept_is_the_integral_of_the_modulus() -> None:
    strength, retarded_s, ramp_s = np.array([[0.5]]), np.array([[3.0]]), 0.7
    after_s = np.array([0.0, 1.0, 8.0])
    gone = (np.arange(20000) + 0.5) / 20000.0
    growth = gone**0.5  # of y = (t / ramp)^1.5
    force = np.array(
        [growth @ (1.0 - (1.0 - np.exp(-(at + ramp_s * (1.0 - gone)) / 2.0)) / 3.0) for at in (0.0, *after_s)]
    )
    found = force_kept(strength, retarded_s, np.array([1.5]), ramp_s, after_s)
    assert found[0] == pytest.approx(force[1:] / force[0], abs=1e-4)
    assert found[0, 0] == 1.0
    said = kept_of(strength, retarded_s, np.array([1.5]), ramp_s, 8.0)
    assert [one.after_s for one in said] == [0.5, 1.0, 2.0, 5.0, 8.0]
    assert said[-1].share == pytest.approx(found[0, 2])


def test_what_a_record_did_not_see_is_a_reason() -> None:
    strength, weight = np.array([[0.3, 0.0], [0.2, 0.2]]), np.array([0.4, 0.6])
    never = np.zeros(2, dtype=bool)
    for slow_s, codes in ((5.0, []), (50.0, ["short-record"])):
        seen = draws_of(strength, np.array([[1.0, 1.0], [1.0, slow_s]]), never, weight).seen(8.0)
        assert [one.code for one in seen.reasons] == codes
        assert seen.within.tolist() == [True, not codes]
    endless = draws_of(strength, np.array([[1.0, 1.0], [1.0, 50.0]]), np.array([False, True]), weight).seen(8.0)
    assert [one.code for one in endless.reasons] == ["no-plateau"]
    assert endless.share == pytest.approx([0.3 / 1.3, 0.2 / 1.2]), "beyond the record nothing is counted"
    assert endless.bounded(0.4, (0.3, 0.5), 1.0) == (0.3, (0.3, 1.0))


@pytest.mark.parametrize(("unseen", "opens"), [(0.1, False), (0.3, True)])
def test_an_interval_is_open_where_the_end_may_be_unseen(unseen: float, opens: bool) -> None:
    strength, retarded_s, endless = np.full((3, 1), 0.3), np.array([[1.0], [50.0], [1.0]]), np.array([0, 0, 1], bool)
    seen = draws_of(strength, retarded_s, endless, np.array([1.0 - unseen, 0.5 * unseen, 0.5 * unseen])).seen(8.0)
    assert (seen.reasons, seen.open) == ((), opens)
    assert seen.bounded(0.4, (0.3, 0.5), 1.0) == (0.4, (0.3, 1.0 if opens else 0.5))


def test_models_are_weighed_by_their_evidence() -> None:
    """Two linear models of Gaussian data, whose evidences have a closed form; one in two choices of its prior."""
    random = np.random.default_rng(3)
    time = np.linspace(0.0, 1.0, 30)
    data = 0.6 * time + 0.3 * random.standard_normal(30)

    def model(design: np.ndarray, mean: np.ndarray, spread: np.ndarray, prior: float) -> tuple[DrawnModel, list[float]]:
        made = DrawnModel(
            mean,
            spread,
            prior,
            lambda at: (data - at @ design) / 0.3,
            lambda at: ((data - at @ design) / 0.3, np.broadcast_to(-design / 0.3, (len(at), *design.shape))),
        )
        evidence = []
        for one in mean:
            covariance = 0.09 * np.eye(30) + design.T @ np.diag(spread**2) @ design
            off = data - one @ design
            half = 0.5 * (off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(2.0 * np.pi * covariance)[1])
            evidence.append(np.log(prior / len(mean)) - half)
        return made, evidence

    line, of_line = model(time[None], np.array([[0.0], [2.0]]), np.array([0.5]), 1.0)
    curve, of_curve = model(np.stack([time, time**2]), np.zeros((1, 2)), np.array([0.5, 0.7]), 0.5)
    drawn, weight = draw_about_each([line, curve], random)
    expected = np.exp(np.logaddexp.reduce(of_line) - np.logaddexp.reduce([*of_line, *of_curve]))
    assert weight[: len(drawn[0])].sum() == pytest.approx(expected, abs=0.02)
    assert weight.sum() == pytest.approx(1.0)
    slope = (time @ data / 0.09) / (time @ time / 0.09 + 4.0)
    near = weight[: len(drawn[0])] * (np.abs(drawn[0][:, 0] - 2.0) > 0.0)
    assert np.average(drawn[0][:, 0], weights=near) == pytest.approx(slope, abs=0.1)


def test_parameters_that_data_cannot_tell_apart_are_drawn() -> None:
    """Only their sum is known: rounding leaves a curvature that is not positive."""
    design = 1e5 * np.ones((2, 1)) * np.linspace(0.5, 1.0, 40)
    data = np.linspace(0.5, 1.0, 40) * 1e5

    def linear(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return at @ design - data, np.broadcast_to(design, (len(at), *design.shape))

    random = np.random.default_rng(2)
    made = DrawnModel(np.zeros((1, 2)), np.full(2, 1e6), 1.0, lambda at: linear(at)[0], linear)
    (drawn,), weight = draw_about_each([made], random)
    assert np.isfinite(drawn).all()
    assert np.average(drawn.sum(axis=1), weights=weight) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("spectrum", [Branches(2, np.linspace(-2.0, 4.0, 6), 1.0), Endless.over(0.7, 8.0, 0.1, 1.0)])
def test_derivatives_of_spectra_are_their_differences(spectrum: Branches | Endless) -> None:
    time = np.linspace(0.0, 8.0, 50)

    def filtered(log_l: np.ndarray, order: int) -> np.ndarray:
        slow = np.exp(-time / np.exp(log_l)[..., None])
        return 1.0 - slow if order == 0 else -slow * time / np.exp(log_l)[..., None]

    mean, spread = spectrum.priors()
    at = mean[:1] + 0.3 * spread
    _, derivative = spectrum.added(at, filtered)
    for index in range(at.shape[1]):
        step = 1e-6 * np.eye(at.shape[1])[index]
        rise = (spectrum.added(at + step, filtered)[0] - spectrum.added(at - step, filtered)[0]) / 2e-6
        assert derivative[0, index] == pytest.approx(rise[0], abs=1e-6)
    strength, retarded_s = spectrum.filters(at)
    total = strength[0] @ (1.0 - np.exp(-time / retarded_s[0][:, None]))
    assert spectrum.added(at, filtered)[0][0] == pytest.approx(total)
