"""Splits of trials into training and test sides: at random as in the thesis, stratified, or by whole groups."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.squeeze.table import LISTED, LabelledTable

Protocol = Literal["random", "stratified", "group"]
PROTOCOLS: tuple[Protocol, ...] = ("random", "stratified", "group")
TEST_SHARE = 0.3
"""Share of the trials in the test side (Thesis 2.5.3)."""


@dataclass(frozen=True, slots=True)
class Split:
    """train, test: indices of trials; some trials may be in neither"""

    train: IntArray
    test: IntArray


def draw(protocol: Protocol, table: LabelledTable, count: int, seed: int) -> list[Split]:
    """`count` splits; the same for the same table and seed. Raises InputError where the table cannot be split so."""
    target = table.target
    group = np.arange(len(table)) if table.group is None else np.unique(table.group, return_inverse=True)[1]
    if protocol == "group":
        if table.group is None:
            hint = "container or session, or leave the splits by group out"
            raise InputError("a `group` for each trial", "none", hint)
        if len(single_group_classes(table)) == len(table.classes) or len(np.unique(table.group)) < 2:
            wanted = "classes from two groups or more, to train on one and test on another"
            raise InputError(wanted, "one group of each")
    drawn = []
    for index in range(count):
        rng = np.random.default_rng([seed, PROTOCOLS.index(protocol), index])
        tested = _TESTED[protocol](target, group.reshape(-1), rng)
        drawn.append(Split(np.flatnonzero(~tested), np.flatnonzero(tested)))
    return drawn


def _random(target: IntArray, group: IntArray, rng: np.random.Generator) -> BoolArray:
    """(trials,) which are tested: a random share of all, at least one."""
    count = len(target)
    tested = np.zeros(count, dtype=bool)
    tested[rng.permutation(count)[: min(max(1, round(TEST_SHARE * count)), count - 1)]] = True
    return tested


def _stratified(target: IntArray, group: IntArray, rng: np.random.Generator) -> BoolArray:
    """(trials,) which are tested: of each class its share, rounded up or down by chance; one trial at least stays to
    train."""
    tested = np.zeros(len(target), dtype=bool)
    for one in range(int(target.max()) + 1):
        rows = rng.permutation(np.flatnonzero(target == one))
        tested[rows[: min(int(TEST_SHARE * len(rows) + rng.random()), len(rows) - 1)]] = True
    if not tested.any():  # few trials of every class: one of a class that has another
        sizes = np.bincount(target)
        tested[rng.choice(np.flatnonzero(sizes[target] > 1))] = True
    return tested


def _by_group(target: IntArray, group: IntArray, rng: np.random.Generator) -> BoolArray:
    """(trials,) which are tested: of the groups of each class their share, at least one; one group at least of each
    class stays to train. That holds where a group has one class (a container) and where it has all (a session)."""
    members = np.zeros((int(group.max()) + 1, int(target.max()) + 1), dtype=bool)
    members[group, target] = True
    groups = members.sum(axis=0)
    share = (TEST_SHARE * groups + rng.random(len(groups))).astype(int)
    left = np.minimum(np.maximum(share, 1), groups - 1)
    tested = np.zeros(len(members), dtype=bool)
    for one in rng.permutation(len(members)):
        if (left[members[one]] > 0).all():
            tested[one] = True
            left[members[one]] -= 1
    return tested[group]


_TESTED = {"random": _random, "stratified": _stratified, "group": _by_group}


def single_group_classes(table: LabelledTable) -> tuple[str, ...]:
    """Classes that come from one group alone: no split by group can train and test them."""
    if table.group is None:
        return ()
    return tuple(one for one in table.classes if len(np.unique(table.group[table.label == one])) < 2)


def splitting_notes(table: LabelledTable) -> list[str]:
    """Remarks for an evaluation with classes that are too small."""
    sizes = {one: int((table.label == one).sum()) for one in table.classes}
    notes = []
    if single := [one for one, size in sizes.items() if size < 2]:
        notes.append(f"one trial alone of {_listed(single)}: never tested in stratified splits")
    if few := [one for one, size in sizes.items() if 2 <= size < 5]:
        them = "it" if len(few) == 1 else "them"
        notes.append(f"fewer than 5 trials of {_listed(few)}: results on {them} are uncertain")
    if alone := single_group_classes(table):
        notes.append(f"{_listed(alone)}: from one group alone, never tested in splits by group")
    return notes


def _listed(names: list[str] | tuple[str, ...]) -> str:
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return f"{', '.join(names[:LISTED])}{more}"
