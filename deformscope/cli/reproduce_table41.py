"""`deformscope reproduce table41`: maps of simulated tables over seeds, after how many touches, planner beside planner.

deformscope reproduce table41 --seeds 5
deformscope reproduce table41 --scenes two-60-150,disc --planners regions,max-variance --touches 12
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from deformscope.cli.common import make_folder, progress, replacing, show_table, write_json
from deformscope.cli.workers import in_processes
from deformscope.config import Table41Config
from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.experiments.table41 import MapAfter, TableRun

GOOD = 0.85
LOOKED_AT = (4, 8, 12)


def run(config: Table41Config) -> None:
    """Explore every scene with every planner over the seeds; write and tell the table."""
    from deformscope.experiments.table41 import TableJob, run_table

    make_folder(config.out)
    jobs = [
        TableJob(scene, seed, planner, config.touches)
        for seed in range(config.seeds)
        for scene in _scenes(config.scenes)
        for planner in _planners(config.planners)
    ]
    runs: list[TableRun] = []
    with progress("exploring", len(jobs)) as done:
        for _, found in in_processes(run_table, jobs, config.workers):
            runs.append(found)
            done(1)
    rows = [row for row in _rows(runs, config.touches) if row["seeds"]]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with replacing(config.out / "table41.csv") as file:
        file.write(text.getvalue().encode())
    told = {"rows": rows, "runs": runs}
    write_json(told, str(config.out / "table41.json"))
    write_json(told, config.json)
    show_table(
        f"{config.seeds} layouts a scene; IoU of regions: median [share of layouts at {GOOD:g} or more]",
        [(f"{row['scene']} {row['planner']}", _line(row)) for row in rows],
    )


def _scenes(named: str) -> Sequence[str]:
    from deformscope.lab.scenes import BUILT_IN, built_in

    scenes = [name.strip() for name in named.split(",") if name.strip()] or list(BUILT_IN)
    for scene in scenes:
        built_in(scene)
    return scenes


def _planners(named: str) -> Sequence[Any]:
    from deformscope.stages.plan import Planner

    planners = [name.strip() for name in named.split(",")]
    if unknown := [name for name in planners if name not in get_args(Planner)]:
        raise InputError(f"planners out of {', '.join(get_args(Planner))}", ", ".join(map(repr, unknown)))
    return planners


def _rows(runs: Sequence[TableRun], touches: int) -> list[dict[str, Any]]:
    """One row a scene and planner."""
    keys = sorted({(one.job.scene, one.job.planner) for one in runs}, key=lambda key: (key[0], key[1]))
    rows = []
    for scene, planner in keys:
        mine = [one for one in runs if (one.job.scene, one.job.planner) == (scene, planner)]
        row: dict[str, Any] = {"scene": scene, "planner": planner, "seeds": len(mine)}
        for count in LOOKED_AT:
            last = [_at(one, count) for one in mine] if count <= touches else []
            ious = [after.iou for after in last if after.iou is not None]
            row[f"iou_{count}"] = round(float(np.median(ious)), 3) if ious else ""
            row[f"good_{count}"] = round(float(np.mean(np.array(ious) >= GOOD)), 2) if ious else ""
        ends = [one.after[-1] for one in mine]
        rigid = [after.rigid_found for after in ends if after.rigid_found is not None]
        row |= {
            "count_right": _share([_right(one) for one in mine]),
            "gradual": _share([after.verdict == "gradual" for after in ends]),
            "rigid_found": _share(rigid) if rigid else "",
            "ordered": _share([after.ordered for after in ends]),
            "travel_m": round(float(np.median([after.travel_m for after in ends])), 2),
            "max_force_n": round(max(one.max_force_n for one in mine), 2),
            "slowest_s": round(float(np.median([one.slowest_s for one in mine])), 2),
        }
        rows.append(row)
    return rows


def _at(run: TableRun, touches: int) -> MapAfter:
    """The map after that many touches, or after the last."""
    return run.after[min(touches, len(run.after)) - 1]


def _right(run: TableRun) -> bool:
    from deformscope.lab.scenes import built_in

    end = run.after[-1]
    count = built_in(run.job.scene, run.job.seed).region_count
    return end.verdict == "gradual" if count == 0 else end.verdict == "regions" and end.region_count == count


def _share(right: Sequence[bool]) -> float:
    return round(float(np.mean(right)), 2)


def _line(row: dict[str, Any]) -> str:
    parts = [
        f"{count} touches {row[f'iou_{count}']} [{row[f'good_{count}']}]"
        for count in LOOKED_AT
        if row[f"iou_{count}"] != ""
    ]
    parts.append(f"count right {row['count_right']}")
    if row["rigid_found"] != "":
        parts.append(f"rigid found {row['rigid_found']}")
    parts += [f"order right {row['ordered']}", f"travel {row['travel_m']} m", f"force up to {row['max_force_n']} N"]
    return ", ".join(parts)
