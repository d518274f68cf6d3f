"""Wrong and lost tracks are named, and left out; what is smooth, however large, is not."""

import numpy as np
import pytest

from deformscope.stages.fit.calibrate import FitOptions, Model, Observation, calibrate
from deformscope.stages.fit.outliers import FALSE_ALARMS, outlying
from tests.stages.bodies import SPACING_M, lattice, pushed

NOISE = 2e-4


@pytest.mark.parametrize("shape", [(6, 8), (4, 4, 4)])
def test_clean_noise_has_hardly_an_outlier(shape: tuple[int, ...]) -> None:
    rest, rng = lattice(shape), np.random.default_rng(1)
    found = [outlying(rest, rng.normal(0.0, NOISE, rest.shape), None, 0.0).any() for _ in range(300)]
    assert np.mean(found) <= 3.0 * FALSE_ALARMS


@pytest.mark.parametrize("shape", [(6, 8), (4, 4, 4)])
@pytest.mark.parametrize("smooth", [0.0, 20.0])
def test_wrong_tracks_stand_out_of_what_is_smooth(shape: tuple[int, ...], smooth: float) -> None:
    rest, rng = lattice(shape), np.random.default_rng(2)
    residual = rng.normal(0.0, NOISE, rest.shape)
    residual[:, 0] += smooth * NOISE * rest[:, 1] / np.ptp(rest[:, 1])
    bad = np.zeros(len(rest), dtype=bool)
    bad[rng.permutation(len(rest))[: len(rest) // 10]] = True
    residual[bad, -1] += 40.0 * NOISE
    found = outlying(rest, residual, np.full(len(rest), NOISE), 0.0)
    assert np.count_nonzero(found & ~bad) == 0
    assert np.count_nonzero(found & bad) >= 0.8 * np.count_nonzero(bad)


def test_outliers_below_the_stated_noise_stay() -> None:
    rest = lattice((5, 6))
    residual = np.zeros(rest.shape)
    residual[7] = NOISE
    assert outlying(rest, residual, None, 1e-9)[7]
    assert not outlying(rest, residual, np.full(len(rest), NOISE), 1e-9).any()


def test_where_half_is_off_no_right_one_is_left_out() -> None:
    rest, rng = lattice((5, 6)), np.random.default_rng(3)
    off = rng.permutation(30)[:15]
    residual = np.zeros(rest.shape)
    residual[off] = rng.normal(0.0, SPACING_M, (15, 2))
    assert set(np.flatnonzero(outlying(rest, residual, np.full(30, 1e-6), 0.0))) <= set(off)


def test_wrong_and_lost_tracks_are_named_and_the_fit_is_that_without_them() -> None:
    rng = np.random.default_rng(4)
    body = pushed((6, 7), rng)
    count = len(body.rest)
    lattice_of = {"shape": body.shape, "cell": np.arange(count)}
    every = np.ones(count, dtype=bool)
    still = Observation(body.rest, body.rest, body.held, every, **lattice_of)  # type: ignore[arg-type]
    model = Model(cluster_size=3)
    deformed = model.body(still).relax(body.held_position, 0.6).position[0] + rng.normal(0.0, NOISE, body.rest.shape)
    moved = np.linalg.norm(deformed - body.rest, axis=1)
    moved[body.held] = 0.0
    lost, wrong = int(moved.argmax()), int(np.flatnonzero(moved > 0.0)[3])
    assert lost != wrong
    tracked = deformed.copy()
    tracked[lost] = body.rest[lost]
    tracked[wrong] += 0.6 * SPACING_M

    def fit(positions: np.ndarray, observed: np.ndarray) -> Observation:
        noise = np.full(count, NOISE)
        return Observation(body.rest, positions, body.held, observed, noise=noise, **lattice_of)  # type: ignore[arg-type]

    options = FitOptions(model, candidates=30)
    found = calibrate([fit(tracked, every)], options)
    (left_out,) = found.left_out
    assert (left_out.lost.tolist(), left_out.wrong.tolist()) == ([lost], [wrong])
    assert found.estimate.as_json()["settings"]["left_out"] == [{"lost": [lost], "wrong": [wrong]}]  # type: ignore[index]
    known = every.copy()
    known[[lost, wrong]] = False
    expected = calibrate([fit(tracked, known)], options).estimate
    assert found.estimate.value == pytest.approx(expected.value, abs=2e-4)
    assert found.estimate.interval == pytest.approx(expected.interval, abs=5e-3)
    assert found.estimate.verdict == expected.verdict
    assert found.estimate.interval[0] < 0.6 < found.estimate.interval[1]
