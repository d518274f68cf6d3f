"""Matching of regions against figures by hand."""

import numpy as np
import pytest

from deformscope.stages.map.map_score import boundary_distance, match_regions


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
    assert boundary_distance(np.zeros((4, 10), dtype=int), halves(5), 0.01) is None
