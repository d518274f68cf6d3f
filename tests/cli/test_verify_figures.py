"""How many of many damages are noticed: flips, cuts and kills. The figures are printed (`pytest -s`)."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.frames import WrenchFrame
from deformscope.recording.items import read_items
from deformscope.recording.ledger import check_recording, ledger_path
from deformscope.recording.reader import Replay

pytestmark = pytest.mark.slow

RIG = '[devices.tip]\ndriver = "optoforce"\ndouble = true\n'
FLIPS, CUTS, KILLS, READ = 200, 50, 10, 40


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    (folder / "rig.toml").write_text(RIG)
    file = folder / "r.rrd"
    assert main(["record", str(folder / "rig.toml"), "--seconds", "3", "--record", str(file)]) in (0, 3)
    return file


def refused(path: Path) -> bool:
    try:
        Replay(path)
    except InputError:
        return True
    return False


@pytest.mark.parametrize("what", ["recording", "ledger"])
def test_every_flip_is_refused(recording: Path, tmp_path: Path, what: str) -> None:
    rng = np.random.default_rng(1)
    found = 0
    for _ in range(FLIPS):
        copy = Path(shutil.copy(recording, tmp_path / "r.rrd"))
        shutil.copy(ledger_path(recording), ledger_path(copy))
        damaged = copy if what == "recording" else ledger_path(copy)
        content = bytearray(damaged.read_bytes())
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(content)
        found += bool(check_recording(copy).problems) and refused(copy)
    print(f"\n{found} of {FLIPS} flips in the {what} refused")
    assert found == FLIPS


def test_every_truncation_is_refused(recording: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    whole = recording.read_bytes()
    shutil.copy(ledger_path(recording), ledger_path(tmp_path / "r.rrd"))
    found = 0
    for _ in range(CUTS):
        (tmp_path / "r.rrd").write_bytes(whole[: rng.integers(len(whole))])
        found += refused(tmp_path / "r.rrd")
    print(f"\n{found} of {CUTS} truncations refused")
    assert found == CUTS


def test_without_a_ledger_verify_survives_every_flip(recording: Path, tmp_path: Path, capfd) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(3)
    whole = recording.read_bytes()
    statuses: dict[int, int] = {}
    for _ in range(READ):
        content = bytearray(whole)
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        (tmp_path / "r.rrd").write_bytes(content)
        status = main(["verify", str(tmp_path / "r.rrd")])
        statuses[status] = statuses.get(status, 0) + 1
        said = capfd.readouterr().err.splitlines()
        assert len(said) <= 3, said
        assert not any("Traceback" in line for line in said)
    with capfd.disabled():
        print(f"\nverify without a ledger, {READ} flips: exit statuses {statuses}")
    assert set(statuses) <= {2, 3}, "a flip that goes unnoticed is never called checked"


def test_every_killed_run_is_readable_and_recovered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rig.toml").write_text(RIG)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONUNBUFFERED": "1"}
    readings = []
    for number in range(KILLS):
        command = [sys.executable, "-m", "deformscope", "record", "rig.toml", "--record", f"k{number}.rrd"]
        with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            for line in process.stderr:
                if "tip: connected" in line:
                    break
            part = tmp_path / f"k{number}.part.rrd"
            size = part.stat().st_size
            while process.poll() is None and part.stat().st_size < size + 100_000 + 7_000 * number:
                time.sleep(0.02)
            process.send_signal(signal.SIGKILL)
        frames = [item for item in read_items(part) if isinstance(item, WrenchFrame)]
        assert [frame.index for frame in frames] == list(range(len(frames)))
        assert main(["recover", str(part)]) == 0
        recovered = tmp_path / f"k{number}.recovered.rrd"
        again = [item for item in read_items(recovered) if isinstance(item, WrenchFrame)]
        assert [frame.index for frame in again] == [frame.index for frame in frames]
        assert check_recording(recovered).problems == []
        readings.append(len(frames))
    capsys.readouterr()
    with capsys.disabled():
        print(f"\n{KILLS} of {KILLS} killed runs read and recovered: {readings} readings")
    assert min(readings) > 100
