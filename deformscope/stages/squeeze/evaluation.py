"""Accuracy of the content's classification from each modality, and its uncertainty (Thesis 2.5).

Everything that is learned is learned inside the training side of each split: scaling, components, classifiers,
calibration and fusion."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.executor.local import ThreadWorkers
from deformscope.executor.tasks import compute_all
from deformscope.results.render import reported
from deformscope.stages.squeeze import groupings
from deformscope.stages.squeeze.classifiers import NAMES
from deformscope.stages.squeeze.groupings import Grouping, Normality, near_copies, without_near_copies
from deformscope.stages.squeeze.scores import (
    ClassificationScore,
    Estimated,
    Interval,
    accuracy_of,
    difference,
    holm,
    over_splits,
    recalls,
    score_of,
    share_of,
    split_ratio,
    wilson,
    worth_of,
)
from deformscope.stages.squeeze.table import (
    LISTED,
    PROTOCOLS,
    LabelledTable,
    Protocol,
    Split,
    absent,
    draw,
    refuse_duplicates,
    splitting_notes,
)
from deformscope.stages.squeeze.trial_run import Answers, Key, Method, joined_name, run_split

Progress = Callable[[str, int, int], None]
"""Called with what is done, how much of it, and of how much."""

CURVE_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the training side (Thesis fig. 2.11)."""
KINDS_PAIRED = 4
"""Largest number of kinds of containers that are paired for transfers by default."""
SURE = 0.9
"""A squeeze could stop when one content is so probable."""


@dataclass(frozen=True, slots=True)
class EvaluationOptions:
    """splits: their number;
    curve_splits: splits of the learning curve and the time steps, 0 = none; protocols: kinds of splits, None = those
    that the table allows; level: level of intervals;
    transfer: (training, tested) patterns of kinds or groups; workers: threads"""

    splits: int = 200
    curve_splits: int = 40
    protocols: tuple[Protocol, ...] | None = None
    level: float = 0.9
    seed: int = 0
    transfer: tuple[tuple[str, str], ...] = ()
    workers: int = 1


@dataclass(frozen=True, slots=True)
class ModalityComparison:
    """Two modalities, or ways to fuse them, on the same splits. difference: difference of the first less the second;
    p_value: corrected for splits that share trials, and for the number of comparisons (Holm); by_class: (C,) recall of
    each class"""

    first: Key = field(metadata=reported("first", None, words=lambda one: ", ".join(one.first)))
    second: Key = field(metadata=reported("second", None, words=lambda one: ", ".join(one.second)))
    protocol: Protocol
    difference: Estimated = field(metadata=reported("difference", interval_key="interval", digits="+.1%"))
    p_value: float = field(metadata=reported("p (Holm)", "p_value_holm", digits=".2g"))
    by_class: tuple[Estimated, ...]


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Accuracy of a method trained on a share of the training trials."""

    modality: str
    method: Method
    share: float = field(metadata=reported())
    trials: float = field(metadata=reported())
    accuracy: Estimated = field(metadata=reported(interval_key="interval"))


@dataclass(frozen=True, slots=True)
class TimePoint:
    """Results at a time of the squeeze. accuracy: accuracy of all trials; stopped: share of trials in which one class
    has reached `SURE` by then; right: share of the stopped trials in which that class is the true one (NaN = none
    stopped)"""

    time_s: float = field(metadata=reported())
    accuracy: Estimated = field(metadata=reported(interval_key="interval"))
    stopped: float = field(metadata=reported())
    right: float = field(metadata=reported())


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All results of an evaluation. table: what was evaluated; protocol: the strictest one, to which comparisons, curve
    and steps belong; skipped: parts left out, and why
    copies: rows that nearly equal one of another group; without_copies: `best` of the others alone, None = no copies or
    too few trials without them"""

    table: LabelledTable
    options: EvaluationOptions
    protocol: Protocol
    scores: tuple[ClassificationScore, ...]
    comparisons: tuple[ModalityComparison, ...] = ()
    curve: tuple[CurvePoint, ...] = ()
    steps: Mapping[str, tuple[TimePoint, ...]] = field(default_factory=dict)
    clusters: Mapping[str, Grouping] = field(default_factory=dict)
    normality: Mapping[str, Normality] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    copies: tuple[tuple[int, ...], ...] = ()
    without_copies: ClassificationScore | None = None

    def score(self, modality: str, method: Method, protocol: Protocol | None = None) -> ClassificationScore:
        """One of the scores. Raises KeyError without such a score."""
        wanted = (modality, method, protocol or self.protocol)
        for one in self.scores:
            if (one.modality, one.method, one.protocol) == wanted:
                return one
        raise KeyError(wanted)

    @property
    def best(self) -> ClassificationScore:
        """The score of the model that is saved: late fusion of modalities, or the only one's pooled classifiers."""
        return self.score(*best_key(self.table))

    @property
    def trusted(self) -> ClassificationScore:
        """The score to rely on: `best`, computed without near copies of training trials if the table has any."""
        return self.without_copies or self.best

    def elsewhere(self, score: ClassificationScore) -> Interval:
        """Interval of the accuracy in another container or session: without groups, trials may be recognised by theirs,
        and accuracy beyond chance may be due to the containers."""
        low, high = score.accuracy.interval
        return (low if self.protocol == "group" else min(low, wilson(score.chance, score.worth, score.level)[0])), high


