"""One run of the bench: its rows as they are measured, and the whole run as JSON."""

import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import warp as wp

from deformscope.bench.plan import BenchPlan, Note, side_of
from deformscope.bench.statics import relax
from deformscope.bench.steps import steps
from deformscope.bench.timing import TimingRow
from deformscope.bench_cases import Case
from deformscope.errors import InputError
from deformscope.stages.msm.lanes import VECTOR_BITS
from deformscope.version import __version__

# Conditions of a figure besides the code: the machine, and its load


def machine(device: str) -> dict[str, object]:
    """Facts for the JSON. load: mean of the last minute; other processes make every figure larger."""
    gpu = None if device == "cpu" else wp.get_device(device)
    return {
        "cpu": _cpu(),
        "vector_bits": VECTOR_BITS,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "device": device,
        "gpu": None if gpu is None else gpu.name,
        "gpu_memory_bytes": None if gpu is None else gpu.total_memory,
        "system": platform.platform(),
        "python": platform.python_version(),
        "deformscope": __version__,
        "warp": wp.config.version,
        "numpy": np.__version__,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


FORMAT = 1
"""Version of the JSON; a change that breaks readers raises it."""

Rows = Callable[[BenchPlan, Note], Iterator[TimingRow]]

MEASURES: tuple[tuple[frozenset[Case], Rows], ...] = (
    (frozenset({"step", "call"}), steps),
    (frozenset({"relax"}), relax),
)


def check(plan: BenchPlan) -> None:
    """Raises InputError for unsupported cases."""
    odd = [size for size in plan.sizes if side_of(size) < 4]
    if odd:
        raise InputError("sizes that are cubes of 4 or more", ", ".join(map(str, odd)), "--sizes 216,1331")


def measure(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
    """Each row of the plan as soon as it is known."""
    for cases, rows in MEASURES:
        if cases & set(plan.only):
            yield from (row for row in rows(plan, note) if row.case in plan.only)


@dataclass(frozen=True, slots=True)
class Report:
    """One run, as in its JSON. complete: whether it ran to its end."""

    format: int
    complete: bool
    machine: Mapping[str, object]
    settings: BenchPlan
    rows: tuple[Mapping[str, object], ...]


def run_bench(plan: BenchPlan, note: Note, done: Callable[[Report, Sequence[TimingRow]], None]) -> None:
    """Measure, and pass report and rows to `done` at the end, also after an interruption. Raises InputError for
    unsupported cases, and for samples of 0 or less."""
    check(plan)
    rows: list[TimingRow] = []
    complete = False
    try:
        for row in measure(plan, note):
            rows.append(row)
        complete = True
    finally:  # the machine's load is measured at the end
        plain = tuple(row.plain() for row in rows)
        done(Report(FORMAT, complete, machine(plan.device), plan, plain), rows)
    if failed := [row for row in rows if not row.positive]:
        got = "; ".join(f"{row.what} by {row.who}: {min(row.samples):.3g} {row.unit}" for row in failed)
        raise InputError("times above 0", got, "deformscope bench again on an idle machine")
