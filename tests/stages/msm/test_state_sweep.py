"""Static states over beta and theta: those of the float64 specification, and the sizes that shapes have."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.reproduce.shapes import column, cube, middle_of, pushed, sheet
from deformscope.stages.msm import reference
from deformscope.stages.msm.state_sweep import PressedLattice, sweep_states


def solved(lattice: PressedLattice, beta: float, theta: float) -> np.ndarray:
    """(K, d) by `reference`, which shares no code with the solver."""
    rest = reference.build_rest(lattice.rest, lattice.clusters, lattice.held, basis=lattice.basis)
    return reference.relax(rest, lattice.target, beta=beta, theta=theta)[0]


@pytest.mark.parametrize("beta", [0.0, 0.4, 0.9])
def test_a_sweep_has_the_static_states_of_the_specification(beta: float) -> None:
    for lattice in (sheet(), column("linear")):
        sweep = sweep_states(lattice, "beta", np.array([beta, 0.5]), 0.0)

        assert sweep.converged.all()
        np.testing.assert_allclose(sweep.at(beta), solved(lattice, beta, 0.0), atol=1e-6)


def test_size_is_area_and_volume() -> None:
    plane, space = sheet(), cube(4)
    stretched = plane.rest * [2.0, 1.5]
    turned = space.rest @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]

    assert plane.size(plane.rest) == pytest.approx(0.14 * 0.06)
    assert plane.size(stretched) == pytest.approx(3.0 * 0.14 * 0.06)
    assert abs(space.size(turned)) == pytest.approx(1e-3)
    np.testing.assert_allclose(space.size(np.stack([space.rest, 2.0 * space.rest])), [1e-3, 8e-3])


def test_volume_grows_with_theta_and_is_the_plates_at_none() -> None:
    sweep = sweep_states(cube(5), "theta", np.array([0.0, 0.3, 0.99]), 0.99)

    assert sweep.size[0] == pytest.approx(0.7, abs=1e-6)
    assert (np.diff(sweep.size) > 0.05).all()


def test_the_same_push_moves_more_at_a_larger_beta_and_is_a_static_state() -> None:
    lattice = sheet()
    stiff, soft = pushed(lattice, 0.1), pushed(lattice, 0.9)
    middle = middle_of(lattice)
    sunk = [float((lattice.rest - one)[middle, 1].mean()) for one in (stiff, soft)]

    assert sunk[1] > 3.0 * sunk[0] > 0.0
    np.testing.assert_allclose(lattice.rest[middle], [[0.06, 0.06], [0.07, 0.06], [0.08, 0.06]])
    ground = lattice.rest[:, 1] == 0.0
    np.testing.assert_array_equal(soft[ground], lattice.rest[ground])


def test_a_state_that_does_not_exist_is_an_error() -> None:
    lattice = sheet()
    with pytest.raises((InputError, ValueError)):
        sweep_states(lattice, "beta", np.array([np.nan]), 0.0)
