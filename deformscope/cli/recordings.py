"""`deformscope record`, `live`, `verify`, `recover`, `discard`, `replay`, `report` and `export`."""

from __future__ import annotations

from deformscope.cli import common
from deformscope.config import (
    DiscardRecordingConfig,
    ExportConfig,
    LiveConfig,
    RecordConfig,
    RecoverConfig,
    ReplayConfig,
    ReportConfig,
    RigRunOptions,
    VerifyConfig,
)
from deformscope.recording.losses import named
from deformscope.runs.rig_run import RigRun, run_rig


def record(config: RecordConfig) -> int:
    """Record a rig, headless unless a viewer is requested. Returns the command's exit status."""
    return _shown(run_rig(config, "none", always_record=True), config)


def live(config: LiveConfig) -> int:
    """Show a rig in rerun's window, and record it on request. Returns the command's exit status."""
    return _shown(run_rig(config, "native", always_record=False), config)


def _shown(run: RigRun, config: RigRunOptions) -> int:
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


def verify(config: VerifyConfig) -> int:
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


def recover(config: RecoverConfig) -> int:
    """Write the readable part of a recording as a new one. Returns the command's exit status."""
    from deformscope.runs.recovery import recover_recording

    found = recover_recording(config.recording, config.out)
    common.wrote("recording", str(found.found["recovered"]))
    common.show(found)
    common.write_json(found.as_json(), config.json)
    return common.EXIT_LOSSES if found.found["problems"] else 0


def export(config: ExportConfig) -> int:
    """Write the export, and list the written files. Returns the command's exit status."""
    from deformscope.runs.exporting import export_recording

    with common.fit_progress() as progress:
        found = export_recording(config, progress)
    common.show(found)
    common.write_json(found.as_json(), config.json)
    for line in found.remarks:
        common.say(f"deformscope: {line}")
    return common.EXIT_LOSSES if found.remarks or not found.checked else 0


def discard(config: DiscardRecordingConfig) -> None:
    """Mark the recording, or an episode of it, as not to be used, in its ledger. Nothing is deleted."""
    from deformscope.runs.recordings import OpenRecording

    recording = OpenRecording(config.recording)
    recording.discard(config.reason, config.episode)
    common.show_table(str(config.recording), [("discarded", str(one)) for one in recording.discarded()])
    common.write_json(recording.as_json(), config.json)


def replay(config: ReplayConfig) -> int:
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


def report(config: ReportConfig) -> None:
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
