"""`deformscope record` and `deformscope live`: all devices of a rig, into a file and onto the screen."""

from __future__ import annotations

from deformscope.cli.common import EXIT_LOSSES, say, show, write_json, wrote
from deformscope.config import LiveConfig, RecordConfig, RigRunOptions
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
    show(run.result)
    write_json(run.result.as_json(), config.output.json)
    recorded, losses = run.result.found["recording"], run.result.losses
    if recorded is not None:
        wrote("recording", run.result.path)
    if losses and recorded:
        say(f"deformscope: the recording is complete, with losses: {named(losses)}")
    if run.early_by:
        say(f"deformscope: ended {run.why}")
        return 128 + run.early_by
    return EXIT_LOSSES if run.failures or (losses and recorded) else 0
