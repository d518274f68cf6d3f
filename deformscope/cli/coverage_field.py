"""`deformscope coverage field`: how well one deformation determines the stiffness of each place of a body.

deformscope coverage field
deformscope coverage field --kinds "two, stretch" "three, shear" --objects 20 --json field.json
"""

from __future__ import annotations

import dataclasses

from deformscope.cli.common import examined, fit_progress, quiet_warp, recorder_of, show, write_json
from deformscope.config import FieldCoverageConfig
from deformscope.errors import InputError
from deformscope.pictures.findings import Findings
from deformscope.pictures.report import Table
from deformscope.session import Step
from deformscope.studies.field_bodies import BODIES, field_rows, try_field
from deformscope.studies.seeds import reported

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
