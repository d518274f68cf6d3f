"""What is lost of a recording whose process is killed outright: the last moments, by the device's own counter."""

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.frames import WrenchFrame
from deformscope.recording.items import read_items
from deformscope.recording.ledger import check_recording
from deformscope_drivers.optoforce.double import OptoforceDouble
from deformscope_drivers.wires import PtyWire
from tests.patience import PATIENCE_S

RIG = """
[devices.tip]
driver = "optoforce"
port = "{port}"
rate_hz = 1000
sensitivity = {{ counts_at_nominal = [16037.0, 16037.0, 16037.0], nominal = [40.0, 40.0, 40.0] }}

[devices.pads]
driver = "dsa"
double = true

[devices.camera]
driver = "webcam"
double = true

[devices.depth]
driver = "depth_camera"
double = true
fps = 10
"""
MOST_S = 0.25 + 0.1
"""A portion is gathered and flushed within the one; devices are read in batches of the other."""


@dataclass(frozen=True)
class Loss:
    """Readings that the double had sent by the kill and that are not in what was recovered, and for how long [s]."""

    readings: int
    seconds: float


def kill(folder: Path, after_s: float) -> Loss:
    """Record a rig with a force sensor of this process, kill it so long after its first portion, and recover it."""
    folder.mkdir()
    double = OptoforceDouble()
    with PtyWire(double) as wire:
        (folder / "rig.toml").write_text(RIG.format(port=wire.port))
        with subprocess.Popen(
            [sys.executable, "-m", "deformscope", "record", "rig.toml", "--record", "r.rrd"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "XDG_RUNTIME_DIR": str(folder)},
        ) as process:
            assert process.stderr is not None
            until = time.monotonic() + PATIENCE_S
            while "Ctrl-C ends it" not in process.stderr.readline():
                assert time.monotonic() < until
            while "wrench/tip" not in (folder / "r.part.rrd.ledger").read_text():  # devices take a moment to begin
                assert time.monotonic() < until
                time.sleep(0.02)
            time.sleep(after_s)
            process.kill()
            killed_ns, sent = time.monotonic_ns(), double._sent
    part, out = folder / "r.part.rrd", folder / "r.recovered.rrd"
    check = check_recording(part)
    assert (check.problems, check.ended) == ([], False)
    assert check.committed > 0
    assert main(["recover", str(part), "--json", str(folder / "told.json")]) == 0
    frames = [one for one in read_items(out) if isinstance(one, WrenchFrame) and one.device == "tip"]
    assert json.loads((folder / "told.json").read_text())["counts"]["tip/frames"] == len(frames)
    counters = np.array([frame.stamp.device_ticks for frame in frames]) % 0x10000
    np.testing.assert_array_equal(np.diff(counters) % 0x10000, 1)  # none is missing between the first and the last
    assert [frame.index for frame in frames] == list(range(len(frames)))
    return Loss((sent - 1 - int(counters[-1])) % 0x10000, (killed_ns - frames[-1].stamp.host_ns) / 1e9)


def test_killed_while_it_records(tmp_path: Path) -> None:
    lost = kill(tmp_path / "0", np.random.default_rng(0).uniform(0.0, 1.5))
    assert lost.readings >= 0
    # a reading a millisecond by the double's own counter; what is on its way when the process dies is some
    assert lost.readings == pytest.approx(1e3 * lost.seconds, abs=50)


@pytest.mark.slow
@pytest.mark.realtime
def test_how_much_a_kill_costs(tmp_path: Path) -> None:
    """DEFORMSCOPE_KILLS=200 pytest -m slow -s tests/recording/test_killed.py"""
    rng = np.random.default_rng(1)
    count = int(os.environ.get("DEFORMSCOPE_KILLS", "20"))
    lost_s = [kill(tmp_path / str(number), rng.uniform(0.0, 4.0)).readings / 1e3 for number in range(count)]
    print(f"{count} kills: lost {np.percentile(lost_s, [0, 50, 90, 100]).round(3)} s (least, median, 90 %, most)")
    assert np.median(lost_s) <= MOST_S
