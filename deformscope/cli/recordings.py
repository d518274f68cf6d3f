"""`deformscope verify`, `recover` and `export`: check a recording, rescue a damaged one, and convert it to other
formats.

deformscope verify run.rrd
deformscope verify run.rrd --stages
deformscope verify run.rrd --privacy
deformscope recover run.part.rrd --out saved.rrd
deformscope export r.rrd --to parquet --out tables
deformscope export r.rrd --to mcap --out bag --only wrench arm
deformscope export r.rrd --images frames --camera front
"""

from __future__ import annotations

from deformscope.cli.common import EXIT_LOSSES, fit_progress, say, show, write_json, wrote
from deformscope.config import ExportConfig, RecoverConfig, VerifyConfig


def verify(config: VerifyConfig) -> int:
    """Check bytes, structure and completeness. Returns the exit status; raises Damaged if the recording is damaged."""
    from deformscope.runs.verification import verify_recording

    found = verify_recording(config.recording, stages=config.stages, privacy=config.privacy)
    show(found)
    write_json(found.as_json(), config.json)
    for line in found.remarks:
        say(line)
    if found.error is not None:
        raise found.error
    for line in found.losses:
        say(f"deformscope: {line}")
    return EXIT_LOSSES if found.losses else 0


def recover(config: RecoverConfig) -> int:
    """Write the readable part of a recording as a new one. Returns the command's exit status."""
    from deformscope.runs.recovery import recover_recording

    found = recover_recording(config.recording, config.out)
    wrote("recording", str(found.found["recovered"]))
    show(found)
    write_json(found.as_json(), config.json)
    return EXIT_LOSSES if found.found["problems"] else 0


def export(config: ExportConfig) -> int:
    """Write the export, and list the written files. Returns the command's exit status."""
    from deformscope.runs.exporting import export_recording

    with fit_progress() as progress:
        found = export_recording(config, progress)
    show(found)
    write_json(found.as_json(), config.json)
    for line in found.remarks:
        say(f"deformscope: {line}")
    return EXIT_LOSSES if found.remarks or not found.checked else 0
