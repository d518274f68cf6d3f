"""beta by the gradient of the error: against the error itself, relaxed at many betas."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("warp")

from deformscope.stages.msm.fit import fit_beta
from deformscope.stages.msm.solver import Msm
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
    found = fit_beta(engine, body.held_position, observed)
    assert found.value == pytest.approx(0.637, abs=1e-3)


def test_a_shape_beyond_the_model_ends_at_the_bound(device: str) -> None:
    """What is stiffer than beta = 0 allows is answered with 0, in the end."""
    body = pushed((6, 8), np.random.default_rng(4))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    ends = engine.relax(body.held_position, [0.0, 0.3]).position
    found = fit_beta(engine, body.held_position, ends[0] + 0.5 * (ends[0] - ends[1]))
    assert found.value < 0.02
