"""Predicted positions: where the simulation says, with the spread that each source of doubt adds."""

import dataclasses

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from studies.predictive import predict
from tests.stages.bodies import Pushed, pushed

NOISE = 2e-4


def observation(body: Pushed, deformed: FloatArray, noise: float | None = NOISE) -> Observation:
    count = len(body.rest)
    return Observation(
        body.rest,
        deformed,
        body.held,
        np.ones(count, dtype=bool),
        noise=None if noise is None else np.full(count, noise),
        shape=body.shape,
        cell=np.arange(count),
    )


def truth(body: Pushed, beta: float) -> FloatArray:
    model = Model(cluster_size=3)
    return np.asarray(model.body(observation(body, body.rest)).relax(body.held_position, beta).position[0])


@pytest.mark.slow
def test_an_unseen_poke_of_the_model_itself_lies_within_its_intervals() -> None:
    hits = total = 0
    for case in range(12):
        rng = np.random.default_rng(case)
        body, beta = pushed((5, 6), rng), float(rng.uniform(0.2, 0.9))
        other = dataclasses.replace(body, held_position=body.held_position + rng.normal(0.0, 2e-3, 2))
        noise = rng.normal(0.0, NOISE, (2, *body.rest.shape))
        seen = observation(body, truth(body, beta) + noise[0])
        poke = observation(other, truth(other, beta) + noise[1])
        model = Model(cluster_size=3)
        predicted = predict(calibrate([seen], FitOptions(model, candidates=30, seed=case)), [seen], model, poke)
        free = poke.free_observed
        inside = (predicted.low <= poke.deformed) & (poke.deformed <= predicted.high)
        hits, total = hits + int(inside[free].sum()), total + inside[free].size
        np.testing.assert_array_equal(predicted.position[poke.held], poke.deformed[poke.held])
        assert (predicted.low <= predicted.position).all()
        assert (predicted.position <= predicted.high).all()
    assert 0.84 < hits / total < 0.97


def test_doubt_grows_with_level_and_with_what_is_asked_of() -> None:
    body = pushed((5, 6), np.random.default_rng(3))
    seen = observation(body, truth(body, 0.6) + np.random.default_rng(4).normal(0.0, NOISE, body.rest.shape))
    model = Model(cluster_size=3)
    found = calibrate([seen], FitOptions(model, candidates=30))
    widths = []
    for level, measured in ((0.5, False), (0.9, False), (0.9, True)):
        predicted = predict(found, [seen], model, seen, level=level, measured=measured)
        widths.append(float(np.mean((predicted.high - predicted.low)[seen.free_observed])))
    assert widths[0] < widths[1] < widths[2]


def test_misfit_grows_with_the_deformation() -> None:
    """A body that the model cannot fit: twice the motion, twice the doubt."""
    body = pushed((5, 6), np.random.default_rng(5))
    wrong = truth(body, 0.6)
    free = np.ones(len(wrong), dtype=bool)
    free[body.held] = False
    wrong[free] += 1e-3 * np.sin(300.0 * body.rest[free][:, ::-1])
    seen = observation(body, wrong, noise=1e-5)
    model = Model(cluster_size=3)
    found = calibrate([seen], FitOptions(model, candidates=30))
    widths = []
    for factor in (1.0, 2.0):
        moved = body.rest + factor * (wrong - body.rest)
        predicted = predict(found, [seen], model, observation(body, moved), measured=False)
        widths.append(float(np.median((predicted.high - predicted.low)[free])))
    assert widths[1] == pytest.approx(2.0 * widths[0], rel=0.35)
