"""Trials with their labels and features: what every classifier is trained on, whoever measured it; and their
splits into training and test sides: at random as in the thesis, stratified, or by whole groups."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError

TextArray = npt.NDArray[np.str_]

SMALL = "_small"
"""Ends the name of a modality that is another one in fewer pixels."""
DERIVED = "physical"
"""A modality that is computed from the others' measurements: these are also joined without it, as in the thesis."""
LISTED = 4
"""Most names that a message lists; of the others it gives the number."""


@dataclass(frozen=True, slots=True)
class LabelledTable:
    """N trials of known content.

    label: (N,) content; group: (N,) label that may not be on both sides of a split, such as the container or the
    session, or None; modalities: (N, p) features by name; NaN = not measured, a row of NaN = the modality is missing in
    that trial; kind: (N,) kinds, such as the container's type, between which transfer is evaluated, or None; trial:
    (N,) names for messages, or None; series: (N, T, p) features over the squeeze by name, NaN after the end of a trial
    step_s: time between two of the T steps [s]; settings: settings with which the features were computed, stored in a
    model. Raises InputError for sizes that do not fit together."""

    label: TextArray
    group: TextArray | None
    modalities: Mapping[str, FloatArray]
    kind: TextArray | None = None
    trial: TextArray | None = None
    series: Mapping[str, FloatArray] = field(default_factory=dict)
    step_s: float = 0.1
    settings: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.label)
        if not self.modalities:
            raise InputError("at least one modality", "none", "an array of features beside `label`")
        for name in ("group", "kind", "trial"):
            column = getattr(self, name)
            if column is not None and column.shape != (count,):
                raise InputError(f"a {name} for each of {count} labels", f"shape {column.shape}")
        for named, dimensions in ((self.modalities, 2), (self.series, 3)):
            for name, values in named.items():
                if values.ndim != dimensions or len(values) != count or 0 in values.shape:
                    raise InputError(f"{count} rows of features in {name}, as many as labels", f"shape {values.shape}")
                if np.isinf(values).any():
                    row = int(np.flatnonzero(np.isinf(values).reshape(count, -1).any(axis=1))[0])
                    raise InputError(f"finite numbers in {name}", f"infinity in {self.name(row)}")
                if np.isnan(values).all():
                    raise InputError(f"numbers in {name}", "none at all", "leave it out")
        if len(self.classes) < 2:
            came = ", ".join(map(repr, self.classes)) or "none"
            raise InputError("at least two different labels", came, "trials of other contents, as sample:squeezes has")

    def __len__(self) -> int:
        return len(self.label)

    @property
    def classes(self) -> tuple[str, ...]:
        """The labels that occur, sorted."""
        return tuple(map(str, np.unique(self.label)))

    @property
    def target(self) -> IntArray:
        """(N,) index of each trial's label among `classes`."""
        return np.unique(self.label, return_inverse=True)[1].reshape(-1)

    @property
    def fused(self) -> tuple[tuple[str, ...], ...]:
        """Sets of modalities that are fused, first those of late fusion. NAME_small is NAME in fewer pixels and
        replaces it in a separate set, as in Thesis 2.5.4. Sets are repeated without the modalities in `DERIVED`. A
        single modality alone without others to fuse."""
        ending = {one.removesuffix(SMALL): one for one in self.modalities if one.endswith(SMALL)}
        small = {whole: one for whole, one in ending.items() if whole in self.modalities}
        whole = tuple(one for one in self.modalities if one not in small.values())
        sets = (whole, tuple(small.get(one, one) for one in whole)) if small and len(whole) > 1 else (whole,)
        measured = tuple(tuple(one for one in names if one != DERIVED) for names in sets)
        return (*sets, *(names for names in measured if len(names) > 1 and names not in sets))

    def name(self, row: int) -> str:
        """How a message names a trial."""
        return f"row {row + 1}" if self.trial is None else f"trial {self.trial[row]}"

    def missing(self, modality: str) -> BoolArray:
        """(N,) whether nothing of a modality was measured."""
        return absent(self.modalities[modality])

    def rows(self, chosen: BoolArray | IntArray) -> "LabelledTable":
        """The trials at these indices (n,), or where a mask (trials,) is true."""
        return replace(
            self,
            label=self.label[chosen],
            group=None if self.group is None else self.group[chosen],
            modalities={name: values[chosen] for name, values in self.modalities.items()},
            kind=None if self.kind is None else self.kind[chosen],
            trial=None if self.trial is None else self.trial[chosen],
            series={name: values[chosen] for name, values in self.series.items()},
        )

    def of(self, modalities: Sequence[str]) -> "LabelledTable":
        """Some of the modalities, in that order. Raises InputError for one that is not there."""
        if unknown := [name for name in modalities if name not in self.modalities]:
            raise InputError(f"modalities out of {', '.join(self.modalities)}", ", ".join(unknown))
        return replace(
            self,
            modalities={name: self.modalities[name] for name in modalities},
            series={name: values for name, values in self.series.items() if name in modalities},
        )

    def merged(self, merges: Mapping[str, Sequence[str]]) -> "LabelledTable":
        """The same trials in fewer classes: new label -> labels that become it, as in `liquid: water, yogurt`."""
        label = self.label.astype(object)
        for name, members in merges.items():
            if unknown := [one for one in members if one not in self.classes]:
                raise InputError(f"labels out of {', '.join(self.classes)}", ", ".join(map(repr, unknown)))
            label[np.isin(self.label, members)] = name
        return replace(self, label=label.astype(np.str_))


def absent(features: FloatArray) -> BoolArray:
    """(n,) rows of (n, p) features without any measured value."""
    return np.asarray(np.isnan(features).all(axis=1))


def duplicates(table: LabelledTable) -> list[tuple[int, ...]]:
    """Rows that are equal in every modality: across a split they would be known before they are tested."""
    found: dict[bytes, list[int]] = defaultdict(list)
    for row in range(len(table)):
        found[b"".join((values[row] + 0.0).tobytes() for values in table.modalities.values())].append(row)
    return [tuple(rows) for rows in found.values() if len(rows) > 1]


def refuse_duplicates(table: LabelledTable) -> None:
    """Raises InputError with the names of duplicate trials."""
    found = duplicates(table)
    if not found:
        return
    shown = "; ".join(" = ".join(map(table.name, rows)) for rows in found[:LISTED])
    more = f" and {len(found) - LISTED} more" if len(found) > LISTED else ""
    raise InputError(
        "trials that differ: a classifier would recognise a copy across a split",
        f"{shown}{more} with the same features",
        "leave the copies out, or --duplicates drop",
    )


def without_duplicates(table: LabelledTable) -> LabelledTable:
    """The first of each set of equal rows. Raises InputError where equal rows have different labels."""
    drop = np.zeros(len(table), dtype=bool)
    for rows in duplicates(table):
        if len({str(table.label[row]) for row in rows}) > 1:
            raise InputError("equal trials with one label", f"{' = '.join(map(table.name, rows))} with several")
        drop[list(rows[1:])] = True
    return table.rows(~drop)


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
