"""Held particles that are off are found by what they do to the free ones, and put where these show them to be."""

import numpy as np
import pytest

from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model, Observation, calibrate
from tests.cases import slow
from tests.stages.bodies import SPACING_M, pushed

NOISE = 1e-4
BETA = 0.6


def fit(off: float, *, noise: float | None = NOISE, held_measured: bool | None = None) -> tuple[Calibration, int]:
    """A body one of whose held particles is so many spacings from where it is said to be, and which."""
    rng = np.random.default_rng(4)
    body = pushed((6, 7), rng)
    count = len(body.rest)
    lattice_of = {"shape": body.shape, "cell": np.arange(count), "held_measured": held_measured}
    every = np.ones(count, dtype=bool)
    still = Observation(body.rest, body.rest, body.held, every, **lattice_of)  # type: ignore[arg-type]
    model = Model(cluster_size=3)
    deformed = model.body(still).relax(body.held_position, BETA).position[0] + rng.normal(0.0, NOISE, body.rest.shape)
    displaced = int(body.held[2])
    deformed[displaced] += off * SPACING_M * np.array([0.6, -0.8])
    stated = None if noise is None else np.full(count, noise)
    seen = Observation(body.rest, deformed, body.held, every, noise=stated, **lattice_of)  # type: ignore[arg-type]
    return calibrate([seen], FitOptions(model, candidates=30)), displaced


@pytest.mark.parametrize(("noise", "held_measured"), [slow(NOISE, None), (NOISE, False)])
def test_a_held_particle_that_is_off_is_named_and_put_right(noise: float, held_measured: bool | None) -> None:
    found, displaced = fit(0.3, noise=noise, held_measured=held_measured)
    assert found.left_out[0].held.tolist() == [displaced]
    low, high = found.estimate.interval
    assert low <= BETA <= high
    assert high - low < 0.5
    moved = found.comparisons[0].observed[displaced] - found.comparisons[0].rest[displaced]
    np.testing.assert_allclose(moved, 0.0, atol=0.1 * SPACING_M)
    assert not found.comparisons[0].seen[displaced]
    (reason,) = [one for one in found.estimate.reasons if one.code == "held-off"]
    assert reason.text.startswith(f"held particle {displaced} seems to be 0.00")
    assert reason.allows is None
    assert found.estimate.as_json()["settings"]["left_out"] == [  # type: ignore[index]
        {"lost": [], "wrong": [], "held": [displaced]}
    ]


def test_without_a_stated_noise_it_may_be_a_misfit() -> None:
    assert not fit(0.3, noise=None)[0].left_out[0].count


def test_right_held_particles_stay() -> None:
    found, _ = fit(0.0)
    assert not found.left_out[0].count
    assert found.estimate.reasons == ()
    assert "left_out" not in found.estimate.settings
