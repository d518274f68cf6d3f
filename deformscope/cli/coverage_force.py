"""`deformscope coverage force`: how often the intervals of a predicted force hold the true one, on random slabs.

deformscope coverage force
deformscope coverage force --full --kinds halves "stiff disc" --slabs 8 --jobs 16 --out forces --json force.json
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from deformscope.cli.common import examined, fit_progress, make_folder, quiet_warp, recorder_of, show, write_json
from deformscope.cli.coverage import rate_json
from deformscope.config import ForceCoverageConfig
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from deformscope.studies.poke_slabs import KINDS
from deformscope.studies.predicted_forces import ForceRow, force_rows, slab_works, try_slab
from deformscope.studies.seeds import reported


def run(config: ForceCoverageConfig) -> None:
    """Try all slabs and print a table for each scatter."""
    quiet_warp()
    seeds = reported(config.slabs, config.output.seed)
    if config.out is not None:
        make_folder(config.out)
    works = slab_works(
        config.kinds or KINDS, seeds, config.scatter, config.full, config.level, config.split, config.out
    )
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            found_of = examined("random slabs", try_slab, works, config.jobs, note)
        tried = [one for each in found_of for one in each]
        rows = force_rows(tried)
        found = Findings(tuple(force_table(rows, scatter, config.level) for scatter in config.scatter))
        show(found)
        recorder.write(Step((found,)))
    lines = [{**dataclasses.asdict(row), "held": rate_json(row.held)} for row in rows]
    write_json(
        {"level": config.level, "full": config.full, "split": config.split, "rows": lines, "slabs": tried},
        config.output.json,
    )


def force_table(rows: Sequence[ForceRow], scatter: float, level: float) -> Table:
    """A line a kind of slab and group of pokes."""
    lines = []
    for row in rows:
        if row.scatter == scatter:
            low, high = row.held.band
            held = f"{row.held.rate:.2f} ({low:.2f} to {high:.2f})"
            surface = "" if row.surface_error is None else f"{row.surface_error:.1%}"
            line = (
                row.slab,
                row.group,
                row.held.cases,
                f"{row.error:.1%}",
                "" if row.own_error is None else f"{row.own_error:.1%}",
                row.wrong,
                held,
                f"{row.width:.0%}",
                surface,
            )
            lines.append(line)
    names = (
        "slab",
        "unseen pokes",
        "number",
        "force off (rms)",
        "nearest is of its material",
        "by a fifth",
        "held (95 % band)",
        "width",
        "surface off",
    )
    return Table(lines, names, f"{level:.0%} intervals of predicted forces, scatter {scatter:.0%} from poke to poke")
