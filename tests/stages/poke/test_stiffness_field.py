"""Stiffness over a surface: which kind of field explains the pokes, and what it says between them."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.poke.stiffness_field import fit_field
from tests.cases import slow_but


def places(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([0.03, 0.03], [0.57, 0.37], (count, 2))


def test_one_poke_says_the_same_everywhere() -> None:
    field = fit_field(np.array([[0.1, 0.2]]), np.array([20.0]))
    assert field.kind == "uniform"
    assert np.isnan(field.left_out).all()
    np.testing.assert_allclose(field.at(np.array([[0.5, 0.1], [0.0, 0.0]])), 20.0)


def test_noise_alone_stays_uniform() -> None:
    uniform = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        field = fit_field(places(8, seed), 20.0 * np.exp(rng.normal(0.0, 0.05, 8)))
        uniform += field.kind == "uniform"
        assert field.at(np.array([[0.3, 0.2]]))[0] == pytest.approx(20.0, rel=0.12)
    assert uniform >= 16


def test_two_halves_are_two_materials_with_the_border_between_the_pokes() -> None:
    for seed in range(10):
        rng = np.random.default_rng(100 + seed)
        at = places(8, seed)
        at[:2, 0] = 0.1, 0.5  # both halves are touched
        truth = np.where(at[:, 0] < 0.3, 20.0, 50.0)
        if min(np.count_nonzero(truth == 20.0), np.count_nonzero(truth == 50.0)) < 2:
            continue
        field = fit_field(at, truth * np.exp(rng.normal(0.0, 0.03, 8)))
        assert field.kind == "materials"
        nearest = np.array([[at[:, 0][truth == 20.0].max(), 0.2], [at[:, 0][truth == 50.0].min(), 0.2]])
        assert field.at(nearest[:1] - np.array([0.05, 0.0]))[0] == pytest.approx(20.0, rel=0.1)
        assert field.at(nearest[1:] + np.array([0.05, 0.0]))[0] == pytest.approx(50.0, rel=0.1)


def test_an_inclusion_within_is_found_though_no_line_parts_it() -> None:
    x, y = np.meshgrid(np.linspace(0.05, 0.55, 6), np.linspace(0.05, 0.35, 4), indexing="ij")
    at = np.column_stack([x.ravel(), y.ravel()])
    inner = np.linalg.norm(at - [0.3, 0.2], axis=1) < 0.12
    field = fit_field(at, np.where(inner, 60.0, 20.0))
    assert field.kind == "materials"
    np.testing.assert_allclose(field.at(at), np.where(inner, 60.0, 20.0))


def test_a_slope_is_gradual() -> None:
    at = places(14, 3)
    field = fit_field(at, 20.0 * np.exp(2.0 * at[:, 0]))
    assert field.kind == "gradual"
    wanted = np.array([[0.2, 0.2], [0.4, 0.2]])
    np.testing.assert_allclose(field.at(wanted), 20.0 * np.exp(2.0 * wanted[:, 0]), rtol=0.1)


def test_the_error_of_a_poke_left_out_is_that_of_predicting_it() -> None:
    at = places(5, 1)
    value = np.array([20.0, 20.0, 20.0, 20.0, 22.0])
    field = fit_field(at, value)
    assert field.kind == "uniform"
    np.testing.assert_allclose(field.left_out, [0.0, 0.0, 0.0, 0.0, 20.0 / 22.0 - 1.0], atol=1e-12)


@pytest.mark.parametrize("bad", [0.0, -3.0, float("nan")])
def test_a_stiffness_that_is_none_is_refused(bad: float) -> None:
    with pytest.raises(InputError, match="stiffness above 0"):
        fit_field(places(2), np.array([20.0, bad]))


@pytest.mark.parametrize("seed", slow_but([0, 5, 9], range(12)))
def test_a_stiff_inclusion_under_three_of_twelve_pokes_is_never_denied(seed: int) -> None:
    """At the pokes on it the field is near what they met, and beside them near it or unsure enough to hold it."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid([0.05, 0.15, 0.25, 0.35], [0.05, 0.15, 0.25], indexing="ij")
    at = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.02, 0.02, (12, 2))
    centre = rng.uniform([0.1, 0.08], [0.3, 0.22])
    stiff = np.argsort(np.linalg.norm(at - centre, axis=1))[:3]
    stiffness = 20.0 * np.exp(rng.normal(0.0, 0.03, 12))
    stiffness[stiff] *= rng.uniform(3.4, 5.8, 3)
    field = fit_field(at, stiffness)
    assert field.kind != "uniform"
    off = np.abs(np.log(field.at(at) / stiffness))
    assert off.max() <= 0.3
    beside = at[stiff] + rng.normal(0.0, 0.01, (3, 2))
    off = np.abs(np.log(field.at(beside) / stiffness[stiff]))
    assert np.all((off < 0.3) | (off < 1.645 * field.deviation(beside)))
    # the soft ones stay soft, and are known to be
    soft = np.setdiff1d(np.arange(12), stiff)
    assert field.deviation(at[soft] + [0.01, 0.0]).max() < 0.3


def test_two_pokes_that_differ_are_both_believed() -> None:
    at = np.array([[0.1, 0.1], [0.3, 0.1]])
    field = fit_field(at, np.array([20.0, 80.0]))
    np.testing.assert_allclose(field.at(at), [20.0, 80.0], rtol=0.05)
    between = np.array([[0.2, 0.1]])
    low, high = (field.at(between)[0] * np.exp(sign * 1.645 * field.deviation(between)[0]) for sign in (-1, 1))
    assert low < 20.0
    assert high > 80.0


def test_pokes_of_one_place_that_differ_leave_it_unsure() -> None:
    at = np.array([[0.1, 0.1], [0.1, 0.1], [0.3, 0.1]])
    field = fit_field(at, np.array([20.0, 80.0, 40.0]))
    assert field.deviation(at[:1])[0] > 0.4


def test_the_deviation_is_of_logarithms_of_pokes_left_out() -> None:
    field = fit_field(places(8, 2), 20.0 * np.exp(np.random.default_rng(2).normal(0.0, 0.05, 8)))
    assert field.kind == "uniform"
    scatter = np.abs(np.log1p(field.left_out))
    far = field.deviation(np.array([[2.0, 2.0]]))[0]
    assert scatter.min() < far < np.hypot(scatter.max(), 0.06)
    assert np.all((field.deviation(field.places) >= 0.05) & (field.deviation(field.places) < 0.1))
    assert fit_field(np.array([[0.1, 0.2]]), np.array([20.0])).deviation(places(2)).tolist() == [0.05, 0.05]
