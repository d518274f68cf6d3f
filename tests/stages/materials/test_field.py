"""A stiffness for each place: bodies of finite elements that are not the fitted ones, and data that tell nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import Observation
from deformscope.stages.materials.field import fit_field
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.field_fit import in_whole_cells
from deformscope.studies.field_bodies import SPACING_M, elastic_pair
from tests.cases import slow

pytest.importorskip("skfem")

SMALL = (11, 8)


def halves(places: FloatArray) -> FloatArray:
    return np.asarray(np.where(places[:, 0] < 0.05, 10e3, 40e3))


def found(seen: Observation) -> FieldEstimate:
    return fit_field(seen)[0]


def held_share(estimate: FieldEstimate, young: FloatArray) -> float:
    """Share of the places whose interval holds the truth."""
    true = young / np.exp(np.log(young).mean())
    low, high = estimate.interval.T
    return float(np.mean((low <= true) & (true <= high)))


def test_two_materials_their_border_and_their_ratio() -> None:
    seen = elastic_pair(SMALL, halves)
    estimate = found(seen)
    assert estimate.verdict == "materials"
    assert estimate.materials == 2
    assert abs(estimate.ratio / 4.0 - 1.0) < 0.15
    assert estimate.ratio_interval[0] < 4.0 < estimate.ratio_interval[1]
    stiff = estimate.material == 1
    sure = np.abs(estimate.place[:, 0] - 0.05) > SPACING_M
    assert np.array_equal(stiff[sure], estimate.place[sure, 0] > 0.05)
    assert held_share(estimate, halves(estimate.place)) > 0.85
    # softer is the larger beta, and the force tells the moduli: of a plate 2 mm thick
    assert estimate.beta[stiff].max() < estimate.beta[~stiff].min()
    assert estimate.absolute is not None
    assert np.allclose(estimate.absolute, halves(estimate.place) * 0.002, rtol=0.1)
    public = estimate.as_json()
    assert len(public["places"]["at_m"]) == 70  # type: ignore[index,call-overload]


@pytest.mark.parametrize("kind", ["rigid", slow("nothing"), slow("noise")])
def test_data_that_tell_nothing_are_unidentified(kind: str) -> None:
    seen = elastic_pair(SMALL, halves)
    errors = 1e-4 * np.random.default_rng(1).standard_normal(seen.rest.shape)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    deformed = {
        "nothing": seen.rest + errors,
        "rigid": seen.rest @ turn.T + 0.1,
        "noise": seen.rest + (seen.deformed - seen.rest) / 40.0 + 5.0 * errors,
    }[kind]
    estimate = found(dataclasses.replace(seen, deformed=deformed, force_n=None))
    assert estimate.verdict == "unidentified"
    assert estimate.determined < 0.2


def test_what_strains_alike_is_not_told_apart() -> None:
    """In a uniform stretch layers along it strain alike, whatever their moduli: that all look the same says nothing."""
    seen = elastic_pair(SMALL, halves)
    errors = 1e-4 * np.random.default_rng(1).standard_normal(seen.rest.shape)
    stretched = seen.rest * np.array([1.05, 1.0 - 0.3 * 0.05]) + errors
    estimate = found(dataclasses.replace(seen, deformed=stretched, force_n=None))
    assert estimate.materials < 2
    assert estimate.ratio_interval[1] > 4.0
    assert estimate.verdict == "unidentified"


def test_particles_of_no_whole_cell_are_left_out() -> None:
    seen = elastic_pair(SMALL, halves)
    rows = np.flatnonzero(np.arange(len(seen.rest)) != 81)  # beside a corner of the lattice, held
    held = np.searchsorted(rows, seen.held[seen.held != 81])
    ragged = dataclasses.replace(
        seen, rest=seen.rest[rows], deformed=seen.deformed[rows], held=held, observed=seen.observed[rows], cell=rows
    )
    whole = in_whole_cells(ragged)
    assert len(whole.rest) == len(seen.rest) - 2
    assert np.isin(whole.rest[whole.held, 0], [0.0, 0.1]).all()
    assert len(whole.held) == len(seen.held) - 2


def test_a_surface_without_depth_and_points_without_a_lattice_are_refused() -> None:
    seen = elastic_pair(SMALL, halves)
    with pytest.raises(InputError, match="particles on a lattice"):
        fit_field(dataclasses.replace(seen, shape=None))
    space = [np.column_stack([points, np.zeros(len(points))]) for points in (seen.rest, seen.deformed)]
    with pytest.raises(InputError, match="fills the plane, or space"):
        fit_field(dataclasses.replace(seen, rest=space[0], deformed=space[1]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_gradual_and_uniform_bodies_and_three_materials(seed: int) -> None:
    shape = (17, 13)

    def gradual(places: FloatArray) -> FloatArray:
        return np.asarray(10e3 * 4.0 ** (places[:, 0] / 0.16))

    def three(places: FloatArray) -> FloatArray:
        return np.asarray(np.select([places[:, 0] < 0.06, places[:, 0] < 0.11], [10e3, 60e3], 20e3))

    smooth = found(elastic_pair(shape, gradual, seed=seed))
    assert smooth.verdict == "gradual"
    assert np.sqrt(np.mean(np.log(smooth.stiffness / 10e3 * 20e3 / gradual(smooth.place)) ** 2)) < 0.2
    same = found(elastic_pair(shape, lambda places: np.full(len(places), 20e3), seed=seed))
    assert same.verdict == "uniform"
    several = found(elastic_pair(shape, three, seed=seed))
    assert several.materials == 3
    assert abs(several.ratio / 6.0 - 1.0) < 0.2


@pytest.mark.slow
def test_a_slab_in_space() -> None:
    estimate = found(elastic_pair((11, 6, 4), halves, noise_m=5e-5))
    assert estimate.verdict == "materials"
    assert abs(estimate.ratio / 4.0 - 1.0) < 0.15
    assert estimate.absolute is not None
    assert np.allclose(estimate.absolute, halves(estimate.place) * SPACING_M, rtol=0.15)
