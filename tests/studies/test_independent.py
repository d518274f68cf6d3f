"""Generators of other solvers: their states and errors are what they say."""

import dataclasses
from typing import get_args

import numpy as np
import pytest

from studies.beta import OTHER, OTHER_SOLVER, DisturbedCase, try_disturbed
from studies.doubt_rates import Data, DoubtCase, try_doubts
from studies.independent import oracle, plane_elements, shape_matching
from studies.independent.observed import CELL, Errors, field, lattice, pushed_clusters
from studies.random_bodies import random_body


@pytest.mark.parametrize("number", range(4))
def test_both_shape_matching_solvers_find_the_same_state(number: int) -> None:
    body = random_body(np.random.default_rng(number), 2 + number % 2)
    rows = shape_matching.windows(body.shape, body.cluster_size)
    for beta in (0.0, 0.5, 0.98):
        own = shape_matching.static_state(body.rest, rows, beta, body.held, body.held_position)
        np.testing.assert_allclose(own, body.deform(beta), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("ratio", [1.0, 2.5])
def test_plane_elements_contract_by_poisson_ratio(ratio: float) -> None:
    material, shape = plane_elements.stiffness(ratio, 0.3), (5, 4)
    places = lattice(shape)
    ends = np.flatnonzero((places[:, 0] == 0.0) | (places[:, 0] == places[:, 0].max()))
    even = places @ np.diag([0.1, -0.03])
    np.testing.assert_allclose(plane_elements.deform(shape, 0.01, material, ends, even[ends]), even, atol=1e-12)


def test_plane_strain_contracts_more_than_plane_stress() -> None:
    nu = 0.3
    strained = plane_elements.stiffness(1.0, nu, strain=True)
    assert strained[0, 1] / strained[1, 1] == pytest.approx(nu / (1.0 - nu))


def test_noise_has_the_correlation_of_its_kernel() -> None:
    rest = lattice((2, 1))[:, :1]
    drawn = np.array([field(np.random.default_rng(seed), rest, 1.0, 0.5).ravel() for seed in range(4000)])
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(np.exp(-1.0), abs=0.04)


def test_a_tool_that_is_off_moves_what_is_said_of_it_alone() -> None:
    without, off = (pushed_clusters(np.random.default_rng(3), one, 2) for one in (Errors(), Errors("along", 5e-4)))
    moved = np.linalg.norm(off.seen - without.seen, axis=1)
    np.testing.assert_allclose(moved[off.tool], 5e-4)
    assert not moved[np.setdiff1d(np.arange(len(moved)), off.tool)].any()


def test_a_pressed_body_and_a_camera_of_one_sign_are_what_they_say() -> None:
    for sign in (-1, 1):
        wrong = Errors(camera="scale", camera_size=0.01, pressed=True, sign=sign)
        body, right = (pushed_clusters(np.random.default_rng(5), one, 2) for one in (wrong, Errors(pressed=True)))
        assert (body.true[body.tool] - body.rest[body.tool])[:, 0].max() < -0.4 * CELL
        far = body.true - body.rest.mean(axis=0)
        np.testing.assert_allclose(body.seen - right.seen, 0.01 * sign * far, atol=1e-12)


def test_an_oracle_is_as_wide_as_the_noise_and_wider_where_the_tool_may_be_off() -> None:
    body = pushed_clusters(np.random.default_rng(7), Errors(pressed=True), 2)
    narrow, wide, off = (
        oracle.widths(dataclasses.replace(body, sigma=sigma, seen=body.true), Errors(), tools, 0.9)[0]
        for sigma, tools in ((1e-5, (0.0,)), (2e-5, (0.0,)), (1e-5, (0.04,)))
    )
    assert wide == pytest.approx(2.0 * narrow, rel=0.02)
    assert off > narrow


def test_an_oracle_of_little_noise_has_the_width_that_its_information_gives() -> None:
    """That of a normal distribution: residuals are linear in beta there."""
    body = pushed_clusters(np.random.default_rng(7), Errors(held=False, pressed=True), 2)
    sigma, rows, place = 1e-6, shape_matching.windows(body.shape, body.clusters), body.true[body.held]
    ends = [shape_matching.static_state(body.rest, rows, body.beta + step, body.held, place) for step in (-1e-4, 1e-4)]
    deviation = sigma / np.linalg.norm((ends[1] - ends[0]) / 2e-4)
    exact = dataclasses.replace(body, sigma=sigma, seen=body.true)
    found = oracle.widths(exact, Errors(held=False, pressed=True), (0.0,), 0.9)[0]
    assert found == pytest.approx(2.0 * 1.645 * deviation, rel=0.02)


@pytest.mark.slow
def test_kinds_of_errors_and_data_of_other_solvers_are_tried() -> None:
    name = OTHER + next(iter(OTHER_SOLVER))
    assert try_disturbed(DisturbedCase(name, 0, seed=1000)).outcome.condition == name
    kinds = [one for one in get_args(Data) if one.startswith(OTHER)]
    bulges = next(one for one in kinds if "nu .3" in one)
    assert "axes-swapped" not in try_doubts(DoubtCase(bulges, 0, seed=1000)).codes
    swapped = next(one for one in kinds if "swapped" in one)
    assert "axes-swapped" in [
        code for number in range(3) for code in try_doubts(DoubtCase(swapped, number, 1000)).codes
    ]
