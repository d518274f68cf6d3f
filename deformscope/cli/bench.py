"""`deformscope bench`: cost of MSM on this machine, as a table."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from deformscope.bench.plan import BenchPlan, default_sizes
from deformscope.bench.report import Report, run_bench
from deformscope.bench.timing import TimingRow
from deformscope.bench_cases import CASES
from deformscope.cli.common import console, quiet_warp, write_json
from deformscope.config import BenchConfig
from deformscope.stages.msm.solver import pick_device

WIDTH = 200
"""Columns of the table without a terminal."""

FACTS: dict[str, Callable[[Any], str]] = {
    "iterations_most": lambda value: f"{value} iterations",
    "smoothed_most": lambda value: f"{value} in the preconditioner",
}
"""The facts of a row in the table, with their formats."""

REMARK = "costs: median over rounds of this row over its reference row (the first of its body by deformscope). "


def run(config: BenchConfig) -> None:
    """Measure, and show the results at the end, also after an interruption."""
    quiet_warp()

    def done(found: Report, rows: Sequence[TimingRow]) -> None:
        if rows:
            show(rows, found)
        write_json(found, config.json)

    device = pick_device(config.device)
    sizes = config.sizes or default_sizes(device, config.quick)
    plan = BenchPlan(device, sizes, config.repeats, config.quick, config.only or CASES)
    where = console()
    # Lines, no spinner: its thread would take its share of what is measured.
    run_bench(plan, lambda doing: where.print(doing, style="dim", markup=False), done)


def show(rows: Sequence[TimingRow], found: Report) -> None:
    """Print one line for each row, in sections by case; on stderr if `--json -` uses stdout."""
    machine = found.machine
    out = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    cores = f"{machine['cores']} cores, vectors of {machine['vector_bits']} bits, load {machine['load']:.1f}"
    processor = machine["gpu"] or f"{machine['cpu']}, {cores}"
    table = Table(title=f"What MSM costs on {machine['device']} ({processor}; warp {machine['warp']})")
    table.add_column("case")
    table.add_column("what", no_wrap=out.width >= WIDTH)
    table.add_column("by", no_wrap=out.width >= WIDTH)
    for heading in ("median", "IQR"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for heading in ("rounds", "costs"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    last = ""
    for row in sorted(rows, key=lambda row: CASES.index(row.case)):
        if last and row.case != last:
            table.add_section()
        costs = "" if row.costs is None else f"{number(row.costs)}x"
        table.add_row(
            *("" if row.case == last else row.case, row.what, row.who, number(row.median), number(row.spread)),
            *(row.unit, str(len(row.samples) or ""), costs),
            details(row),
        )
        last = row.case
    out.print(table)
    out.print(REMARK, markup=False)
    if not found.complete:
        out.print("It ended early: rows are missing.", style="bold", markup=False)


def number(value: float | None) -> str:
    """A number with three significant digits, and its thousands separated."""
    if value is None:
        return ""
    if abs(value) >= 1000:
        return f"{value:,.0f}".replace(",", " ")
    return f"{value:.3g}"


def details(row: TimingRow) -> str:
    """Remarks on a row besides its figures."""
    parts = [text(row.facts[name]) for name, text in FACTS.items() if row.facts.get(name) is not None]
    threads = row.facts.get("threads")
    if isinstance(threads, float) and abs(threads - 1) > 0.1:
        parts.append(f"{threads:.2g} threads")
    candidates = row.facts.get("candidates")
    if candidates is not None:
        parts.append(f"{row.facts['converged']} of {candidates} converged")
    moved, bandwidth = row.facts.get("bytes"), row.facts.get("bandwidth_bytes_s")
    if isinstance(moved, int) and isinstance(bandwidth, float) and row.median is not None:
        times = row.median / 1e3 / (moved / bandwidth)
        parts.append(f"{times:.2g} times the time that moving {moved / 1e6:.0f} MB takes at {bandwidth / 1e9:.0f} GB/s")
    if row.doubt:
        parts.append(row.doubt)
    return "; ".join([*parts, *([row.note] if row.note else [])])
