"""`deformscope coverage`: how often the intervals hold the truth, counted on random objects.

deformscope coverage --quick
deformscope coverage --objects 1000 --jobs 2 --out runs/coverage --json coverage.json
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import fit_progress, make_folder, quiet_warp, write_json
from deformscope.config import CoverageConfig

if TYPE_CHECKING:
    from rich.table import Table

    from deformscope.stages.fit.estimate import Verdict
    from deformscope.stages.fit.search import Progress
    from deformscope.studies.coverage import CoverageRow, Rate
    from deformscope.studies.unseen_pokes import UnseenPrediction

WIDTH = 190
"""Columns of the tables where there is no terminal to fit them to."""


def run(config: CoverageConfig) -> None:
    """Try all objects, tell the tables, draw the ranks."""
    if config.out is not None:
        make_folder(config.out)
    quiet_warp()
    from deformscope.studies.coverage import (
        NOTHING,
        PART_APART,
        QUICK_OBJECTS,
        Rate,
        coverage_rows,
        plan,
        spread,
        try_nothing,
        try_object,
    )
    from deformscope.studies.rank_histogram import draw_ranks, rank_counts
    from deformscope.studies.unseen_pokes import PokeCase, try_unseen_poke

    begun = time.monotonic()
    cases, nothing = plan(config.objects, config.seed, config.level, quick=config.quick)
    bodies = -(-(QUICK_OBJECTS if config.quick else config.objects) // PART_APART)
    pokes = [PokeCase(number, config.seed, config.level) for number in range(bodies)]
    with fit_progress() as note:
        done = counted(note, "random objects", len(cases))
        outcomes = spread(try_object, cases, config.jobs, done, quiet_warp)
        done = counted(note, "data without information", len(nothing))
        verdicts = spread(try_nothing, nothing, config.jobs, done, quiet_warp)
        done = counted(note, "unseen pokes", len(pokes))
        predictions = spread(try_unseen_poke, pokes, config.jobs, done, quiet_warp)

    rows = coverage_rows(outcomes)
    told = {
        kind: [verdict for case, verdict in zip(nothing, verdicts, strict=True) if case.kind == kind]
        for kind in NOTHING
    }
    unidentified = {kind: Rate(len(some), some.count("unidentified")) for kind, some in told.items()}
    ranks = rank_counts([one for one, case in zip(outcomes, cases, strict=True) if case.truth == "prior"])
    groups = prediction_groups(predictions)
    seconds = time.monotonic() - begun
    show(config, rows, told, unidentified, groups)
    picture = None
    if config.out is not None:
        picture = config.out / "coverage.png"
        draw_ranks(ranks, picture)
    from statistics import median

    fit_s = {f"{dim}D": median([one.seconds for one in outcomes if one.dim == dim]) for dim in (2, 3)}
    print(f"a fit: {fit_s['2D']:.2g} s in the plane, {fit_s['3D']:.2g} s in space; all: {seconds:.0f} s")
    if picture is not None:
        print(f"ranks: {picture}")
    write_json(
        {
            "level": config.level,
            "seed": config.seed,
            "coverage": [
                {
                    "condition": row.condition,
                    "group": row.group,
                    **told_rate(row.covered),
                    "width": row.width,
                    "confident_wrong": row.confident_wrong.hits,
                }
                for row in rows
            ],
            "ranks": ranks,
            "no_information": [{"kind": kind, **told_rate(rate)} for kind, rate in unidentified.items()],
            "unseen_pokes": [
                {
                    "group": name,
                    "pokes": len(some),
                    **told_rate(pooled(some)),
                    "width_m": middle(some, lambda one: one.width),
                    "error_m": middle(some, lambda one: one.error),
                    "motion_m": middle(some, lambda one: one.motion),
                }
                for name, some in groups.items()
            ],
            "fit_seconds": fit_s,
            "seconds": seconds,
            "picture": picture,
        },
        config.json,
    )


def counted(note: Progress, what: str, total: int) -> Callable[[int], None]:
    """Tells how many there are by now, where it is called with how many more."""
    note(what, 0, total)
    count = 0

    def done(more: int) -> None:
        nonlocal count
        count += more
        note(what, count, total)

    return done


def told_rate(rate: Rate) -> dict[str, Any]:
    return {"cases": rate.cases, "hits": rate.hits, "rate": rate.rate, "band": list(rate.band)}


def prediction_groups(predictions: Sequence[UnseenPrediction]) -> dict[str, list[UnseenPrediction]]:
    """All, and by dimension and cluster size."""
    groups = {"all": list(predictions)}
    groups |= {f"{dim}D": [one for one in predictions if one.dim == dim] for dim in (2, 3)}
    groups |= {f"clusters of {s}": [one for one in predictions if one.cluster_size == s] for s in (2, 3, 4)}
    return {name: some for name, some in groups.items() if some}


def pooled(some: Sequence[UnseenPrediction]) -> Rate:
    from deformscope.studies.coverage import Rate

    return Rate(sum(one.coordinates for one in some), sum(one.covered for one in some))


def middle(some: Sequence[UnseenPrediction], of: Callable[[UnseenPrediction], float]) -> float:
    from statistics import median

    return median(of(one) for one in some)


# Telling -------------------------------------------------------------------------------------------------------------


def show(
    config: CoverageConfig,
    rows: Sequence[CoverageRow],
    told: dict[Any, list[Verdict]],
    unidentified: dict[Any, Rate],
    groups: dict[str, list[UnseenPrediction]],
) -> None:
    """Three tables; on stderr where `--json -` has taken stdout."""
    from rich.console import Console

    out = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    level = f"{config.level:.0%}"
    out.print(coverage_table(f"{level} intervals for beta: how many hold the truth", rows))
    table = _table("Data that tell nothing: how many verdicts are unidentified")
    for name in ("data", "cases", "unidentified", "95 % band", "other verdicts"):
        table.add_column(name, justify="left" if name in ("data", "other verdicts") else "right")
    for kind, rate in unidentified.items():
        others = sorted(set(told[kind]) - {"unidentified"})
        text = ", ".join(f"{told[kind].count(one)} {one}" for one in others)
        table.add_row(kind, str(rate.cases), f"{rate.rate:.3f}", _band(rate), text)
    out.print(table)
    table = _table(f"Finite element bodies: coordinates of an unseen poke within their {level} predictive intervals")
    for name in ("bodies", "pokes", "coordinates", "within", "width [mm]", "error [mm]", "motion [mm]"):
        table.add_column(name, justify="left" if name == "bodies" else "right")
    for name, some in groups.items():
        rate = pooled(some)
        lengths = [middle(some, of) for of in (lambda o: o.width, lambda o: o.error, lambda o: o.motion)]
        numbers = (f"{1e3 * length:.2f}" for length in lengths)
        table.add_row(name, str(len(some)), str(rate.cases), f"{rate.rate:.3f}", *numbers)
    out.print(table)


def coverage_table(title: str, rows: Sequence[CoverageRow]) -> Table:
    """A line a condition: all truths in between, parts of them, and apart those where the range ends."""
    from deformscope.studies.coverage import GROUPS

    table = _table(title)
    found = {row.group for row in rows}
    groups = [group for group in GROUPS if group in found]
    table.add_column("noise")
    for name in ("cases", "held", "95 % band", "width"):
        table.add_column(name, justify="right")
    for group in groups[1:]:
        table.add_column(group, justify="right")
    table.add_column("confidently wrong", justify="right")
    for condition in dict.fromkeys(row.condition for row in rows):
        mine = {row.group: row for row in rows if row.condition == condition}
        every = mine["all"]
        wrong = sum(row.confident_wrong.hits for name, row in mine.items() if name == "all" or name.startswith("beta"))
        table.add_row(
            condition,
            str(every.covered.cases),
            f"{every.covered.rate:.3f}",
            _band(every.covered),
            f"{every.width:.3f}",
            *(f"{mine[name].covered.rate:.3f}" if name in mine else "" for name in groups[1:]),
            str(wrong),
        )
    return table


def _table(title: str) -> Table:
    from rich.box import SIMPLE
    from rich.table import Table

    return Table(title=title, box=SIMPLE, title_justify="left")


def _band(rate: Rate) -> str:
    low, high = rate.band
    return f"{low:.3f} to {high:.3f}"
