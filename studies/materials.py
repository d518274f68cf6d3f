"""`python -m studies materials`: how often the intervals of `calibrate axes`, `yield` and `viscous` hold the truth.

python -m studies materials
python -m studies materials --kinds axes viscous --objects 200 --json materials.json
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, arg

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from studies.material_motions import MOTION_KINDS, PARAMETERS, MotionOutcome, try_motion
from studies.quantities import quantity_rows
from studies.quantity_table import quantity_table, row_json
from studies.seeds import reported


@dataclass(frozen=True, slots=True)
class MaterialsCoverageConfig(RecordedOptions):
    """Count how often the intervals of `calibrate axes`, `yield` and `viscous` hold the truth: deformations and motions
    of known materials, under noise that neighbours share."""

    kinds: Annotated[tuple[Literal["axes", "yield", "viscous"], ...], arg(metavar="NAME...")] = ()
    """Of axes, yield and viscous; default: all."""
    objects: flags.ManyFlag = 12
    """Motions of each kind, from seed SEED on; one to yield takes some 5 s, another less than one."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


def run(config: MaterialsCoverageConfig) -> None:
    """Fit all motions and print a table of each kind, and the verdicts."""
    quiet_warp()
    wanted, seeds = config.kinds or MOTION_KINDS, reported(config.objects, config.output.seed)
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            cases = [(kind, seed) for kind in wanted for seed in seeds]
            tried = examined("motions", try_motion, cases, config.jobs, note)
        kinds = {kind: [one for one in tried if one.kind == kind] for kind in wanted}
        rows = {kind: quantity_rows(some, PARAMETERS[kind]) for kind, some in kinds.items()}
        tables = [quantity_table(found, "motions", f"calibrate {kind}") for kind, found in rows.items()]
        found = Findings((*tables, _verdict_table([one for some in kinds.values() for one in some])))
        show(found)
        recorder.write(Step((found,)))
    write_json(
        {
            kind: {"rows": [row_json(row) for row in rows[kind]], "verdicts": _verdicts(some)}
            for kind, some in kinds.items()
        },
        config.output.json,
    )


def _verdict_table(outcomes: list[MotionOutcome]) -> Table:
    lines = []
    for kind in dict.fromkeys(one.kind for one in outcomes):
        some = _verdicts([one for one in outcomes if one.kind == kind])
        lines.append((kind, "; ".join(f"{name}: {count}" for name, count in some.items())))
    return Table(lines, ("motions of", "verdicts"), "what they were taken for")


def _verdicts(some: list[MotionOutcome]) -> dict[str, int]:
    verdicts = [one.verdict for one in some]
    return {name: verdicts.count(name) for name in sorted(set(verdicts))}


STUDY = Study(MaterialsCoverageConfig, run)