def best_key(table: LabelledTable) -> Key:
    """Late fusion of several modalities, else the pooled classifiers of the only one."""
    names = table.fused[0]
    return joined_name(names), "late-fusion" if len(names) > 1 else "pooled"


def allowed_protocols(table: LabelledTable) -> tuple[tuple[Protocol, ...], list[str]]:
    """The splits that a table can be split by, and why others are left out."""
    found: list[Protocol] = []
    notes = []
    for one in PROTOCOLS:
        try:
            draw(one, table, 1, 0)
            found.append(one)
        except InputError as error:
            if table.group is not None:
                notes.append(f"no splits by {one}: {error}")
    if table.group is None:
        notes.append("no `group`: accuracy in another container or session is unknown")
    return tuple(found), notes


def evaluate(
    table: LabelledTable,
    options: EvaluationOptions | None = None,
    progress: Progress | None = None,
    beyond: LabelledTable | None = None,
) -> Evaluation:
    """Evaluate every modality alone, all of them fused early and late.

    beyond: the same trials and others, of other kinds of containers, for transfers alone; None = `table` Raises
    InputError for duplicate trials and for a table without the requested splits."""
    options = options or EvaluationOptions()
    progress = progress or (lambda what, done, total: None)
    beyond = table if beyond is None else beyond
    refuse_duplicates(beyond)
    if beyond.classes != table.classes:
        raise InputError(f"the contents {', '.join(table.classes)} for transfers", ", ".join(beyond.classes))
    if np.bincount(table.target).max() < 2:
        raise InputError("two trials of a label at least", "one of each", "more trials")
    allowed, notes = allowed_protocols(table)
    protocols = options.protocols or allowed
    strictest = max(protocols, key=PROTOCOLS.index)
    transfers = _transfers(beyond, options.transfer, notes)
    runner = _Runner(table, options, progress)
    others = _Runner(beyond, options, progress)
    methods: tuple[Method, ...] = (*NAMES, "pooled", "late-fusion")
    scores: list[ClassificationScore] = []
    outcomes: dict[Key, list[Answers]] = {}
    drawn: list[Split] = []
    for protocol in protocols:
        splits = draw(protocol, table, options.splits, options.seed)
        found = runner.run(f"{protocol} splits", splits, methods, by_group=protocol == "group")
        for name in table.modalities:
            if (name, "pooled") not in found:
                came = f"too few trials with {name}, or none that differ in it"
                wanted = "features that vary on the training side of every split"
                raise InputError(wanted, came, "leave that modality out")
        scores += [score_of(table, key, protocol, splits, one, options.level) for key, one in found.items()]
        if protocol == strictest:
            outcomes, drawn = found, splits
    for pair, split in transfers.items():
        what = f"transfer {pair[0]} to {pair[1]}"
        found = others.run(what, [split], methods, by_group=beyond.group is not None)
        scores += [score_of(beyond, key, "transfer", [split], one, options.level, pair) for key, one in found.items()]
    steps = {} if not options.curve_splits else _time_steps(table, options, runner, strictest, drawn)
    curve = () if not options.curve_splits else _curve(table, options, runner, strictest, drawn)
    copies = near_copies(table)
    alone = _without_copies(table, copies, options, progress, strictest, notes) if copies else None
    progress("natural groupings", 0, 0)
    return Evaluation(
        table,
        options,
        strictest,
        tuple(scores),
        tuple(_comparisons(table, options, outcomes, drawn, strictest)),
        curve,
        steps,
        groupings.clusters(table, options.seed),
        groupings.normality(table),
        (*splitting_notes(table), *_missing_notes(table), *notes),
        tuple(copies),
        alone,
    )


