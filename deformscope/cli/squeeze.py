"""`deformscope squeeze`: squeeze a container once, for a data set or to name its content.

deformscope squeeze lab:containers --content rice --container box-07 --record r.rrd
deformscope squeeze lab:containers --content rice --container box-07 --dataset squeezes
deformscope squeeze lab:containers --model contents.npz --seed 5
"""

from __future__ import annotations

from typing import Any

from deformscope.api.squeeze_result import squeeze_table
from deformscope.cli.common import EXIT_LOSSES, show, write_json
from deformscope.config import SqueezeConfig
from deformscope.pictures.findings import table_text
from deformscope.runs.squeeze_run import leave, squeeze_on


def run(config: SqueezeConfig) -> int:
    """Squeeze, keep, report. Returns the command's exit status."""

    def report(found: dict[str, Any]) -> None:
        write_json(found, config.output.json)
        show(table_text(squeeze_table(found)))

    squeezed = squeeze_on(config, report)
    leave(squeezed)
    return EXIT_LOSSES if squeezed.found["losses"] and squeezed.found["recording"] is not None else 0
