"""Splits: their sizes, and what may not be on both sides."""

import dataclasses

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.squeeze.table import PROTOCOLS, draw, splitting_notes
from tests.stages.squeeze.trials import blobs


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_seventy_and_thirty_percent_without_a_trial_on_both_sides(protocol: str) -> None:
    table = blobs(classes=4, each=30, groups=10)
    splits = draw(protocol, table, 20, 0)  # type: ignore[arg-type]
    for split in splits:
        assert sorted([*split.train, *split.test]) == list(range(120))
    assert np.mean([len(split.test) for split in splits]) == pytest.approx(36, abs=0.5)
    assert np.unique(np.concatenate([split.test for split in splits])).size == 120
    again = draw(protocol, table, 20, 0)  # type: ignore[arg-type]
    assert all(np.array_equal(one.test, other.test) for one, other in zip(splits, again, strict=True))


def test_stratified_splits_keep_the_shares_of_classes() -> None:
    table = blobs(classes=4, each=10)
    for split in draw("stratified", table, 10, 0):
        np.testing.assert_array_equal(np.bincount(table.target[split.test]), 3)


@pytest.mark.parametrize("crossed", [True, False])
def test_groups_stay_together_and_every_class_has_one_to_train(crossed: bool) -> None:
    """Whether a group has one class, as a container, or all of them, as a session."""
    table = blobs(classes=3, each=20, groups=5)
    assert table.group is not None
    if crossed:
        table = dataclasses.replace(table, group=np.array([f"session {row % 6}" for row in range(60)]))
    assert table.group is not None
    for split in draw("group", table, 30, 1):
        assert not set(table.group[split.train]) & set(table.group[split.test])
        assert set(table.target[split.train]) == {0, 1, 2}
        assert set(table.target[split.test]) == {0, 1, 2}


def test_a_class_of_one_group_is_never_tested_and_one_of_one_trial_stays_to_train() -> None:
    table = blobs(classes=3, each=12, groups=4)
    group = table.group.copy()
    group[:12] = "the only one"
    table = dataclasses.replace(table, group=group)
    assert all(not (table.target[split.test] == 0).any() for split in draw("group", table, 20, 0))
    assert any("c00: from one group alone" in note for note in splitting_notes(table))
    few = table.rows(np.r_[0, 12:36])
    assert all(0 in split.train for split in draw("stratified", few, 20, 0))
    assert any("one trial alone of c00" in note for note in splitting_notes(few))


def test_tables_that_cannot_be_split_by_group_are_refused() -> None:
    with pytest.raises(InputError, match="a `group` for each trial"):
        draw("group", dataclasses.replace(blobs(), group=None), 2, 0)
    with pytest.raises(InputError, match="two groups or more"):
        draw("group", blobs(groups=1), 2, 0)
