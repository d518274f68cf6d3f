"""Time stepping through frames: the reference's steps, held particles on straight ways, and the static limit."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.fit.dynamics import MovingSearch, Pace, step_through
from deformscope.stages.fit.model import Model
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.solver import Msm
from tests.stages import reference_states
from tests.stages.bodies import Pushed, pushed
from tests.stages.sequences import pulled


def body_and_way(seed: int, frames: int) -> tuple[Pushed, Msm, FloatArray]:
    body = pushed((5, 6), np.random.default_rng(seed))
    way = np.stack([body.rest[body.held] * (1 - s) + s * body.held_position for s in np.linspace(0, 1, frames + 1)[1:]])
    return body, Msm(body.rest, body.clusters(3), body.held), way


def test_steps_are_those_of_the_reference() -> None:
    body, msm, way = body_and_way(1, 2)
    pace = Pace(alpha=0.4, dt=2e-3, times=(0.01, 0.014))
    assert pace.steps() == [5, 2]
    found, diverged = step_through(msm, way, np.array([0.3, 0.8]), 0.0, pace)
    assert not diverged.any()
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    for row, beta in enumerate((0.3, 0.8)):
        x, before = body.rest.copy(), body.rest[body.held]
        previous = x.copy()
        for frame, (target, steps) in enumerate(zip(way, pace.steps(), strict=True)):
            for step in range(steps):
                on_the_way = before + (step + 1) / steps * (target - before)
                # held particles have no velocity of their own: both states hold them where they are to be
                previous[body.held] = x[body.held] = on_the_way
                velocity = (x - previous) / pace.dt
                previous, (x, _) = (
                    x,
                    reference_states.step(x, velocity, spec, on_the_way, beta=beta, alpha=pace.alpha, dt=pace.dt),
                )
                x, previous = x.copy(), previous.copy()
            np.testing.assert_allclose(found[row, frame], x, atol=1e-12)
            before = target


def test_a_slow_motion_is_a_row_of_static_states_whatever_alpha_and_dt() -> None:
    _, msm, way = body_and_way(2, 2)
    still = msm.relax(way, np.full(2, 0.6)).position
    for alpha, dt in ((0.5, 2e-3), (1.0, 1e-3)):
        found, _ = step_through(msm, way, np.array([0.6]), 0.0, Pace(alpha, dt, (6.0, 12.0)))
        np.testing.assert_allclose(found[0], still, atol=2e-3 * np.abs(way[-1] - msm.rest[msm.held]).max())


def test_a_moving_search_over_some_frames_steps_through_all() -> None:
    one = pulled(np.random.default_rng(3), "own", frames=4, shape=(5, 5))
    pace = Pace(0.5, 2e-3, (0.02, 0.04, 0.06, 0.08))
    every = MovingSearch(one.seen, Model(), (0.0, 0.99), pace)
    every.simulate(np.array([0.2, 0.7]))
    fresh = MovingSearch(one.seen, Model(), (0.0, 0.99), pace).only(np.array([1, 3]), np.ones(2))
    fresh.simulate(np.array([0.2, 0.7]))
    for mine, row in zip(fresh.tried.positions, (1, 3), strict=True):
        np.testing.assert_array_equal(mine, every.tried.positions[row])
    # what held positions that are off do is counted from the moving state
    held = one.seen[3].held
    state = every.tried.positions[3][1]
    np.testing.assert_allclose(every.relax(every.bodies[0], state[held][None], 0.7, state).position[0], state)


@pytest.mark.slow  # two whole motions
def test_moved_evenly_or_at_once_a_body_ends_in_the_same_state() -> None:
    body = pushed((4, 4), np.random.default_rng(4))
    msm = Msm(body.rest, clusters.single(16), body.held)
    at_once, evenly = msm.start(1), msm.start(1)
    ended = msm.step(evenly, body.held_position, 0.5, steps=3000, held_from=body.rest[body.held])
    np.testing.assert_allclose(ended, msm.step(at_once, body.held_position, 0.5, steps=3000), atol=1e-6)
