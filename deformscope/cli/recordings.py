"""`deformscope record`, `live`, `verify`, `recover`, `discard`, `replay`, `report`, `export`, `import`, `catalog`."""

from typing import TYPE_CHECKING

from deformscope import config as options
from deformscope.cli import common
from deformscope.recording.losses import named

if TYPE_CHECKING:
    from deformscope.runs.rig_run import RigRun


def record(config: options.RecordConfig) -> int:
    """Record a rig, headless unless a viewer is requested. Returns the command's exit status."""
    from deformscope.runs.rig_run import run_rig  # slow to import

    return _shown(run_rig(config, "none", always_record=True), config)


def live(config: options.LiveConfig) -> int:
    """Show a rig in rerun's window, and record it on request. Returns the command's exit status."""
    from deformscope.runs.rig_run import run_rig

    return _shown(run_rig(config, "native", always_record=False), config)


def _shown(run: "RigRun", config: options.RigRunOptions) -> int:
    """Print the summary of the recording; the command's exit status."""
    common.show(run.result)
    common.write_json(run.result.as_json(), config.output.json)
    recorded, losses = run.result.found["recording"], run.result.losses
    if recorded is not None:
        common.wrote("recording", run.result.path)
    if losses and recorded:
        common.say(f"deformscope: the recording is complete, with losses: {named(losses)}")
    if run.early_by:
        common.say(f"deformscope: ended {run.why}")
        return 128 + run.early_by
    return common.EXIT_LOSSES if run.failures or (losses and recorded) else 0


def verify(config: options.VerifyConfig) -> int:
    """Check bytes, structure and completeness. Returns the exit status; raises Damaged if the recording is damaged."""
    from deformscope.runs.verification import verify_recording

    found = verify_recording(config.recording, stages=config.stages, privacy=config.privacy)
    common.show(found)
    common.write_json(found.as_json(), config.json)
    for line in found.remarks:
        common.say(line)
    if found.error is not None:
        raise found.error
    for line in found.losses:
        common.say(f"deformscope: {line}")
    return common.EXIT_LOSSES if found.losses else 0


def recover(config: options.RecoverConfig) -> int:
    """Write the readable part of a recording as a new one. Returns the command's exit status."""
    from deformscope.runs.recovery import recover_recording

    found = recover_recording(config.recording, config.out)
    common.wrote("recording", str(found.found["recovered"]))
    common.show(found)
    common.write_json(found.as_json(), config.json)
    return common.EXIT_LOSSES if found.found["problems"] else 0


def export(config: options.ExportConfig) -> int:
    """Write the export, and list the written files. Returns the command's exit status."""
    from deformscope.runs.recordings import export_recording

    with common.fit_progress() as progress:
        found = export_recording(config, progress)
    common.show(found)
    common.write_json(found.as_json(), config.json)
    for line in found.remarks:
        common.say(f"deformscope: {line}")
    return common.EXIT_LOSSES if found.remarks or not found.checked else 0


def discard(config: options.DiscardRecordingConfig) -> None:
    """Mark the recording, or an episode of it, as not to be used, in its ledger. Nothing is deleted."""
    from deformscope.runs.recordings import OpenRecording

    recording = OpenRecording(config.recording)
    recording.discard(config.reason, config.episode)
    common.show_table(str(config.recording), [("discarded", str(one)) for one in recording.discarded()])
    common.write_json(recording.as_json(), config.json)


def replay(config: options.ReplayConfig) -> int:
    """Run the same stages on the recorded inputs; of a rig, decode its bytes again and compare frames. Raises
    `Different` if the numbers differ from the recorded ones. Returns the command's exit status."""
    from deformscope.pictures.report import Table, table_text
    from deformscope.recording.ledger import ledger_path
    from deformscope.runs.replay import replay_on

    with common.fit_progress() as progress:
        found = replay_on(config, progress)
    common.show(*(table_text(one) if isinstance(one, Table) else one for one in found.shown))
    common.write_json(found.as_json(), config.output.json)
    if found.different is not None:
        raise found.different
    for note in found.notes:
        common.say(note)
    if found.verdict:
        common.console().print(found.verdict)
    return 0 if ledger_path(config.recording).exists() else common.EXIT_LOSSES


def report(config: options.ReportConfig) -> None:
    """Draw the figures of a recording as one HTML page, and list missing stages."""
    from deformscope.runs.recording_report import report_recording

    out = config.recording.with_suffix(".html") if config.out is None else config.out
    common.check_writable(out, "--out")
    found = report_recording(config.recording)
    common.write_file(out, found.page().encode())
    common.show(found)
    common.say(f"stages missing: {', '.join(found.lacks) or 'none'}")
    common.wrote("report", out)
    common.write_json({**found.to_dict(), "report": out}, config.json)


def import_(config: options.ImportConfig) -> int:
    """Import the source, or describe its content. Returns the command's exit status.

    deformscope import --inspect bag.mcap > map.toml
    deformscope import bag.mcap --map map.toml --record run.rrd
    """
    from deformscope.runs.importing import import_source, inspect_source

    if config.inspect:
        found = inspect_source(config)
        if config.output.json != "-":
            print(found.toml, end="")
        if config.picture is not None:
            common.write_file(config.picture, found.picture())
        shown = {"source": config.source, "topics": found.topics, "map": found.toml}
        common.write_json(shown | {"streams": [one.as_json() for one in found.values]}, config.output.json)
        return 0
    result = import_source(config)
    common.show(result)
    common.write_json(result.as_json(), config.output.json)
    if losses := result.losses:
        common.say(f"deformscope: the recording is complete, with losses: {named(losses)}")
    return common.EXIT_LOSSES if losses else 0


def catalog(config: options.CatalogConfig) -> None:
    """List the recordings, after the index is made or updated."""
    from deformscope.runs.catalog import PAGE, catalog_page, catalogue, serve_page

    names = [name.strip() for name in config.columns.split(",") if name.strip()]
    with common.fit_progress() as progress:
        found = catalogue(config.folder, config.where, config.sort, names, workers=config.workers, progress=progress)
        page = catalog_page(found, workers=config.workers, progress=progress) if config.page else None
        if config.serve:
            serve_page(found, config.workers, progress)
    common.show(found)
    if page is not None:
        common.write_file(config.folder / PAGE, page.encode())
        common.wrote("page", config.folder / PAGE)
    if config.json is not None:
        common.write_json(found.as_json(), config.json)
    if config.serve:
        common.keep_page(served=True)


def compare(config: options.CompareConfig) -> None:
    """Print the differences of two recordings."""
    from deformscope.runs.catalog import compare_recordings

    found = compare_recordings(config.first, config.second, corrected=config.corrected)
    common.show(found)
    if found.unaligned:
        common.say(f"not aligned by contact: {found.unaligned}")
    common.write_json(found.as_json(), config.json)
