"""`deformscope demo`: the main task on simulated devices; leaves `runs/demo-<stamp>.rrd`.

deformscope demo
deformscope demo --images --viewer none --json -
"""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path

from deformscope.cli.calibrate import run as calibrate
from deformscope.cli.common import quiet_warp, say
from deformscope.cli.explore import run as explore
from deformscope.config import BetaConfig, DemoConfig, ExploreConfig
from deformscope.file_io import new_recording
from deformscope.runs.calibration import rerun_command

FOLDER = Path("runs")
SAMPLE = "tension"
SCENE = "lab:three-60-110-rigid"
TOUCHES = 12


def run(config: DemoConfig) -> None:
    """Explore a simulated table, or fit the images that ship; record it, and show it where there is a display."""
    quiet_warp()
    output = config.output
    if output.record is None:
        output = dataclasses.replace(output, record=new_recording(FOLDER, "demo"))
    if config.images:
        calibrate(BetaConfig((f"sample:{SAMPLE}",), output=output))
    else:
        explore(ExploreConfig(rig=SCENE, budget=TOUCHES, detail=config.detail, output=output))
    say(f"open it with: {rerun_command()} --bind 127.0.0.1 {shlex.quote(str(output.record))}")
