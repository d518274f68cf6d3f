"""beta by the gradient of the error: against the error itself, relaxed at many betas."""

import numpy as np
import pytest

from deformscope.stages.msm import iteration
from deformscope.stages.msm.fit import LARGEST, _followed, fit_beta
from deformscope.stages.msm.iteration import Newton
from deformscope.stages.msm.solver import Msm
from tests.cases import Patch
from tests.stages.bodies import pushed


@pytest.mark.parametrize(("shape", "size", "truth"), [((7, 9), 2, 0.4), ((7, 9), 4, 0.8), ((4, 4, 5), 3, 0.6)])
def test_the_found_beta_has_the_least_error(device: str, shape: tuple[int, ...], size: int, truth: float) -> None:
    rng = np.random.default_rng(size)
    body = pushed(shape, rng)
    engine = Msm(body.rest, body.clusters(size), body.held, device=device)
    observed = engine.relax(body.held_position, truth).position[0] + rng.normal(0, 0.02 * engine.scale, body.rest.shape)
    found = fit_beta(engine, body.held_position, observed)
    assert found.converged
    near = found.value + np.array([-2e-3, -1e-3, 0.0, 1e-3, 2e-3])
    distance = np.linalg.norm(engine.relax(body.held_position, near).position - observed, axis=2).mean(axis=1)
    assert distance.argmin() == 2
    assert found.aee == pytest.approx(distance[2], rel=1e-6)


def test_exact_observations_give_the_truth_and_unseen_particles_do_not_count(device: str) -> None:
    body = pushed((6, 8), np.random.default_rng(3))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    observed = engine.relax(body.held_position, 0.637).position[0]
    observed[::3] = np.nan
    assert fit_beta(engine, body.held_position, observed).value == pytest.approx(0.637, abs=1e-3)


@pytest.mark.parametrize(("size", "start"), [(2, 0.5), (3, 0.1), (4, 0.9)])
def test_one_launch_finds_what_evaluations_from_python_find(device: str, size: int, start: float) -> None:
    rng = np.random.default_rng(6)
    body = pushed((6, 8), rng)
    engine = Msm(body.rest, body.clusters(size), body.held, device=device)
    observed = engine.relax(body.held_position, 0.6).position[0] + rng.normal(0, 0.02 * engine.scale, body.rest.shape)
    found = fit_beta(engine, body.held_position, observed, start=start)
    method = Newton(engine._body, engine._particles, 1, 0)
    u = np.zeros_like(body.rest)
    u[body.held] = (body.held_position - body.rest[body.held]) / engine.scale
    method.put(u[None])
    target, seen = (observed - body.rest) / engine.scale, np.ones(len(body.rest), dtype=bool)
    beta, evaluations, settled = _followed(method, engine, target, seen, start=start, tolerance=1e-4, most=40)
    assert settled
    assert 0.0 < beta < LARGEST
    assert (found.value, found.evaluations) == (pytest.approx(beta, abs=1e-7), evaluations)


def test_a_search_that_comes_back_after_each_evaluation_is_the_same(device: str, monkeypatch: Patch) -> None:
    rng = np.random.default_rng(7)
    body = pushed((6, 8), rng)
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    observed = engine.relax(body.held_position, 0.6).position[0] + rng.normal(0, 0.02 * engine.scale, body.rest.shape)
    whole = fit_beta(engine, body.held_position, observed)
    monkeypatch.setattr(iteration, "TURN", 1)
    in_turns = fit_beta(engine, body.held_position, observed)
    assert whole.evaluations > 2
    assert (in_turns.value, in_turns.evaluations) == (whole.value, whole.evaluations)
    np.testing.assert_array_equal(in_turns.position, whole.position)


def test_a_shape_beyond_the_model_ends_at_the_bound(device: str) -> None:
    """What is stiffer than beta = 0 allows is answered with 0, in the end."""
    body = pushed((6, 8), np.random.default_rng(4))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    ends = engine.relax(body.held_position, [0.0, 0.3]).position
    assert fit_beta(engine, body.held_position, ends[0] + 0.5 * (ends[0] - ends[1])).value < 0.02
