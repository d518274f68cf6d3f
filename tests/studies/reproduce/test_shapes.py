"""Static states over beta and theta: those of the float64 specification, and what the thesis's figures show of them."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.msm import reference
from studies.figures import pushed, search_known
from studies.reproduce.shapes import HeldLattice, column, cube, sheet
from tests.stages import reference_states


def solved(body: HeldLattice, beta: float) -> FloatArray:
    """(K, d) by `reference`, which shares no code with the solver."""
    seen, model = body.seen, body.model
    rest = reference.build_rest(seen.rest, model.grouping(seen), seen.held, basis=model.basis)
    return reference_states.relax(rest, seen.deformed[seen.held], beta=beta)[0]


@pytest.mark.parametrize("beta", [0.0, 0.4, 0.9])
def test_a_sweep_has_the_static_states_of_the_specification(beta: float) -> None:
    for body in (sheet(), column("linear")):
        sweep = body.sweep(np.array([beta, 0.5]))
        position = solved(body, beta)
        np.testing.assert_allclose(sweep.position[0], body.side(position), atol=1e-6)
        free = np.delete(position - body.seen.rest, body.seen.held, axis=0)
        assert sweep.measure[0] == pytest.approx(1e3 * np.linalg.norm(free, axis=1).mean(), abs=1e-3)
        np.testing.assert_array_equal(sweep.held.sum(), len(body.seen.held))


def test_volume_grows_with_theta_and_is_the_plates_at_none() -> None:
    sweep = cube(5).sweep(np.array([0.0, 0.3, 0.99]))
    assert sweep.measure[0] == pytest.approx(70.0, abs=1e-4)
    assert (np.diff(sweep.measure) > 5.0).all()
    assert sweep.rest.shape == (5, 5, 2)
    assert sweep.held.sum() == 10


def test_the_same_push_moves_more_at_a_larger_beta() -> None:
    body = sheet()
    (stiff, middle), (soft, _) = pushed(body, 0.1), pushed(body, 0.9)
    rows = [int(np.argmin(np.linalg.norm(body.seen.rest - one, axis=1))) for one in middle]
    sunk = [float((body.seen.rest - one)[rows, 1].mean()) for one in (stiff, soft)]
    assert sunk[1] > 3.0 * sunk[0] > 0.0
    np.testing.assert_allclose(middle, [[0.06, 0.06], [0.07, 0.06], [0.08, 0.06]])


def test_each_search_finds_a_known_beta_and_the_printed_one_at_the_highest_cost() -> None:
    found = {one.search: one for one in search_known(0)}
    assert [one.value for one in found.values()] == pytest.approx([0.7] * 3, abs=0.01)
    assert max(found.values(), key=lambda one: one.evaluations).search == "Algorithm 2 as printed"
    assert min(one.aee_m for one in found.values()) == pytest.approx(found["gradient"].aee_m, rel=1e-6)


def test_a_state_that_does_not_exist_is_an_error() -> None:
    body = sheet()
    with pytest.raises((InputError, ValueError)):
        body.sweep(np.array([np.nan]))
