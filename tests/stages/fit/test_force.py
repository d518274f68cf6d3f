"""Stiffness from force: scale, noise, misfit, and several forces together."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.force import Stiffness, stiffness, stiffness_posterior
from deformscope.stages.fit.model import FORCE_SHARE
from deformscope.stages.msm import reference
from tests.stages import reference_states
from tests.stages.bodies import Pushed, pushed

NONE, ONE = np.zeros(1), np.ones(1)


def seen_with(body: Pushed, deformed: FloatArray, force: float, noise: float | None = None) -> Observation:
    count = len(body.rest)
    every = np.ones(count, dtype=bool)
    return Observation(
        body.rest,
        deformed,
        body.held,
        every,
        shape=body.shape,
        cell=np.arange(count),
        force_n=force,
        contact=body.held[body.shape[1] :],
        force_noise_n=noise,
    )


def pull(body: Pushed, deformed: FloatArray, beta: float) -> float:
    """Net force by the reference, per unit of k."""
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    contact = body.held[body.shape[1] :]
    return float(np.linalg.norm(reference_states.reaction(deformed, spec, beta)[contact].sum(axis=0)))


def static(body: Pushed, beta: float) -> FloatArray:
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    return reference_states.relax(spec, body.held_position, beta=beta)[0]


def test_stated_noise_is_that_of_k() -> None:
    body = pushed((5, 6), np.random.default_rng(0))
    shape = static(body, 0.5)
    unit = pull(body, shape, 0.5)
    for noise, share in ((None, FORCE_SHARE), (0.3, 0.1), (0.0, 1e-6)):
        found = stiffness([seen_with(body, shape, 3.0, noise)], Model(), [shape[None]], 0.5 * ONE, NONE)
        assert found.value[0] == pytest.approx(3.0 / unit)
        assert found.deviation[0] / found.value[0] == pytest.approx(share)


def test_the_square_of_the_misfit_adds_to_the_noise() -> None:
    body = pushed((5, 6), np.random.default_rng(0))
    shape = static(body, 0.5)
    found = stiffness([seen_with(body, shape, 3.0, 0.3)], Model(), [shape[None]], 0.5 * ONE, NONE, misfit=[0.5])
    assert found.deviation[0] / found.value[0] == pytest.approx(np.hypot(0.1, 0.25))


def test_several_forces_fit_one_k_and_their_scatter_widens_it() -> None:
    bodies = [pushed((5, 6), np.random.default_rng(seed)) for seed in range(4)]
    shapes = [static(body, 0.5) for body in bodies]
    units = [pull(body, shape, 0.5) for body, shape in zip(bodies, shapes, strict=True)]
    deviations = []
    for scatter in ([1.0, 1.0, 1.0, 1.0], [1.3, 0.7, 1.3, 0.7]):
        seen = [
            seen_with(body, shape, 50.0 * unit * factor)
            for body, shape, unit, factor in zip(bodies, shapes, units, scatter, strict=True)
        ]
        found = stiffness(seen, Model(), [shape[None] for shape in shapes], 0.5 * ONE, NONE)
        assert found.value[0] == pytest.approx(50.0, rel=0.25)
        deviations.append(found.deviation[0] / found.value[0])
    assert deviations[0] == pytest.approx(FORCE_SHARE / 2.0, rel=1e-6)  # four forces alike
    assert deviations[1] > 4.0 * deviations[0]


def test_the_posterior_of_k_mixes_what_the_parameter_may_be() -> None:
    found = stiffness_posterior(Stiffness(np.array([1.0, 2.0]), np.array([0.01, 0.01])), np.array([0.25, 0.75]))
    assert found.rank(1.5) == pytest.approx(0.25, abs=1e-3)
    assert stiffness_posterior(Stiffness(np.array([np.nan]), ONE), ONE) is None


def test_the_interval_of_a_fit_holds_the_force_s_noise() -> None:
    body = pushed((5, 6), np.random.default_rng(1))
    shape = static(body, 0.5)
    unit = pull(body, shape, 0.5)
    widths = {}
    for noise in (0.0, 0.1, 1.0):
        found = calibrate([seen_with(body, shape, 2.0, noise)], FitOptions(candidates=30)).estimate
        assert found.stiffness is not None
        value, (low, high) = found.stiffness
        assert value == pytest.approx(2.0 / unit, rel=2e-3)
        assert low <= value <= high
        widths[noise] = (high - low) / value
    assert widths[0.0] < 0.02
    assert widths[0.1] == pytest.approx(2 * 1.645 * 0.05, rel=0.1)
    assert widths[1.0] > 1.0
    assert found.stiffness_verdict == "unidentified"
