"""One run of the bench: its rows as they are measured, and the whole run as JSON."""

import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias

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

Earlier: TypeAlias = "Mapping[tuple[str, str, str, str], Mapping[str, Any]]"

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


def run_bench(
    plan: BenchPlan, against: Path | None, note: Note, done: Callable[[Report, Sequence[TimingRow]], None]
) -> None:
    """Measure, and pass report and rows to `done` at the end, also after an interruption. against: JSON of an earlier
    run, which is compared. Raises InputError for unsupported cases, and for samples of 0 or less."""
    check(plan)
    earlier = read_earlier(against)
    rows: list[TimingRow] = []
    complete = False
    try:
        for row in measure(plan, note):
            rows.append(row)
        complete = True
    finally:  # the machine's load is measured at the end
        plain = tuple(row.plain(earlier.get((row.case, row.what, row.who, row.unit))) for row in rows)
        done(Report(FORMAT, complete, machine(plan.device), plan, plain), rows)
    if failed := [row for row in rows if not row.positive]:
        got = "; ".join(f"{row.what} by {row.who}: {min(row.samples):.3g} {row.unit}" for row in failed)
        raise InputError("times above 0", got, "deformscope bench again on an idle machine")


def read_earlier(path: Path | None) -> Earlier:
    """The rows of a run's JSON by case, what, who and unit; none without a path. Raises InputError for a file without
    such rows."""
    if path is None:
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["format"] != FORMAT:
            came = f"{found['format']} in {path}"
            raise InputError(f"the JSON of a bench in format {FORMAT}", came, "a bench of now")
        return {(row["case"], row["what"], row["who"], row["unit"]): row for row in found["rows"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"{path}: {type(error).__name__}: {error}"
        raise InputError("the JSON of an earlier bench", problem, "deformscope bench --json FILE") from None
