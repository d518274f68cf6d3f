"""Evaluates one split: every classifier of every modality, and early and late fusion, trained on one side and tested on
the other."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.squeeze.classifiers import NAMES, Name, columns_of, fit, usable
from deformscope.stages.squeeze.components import Space, fit_scaling, project
from deformscope.stages.squeeze.fusion import Fitted, everywhere, fit_expert, fit_pool, fuse
from deformscope.stages.squeeze.table import Split

Method = Name | Literal["pooled", "late-fusion"]
Key = tuple[str, Method]
"""Modality, or several with + between them; and method."""


@dataclass(frozen=True, slots=True)
class Answers:
    """Answers of a classifier. rows: (m,) tested trials; answer: (m,) classes; sure: (m,) posteriors of these;
    log_truth: (m,) logarithm of the true class's posterior; components: number of components used"""

    rows: IntArray
    answer: IntArray
    sure: FloatArray
    log_truth: FloatArray
    components: int


def joined_name(modalities: Sequence[str]) -> str:
    """Name of several modalities together."""
    return "+".join(modalities)


def answers_of(rows: IntArray, logs: FloatArray, target: IntArray, components: int) -> Answers:
    """Answers from (m, C) logarithms of posteriors and (m,) true classes."""
    answer = logs.argmax(axis=1)
    row = np.arange(len(rows))
    return Answers(rows, answer, np.exp(logs[row, answer]), logs[row, target], components)


@dataclass(frozen=True, slots=True)
class Sides:
    """A modality on both sides of a split: rows where it was measured, and these on components."""

    train: IntArray
    test: IntArray
    space: Space


def sides_of(
    features: Mapping[str, FloatArray], missing: Mapping[str, BoolArray], split: Split, fused: Sequence[tuple[str, ...]]
) -> dict[str, Sides]:
    """Every modality (trials, columns) alone, and joined ones: early fusion, standardised columns side by side.
    missing: (trials,) which lack each modality"""
    scaled: dict[str, tuple[IntArray, IntArray, FloatArray, FloatArray]] = {}
    for name, values in features.items():
        train, test = split.train[~missing[name][split.train]], split.test[~missing[name][split.test]]
        if len(train):
            scaling = fit_scaling(values[train])
            scaled[name] = (train, test, scaling.apply(values[train]), scaling.apply(values[test]))
    grams: dict[str, FloatArray] = {}
    for name, (train, _, one, other) in scaled.items():
        if one.shape[1] > len(train):
            both = np.concatenate([one, other])
            grams[name] = both @ both.T
    found = {name: Sides(*four[:2], project(*four[2:], grams.get(name))) for name, four in scaled.items()}
    for names in fused:
        if len(names) > 1 and set(names) <= set(scaled):
            found[joined_name(names)] = _joined({name: scaled[name] for name in names}, grams, split)
    return found


def _joined(
    scaled: Mapping[str, tuple[IntArray, IntArray, FloatArray, FloatArray]],
    grams: Mapping[str, FloatArray],
    split: Split,
) -> Sides:
    whole = all(len(train) + len(test) == len(split.train) + len(split.test) for train, test, *_ in scaled.values())
    width = sum(one.shape[1] for *_, one, _ in scaled.values())
    if whole and width > len(split.train):
        gram = np.zeros((len(split.train) + len(split.test),) * 2)
        for name, (_, _, one, other) in scaled.items():
            if name in grams:
                gram += grams[name]
            else:
                both = np.concatenate([one, other])
                gram += both @ both.T
        space = project(np.zeros((len(split.train), width)), np.zeros((len(split.test), width)), gram)
        return Sides(split.train, split.test, space)
    train = functools.reduce(np.intersect1d, [rows for rows, *_ in scaled.values()])
    test = functools.reduce(np.intersect1d, [rows for _, rows, *_ in scaled.values()])
    one = np.concatenate([four[2][np.isin(four[0], train)] for four in scaled.values()], axis=1)
    other = np.concatenate([four[3][np.isin(four[1], test)] for four in scaled.values()], axis=1)
    return Sides(train, test, project(one, other))


def run_split(
    features: Mapping[str, FloatArray],
    missing: Mapping[str, BoolArray],
    target: IntArray,
    classes: int,
    split: Split,
    *,
    apart: IntArray | None = None,
    methods: Sequence[Method] = (*NAMES, "pooled", "late-fusion"),
    fused: Sequence[tuple[str, ...]] | None = None,
    seed: int = 0,
) -> dict[Key, Answers]:
    """Train and test every method.

    features: (N, p) features by modality; missing: (N,) trials that lack it, by modality; target: (N,) classes; apart:
    (N,) groups, if splits are by group: then splits inside the training side are by group, too; fused: modalities that
    are joined, the first of them fused late too, None = all"""
    fused = (tuple(features),) if fused is None else fused
    found: dict[Key, Answers] = {}
    fitted: dict[str, tuple[Sides, Fitted, FloatArray]] = {}
    for modality, sides in sides_of(features, missing, split, fused).items():
        space, truth = sides.space, target[sides.train]
        if not space.train.size:
            continue
        groups = None if apart is None else apart[sides.train]
        if modality in features and {"pooled", "late-fusion"} & {*methods}:
            expert = fit_expert(space.train, space.kept, space.raw, truth, classes, groups, seed=seed)
            said = {member.name: member.log_posterior(space.test) for member in expert.expert.members}
            logs = everywhere(expert.expert.pool, np.stack(list(said.values())))
            fitted[modality] = sides, expert, logs
            found[modality, "pooled"] = answers_of(sides.test, logs, target[sides.test], space.train.shape[1])
        else:
            said = {}
            for name in (one for one in NAMES if one in methods and usable(one, space.raw)):
                columns = columns_of(name, space.kept)
                classifier = fit(name, space.train[:, :columns], truth, classes, groups)
                said[name] = classifier.log_posterior(space.test[:, :columns])
        for name in (one for one in said if one in methods):
            count = min(columns_of(name, space.kept) or space.train.shape[1], space.train.shape[1])
            found[modality, name] = answers_of(sides.test, said[name], target[sides.test], count)
    late = [fitted[name] for name in fused[0] if name in fitted]
    if "late-fusion" in methods and len(late) > 1:
        logs = late_fusion(late, target, classes, split)
        found[joined_name(fused[0]), "late-fusion"] = answers_of(split.test, logs, target[split.test], 0)
    return found


def late_fusion(
    fitted: Sequence[tuple[Sides, Fitted, FloatArray]], target: IntArray, classes: int, split: Split
) -> FloatArray:
    """(m, C) fused posteriors of the split's test side; weights are learned from training points left out. fitted: for
    each modality its sides, its expert, and its posteriors on the test side"""
    shape = len(fitted), len(split.train)
    inside, known = np.zeros((*shape, classes)), np.zeros(shape, dtype=bool)
    outside = np.zeros((len(fitted), len(split.test), classes))
    present = np.zeros(outside.shape[:2], dtype=bool)
    for index, (sides, one, said) in enumerate(fitted):
        at = np.searchsorted(split.train, sides.train)
        inside[index, at], known[index, at] = one.logs, one.known
        at = np.searchsorted(split.test, sides.test)
        outside[index, at], present[index, at] = said, True
    usable_rows = known.any(axis=0)
    pool = fit_pool(inside[:, usable_rows], known[:, usable_rows], target[split.train][usable_rows])
    return fuse(pool, outside, present)
