"""A recording in other formats: what `deformscope export` writes."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.config import ExportConfig
from deformscope.pictures.messages import counted
from deformscope.pictures.report import Table
from deformscope.recording.export.export import Credits, ExportRequest, export
from deformscope.recording.ledger import inherited
from deformscope.recording.losses import named
from deformscope.recording.reader import Replay
from deformscope.recording.streams import SCHEMA_VERSION
from deformscope.runs.result import FoundResult
from deformscope.terminal import Progress


@dataclass(frozen=True, slots=True)
class ExportResult(FoundResult):
    """What `export` wrote. remarks: what the recording lacks; checked: whether the recording has a ledger for the
    check"""

    remarks: tuple[str, ...] = ()
    checked: bool = True


def export_recording(config: ExportConfig, progress: Progress) -> ExportResult:
    """Write an export, and list its files."""
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
    found = export(replay, asked, progress)
    if config.format == "images":
        rows = [(f"{one.what} of {one.device}", f"{one.count} in {one.folder}") for one in found.images]
    else:
        rows = [(one.entity, f"{one.rows} in {found.folder / one.file}") for one in found.files]
    said = {"recording": config.recording, "schema_version": SCHEMA_VERSION, "format": config.format}
    said |= {"folder": found.folder, "images": found.images, "files": found.files}
    remarks = [inherited(replay.source_problems)] if replay.source_problems else []
    remarks += [f"losses: {named(replay.losses)}"] if replay.losses else []
    if "recovered" in replay.outcome or not replay.outcome.get("complete"):
        remarks.append("the recording does not have its run's end: what came after is lost")
    written = counted(sum(one.count for one in found.images) or len(found.files), "image" if found.images else "file")
    table = Table(rows, caption=f"{config.recording}: {written} in {found.folder}")
    return ExportResult(said, (table,), tuple(remarks), replay.has_ledger)
