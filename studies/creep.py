"""`python -m studies creep`: how far off stiffness, relaxation and loss of foams that creep are, and how often their
intervals hold the truth.

python -m studies creep
python -m studies creep --objects 400 --hold 4 --jobs 16 --json creep.json
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, get_args

from tyro.conf import OmitArgPrefixes, arg

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from deformscope.stages.poke.creep import CreepVerdict
from studies.creep_touches import KINDS, QUANTITIES, CreepCase, CreepKind, CreepOutcome, try_creep
from studies.quantities import quantity_rows
from studies.quantity_table import quantity_table, row_json
from studies.seeds import reported


@dataclass(frozen=True, slots=True)
class CreepCoverageConfig(RecordedOptions):
    """Count how often the intervals of a creeping foam's stiffness, relaxation and energy loss hold the truth: touches
    of finite elements with a memory, a quarter as many of foams without one."""

    objects: flags.ManyFlag = 60
    """Foams that creep, from seed SEED on; each takes some 5 s."""
    hold: Annotated[float, arg(metavar="S")] = 8.0
    """How long the force is held [s]."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if not 0.5 <= self.hold <= 60.0:
            raise InputError("0.5 to 60 s after --hold", f"{self.hold:g}")


VERDICTS: tuple[str, ...] = get_args(CreepVerdict)


def run(config: CreepCoverageConfig) -> None:
    """Touch all foams and print a table of each kind."""
    quiet_warp()
    seeds = reported(config.objects, config.output.seed)
    few = seeds[: max(1, len(seeds) // 4)]
    cases = [CreepCase(seed, config.hold) for seed in seeds]
    cases += [CreepCase(seed, config.hold, kind) for kind in KINDS[1:] for seed in few]
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            tried = examined("touches", try_creep, cases, config.jobs, note)
        kinds = {kind: [one for one in tried if one.kind == kind] for kind in KINDS}
        tables = [
            quantity_table(quantity_rows(some, QUANTITIES), "touches", f"{name} touches, held for {config.hold:g} s")
            for name, some in kinds.items()
        ]
        found = Findings((*tables, verdict_table(kinds)))
        show(found)
        recorder.write(Step((found,)))
    write_json(
        {
            "hold_s": config.hold,
            "rows": {name: [row_json(row) for row in quantity_rows(some, QUANTITIES)] for name, some in kinds.items()},
            "verdicts": {name: _verdicts(some) for name, some in kinds.items()},
        },
        config.output.json,
    )


def verdict_table(kinds: dict[CreepKind, list[CreepOutcome]]) -> Table:
    """A line a kind."""
    lines = [(kind, *(_verdicts(some).get(name, 0) for name in VERDICTS)) for kind, some in kinds.items()]
    return Table(lines, ("touches of", *VERDICTS), "what they were taken for")


def _verdicts(some: list[CreepOutcome]) -> dict[str, int]:
    verdicts = [one.verdict for one in some]
    return {name: verdicts.count(name) for name in sorted(set(verdicts))}


STUDY = Study(CreepCoverageConfig, run)
