"""Maps beside an oracle's that knows what kind of border there is."""

import numpy as np
import pytest

from deformscope.stages.regions.partitions import Family, draw
from studies.borders import BorderConfig, BorderOutcome, report, try_border


def test_an_oracle_draws_its_family_alone() -> None:
    shares = tuple(float(one is Family.RING) for one in Family)
    maps = draw(np.random.default_rng(0), 2, (0.6, 0.4), 50, shares)
    assert set(maps.family.ravel()) == {Family.RING}
    assert maps.take(np.arange(3)).family_shares == shares


def test_a_line_of_each_scene_and_estimator() -> None:
    tried = [BorderOutcome("ring", seed, oracle, 0.5 + 0.4 * oracle, oracle, 8) for seed in (0, 1) for oracle in (0, 1)]
    (table,) = report(BorderConfig(), 1.0, tried).tables
    assert [row[:5] for row in table.rows] == [
        ("ring", "explore", "2", "0.500 [0.00]", "0 of 2"),
        ("ring", "oracle", "2", "0.900 [1.00]", "2 of 2"),
    ]


@pytest.mark.slow
def test_an_oracle_is_no_worse_on_a_straight_border() -> None:
    known, other = (try_border(("two-60-150", 0, 6, oracle)) for oracle in (True, False))
    assert known.right
    assert known.iou > other.iou - 0.03
