"""`python -m studies field`: how well one deformation determines the stiffness of each place of a body.

python -m studies field
python -m studies field --kinds "two, stretch" "three, shear" --objects 20 --json field.json
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import OmitArgPrefixes, arg

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.cli.study import Study
from deformscope.config import flags
from deformscope.config.options import OutputOptions, RecordedOptions
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from studies.field_bodies import BODIES, field_rows, try_field
from studies.seeds import reported


@dataclass(frozen=True, slots=True)
class FieldCoverageConfig(RecordedOptions):
    """Count how often `calibrate field` finds materials, their border and their ratio: plates and slabs of finite
    elements, under noise that neighbours share."""

    kinds: Annotated[tuple[str, ...], arg(metavar="NAME...")] = ()
    """Bodies by name, as the table has them; default: all."""
    objects: flags.ManyFlag = 6
    """Bodies of each kind, from seed SEED on; a plate takes some 5 s, a slab 30."""
    jobs: flags.ManyFlag = 2
    """Processes that share the work."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


NAMES = (
    *("body", "verdict right", "unidentified", "ratio within 15 %", "ratio over the true one"),
    *("border within 1 spacing", "intervals hold ratio, places", "1 - beta over the true ratio"),
)


def run(config: FieldCoverageConfig) -> None:
    """Fit all bodies and print a line of each kind."""
    quiet_warp()
    unknown = [one for one in config.kinds if one not in BODIES]
    if unknown:
        raise InputError(f"--kinds of {'; '.join(BODIES)}", "; ".join(unknown))
    seeds = reported(config.objects, config.output.seed)
    cases = [(kind, seed) for kind in (config.kinds or tuple(BODIES)) for seed in seeds]
    with recorder_of(config) as recorder:
        with fit_progress() as note:
            tried = examined("bodies", try_field, cases, config.jobs, note)
        caption = (
            f"Fields of stiffness, seeds {seeds.start} to {seeds.stop - 1}; ratio, border: where the verdict is right"
        )
        found = Findings((Table(field_rows(tried), NAMES, caption),))
        show(found)
        recorder.write(Step((found,)))
    write_json([dataclasses.asdict(one) for one in tried], config.output.json)


STUDY = Study(FieldCoverageConfig, run)
