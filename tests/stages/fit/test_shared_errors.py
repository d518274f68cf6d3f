"""Frames of one motion: they count by what is new, and the interval holds the truth however noise is shared."""

import dataclasses
import typing

import numpy as np
import pytest

from deformscope.stages.fit.calibrate import FitOptions, Model, calibrate
from deformscope.stages.fit.search import Search
from deformscope.stages.fit.shared_errors import FULLY, Shared, for_posterior, patches, shared_part, together, weights
from tests.stages.bodies import lattice
from tests.stages.sequences import Sharing, pulled

SHARINGS: tuple[Sharing, ...] = typing.get_args(Sharing)
FIT = FitOptions(Model(), (0.0, 0.99), candidates=25)


def rate(sharing: Sharing, cases: int) -> tuple[float, float, float, float]:
    """Coverage over all frames; root mean square error over all frames and of the last alone; ratio of widths."""
    held, error, width = 0, [], []
    for case in range(cases):
        one = pulled(np.random.default_rng([case, SHARINGS.index(sharing)]), sharing)
        whole = calibrate(one.seen, FIT, one_motion=True).estimate
        last = calibrate(one.seen[-1:], FIT).estimate
        held += whole.interval[0] <= one.beta <= whole.interval[1]
        error.append((whole.value - one.beta, last.value - one.beta))
        width.append((whole.interval[1] - whole.interval[0]) / (last.interval[1] - last.interval[0]))
    root = np.sqrt(np.mean(np.square(error), axis=0))
    return held / cases, float(root[0]), float(root[1]), float(np.median(width))


def evenly(rho: float, most: float | None = None) -> Shared:
    """Any two frames share as much."""
    return Shared(rho, rho if most is None else most, rho, 0.0)


def test_independent_frames_count_in_full_and_shared_ones_as_the_best_of_them() -> None:
    reported, rows = np.array([1.0, 2.0, 3.0]), np.arange(3)
    np.testing.assert_allclose(weights(reported, rows, evenly(0.0)), 1.0)
    np.testing.assert_allclose(weights(reported, rows, FULLY), [0.0, 0.0, 1.0])


def test_of_a_drift_the_last_frame_counts_most() -> None:
    weight = weights(np.arange(1.0, 7.0), np.arange(6), Shared(0.7, 0.7, 0.0, 0.9))
    assert weight[-1] > 3.0 * weight[:-1].max()


@pytest.mark.parametrize(("far", "near"), [(0.0, 0.0), (0.2, 0.0), (0.6, 0.5), (0.0, 0.9)])
def test_curvature_is_the_variance_of_the_score(far: float, near: float) -> None:
    """What makes a composite likelihood's interval right: sum w a^2 = (w a)' C (w a)."""
    rng = np.random.default_rng(1)
    reported, rows = rng.uniform(0.5, 3.0, 7), np.arange(7)
    for more in (0.0, 0.2):
        shared = Shared(0.5, 0.5 + more, far, near)
        score = weights(reported, rows, shared) * reported
        assert score.min() >= 0.0
        assert score @ reported == pytest.approx(score @ shared.bound(rows) @ score, rel=1e-9)
        for _ in range(200):  # no other weights do better
            other = rng.uniform(0.0, 1.0, 7)
            c = shared.matrix(rows)
            assert (other @ reported) ** 2 / (other @ c @ other) <= (score @ reported) ** 2 / (score @ c @ score) * (
                1 + 1e-9
            )


def test_frames_that_tell_nothing_are_left_out_unless_all_do() -> None:
    np.testing.assert_array_equal(weights(np.array([0.0, 2.0]), np.arange(2), evenly(0.0)), [0.0, 1.0])
    np.testing.assert_array_equal(weights(np.zeros(2), np.arange(2), evenly(0.0)), [1.0, 1.0])


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.95])
def test_the_shared_part_is_found_from_scores(rho: float) -> None:
    rng = np.random.default_rng(3)
    score = np.sqrt(rho) * rng.standard_normal((1, 400)) + np.sqrt(1.0 - rho) * rng.standard_normal((6, 400))
    found = shared_part(score * np.arange(1, 7)[:, None], rng)
    assert found.mean == pytest.approx(rho, abs=0.06)
    assert found.mean <= found.most < rho + 0.12
    assert found.near < 0.2 or rho > 0.9


