"""A disk that becomes full is announced, and the recording ended while there is room to end it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope.recording import lateness
from deformscope.recording import rrd_file as recording_file
from deformscope.recording.lateness import ANNOUNCED_S, FREE_BYTES, WINDOW_S, DiskForecast, RecordingError
from deformscope.recording.ledger import check_recording
from deformscope.recording.recorder import Recorder
from tests.log import synthetic
from tests.verified import verify_here


def test_a_disk_that_fills_is_announced_once_at_each_limit() -> None:
    """At 10 MB/s: within 20 min, 5 min and 1 min of what has to stay free."""
    forecast, free, said = DiskForecast(), 15_000_000_000, list[tuple[float, str]]()
    for second in range(1500):
        if words := forecast.look(free - 10_000_000 * second, float(second)):
            said.append((second, words))
    assert forecast.bytes_per_s == pytest.approx(10e6)
    assert forecast.reserve == pytest.approx(50e6)
    left_s = [(free - 10_000_000 * second - FREE_BYTES) / 10e6 for second, _ in said]
    assert len(said) == len(ANNOUNCED_S)
    for (_, words), left, limit in zip(said, left_s, ANNOUNCED_S[::-1], strict=True):
        assert limit - WINDOW_S <= left <= limit
        assert f"{left / 60:.0f} min" in words or f"{left:.0f} s" in words
        assert "10.0 MB/s" in words


def test_a_disk_that_does_not_fill_is_not_spoken_of() -> None:
    forecast = DiskForecast()
    assert not any(forecast.look(10**9 + (second % 7) * 10**6, float(second)) for second in range(0, 600, 7))
    forecast = DiskForecast()  # too short to tell a rate
    assert not any(forecast.look(10**9 - 10**8 * second, float(second)) for second in range(9))
    assert forecast.reserve == 0


def test_the_recording_ends_while_there_is_room_to_end_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """100 MB/s leave room for five seconds, not for 64 MiB."""
    usage, looks = shutil.disk_usage(tmp_path), iter(range(10**6))
    monkeypatch.setattr(recording_file, "BEAT_S", 0.0)
    monkeypatch.setattr(lateness, "WINDOW_S", 1e-6)
    monkeypatch.setattr(
        DiskForecast, "bytes_per_s", property(lambda self: 100e6, lambda self, value: None), raising=False
    )
    monkeypatch.setattr(shutil, "disk_usage", lambda where: usage._replace(free=10**9 - 10**6 * next(looks)))
    path = tmp_path / "run.rrd"
    with pytest.raises(RecordingError, match="476 MiB free on the disk"), Recorder(path) as made:  # noqa: PT012
        while True:
            made.write(next(synthetic.frames(1)))
    assert "the disk will be full in" in caplog.text
    assert check_recording(tmp_path / "run.part.rrd").problems == []


@pytest.mark.slow
@pytest.mark.parametrize("command", ["record lab:bench", "explore lab:two-60-150 --seed 3"])
def test_a_disk_that_becomes_full(command: str, tmp_path: Path) -> None:
    """A file system of 90 MB, in a name space of its own: ended in time with what was recorded; arm at rest."""
    (tmp_path / "disk").mkdir()
    script = f"mount -t tmpfs -o size=90m tmpfs disk; {sys.executable} -m deformscope {command} --record disk/r.rrd"
    unshared = subprocess.run(
        ["unshare", "-rm", "sh", "-c", f"{script}; status=$?; cp disk/* .; exit $status"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "XDG_RUNTIME_DIR": str(tmp_path)},
    )
    if "Operation not permitted" in unshared.stderr:
        pytest.skip("needs a name space of its own for mounts")
    assert unshared.returncode == 2, unshared.stderr
    assert "MiB free on the disk" in unshared.stderr.splitlines()[-1]
    if "explore" in command:
        assert re.search(r"^  arm +at rest$", unshared.stdout, re.MULTILINE)
    assert check_recording(tmp_path / "r.part.rrd").problems == []
    assert main(["recover", str(tmp_path / "r.part.rrd")]) == 0
    assert verify_here(tmp_path / "r.recovered.rrd") == 3  # whole, and what came after is lost
