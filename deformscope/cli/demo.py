"""`deformscope demo`: the main task on simulated devices; leaves `runs/demo-<stamp>.rrd`."""

import dataclasses
from pathlib import Path

from deformscope.cli.calibrate import run as calibrate
from deformscope.cli.common import quiet_warp, say, wrote
from deformscope.cli.explore import run as explore
from deformscope.config import BetaConfig, DemoConfig, ExploreConfig
from deformscope.file_io import new_recording

FOLDER = Path("runs")
SAMPLE = "tension"
SCENE = "lab:three-60-110-rigid"
TOUCHES = 12


def run(config: DemoConfig) -> None:
    """Explore a simulated table, or fit the images that ship; record it, and show it where there is a display."""
    quiet_warp()
    output = config.output
    record = output.record or new_recording(FOLDER, "demo")
    output = dataclasses.replace(output, record=record)
    if config.images:
        calibrate(BetaConfig((f"sample:{SAMPLE}",), output=output))
    else:
        say(f"{TOUCHES} touches of a simulated table; writes {record} (125 MB); after the first: the time left")
        explore(ExploreConfig(rig=SCENE, budget=TOUCHES, output=output))
    wrote("recording", record)
