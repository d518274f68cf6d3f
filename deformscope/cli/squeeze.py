"""`deformscope squeeze`: squeeze a container once, for a data set or to name its content.

deformscope squeeze lab:containers --content rice --container box-07 --record r.rrd
deformscope squeeze lab:containers --content rice --container box-07 --dataset squeezes
deformscope squeeze lab:containers --model contents.npz --seed 5
"""

from __future__ import annotations

import signal

from deformscope.api.moving import signal_word
from deformscope.api.squeeze_result import SqueezeResult
from deformscope.api.squeeze_run import leave, squeeze_on
from deformscope.cli.common import EXIT_LOSSES, say, show, write_json
from deformscope.config import SqueezeConfig


def run(config: SqueezeConfig) -> int:
    """Squeeze, keep, report. Returns the command's exit status."""

    def report(result: SqueezeResult) -> None:
        write_json(result.as_json(), config.output.json)
        show(result)

    squeezed = squeeze_on(config, report)
    if squeezed.interrupted:
        path = squeezed.result.recording
        kept = "" if path is None else f"; the recording is whole: {path}"
        by = squeezed.by or f"by {signal_word(squeezed.signal_number)}"
        say(f"deformscope: ended {by}; the hand {squeezed.result.hand_text}{kept}")
        return 128 + (squeezed.signal_number or signal.SIGINT)
    leave(squeezed)
    return EXIT_LOSSES if squeezed.result.losses and squeezed.result.recording is not None else 0
