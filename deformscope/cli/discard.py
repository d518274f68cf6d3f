"""`deformscope discard`: marks a recording, or one of its episodes, as not to be used, with the reason. Nothing is
deleted.

deformscope discard r.rrd --reason "the stick slipped"
deformscope discard r.rrd --episode 2 --reason "touched the table"
"""

from __future__ import annotations

from deformscope.cli.common import show_table, write_json
from deformscope.config import DiscardRecordingConfig
from deformscope.runs.recordings import OpenRecording


def run(config: DiscardRecordingConfig) -> None:
    """Write the mark into the recording's ledger."""
    recording = OpenRecording(config.recording)
    recording.discard(config.reason, config.episode)
    show_table(str(config.recording), [("discarded", str(one)) for one in recording.discarded()])
    write_json(recording.as_json(), config.json)