def _without_copies(
    table: LabelledTable,
    copies: list[tuple[int, ...]],
    options: EvaluationOptions,
    progress: Progress,
    protocol: Protocol,
    notes: list[str],
) -> ClassificationScore | None:
    """The recommended method, evaluated on one trial of each set of near copies and on all that have none."""
    shown = "; ".join(" ~ ".join(map(table.name, rows)) for rows in copies[:LISTED])
    more = f" and {len(copies) - LISTED} more" if len(copies) > LISTED else ""
    where = "another trial" if table.group is None else "one of another group"
    notes.append(f"nearly equal to {where}, nearer than chance explains: {shown}{more}")
    try:
        kept = without_near_copies(table, copies)
        splits = draw(protocol, kept, options.splits, options.seed)
        methods: tuple[Method, ...] = (*NAMES, "pooled", "late-fusion")
        found = _Runner(kept, options, progress).run("without copies", splits, methods, by_group=protocol == "group")
        key = best_key(kept)
        return score_of(kept, key, protocol, splits, found[key], options.level)
    except (InputError, KeyError):
        notes.append("too few trials remain without near copies: accuracy in new ones is unknown")
        return None


class _Runner:
    """Runs splits of a table in threads: what takes time is linear algebra, which lets other threads run."""

    def __init__(self, table: LabelledTable, options: EvaluationOptions, progress: Progress) -> None:
        self.table, self.options, self.progress = table, options, progress
        self.missing = {name: table.missing(name) for name in table.modalities}
        self.target, self.classes = table.target, len(table.classes)
        self.group = None if table.group is None else np.unique(table.group, return_inverse=True)[1].reshape(-1)

    def run(
        self,
        what: str,
        splits: Sequence[Split],
        methods: Sequence[Method],
        *,
        by_group: bool,
        features: Mapping[str, FloatArray] | None = None,
    ) -> dict[Key, list[Answers]]:
        """Outcomes of each method, split by split. features: (trials, columns) by modality, instead of the table's"""
        shown = self.table.modalities if features is None else features
        missing = self.missing if features is None else {k: absent(v) for k, v in shown.items()}
        apart = self.group if by_group else None
        fused = self.table.fused if features is None else None

        def one(split: Split) -> dict[Key, Answers]:
            how: Any = {"apart": apart, "methods": methods, "fused": fused, "seed": self.options.seed}
            return run_split(shown, missing, self.target, self.classes, split, **how)

        counted = itertools.count()
        workers = ThreadWorkers(self.options.workers)
        every = compute_all(workers, one, splits, lambda: self.progress(what, next(counted), len(splits)))
        found: dict[Key, list[Answers]] = {}
        for outcomes in every:
            for key, outcome in outcomes.items():
                found.setdefault(key, []).append(outcome)
        # A modality that a training side lacked altogether has fewer splits than others: it is not evaluated.
        return {key: outcomes for key, outcomes in found.items() if len(outcomes) == len(splits)}


