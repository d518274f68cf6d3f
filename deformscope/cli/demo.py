"""`deformscope demo`: the main job on what is built in; leaves `runs/demo-<stamp>.rrd`.

deformscope demo
deformscope demo --images --viewer none --json -
"""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from datetime import datetime
from pathlib import Path

from deformscope.cli.calibrate import run as calibrate
from deformscope.cli.common import quiet_warp, say
from deformscope.cli.explore import run as explore
from deformscope.config import BetaConfig, DemoConfig, ExploreConfig
from deformscope.config.options import OutputOptions
from deformscope.errors import InputError

FOLDER = Path("runs")
SAMPLE = "tension"
SCENE = "lab:three-60-110-rigid"
TOUCHES = 12


def run(config: DemoConfig) -> None:
    """Explore a simulated table, or fit the images that ship; record it, and show it where there is a display."""
    quiet_warp()
    output = config.output
    if output.record is None:
        output = dataclasses.replace(output, record=_new_recording())
    if config.images:
        _fit_images(output)
        _say_how_to_open(output.record)
        return

    explore(ExploreConfig(SCENE, touches=TOUCHES, output=output))
    _say_how_to_open(output.record)


def _say_how_to_open(recording: Path | None) -> None:
    """The command for a shell in this folder; the viewer stands beside the Python that runs this."""
    assert recording is not None
    viewer = Path(sys.executable).with_name("rerun")
    command = os.path.relpath(viewer) if viewer.is_relative_to(Path.cwd()) else str(viewer)
    say(f"open it with: {shlex.join([command if viewer.exists() else 'rerun', str(recording)])}")


def _fit_images(output: OutputOptions) -> None:
    calibrate(BetaConfig((f"sample:{SAMPLE}",), output=output))


def _new_recording() -> Path:
    """A name that no earlier run took, in a folder that git ignores."""
    try:
        FOLDER.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(
            "a folder that can be written to", (error.strerror or str(error)).lower(), "--record FILE.rrd", FOLDER
        ) from error
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    for number in range(1, 100):
        path = FOLDER / f"demo-{stamp}{'' if number == 1 else f'-{number}'}.rrd"
        if not path.exists():
            return path
    raise InputError("fewer demos in one second", "100", where=FOLDER)
