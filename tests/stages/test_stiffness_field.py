"""Stiffness over a surface: which kind of field explains the pokes, and what it says between them."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.stiffness_field import fit_field


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
