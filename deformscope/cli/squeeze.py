"""`deformscope squeeze`: squeeze a container once, for a data set or to name its content."""

from __future__ import annotations

from deformscope.cli.common import EXIT_LOSSES, show, write_json
from deformscope.config import SqueezeConfig
from deformscope.runs.squeeze_result import SqueezeResult
from deformscope.runs.squeeze_run import leave, squeeze_on


def run(config: SqueezeConfig) -> int:
    """Squeeze, store the trial, and report. Returns the command's exit status."""

    def report(result: SqueezeResult) -> None:
        write_json(result.as_json(), config.output.json)
        show(result)

    squeezed = squeeze_on(config, report)
    leave(squeezed)
    return EXIT_LOSSES if squeezed.result.losses and squeezed.result.recording is not None else 0
