"""Studies: cases that are tried in several processes, and statistics of all outcomes. One runner for all of them.

def trials(options: CreepOptions) -> list[Trials]:
    return [Trials("touches", try_creep, [CreepCase(seed) for seed in range(options.objects)])]

STUDY = Study(CreepOptions, trials, report)      # report(options, seconds, outcomes) -> StudyReport
"""

import functools
import json
import time
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, cast

import msgspec
import numpy as np
from tyro.conf import OmitArgPrefixes

from deformscope.cli.common import (
    begin_worker,
    fit_progress,
    make_folder,
    quiet_warp,
    recorder_of,
    say,
    show,
    write_file,
    write_json,
)
from deformscope.config import flags
from deformscope.config.executor import ExecutorOptions
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.errors import InputError
from deformscope.executor.local import HereWorker, open_workers
from deformscope.executor.tasks import Journal, compute
from deformscope.frames import StageCost
from deformscope.pictures.report import Figure, Findings, Table
from deformscope.session import Step

CaseT = TypeVar("CaseT")
OutcomeT = TypeVar("OutcomeT")


@dataclass(frozen=True, slots=True)
class StudyOptions(RecordedOptions):
    """Options of every study."""

    jobs: flags.ManyFlag = 2
    """Number of parallel processes."""
    resume: Annotated[Path | None, flags.one_word("FILE", Path), flags.unset] = None
    """Store each outcome in this file, one line of JSON each. A later command of the same version reads them instead of
    computing the same cases again."""
    on: OmitArgPrefixes[ExecutorOptions] = field(default_factory=ExecutorOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class Trials(Generic[CaseT, OutcomeT]):
    """Cases that are all tried by the same function. of: the plural of a case's name; try_one: a function of a
    module"""

    of: str
    try_one: Callable[[CaseT], OutcomeT]
    cases: Sequence[CaseT]


@dataclass(frozen=True, slots=True)
class StudyReport:
    """Statistics of all outcomes. tables, figures: shown and recorded; further: tables that are recorded, not shown;
    results, costs: recorded too; files: content by path; a file whose path is None is not written"""

    tables: Sequence[Table]
    json: object
    figures: Sequence[Figure] = ()
    files: Mapping[Path | None, bytes] = field(default_factory=dict)
    further: Sequence[Table] = ()
    results: Sequence[object] = ()
    costs: Sequence[StageCost] = ()


@dataclass(frozen=True, slots=True)
class Study:
    """options: the class of its flags, a `StudyOptions`; trials: its cases
    report: called with the options, the duration [s], and the outcomes of each of the trials"""

    options: type[Any]
    trials: Callable[[Any], Sequence[Trials[Any, Any]]]
    report: Callable[..., StudyReport]


def run(study: Study, options: StudyOptions) -> None:
    """Try all cases; show, record and write their statistics."""
    if isinstance(out := getattr(options, "out", None), Path):
        make_folder(out)
    quiet_warp()
    began = time.monotonic()
    every = study.trials(options)
    with recorder_of(options) as recorder:
        outcomes = [_resumed(trials, options) for trials in every]
        report = study.report(options, time.monotonic() - began, *outcomes)
        show(Findings(tuple(report.tables)))
        found = Findings((*report.tables, *report.further), tuple(report.figures))
        recorder.write(Step((found, *report.results), costs=tuple(report.costs)))
    for path, content in report.files.items():
        write_file(path, content)
    write_json(report.json, options.output.json)


def tried(
    trials: Trials[CaseT, OutcomeT],
    options: StudyOptions,
    known: Mapping[int, OutcomeT] | None = None,
    keep: Callable[[CaseT, OutcomeT], None] = lambda case, outcome: None,
) -> list[OutcomeT]:
    """The outcome of each case in their order, from a number of workers of the executor, each on one core, with a
    progress bar. A case that fails does not end the others: its error is raised once they are done.

    known: outcomes that exist already, by the index of their case; keep: called with each new one"""
    from threadpoolctl import threadpool_limits

    found = dict(known or {})
    left = [(index, case) for index, case in enumerate(trials.cases) if index not in found]
    failed: list[Exception] = []
    one = functools.partial(_of_case, trials.try_one)
    with (
        fit_progress() as note,
        threadpool_limits(1),
        open_workers(options.on.executor, options.on.address, options.jobs, len(left)) as open_to,
    ):
        note(trials.of, 0, len(left))
        begin = None if isinstance(open_to, HereWorker) else begin_worker
        for count, outcome in enumerate(compute(open_to, one, left, begin=begin), start=1):
            note(trials.of, count, len(left))
            if outcome.error is not None:
                failed.append(outcome.error)
                continue
            index, case = outcome.item
            found[index] = cast("OutcomeT", outcome.value)
            keep(case, found[index])
    if failed:
        say(f"{len(failed)} of {len(left)} {trials.of} failed; all others are done")
        raise failed[0]
    return [found[index] for index in range(len(trials.cases))]


def _of_case(try_one: Callable[[CaseT], OutcomeT], numbered: tuple[int, CaseT]) -> OutcomeT:
    return try_one(numbered[1])


# Outcomes in a file, a line each, so that none is lost where the rest is cut off --------------------------------------


def _resumed(trials: Trials[Any, Any], options: StudyOptions) -> list[Any]:
    if options.resume is None:
        return tried(trials, options)
    with Journal(options.resume, "a study's outcomes", "leave --resume out") as journal:
        try:
            kept = {(of, json.dumps(case)): (kind, outcome) for of, case, kind, outcome in journal.lines()}
            outcomes = {
                index: _outcome(trials.try_one, *one)
                for index, case in enumerate(trials.cases)
                if (one := kept.get((trials.of, json.dumps(_plain(case))))) is not None
            }
        except (msgspec.ValidationError, ValueError, TypeError) as error:
            raise InputError("outcomes of this version", str(error), "leave --resume out", options.resume) from error

        def keep(case: Any, outcome: Any) -> None:
            journal.add([trials.of, _plain(case), type(outcome).__name__, _plain(outcome)])

        return tried(trials, options, outcomes, keep)


def _plain(value: object) -> Any:
    """Content for JSON, including nan and infinities, which Python's reads and writes."""
    return msgspec.to_builtins(value, enc_hook=_numbers)


def _numbers(one: Any) -> object:
    if isinstance(one, np.ndarray):
        return [one.dtype.str, one.shape, one.ravel().tolist()]
    if isinstance(one, Path):
        return str(one)
    return one.tolist() if isinstance(one, np.generic) else one


def _array(kind: Any, one: Any) -> object:
    """Restore a value that `_numbers` converted. kind: its type hint"""
    if (typing.get_origin(kind) or kind) is not np.ndarray:
        return one
    dtype, shape, values = one
    return np.array(values, dtype).reshape(shape)


def _outcome(try_one: Callable[..., object], kind: str, value: object) -> object:
    """Restore a result of `try_one`. kind: name of its class, if there are several classes"""
    returned = typing.get_type_hints(try_one)["return"]
    several = [one for one in typing.get_args(returned) if getattr(one, "__name__", "") == kind]
    return msgspec.convert(value, type=several[0] if several else returned, dec_hook=_array)
