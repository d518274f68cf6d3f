"""Scores of maps against figures by hand."""

from dataclasses import replace

import numpy as np
import pytest

from deformscope.stages.map.map_score import called_labels
from deformscope.stages.regions.posterior import RegionMap
from deformscope.stages.regions.touches import MapGrid
from studies.map_score import TrueMap, score_map

GRID = MapGrid((0.10, 0.04), 0.01)


def halves(column: int) -> np.ndarray:
    return np.repeat((np.arange(10) >= column)[None], 4, axis=0).astype(int)


def reported(labels: np.ndarray, level: tuple[float, ...] = (0.0, 1.0)) -> RegionMap:
    """A map that is sure of itself: intervals of +-0.1."""
    count = len(level)
    levels = np.array(level)
    return RegionMap(
        GRID,
        "regions",
        count,
        {str(count): 1.0},
        labels,
        np.ones(labels.shape),
        levels,
        np.full(count, 0.06),
        np.stack([levels - 0.1, levels + 0.1], axis=1),
        np.zeros(count, dtype=bool),
        levels[labels],
        np.full(labels.shape, 0.1),
        0.0,
        np.nan,
    )


def truth(labels: np.ndarray, level: tuple[float, ...] = (0.0, 1.0), rigid: tuple[int, ...] = ()) -> TrueMap:
    levels = np.array(level)
    return TrueMap(labels, levels, np.isin(np.arange(len(level)), rigid), levels[labels])


def test_a_perfect_map_scores_so() -> None:
    score = score_map(reported(halves(7)), truth(halves(7)))
    assert (score.iou, score.least_iou, score.boundary_m, score.levels_covered) == (1.0, 1.0, 0.0, 1.0)
    assert (score.field_rms, score.field_covered) == (0.0, 1.0)
    assert score.right
    assert score.ordered
    assert score.rigid_found is None


def test_what_is_off_is_reported_apart() -> None:
    # the right half of the truth is smaller, and its level 0.3 off
    score = score_map(reported(halves(6)), truth(halves(7), (0.0, 1.3)))
    assert score.least_iou == pytest.approx(3 / 4)
    assert score.boundary_m == pytest.approx(0.01)
    assert score.levels_covered == 0.5
    assert score.field_rms == pytest.approx(np.sqrt((1 * 1.0 + 3 * 0.3**2) / 10))
    assert score.field_covered == pytest.approx(0.6)


def test_levels_in_the_wrong_order_are_found_out() -> None:
    assert not score_map(reported(halves(5)), truth(halves(5), (1.0, 0.0))).ordered


def test_a_wrong_number_of_regions_is_not_right_and_tells_no_levels() -> None:
    score = score_map(reported(np.zeros((4, 10), dtype=int), (0.0,)), truth(halves(7)))
    assert not score.right
    assert score.levels_covered is None
    assert score.least_iou == 0.0


def test_rigid_is_found_by_its_flag_and_left_out_of_field_and_levels() -> None:
    known = truth(halves(7), (0.0, 5.0), rigid=(1,))
    bound = reported(halves(7), (0.0, 3.0))
    assert score_map(bound, known).rigid_found is False
    flagged = score_map(replace(bound, rigid=np.array([False, True])), known)
    assert flagged.rigid_found is True
    assert flagged.levels_covered == 1.0
    assert flagged.field_rms == 0.0


def test_a_gradual_verdict_calls_no_regions() -> None:
    gradual = replace(
        reported(halves(5)),
        verdict="gradual",
        region_count=0,
        labels=np.full((4, 10), -1),
        level=np.zeros(0),
        level_interval=np.zeros((0, 2)),
        rigid=np.zeros(0, dtype=bool),
    )
    smooth = TrueMap(None, np.zeros(0), np.zeros(0, dtype=bool), halves(5) + 0.05)
    assert not called_labels(gradual).any()
    assert not score_map(gradual, truth(halves(5))).right
    assert score_map(gradual, truth(halves(5), rigid=(1,))).rigid_found is False
    score = score_map(gradual, smooth)
    assert score.right
    assert score.region_count == 0
    assert score.iou is None
    assert score.field_rms == pytest.approx(0.05)
    assert not score_map(reported(halves(5)), smooth).right