# Transfer ------------------------------------------------------------------------------------------------------------


def _transfers(
    table: LabelledTable, wanted: Sequence[tuple[str, str]], notes: list[str]
) -> dict[tuple[str, str], Split]:
    """Trained on all trials of one kind of container, tested on all of another. wanted: patterns; none = every pair of
    kinds"""
    where = table.kind if table.kind is not None else table.group
    if where is None:
        if wanted:
            raise InputError("`kind` or `group` in the table, for a transfer", "neither")
        return {}
    kinds = [] if table.kind is None else list(map(str, np.unique(table.kind)))
    if not wanted and len(kinds) > KINDS_PAIRED:
        notes.append(f"no transfers between {len(kinds)} kinds unless requested (--transfer)")
        kinds = []
    found = {}
    for pair in wanted or itertools.permutations(kinds, 2):
        train, test = (np.array([fnmatchcase(str(one), pattern) for one in where]) for pattern in pair)
        for side, pattern in ((train, pair[0]), (test, pair[1])):
            if not side.any():
                raise InputError(f"a pattern of {', '.join(sorted(set(map(str, where))))}", repr(pattern))
        if (train & test).any():
            raise InputError("different trials to train and to test", f"{pair[0]!r} and {pair[1]!r} share some")
        if len(np.unique(table.label[train])) < 2 or not np.isin(table.label[test], table.label[train]).any():
            notes.append(f"no transfer from {pair[0]} to {pair[1]}: too few classes in common")
        else:
            found[pair] = Split(np.flatnonzero(train), np.flatnonzero(test))
    return found


# Comparisons ---------------------------------------------------------------------------------------------------------


def _comparisons(
    table: LabelledTable,
    options: EvaluationOptions,
    outcomes: Mapping[Key, Sequence[Answers]],
    splits: Sequence[Split],
    protocol: Protocol,
) -> list[ModalityComparison]:
    """Modalities with one another, each with the joined ones, and late fusion with each, on the same splits."""
    names = table.fused[0]
    joined = joined_name(names)
    pairs: list[tuple[Key, Key]] = []
    for method in ("knn", "pooled"):
        shown = [*table.modalities, joined] if method == "knn" and len(names) > 1 else list(table.modalities)
        pairs += [((one, method), (other, method)) for one, other in itertools.combinations(shown, 2)]
    pairs += [((joined, "late-fusion"), (one, "pooled")) for one in names if len(names) > 1]
    pairs += [((joined, "late-fusion"), (joined, "knn"))] if len(names) > 1 else []
    pairs = [pair for pair in pairs if set(pair) <= set(outcomes)]
    target, classes = table.target, len(table.classes)
    ratio = split_ratio(splits)
    accuracy = {key: np.array([accuracy_of(one, target) for one in found]) for key, found in outcomes.items()}
    recall = {key: np.array([recalls(one, target, classes) for one in found]) for key, found in outcomes.items()}
    worth = worth_of(table, protocol, splits, next(iter(outcomes.values())))
    each = worth * np.bincount(target, minlength=classes) / len(target)
    found = [difference(accuracy[one], accuracy[other], ratio, options.level, worth) for one, other in pairs]
    corrected = holm([p_value for _, p_value in found])
    return [
        ModalityComparison(
            *pair,
            protocol,
            estimated,
            p_value,
            tuple(
                over_splits(recall[pair[0]][:, c] - recall[pair[1]][:, c], ratio, options.level, float(each[c]))
                for c in range(classes)
            ),
        )
        for pair, (estimated, _), p_value in zip(pairs, found, corrected, strict=True)
    ]


# Learning curve and time steps ---------------------------------------------------------------------------------------


