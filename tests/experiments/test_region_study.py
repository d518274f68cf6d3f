"""The study of planners: its scores against figures by hand, its scenes, and a short run."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.experiments.region_study import (
    After,
    Job,
    Run,
    boundary_distance,
    first_passage,
    match_regions,
    ratio,
    run_job,
    scene_truth,
    summarise,
    synthetic_world,
)
from deformscope.stages.touches import MapGrid

GRID = MapGrid(cell_m=0.01)


def halves(column: int) -> np.ndarray:
    return np.repeat((np.arange(10) >= column)[None], 4, axis=0).astype(int)


def test_iou_is_of_the_best_matching_over_the_larger_number_of_regions() -> None:
    assert match_regions(halves(5), halves(5)) == (1.0, [(0, 0), (1, 1)])
    assert match_regions(1 - halves(5), halves(5)) == (1.0, [(0, 1), (1, 0)])
    assert match_regions(halves(6), halves(5))[0] == pytest.approx((5 / 6 + 4 / 5) / 2)
    # a region that is missed, or made up, counts 0
    assert match_regions(np.zeros((4, 10), dtype=int), halves(6))[0] == pytest.approx(0.6 / 2)
    assert match_regions(halves(6), np.zeros((4, 10), dtype=int))[0] == pytest.approx(0.6 / 2)


def test_boundaries_are_as_far_apart_as_they_are() -> None:
    assert boundary_distance(halves(5), halves(8), 0.01) == pytest.approx(0.03)
    assert np.isnan(boundary_distance(np.zeros((4, 10), dtype=int), halves(5), 0.01))


def after(touches: int, iou: float) -> After:
    return After(touches, 0.2 * touches, 2, "regions", iou, 0.0, 1.0, 0.0, True, None, {}, 0.0, (0.0, 0.0))


def test_first_passage_and_its_ratio() -> None:
    slow = [Run("s", seed, "max-variance", None, tuple(after(n, 0.1 * n) for n in range(1, 11))) for seed in range(5)]
    fast = [Run("s", seed, "regions", None, tuple(after(n, 0.2 * n) for n in range(1, 11))) for seed in range(5)]
    assert first_passage(slow[0], 0.75) == (8, pytest.approx(1.6), True)
    assert first_passage(slow[0], 1.5) == (10, pytest.approx(2.0), False)
    assert ratio(fast, slow, 0.75, 0) == pytest.approx((0.5, 0.5, 0.5))
    assert ratio(fast, slow, 0.75, 1) == pytest.approx((0.5, 0.5, 0.5))


def test_a_summary_is_of_all_seeds_and_leaves_out_what_is_not_known() -> None:
    runs = [
        Run("s", seed, "regions", stop, (after(1, 0.2), after(2, iou)))
        for seed, stop, iou in ((0, 2, 0.9), (1, None, 0.8), (2, 1, np.nan))
    ]
    told = summarise(runs, 2, 8)
    assert told.iou == pytest.approx(0.85)
    assert told.good == pytest.approx(1 / 3)
    assert (told.right_count, told.gradual, told.stop_after) == (1.0, 0.0, 2.0)
    assert told.travel_m == pytest.approx(0.4)
    assert np.isnan(told.rigid_found)


@pytest.mark.parametrize("scene", ["two-60-150", "three-60-110-rigid", "disc", "soft-spot", "wavy", "strip"])
def test_scenes_differ_by_seed_and_have_their_regions(scene: str) -> None:
    first, second = (scene_truth(scene, seed, GRID) for seed in (0, 1))
    assert first.labels is not None
    assert second.labels is not None
    assert (first.labels != second.labels).any()
    assert set(first.labels.ravel().tolist()) == set(range(first.region_count))
    np.testing.assert_array_equal(first.log_stiffness, first.level[first.labels])
    np.testing.assert_array_equal(scene_truth(scene, 0, GRID).labels, first.labels)


def test_a_gradient_has_no_regions_and_an_unknown_scene_is_refused() -> None:
    assert scene_truth("gradient", 0, GRID).labels is None
    with pytest.raises(InputError, match="scene"):
        scene_truth("moon", 0)


def test_a_synthetic_world_answers_with_blur_noise_and_bounds() -> None:
    truth = scene_truth("two-150-rigid", 3, GRID)
    assert truth.labels is not None
    world = synthetic_world(truth, 3, GRID)
    soft, rigid = (GRID.centres_m[(truth.labels == label).ravel()][:, 0] for label in (0, 1))
    far = {0: np.array([soft.min(), 0.2]), 1: np.array([rigid.max(), 0.2])}
    values = np.array([world(far[0])[0] for _ in range(200)])
    assert values.mean() == pytest.approx(np.log(150.0), abs=0.02)
    assert values.std() == pytest.approx(0.08, rel=0.2)
    assert world(far[1])[2]


def test_a_run_finds_two_halves_and_repeats() -> None:
    run = run_job(Job("two-60-150", 101, "regions", touches=6, cell_m=0.01))
    again = run_job(Job("two-60-150", 101, "regions", touches=3, cell_m=0.01))
    assert [one.touches for one in run.after] == [1, 2, 3, 4, 5, 6]
    last = run.after[-1]
    assert last.region_count == 2
    assert last.iou > 0.8
    assert last.ordered
    assert np.all(np.diff([one.travel_m for one in run.after]) > 0.0)
    assert [one.iou for one in again.after] == [one.iou for one in run.after[:3]]
    assert [one.xy_m for one in again.after] == [one.xy_m for one in run.after[:3]]
