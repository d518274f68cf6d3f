"""beta and theta together: against the error itself, relaxed at many of both."""

import numpy as np
import pytest

from deformscope.stages.msm import clusters
from deformscope.stages.msm.reference import Volume
from deformscope.stages.msm.solver import Msm
from studies.reproduce.both_fit import fit_beta_theta
from tests.stages.bodies import pushed


@pytest.mark.parametrize(("size", "beta", "theta"), [(2, 0.7, 0.6), (3, 0.9, 0.2), (2, 0.5, 0.0)])
def test_exact_observations_give_both_beta_and_theta(size: int, beta: float, theta: float) -> None:
    body = pushed((4, 5, 4), np.random.default_rng(5))
    engine = Msm(body.rest, body.clusters(size), body.held)
    observed = engine.relax(body.held_position, beta, theta, volume="project").position[0]
    observed[::4] = np.nan
    found = fit_beta_theta(engine, body.held_position, observed)
    assert found.converged
    assert found.beta == pytest.approx(beta, abs=2e-3)
    assert found.theta == pytest.approx(theta, abs=2e-3)


@pytest.mark.parametrize("size", [2, 3, None])
def test_no_neighbour_of_beta_and_theta_has_a_lower_error(size: int | None) -> None:
    rng = np.random.default_rng(6)
    body = pushed((4, 5, 4), rng)
    grouped = clusters.single(len(body.rest)) if size is None else body.clusters(size)
    engine = Msm(body.rest, grouped, body.held, basis="quadratic" if size is None else "linear")
    volume: Volume = "scale" if size is None else "project"
    truth = engine.relax(body.held_position, 0.8, 0.5, volume=volume).position[0]
    observed = truth + rng.normal(0, 0.02 * engine.scale, body.rest.shape)
    found = fit_beta_theta(engine, body.held_position, observed, volume=volume)
    beta, theta = (each.ravel() for each in np.meshgrid(np.linspace(0.4, 0.96, 15), np.linspace(0.0, 1.0, 11)))
    grid = engine.relax(body.held_position, beta, theta, volume=volume, tolerance=1e-6)
    distance = np.linalg.norm(grid.position - observed, axis=2).mean(axis=1)[grid.converged & ~grid.diverged]
    assert found.converged
    assert found.aee <= distance.min() * 1.001


def test_bounds_of_beta_and_theta_are_kept() -> None:
    """A body that keeps more than its volume asks for theta = 1, and no more beta than was allowed."""
    body = pushed((4, 5, 4), np.random.default_rng(7))
    engine = Msm(body.rest, body.clusters(2), body.held)
    ends = engine.relax(body.held_position, 0.95, [0.0, 1.0], volume="project").position
    found = fit_beta_theta(engine, body.held_position, ends[1] + 0.3 * (ends[1] - ends[0]), largest_beta=0.95)
    assert found.beta <= 0.95
    assert found.theta == 1.0
