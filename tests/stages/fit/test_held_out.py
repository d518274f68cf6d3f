"""Held-out error: blocks of neighbours, folds that cover all, and no profit from having been fitted."""

import numpy as np
import pytest

from deformscope.stages.fit.held_out import FOLDS, HeldOut, blocks_of, difference, hold_out, separates
from deformscope.stages.fit.model import Model
from deformscope.stages.fit.search import Search
from tests.stages.bodies import lattice
from tests.stages.sequences import pulled


def test_blocks_are_larger_than_the_flows_window_where_there_is_room() -> None:
    rest = lattice((15, 15), 20.0)
    block, fold = blocks_of(rest, 20.0, 60.0)
    for one in range(int(block.max()) + 1):
        assert np.ptp(rest[block == one], axis=0).max() >= 40.0  # three particles a side
        assert len(set(fold[block == one])) == 1
    assert set(fold) == set(range(FOLDS))
    # no block touches another of its fold along a side
    middle = np.array([rest[block == one].mean(axis=0) for one in range(int(block.max()) + 1)])
    number = np.array([fold[block == one][0] for one in range(len(middle))])
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)
    beside = (apart > 0.0) & (apart < 1.2 * apart[apart > 0.0].min())
    assert not (beside & (number[:, None] == number)).any()


def test_held_out_error_is_that_of_particles_left_out() -> None:
    one = pulled(np.random.default_rng(1), "own", frames=3, sigma=2e-4, shape=(9, 9), beta=0.5)
    search = Search(one.seen, Model(), (0.0, 0.99))
    search.sweep(16, None)
    block, fold = blocks_of(one.seen[0].rest, 0.01, 0.03)
    free = one.seen[0].free_observed
    found = hold_out(search, free, block, fold)
    assert found.value == pytest.approx(0.5, abs=0.1)
    assert found.fit <= found.error
    assert found.error == pytest.approx(2e-4 * np.sqrt(np.pi / 2), rel=0.2)  # the mean length of such noise
    # what is not judged does not count
    assert np.isfinite(hold_out(search, free & (block == 4), block, fold).block).sum() == 1


def test_ways_are_reported_apart_beyond_their_scatter_only() -> None:
    rng = np.random.default_rng(2)
    base = rng.uniform(1.0, 2.0, 12)

    def way(block: np.ndarray) -> HeldOut:
        return HeldOut(float(block.mean()), block, 0.0, 0.5)

    assert separates(way(base + 0.1), way(base))  # everywhere worse
    assert not separates(way(base + rng.normal(0.0, 0.2, 12)), way(base))
    assert not separates(way(base + 1e-4), way(base))  # everywhere worse, by nothing that matters
    gap, scatter = difference(way(base + 0.1), way(base))
    assert gap == pytest.approx(0.1)
    assert scatter < 1e-9
