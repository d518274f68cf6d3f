"""`deformscope replay`: runs the same stages on the recorded inputs, and compares results with the recorded ones. For a
rig, bytes are decoded again and compared with the frames.

deformscope replay out.rrd
deformscope replay out.rrd --viewer native --pace real
deformscope replay out.rrd --record again.rrd --json -
"""

from __future__ import annotations

from deformscope.cli.common import EXIT_LOSSES, console, fit_progress, say, show, write_json
from deformscope.config import ReplayConfig
from deformscope.pictures.findings import table_text
from deformscope.pictures.report import Table
from deformscope.recording.ledger import ledger_path
from deformscope.runs.replay import replay_on


def run(config: ReplayConfig) -> int:
    """Recompute a recording from its inputs; raises `Different` if the numbers differ from the recorded ones. Returns
    the command's exit status."""
    with fit_progress() as progress:
        found = replay_on(config, progress)
    show(*(table_text(one) if isinstance(one, Table) else one for one in found.shown))
    write_json(found.as_json(), config.output.json)
    if found.different is not None:
        raise found.different
    for note in found.notes:
        say(note)
    if found.verdict:
        console().print(found.verdict)
    return 0 if ledger_path(config.recording).exists() else EXIT_LOSSES
