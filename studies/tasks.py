"""Tasks: what the executor itself costs when there are many that compute nothing: time, memory, size of the index.

python -m studies tasks --tasks 100000
"""

import json
import os
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from deformscope.config import flags
from deformscope.pictures.report import Table
from deformscope.runs.sweep import JOURNAL, RESULTS, SweepOptions, SweepTask, Variation, sweep_on
from studies.runner import Study, StudyOptions, StudyReport, Trials

SMALL = {"parameter": "beta", "value": 0.5, "interval": [0.4, 0.6], "verdict": "identified", "noise": [0.1] * 100}
"""A result of one to two kilobytes."""


@dataclass(frozen=True, slots=True)
class TasksOptions(StudyOptions):
    """Sweep a number of tasks that compute nothing, once, and again with all stored."""

    tasks: flags.ManyFlag = 1000
    """Tasks."""


@dataclass(frozen=True, slots=True)
class TasksCase:
    """tasks: how many; workers: that share them"""

    tasks: int
    workers: int


@dataclass(frozen=True, slots=True)
class TasksCost:
    """swept_s, again_s: the whole sweep, and one that computes nothing; cpu_s, again_cpu_s: processor time of the
    process that asks; before_mb, peak_mb: its most memory, before it asks and at its end"""

    case: TasksCase
    swept_s: float
    again_s: float
    cpu_s: float
    again_cpu_s: float
    before_mb: float
    peak_mb: float
    journal_mb: float
    results_mb: float
    rows: int


def compute_nothing(task: SweepTask) -> dict[str, object]:
    """A result, and which worker gave it."""
    return SMALL | {"worker": os.getpid()}


def sweep_nothing(case: TasksCase) -> TasksCost:
    """Files that are not there have a content of their own, and are not read."""
    sources = [f"nowhere/{number:06d}.rrd" for number in range(case.tasks)]
    ways, options = [Variation({}, None, json.dumps("nothing"))], SweepOptions(workers=case.workers)
    took, rows, before_mb = [], 0, _most_mb()
    with TemporaryDirectory() as made:
        out = Path(made)
        for _ in range(2):
            began, cpu_s = time.perf_counter(), time.process_time()
            rows = sweep_on(compute_nothing, sources, ways, out, options).table.num_rows
            took.append((time.perf_counter() - began, time.process_time() - cpu_s))
        sizes = [(out / name).stat().st_size / 1e6 for name in (JOURNAL, RESULTS)]
    (swept_s, cpu_s), (again_s, again_cpu_s) = took
    return TasksCost(
        case=case,
        swept_s=swept_s,
        again_s=again_s,
        cpu_s=cpu_s,
        again_cpu_s=again_cpu_s,
        before_mb=before_mb,
        peak_mb=_most_mb(),
        journal_mb=sizes[0],
        results_mb=sizes[1],
        rows=rows,
    )


def _most_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def trials(options: TasksOptions) -> list[Trials[TasksCase, TasksCost]]:
    return [Trials("sweeps", sweep_nothing, [TasksCase(options.tasks, options.jobs)])]


def report(options: TasksOptions, seconds: float, found: list[TasksCost]) -> StudyReport:
    (cost,) = found
    rows = [
        ("tasks, rows of results", f"{cost.case.tasks}, {cost.rows}"),
        ("workers", str(cost.case.workers)),
        ("whole sweep", f"{cost.swept_s:.1f} s, {cost.cpu_s:.1f} s of it in the calling process"),
        ("again, with all tasks stored", f"{cost.again_s:.1f} s, {cost.again_cpu_s:.1f} s of CPU"),
        ("peak memory of the calling process", f"{cost.peak_mb:.0f} MB, {cost.before_mb:.0f} MB before it began"),
        (JOURNAL, f"{cost.journal_mb:.1f} MB"),
        (RESULTS, f"{cost.results_mb:.2f} MB"),
    ]
    return StudyReport([Table(rows, caption="Tasks that compute nothing")], cost)


STUDY = Study(TasksOptions, trials, report)