def _curve(
    table: LabelledTable, options: EvaluationOptions, runner: _Runner, protocol: Protocol, splits: Sequence[Split]
) -> tuple[CurvePoint, ...]:
    """Thesis fig. 2.11: the test side stays, the training side is thinned out."""
    points = []
    splits = splits[: options.curve_splits]
    for share in CURVE_SHARES:
        thinned = []
        for index, split in enumerate(splits):
            rng = np.random.default_rng([options.seed, index, 11])
            count = max(2, round(share * len(split.train)))
            thinned.append(Split(np.sort(rng.permutation(split.train)[:count]), split.test))
        what = f"learning curve, {share:.0%}"
        found = runner.run(what, thinned, ("knn", "linear"), by_group=protocol == "group")
        for (modality, method), outcomes in found.items():
            score = score_of(table, (modality, method), protocol, thinned, outcomes, options.level)
            trials = float(np.mean([len(one.train) for one in thinned]))
            points.append(CurvePoint(modality, method, share, trials, score.accuracy))
    return tuple(points)


def _time_steps(
    table: LabelledTable, options: EvaluationOptions, runner: _Runner, protocol: Protocol, splits: Sequence[Split]
) -> dict[str, tuple[TimePoint, ...]]:
    """The posterior over the squeeze: at each step a classifier of that step, on the same splits; with several
    modalities that have steps, also their late fusion."""
    splits = splits[: options.curve_splits]
    truth = np.concatenate([table.target[split.test] for split in splits])
    held = {name: held_values(series) for name, series in table.series.items()}
    longest = max((values.shape[1] for values in held.values()), default=0)
    points: dict[str, list[TimePoint]] = {}
    stops: dict[str, list[IntArray]] = {}  # (m,) of each split, the class that ends a squeeze so far; -1: none
    for step in range(longest):
        time_s = step * table.step_s
        now = {name: values[:, min(step, values.shape[1] - 1)] for name, values in held.items()}
        features = {name: values for name, values in now.items() if not np.isnan(values).all()}
        how: Any = {"by_group": protocol == "group", "features": features}
        outcomes = runner.run(f"at {time_s:.1f} s", splits, ("pooled", "late-fusion"), **how)
        for (name, _), answers in outcomes.items():
            named = stops.setdefault(name, [np.full(len(split.test), -1) for split in splits])
            for split, before, one in zip(splits, named, answers, strict=True):
                at = np.searchsorted(split.test, one.rows)
                fresh = (one.sure >= SURE) & (before[at] < 0)
                before[at[fresh]] = one.answer[fresh]
            ended = np.concatenate(named) >= 0
            right = (np.concatenate(named) == truth)[ended]
            worth = worth_of(table, protocol, splits, answers)
            accuracy = share_of(np.array([accuracy_of(one, table.target) for one in answers]), worth, options.level)
            share = float(right.mean()) if right.size else float("nan")
            points.setdefault(name, []).append(TimePoint(time_s, accuracy, float(ended.mean()), share))
    return {name: tuple(found) for name, found in points.items()}


def held_values(series: FloatArray) -> FloatArray:
    """(N, T, p) in which a trial that has ended keeps its last values."""
    held = series.copy()
    for step in range(1, held.shape[1]):
        ended = np.isnan(held[:, step]).all(axis=1)
        held[ended, step] = held[ended, step - 1]
    return held


def _missing_notes(table: LabelledTable) -> list[str]:
    notes = []
    for name, values in table.modalities.items():
        whole = table.missing(name)
        if whole.any():
            notes.append(f"{name} is missing in {whole.sum()} of {len(table)} trials: they neither train nor test it")
        share = float(np.isnan(values[~whole]).mean())
        if share:
            notes.append(f"{share:.1%} of {name} was not measured: replaced by the mean of the training side")
        flat = int((~np.isfinite(values) | (values == values[:1])).all(axis=0).sum())
        if flat:
            notes.append(f"{flat} of {values.shape[1]} columns of {name} are constant, and dropped")
    return notes
