"""Stiffness over a surface: what a few pokes say between them, and that they never contradict themselves."""

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.poke import stiffness_field
from deformscope.stages.poke.stiffness_field import StiffnessField, fit_field
from tests.cases import slow_but

TIP = 0.02


def places(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([0.03, 0.03], [0.57, 0.37], (count, 2))


def grid(columns: int = 4, rows: int = 3) -> np.ndarray:
    """(n, 2) places on a surface of 0.4 x 0.3 m."""
    x, y = np.meshgrid(np.linspace(0.05, 0.35, columns), np.linspace(0.05, 0.25, rows), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.fixture(scope="module", autouse=True)
def _fewer_maps() -> Iterator[None]:
    """As many as these surfaces need: a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stiffness_field, "PARTICLES", 300)
        yield


@pytest.fixture(scope="module")
def halves() -> StiffnessField:
    """20 N/m left of 0.2 m, 80 N/m right of it; no poke is nearer to the border than 5 cm."""
    at = grid()
    scatter = np.exp(np.random.default_rng(1).normal(0.0, 0.03, len(at)))
    return fit_field(at, np.where(at[:, 0] < 0.2, 20.0, 80.0) * scatter, TIP)


def test_one_poke_says_the_same_everywhere() -> None:
    field = fit_field(np.array([[0.1, 0.2]]), np.array([20.0]), TIP)
    assert field.kind == "uniform"
    assert np.isnan(field.left_out).all()
    far = np.array([[0.5, 0.1], [0.0, 0.0]])
    np.testing.assert_allclose(field.at(far), 20.0, rtol=1e-6)
    low, high = field.interval(far)[0]
    assert 17.0 < low < 19.5
    assert 20.5 < high < 23.5


def test_a_field_holds_every_poke_that_it_knows() -> None:
    """Whatever they met, be it three materials and a poke that nothing explains."""
    at = places(7, 5)
    stiffness = np.exp(np.array([0.0, 1.0, 3.0, 0.0, 1.0, 3.0, 0.0]))
    stiffness[4] *= 1.7
    found = fit_field(at, stiffness, TIP).interval(at)
    assert np.all((found[:, 0] <= stiffness) & (stiffness <= found[:, 1]))


def test_near_a_border_either_material_is_possible_and_away_from_it_one(halves: StiffnessField) -> None:
    assert halves.kind == "materials"
    low, high = halves.interval(np.array([[0.2, 0.1], [0.2, 0.2]])).T
    assert np.all(low < 22.0)
    assert np.all(high > 72.0)
    inside = np.array([[0.1, 0.1], [0.06, 0.2], [0.3, 0.1], [0.34, 0.2]])
    np.testing.assert_allclose(halves.at(inside), [20.0, 20.0, 80.0, 80.0], rtol=0.06)
    low, high = halves.interval(inside).T
    assert np.all((high - low) / halves.at(inside) < 0.4)


def test_a_wider_tip_feels_the_border_from_farther_away(halves: StiffnessField) -> None:
    """A tip of 2 cm is on the one material or on the other; one of 12 cm always feels both."""
    place = np.array([[0.2, 0.15]])
    narrow, wide = halves.interval(place)[0], halves.interval(place, contact_m=0.07)[0]
    assert wide[1] / wide[0] < narrow[1] / narrow[0]
    assert 25.0 < halves.at(place, 0.07)[0] < 65.0


def test_a_level_is_met_by_a_narrower_or_wider_interval(halves: StiffnessField) -> None:
    place = np.array([[0.1, 0.1]])
    ratios = [float(np.divide(*halves.interval(place, level)[0, ::-1])) for level in (0.5, 0.9, 0.99)]
    assert ratios == sorted(ratios)
    low, high = halves.interval(place, extra=0.2)[0]
    assert high / low > np.exp(2 * 1.6 * 0.2)


@pytest.mark.parametrize("seed", slow_but([0], range(4)))
def test_a_stiff_inclusion_under_three_of_twelve_pokes_is_believed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = grid() + rng.uniform(-0.01, 0.01, (12, 2))
    stiff = np.argsort(np.linalg.norm(at - rng.uniform([0.12, 0.1], [0.28, 0.2]), axis=1))[:3]
    stiffness = 20.0 * np.exp(rng.normal(0.0, 0.03, 12))
    stiffness[stiff] *= rng.uniform(3.4, 5.8, 3)
    field = fit_field(at, stiffness, TIP)
    assert field.kind != "uniform"
    assert np.abs(np.log(field.at(at) / stiffness)).max() < 0.35
    low, high = field.interval(at[stiff].mean(axis=0)[None])[0]
    assert high > 3.4 * 20.0
    low, high = field.interval(at[np.setdiff1d(np.arange(12), stiff)]).T
    assert np.median(high / low) < 1.4


@pytest.mark.parametrize(
    ("kind", "size_m"),
    slow_but(
        [("uniform", 0.05), ("materials", 0.05), ("gradual", 0.6)],
        list(product(["uniform", "materials", "gradual"], [0.05, 0.6])),
    ),
)
def test_a_surface_is_of_one_kind_whatever_its_size(kind: str, size_m: float) -> None:
    """Twelve values of 5 % scatter: all alike, two halves of 20 and 50 N/m, or a slope by a factor of 3.3."""
    rng = np.random.default_rng(4)
    at = rng.uniform(0.0, [1.0, 0.6], (12, 2))
    value = {
        "uniform": np.full(12, np.log(20.0)),
        "materials": np.where(at[:, 0] < 0.5, np.log(20.0), np.log(50.0)),
        "gradual": np.log(20.0) + 1.2 * at[:, 0],
    }[kind]
    # a corner anywhere: places of a camera's frame may be below 0
    field = fit_field(size_m * at - [0.1, 0.2], np.exp(value + rng.normal(0.0, 0.05, 12)), 0.03 * size_m)
    assert field.kind == kind
    if kind == "gradual":
        wanted = size_m * np.array([[0.4, 0.3], [0.6, 0.3]]) - [0.1, 0.2]
        np.testing.assert_allclose(field.at(wanted), 20.0 * np.exp([0.48, 0.72]), rtol=0.1)


@pytest.mark.slow
def test_scatter_from_poke_to_poke_is_learned() -> None:
    at = places(16, 1)
    widths = []
    for scatter in (0.02, 0.1):
        field = fit_field(at, 20.0 * np.exp(np.random.default_rng(2).normal(0.0, scatter, 16)), TIP)
        assert field.kind == "uniform"
        low, high = field.interval(np.array([[0.3, 0.2]]))[0]
        widths.append(np.log(high / low))
    assert widths[0] < 0.2
    assert 0.25 < widths[1] < 0.6


def test_the_error_of_a_poke_left_out_is_that_of_predicting_it_from_the_others(halves: StiffnessField) -> None:
    """Against fits to the others: pokes of one material, and of two."""
    at, value = places(7, 1), 20.0 * np.exp(np.random.default_rng(3).normal(0.0, 0.06, 7))
    field = fit_field(at, value, TIP)
    for one in (0, 3):
        others = np.arange(7) != one
        predicted = fit_field(at[others], value[others], TIP).at(at[one : one + 1])[0]
        assert field.left_out[one] == pytest.approx(predicted / value[one] - 1.0, abs=0.02)
    assert np.abs(halves.left_out[[0, -1]]).max() < 0.1  # in corners, away from the border


@pytest.mark.parametrize("bad", [0.0, -3.0, float("nan")])
def test_a_stiffness_that_is_none_is_refused(bad: float) -> None:
    with pytest.raises(InputError, match="stiffness above 0"):
        fit_field(places(2), np.array([20.0, bad]), TIP)


def test_two_pokes_that_differ_are_both_believed() -> None:
    at = np.array([[0.1, 0.1], [0.3, 0.1]])
    field = fit_field(at, np.array([20.0, 80.0]), None)
    np.testing.assert_allclose(field.at(at), [20.0, 80.0], rtol=0.1)
    low, high = field.interval(np.array([[0.2, 0.1]]))[0]
    assert low < 22.0
    assert high > 72.0


def test_pokes_of_one_place_that_differ_leave_it_unsure() -> None:
    at = np.array([[0.1, 0.1], [0.1, 0.1], [0.3, 0.1]])
    low, high = fit_field(at, np.array([20.0, 80.0, 40.0]), TIP).interval(at[:1])[0]
    assert low <= 20.0
    assert high >= 80.0