def test_a_drift_is_reported_from_what_all_frames_share() -> None:
    rng = np.random.default_rng(8)
    found = shared_part(np.cumsum(rng.standard_normal((6, 400)), axis=0), rng)
    assert found.near > 0.4
    assert found.far < found.mean


def test_too_few_patches_cannot_tell_that_frames_are_independent() -> None:
    rng = np.random.default_rng(4)
    assert shared_part(rng.standard_normal((6, 3)), rng) == FULLY
    assert shared_part(rng.standard_normal((1, 30)), rng) == FULLY


def test_patches_are_of_the_asked_side_without_slivers() -> None:
    sizes = np.bincount(patches(lattice((10, 7), 1.0), 3.0))
    assert len(sizes) == 3 * 2
    assert sizes.min() >= 9


def test_frames_of_the_posterior_are_few_and_no_less_honest() -> None:
    search = Search(pulled(np.random.default_rng(5), "own", frames=20, sigma=1e-4).seen, Model(), (0.0, 0.99))
    search.sweep(20, None)
    search.refine()
    found = together(search, 0)
    rows, weight = for_posterior(found)
    assert len(rows) <= 8
    assert rows[-1] == 19
    assert weight @ found.information[rows] ** 2 <= found.weight @ found.information**2


def test_frames_that_run_together_are_what_they_are_alone() -> None:
    one = pulled(np.random.default_rng(6), "own", frames=3, shape=(6, 6))
    value = np.array([0.1, 0.5, 0.9])
    whole = Search(one.seen, Model(), (0.0, 0.99))
    whole.simulate(value)
    assert len(set(map(id, whole.bodies))) == 1
    for row, seen in enumerate(one.seen):
        alone = Search([seen], Model(), (0.0, 0.99))
        alone.simulate(value)
        np.testing.assert_allclose(whole.tried.positions[row], alone.tried.positions[0], atol=1e-8)


def test_known_beta_without_noise() -> None:
    one = pulled(np.random.default_rng(7), "own", sigma=0.0, beta=0.62, frames=3)
    found = calibrate(one.seen, FIT, one_motion=True).estimate
    assert found.value == pytest.approx(0.62, abs=1e-3)
    assert len(found.settings["frame_values"]) == 3  # type: ignore[arg-type]


def test_a_wrong_track_is_left_out_of_the_frames_that_it_is_in() -> None:
    one = pulled(np.random.default_rng(7), "own", sigma=0.0, beta=0.62, frames=2)
    seen = list(one.seen)
    wrong = int(np.flatnonzero(seen[1].free_observed)[7])
    deformed = seen[1].deformed.copy()
    deformed[wrong] += 0.006
    seen[1] = dataclasses.replace(seen[1], deformed=deformed)
    found = calibrate(seen, FIT, one_motion=True)
    assert [one.wrong.tolist() for one in found.left_out] == [[], [wrong]]
    assert found.estimate.value == pytest.approx(0.62, abs=1e-3)


@pytest.mark.slow
def test_noise_of_its_own_in_each_frame_averages_out() -> None:
    covered, whole, last, width = rate("own", 8)
    assert whole < last
    assert width < 0.95
    assert covered >= 5 / 8  # 90 % less 2.6 binomial standard deviations


@pytest.mark.slow
def test_noise_that_frames_share_does_not() -> None:
    covered, whole, last, width = rate("shared", 8)
    assert covered >= 5 / 8
    assert width > 0.9  # 1/sqrt(6) = 0.41 if frames counted as independent
    assert whole < 1.1 * last


@pytest.mark.slow
@pytest.mark.parametrize("sharing", SHARINGS)
def test_intervals_cover_however_noise_is_shared(sharing: Sharing) -> None:
    cases = 40
    covered, whole, last, width = rate(sharing, cases)
    said = f"{sharing}: {covered:.3f}, rms {whole:.4f} (last {last:.4f}), width {width:.3f}"
    assert covered >= 0.9 - 2.6 * np.sqrt(0.09 / cases), said
    # of a walk the last frame alone would be best; what the estimated correlation costs is in `motion`
    assert whole < (1.15 if sharing == "walking" else 1.1) * last, said
