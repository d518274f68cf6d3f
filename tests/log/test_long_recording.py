"""A recording of hours needs no more memory than one of minutes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from deformscope.frames import HandFrame
from deformscope.recording.items import read_items
from deformscope.recording.ledger import read_counts
from tests.log.long_recording import PER_SECOND
from tests.verified import verify_here

ROOT = Path(__file__).resolve().parents[2]
SETTLED_S, MOST_MB = 180, 100.0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("seconds", "more"),
    [(7200, []), (600, ["--cameras"]), (3600, ["--touches"])],
    ids=["no cameras", "all devices", "exploration"],
)
def test_memory_is_flat(seconds: int, more: list[str], tmp_path: Path) -> None:
    path = tmp_path / "long.rrd"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "drivers")])}
    done = subprocess.run(
        [sys.executable, "-m", "tests.log.long_recording", str(path), str(seconds), *more],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    *lines, told = done.stdout.splitlines()
    looks = [tuple(map(int, line.split())) for line in lines]
    settled = [memory_mb for at_s, memory_mb, _ in looks if at_s >= SETTLED_S]
    assert len(settled) > 10
    assert max(settled) - settled[0] < MOST_MB, (told, looks)
    assert looks[-1][0] == seconds
    assert verify_here(path) == 3  # whole, with the losses that the health reports in it name
    counts = read_counts(path)
    assert counts["fingertip/frames"] == counts["fingertip/received"] == 1000 * seconds
    assert counts["jaco/frames"] == 100 * seconds
    hands = sum(1 for _ in read_items(path, trust=True, kinds=(HandFrame,)))
    assert hands == counts["hand/frames"] == PER_SECOND["hand"] * seconds
