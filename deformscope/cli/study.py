"""Studies: cases that are tried in several processes, and what is said of all outcomes. One runner for all of them.

def trials(options: CreepOptions) -> list[Trials]:
    return [Trials("touches", try_creep, [CreepCase(seed) for seed in range(options.objects)])]

STUDY = Study(CreepOptions, trials, report)      # report(options, seconds, outcomes) -> StudyReport
"""

from __future__ import annotations

import json
import time
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from deformscope.cli.common import fit_progress, quiet_warp, recorder_of, show, write_file, write_json
from deformscope.config.reproduce import StudyOptions
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Figure, Table
from deformscope.processes import in_processes
from deformscope.session import Step

CaseT = TypeVar("CaseT")
OutcomeT = TypeVar("OutcomeT")


@dataclass(frozen=True, slots=True)
class Trials(Generic[CaseT, OutcomeT]):
    """Cases that are tried alike. of: what they are, in the plural; try_one: a function of a module"""

    of: str
    try_one: Callable[[CaseT], OutcomeT]
    cases: Sequence[CaseT]


@dataclass(frozen=True, slots=True)
class StudyReport:
    """What is said of all outcomes. tables, figures: as they are shown and recorded; files: content by path, None is
    not written"""

    tables: Sequence[Table]
    json: object
    figures: Sequence[Figure] = ()
    files: Mapping[Path | None, bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Study:
    """options: the class of its flags, a `StudyOptions`; trials: what is tried with them
    report: called with the options, the seconds that it took, and the outcomes of each of the trials"""

    options: type[Any]
    trials: Callable[[Any], Sequence[Trials[Any, Any]]]
    report: Callable[..., StudyReport]


def run(study: Study, options: StudyOptions) -> None:
    """Try all cases; show, record and write what is said of them."""
    quiet_warp()
    began = time.monotonic()
    every = study.trials(options)
    with recorder_of(options) as recorder:
        outcomes = [_resumed(trials, options) for trials in every]
        report = study.report(options, time.monotonic() - began, *outcomes)
        found = Findings(tuple(report.tables), tuple(report.figures))
        show(found)
        recorder.write(Step((found,)))
    for path, content in report.files.items():
        write_file(path, content)
    write_json(report.json, options.output.json)


def tried(
    trials: Trials[CaseT, OutcomeT],
    workers: int | None,
    known: Mapping[int, OutcomeT] | None = None,
    keep: Callable[[Sequence[tuple[CaseT, OutcomeT]]], None] | None = None,
    together: int = 1,
) -> list[OutcomeT]:
    """The outcome of each case in their order, computed in several processes, each on one core, with a progress bar.

    known: outcomes that are there already, by the index of their case
    keep: called with so many new ones at a time, also with what is there where the command is broken off
    """
    from threadpoolctl import threadpool_limits

    found = dict(known or {})
    left = [index for index in range(len(trials.cases)) if index not in found]
    waiting: list[tuple[CaseT, OutcomeT]] = []
    try:
        with fit_progress() as note, threadpool_limits(1):
            note(trials.of, 0, len(left))
            coming = in_processes(trials.try_one, [trials.cases[index] for index in left], workers, quiet_warp)
            for count, (place, one) in enumerate(coming, start=1):
                found[left[place]] = one
                waiting.append((trials.cases[left[place]], one))
                if keep is not None and len(waiting) >= together:
                    keep(waiting)
                    waiting = []
                note(trials.of, count, len(left))
    finally:
        if keep is not None and waiting:
            keep(waiting)
    return [found[index] for index in range(len(trials.cases))]


# Outcomes in a file, a line each, so that none is lost where the rest is cut off --------------------------------------


def _resumed(trials: Trials[Any, Any], options: StudyOptions) -> list[Any]:
    path = options.resume
    if path is None:
        return tried(trials, options.jobs)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]  # a last line that was cut off is left out
    write_file(path, whole.encode())
    kept = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            of, case, kind, outcome = json.loads(line)
        except ValueError as error:
            raise InputError("a study's outcomes", str(error), "leave --resume out", f"{path}:{number}") from error
        kept[of, json.dumps(case)] = (kind, outcome)
    known = {}
    for index, case in enumerate(trials.cases):
        if (one := kept.get((trials.of, json.dumps(_plain(case))))) is not None:
            try:
                known[index] = _outcome(trials.try_one, *one)
            except msgspec.ValidationError as error:
                raise InputError("outcomes of this version", str(error), "leave --resume out", path) from error

    def keep(new: Sequence[tuple[Any, Any]]) -> None:
        with path.open("a", encoding="utf-8") as file:
            for case, one in new:
                file.write(json.dumps([trials.of, _plain(case), type(one).__name__, _plain(one)]) + "\n")

    return tried(trials, options.jobs, known, keep)


def _plain(value: object) -> Any:
    """What JSON holds, but for nan and infinities, which Python's reads and writes."""
    return msgspec.to_builtins(value, enc_hook=_numbers)


def _numbers(one: Any) -> object:
    if isinstance(one, np.ndarray):
        return [one.dtype.str, one.shape, one.ravel().tolist()]
    return one.tolist() if isinstance(one, np.generic) else one


def _array(kind: Any, one: Any) -> object:
    """As `_numbers` has left it. kind: as its type hint says"""
    if (typing.get_origin(kind) or kind) is not np.ndarray:
        return one
    dtype, shape, values = one
    return np.array(values, dtype).reshape(shape)


def _outcome(try_one: Callable[..., object], kind: str, value: object) -> object:
    """As `try_one` returns it. kind: the name of its class, where there are several"""
    returned = typing.get_type_hints(try_one)["return"]
    several = [one for one in typing.get_args(returned) if getattr(one, "__name__", "") == kind]
    return msgspec.convert(value, type=several[0] if several else returned, dec_hook=_array)
