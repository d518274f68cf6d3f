"""`python -m studies force`: how often the intervals of a predicted force hold the true one, on random slabs.

python -m studies force
python -m studies force --full --kinds halves "stiff disc" --slabs 8 --jobs 16 --out forces --json force.json
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from deformscope.cli.common import examined, fit_progress, make_folder, quiet_warp, recorder_of, show, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.reproduce.poke_slabs import KINDS
from deformscope.session import Step
from studies.coverage import rate_json
from studies.predicted_forces import ForceRow, force_rows, slab_works, try_slab
from studies.seeds import reported

SlabKindFlag = Literal["one material", "halves", "stiff disc", "soft disc", "gradual"]


@dataclass(frozen=True, slots=True)
class ForceCoverageConfig(RecordedOptions):
    """Count how often the intervals of a predicted force hold the true one: random slabs of one material, halves, stiff
    and soft discs and gradual ones, half of whose 24 pokes are fitted, under scatter that the model is not given."""

    slabs: flags.ManyFlag = 20
    """Slabs of each kind, from seed SEED on. A slab takes some 3 s."""
    kinds: Annotated[tuple[SlabKindFlag, ...], arg(metavar="KIND...")] = ()
    """Of slabs; default all."""
    scatter: Annotated[tuple[float, ...], arg(metavar="SHARE...")] = (0.0, 0.03, 0.06, 0.1)
    """By how much the force scatters from poke to poke, as a share."""
    full: bool = False
    """Press the slabs with finite elements and fit shape-matching models to what their surfaces do: some minutes a
    slab."""
    out: Annotated[Path | None, flags.one_word("DIR", Path), flags.unset] = None
    """Folder of a file for each slab, written as it comes; a slab whose file is there is not tried again."""
    split: Literal["alternate", "random"] = "alternate"
    """Which half is fitted: every other poke, as on a chess board, or any half."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if not self.scatter or any(not 0.0 <= one < 1.0 for one in self.scatter):
            raise InputError("shares from 0 to below 1 after --scatter", " ".join(f"{one:g}" for one in self.scatter))


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


STUDY = Study(ForceCoverageConfig, run)
