"""beta and theta together: known pairs are found, and what cannot be separated is reported so."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.calibrate import Model, Observation
from deformscope.stages.fit.joint import JointOptions, calibrate_both
from deformscope.stages.msm import reference
from studies.reproduce.pressed_cubes import thesis_cubes
from tests.stages import reference_states
from tests.stages.bodies import Pushed, lattice, pushed


def observation(body: Pushed, deformed: FloatArray, noise: float | None = None, **more: object) -> Observation:
    count = len(body.rest)
    given = {"shape": body.shape, "cell": np.arange(count)} | more
    sigma = None if noise is None else np.full(count, noise)
    return Observation(body.rest, deformed, body.held, np.ones(count, dtype=bool), noise=sigma, **given)  # type: ignore[arg-type]


def truth(body: Pushed, beta: float, theta: float) -> FloatArray:
    """By the float64 reference."""
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    state, residual = reference_states.relax(spec, body.held_position, beta=beta, theta=theta, volume="project")
    assert residual < 1e-8
    return state


@pytest.mark.slow
def test_exact_data_give_both_values() -> None:
    body = pushed((5, 5), np.random.default_rng(2))
    found, comparisons = calibrate_both([observation(body, truth(body, 0.7, 0.4))], JointOptions())
    assert found.beta.value == pytest.approx(0.7, abs=2e-3)
    assert found.theta.value == pytest.approx(0.4, abs=5e-3)
    assert found.beta.interval[0] <= found.beta.value <= found.beta.interval[1]
    assert found.beta.verdict == found.theta.verdict == "identified"
    assert comparisons[0].simulated.shape == body.rest.shape


def test_the_most_likely_pair_is_that_of_the_density_and_the_thesis_pair_stands_beside_it() -> None:
    """Of finite elements, which no pair fits: the two pairs differ."""
    (cube,), _ = thesis_cubes((0.1,), (4,), (0.02,))
    found, comparisons = calibrate_both([cube.seen], JointOptions(Model(cluster_size=2, volume="project")))
    beta, theta = found.beta.posterior.parameter, found.theta.posterior.parameter
    error = np.linalg.norm(comparisons[0].simulated - comparisons[0].observed, axis=1).mean()
    row, column = np.unravel_index(found.density.argmax(), found.density.shape)
    for one, grid, at in ((found.beta, beta, row), (found.theta, theta, column)):
        assert grid[max(at - 1, 0)] <= one.value <= grid[min(at + 1, len(grid) - 1)]
        assert one.least_aee[1] < one.aee == pytest.approx(error, rel=1e-9)
    states = (
        Model(cluster_size=2)
        .body(cube.seen)
        .relax(
            cube.seen.deformed[cube.seen.held],
            np.array([found.beta.value, found.beta.least_aee[0]]),
            np.array([found.theta.value, found.theta.least_aee[0]]),
            volume="project",
        )
    )
    off = np.linalg.norm(states.position - cube.seen.deformed, axis=2)
    assert off.mean(axis=1).tolist() == pytest.approx([found.beta.aee, found.theta.least_aee[1]], rel=1e-6)


def test_noisy_data_give_sets_that_hold_both_and_a_density_of_mass_one() -> None:
    rng = np.random.default_rng(3)
    body = pushed((5, 5), rng)
    exact = truth(body, 0.6, 0.3)
    contact = body.held[5:]
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    force = float(np.linalg.norm(reference_states.reaction(exact, spec, 0.6, 0.3)[contact].sum(axis=0)))
    seen = observation(body, exact + rng.normal(0.0, 1e-4, exact.shape), 1e-4, force_n=200.0 * force, contact=contact)
    found, _ = calibrate_both([seen], JointOptions(level=0.98))
    assert found.beta.interval[0] <= 0.6 <= found.beta.interval[1]
    assert found.theta.interval[0] <= 0.3 <= found.theta.interval[1]
    beta, theta = found.beta.posterior.parameter, found.theta.posterior.parameter
    assert np.trapezoid(np.trapezoid(found.density, theta, axis=1), beta) == pytest.approx(1.0)
    assert -1.0 < found.correlation < 1.0
    low, high = found.beta.stiffness[1]
    assert low <= 200.0 <= high
    shown = found.as_json()
    assert set(shown["parameters"]) == {"beta", "theta"}  # type: ignore[arg-type, call-overload]
    assert np.shape(shown["posterior"]["density"]) == (len(beta), len(theta))  # type: ignore[index, call-overload]


@pytest.mark.slow
def test_a_wrong_track_is_left_out_and_named() -> None:
    body = pushed((5, 5), np.random.default_rng(2))
    deformed = truth(body, 0.7, 0.4)
    free = np.setdiff1d(np.arange(25), body.held)
    deformed[free[6]] += 0.004
    found, _ = calibrate_both([observation(body, deformed)], JointOptions())
    for one in (found.beta, found.theta):
        assert one.settings["left_out"] == [{"lost": [], "wrong": [int(free[6])]}]
    assert found.beta.value == pytest.approx(0.7, abs=2e-3)
    assert found.theta.value == pytest.approx(0.4, abs=5e-3)


def test_a_body_at_rest_tells_neither() -> None:
    rest = lattice((4, 5))
    found, _ = calibrate_both([observation(Pushed(rest, (4, 5), np.arange(5), rest[:5]), rest)], JointOptions())
    assert found.beta.verdict == found.theta.verdict == "unidentified"


def test_equation_3_17_is_refused() -> None:
    body = pushed((4, 4), np.random.default_rng(5))
    with pytest.raises(InputError, match="projection"):
        calibrate_both([observation(body, body.rest + 1e-4)], JointOptions(Model(volume="scale")))
