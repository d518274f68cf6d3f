"""`deformscope squeeze`: squeeze a container once, for a data set or to name its content.

deformscope squeeze lab:containers --content rice --container box-07 --record r.rrd
deformscope squeeze lab:containers --content rice --container box-07 --dataset squeezes
deformscope squeeze lab:containers --model contents.npz --seed 5
"""

from __future__ import annotations

import signal
from typing import Any

from deformscope.api.squeeze_result import hand_words, squeeze_table
from deformscope.cli.common import EXIT_LOSSES, say, show, write_json
from deformscope.config import SqueezeConfig
from deformscope.pictures.findings import table_text
from deformscope.runs.moving import signal_word
from deformscope.runs.squeeze_run import leave, squeeze_on


def run(config: SqueezeConfig) -> int:
    """Squeeze, keep, report. Returns the command's exit status."""

    def report(found: dict[str, Any]) -> None:
        write_json(found, config.output.json)
        show(table_text(squeeze_table(found)))

    squeezed = squeeze_on(config, report)
    if squeezed.interrupted:
        path = squeezed.found["recording"]
        kept = "" if path is None else f"; the recording is whole: {path}"
        by = squeezed.by or f"by {signal_word(squeezed.signal_number)}"
        say(f"deformscope: ended {by}; the hand {hand_words(squeezed.found)}{kept}")
        return 128 + (squeezed.signal_number or signal.SIGINT)
    leave(squeezed)
    return EXIT_LOSSES if squeezed.found["losses"] and squeezed.found["recording"] is not None else 0
