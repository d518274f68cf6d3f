"""`deformscope export`: a recording in formats of others.

deformscope export r.rrd --to parquet --out tables
deformscope export r.rrd --to mcap --out bag --only wrench arm
deformscope export r.rrd --images frames --camera front
"""

from __future__ import annotations

from deformscope.cli.common import EXIT_LOSSES, fit_progress, say, show_table, write_json
from deformscope.config import ExportConfig
from deformscope.recording.export.export import Credits, ExportRequest, export
from deformscope.recording.losses import named
from deformscope.recording.reader import Replay
from deformscope.recording.streams import SCHEMA_VERSION


def run(config: ExportConfig) -> int:
    """Write it, and list the files. Returns the command's exit status."""
    asked = ExportRequest(
        to=config.format,
        folder=config.folder,
        only=config.only,
        camera=config.camera,
        anonymous=config.anonymous,
        credits=Credits(config.license, config.author, config.citation),
        overwrite=config.overwrite,
        manifest=config.to is not None,
    )
    replay = Replay(config.recording)
    with fit_progress() as note:
        found = export(replay, asked, note)
    if config.format == "images":
        rows = [(f"{one.what} of {one.device}", f"{one.count} in {one.folder}") for one in found.images]
    else:
        rows = [(one.entity, f"{one.rows} in {found.folder / one.file}") for one in found.files]
    show_table(str(config.recording), rows)
    said = {"recording": config.recording, "schema_version": SCHEMA_VERSION, "format": config.format}
    write_json(said | {"folder": found.folder, "images": found.images, "files": found.files}, config.json)
    remarks = [f"losses: {named(replay.losses)}"] if replay.losses else []
    if "recovered" in replay.outcome or not replay.outcome.get("complete"):
        remarks.append("the recording does not have its run's end: what came after is lost")
    for line in remarks:
        say(f"deformscope: {line}")
    return EXIT_LOSSES if remarks or not replay.has_ledger else 0
