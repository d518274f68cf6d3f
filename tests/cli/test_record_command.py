"""`record`, `verify`, `doctor`, `devices`, `double`, as a user runs them, on doubles over real transports."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from deformscope.cli import main
from deformscope.frames import HealthReport, Item, RawBytes, WrenchFrame
from deformscope.recording.items import read_items
from deformscope.recording.ledger import check_recording, ledger_path, read_ledger
from tests.cases import Capture, Patch
from tests.patience import PATIENCE_S
from tests.verified import verify_here

SMALL = """
[devices.tip]
driver = "optoforce"
double = true
sensitivity = { counts_at_nominal = [16037.0, 16037.0, 16037.0], nominal = [40.0, 40.0, 40.0] }

[devices.pads]
driver = "dsa"
double = true
"""
WHOLE = (0, 3)
"""Exit statuses of a whole recording: what a busy machine loses is named, and is 3."""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of that rig."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "rig.toml").write_text(SMALL)
    assert main(["record", str(folder / "rig.toml"), "--seconds", "1.5", "--record", str(folder / "r.rrd")]) in WHOLE
    return folder / "r.rrd"


def copied(recorded: Path, folder: Path) -> Path:
    shutil.copy(ledger_path(recorded), folder)
    return Path(shutil.copy(recorded, folder))


@pytest.fixture
def started() -> Iterator[list[subprocess.Popen[str]]]:
    """Processes that a test starts; whatever is left of them is ended."""
    processes: list[subprocess.Popen[str]] = []
    yield processes
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.wait(PATIENCE_S)
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def start(started: list[subprocess.Popen[str]], *arguments: str | Path, cwd: Path) -> subprocess.Popen[str]:
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "PYTHONUNBUFFERED": "1",
        "XDG_RUNTIME_DIR": str(cwd),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "deformscope", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=environment,
    )
    started.append(process)
    return process


def wait_for(stream: IO[str] | None, words: str) -> str:
    """Read lines until one holds the words."""
    assert stream is not None
    until = time.monotonic() + PATIENCE_S
    seen = ""
    while time.monotonic() < until and (line := stream.readline()):
        seen += line
        if words in line:
            return line
    raise AssertionError(f"{words!r} was not said; but: {seen}")


def test_a_bench_of_doubles_is_recorded_whole(tmp_path: Path, capsys: Capture) -> None:
    file, told = tmp_path / "r.rrd", tmp_path / "r.json"
    command = ["record", "lab:bench", "--record", str(file), "--overwrite", "--json", str(told)]
    for seconds in ("2", "8", "30"):  # until a busy machine has drawn a few depth images
        assert main([*command, "--seconds", seconds]) in WHOLE
        found = json.loads(told.read_text())
        if all(health["received"] > 5 for health in found["devices"].values()):
            break
    assert found["recording"] == str(file)
    assert set(found["devices"]) == {"tip", "wrist", "pads", "hand", "arm", "camera", "depth"}
    for name, health in found["devices"].items():
        assert health["received"] > 5, name
    assert check_recording(file).problems == []
    capsys.readouterr()
    assert verify_here(file, "--json", "-") in WHOLE
    verified = json.loads(capsys.readouterr().out)
    assert verified["ok"]
    # What each device gave is what the file holds; how much had to be dropped, a busy machine decides.
    for name, health in found["devices"].items():
        assert verified["counts"][f"{name}/frames"] == health["received"] - health["dropped"], name


@pytest.mark.realtime
def test_doubles_on_an_idle_machine_lose_nothing(tmp_path: Path) -> None:
    told = tmp_path / "r.json"
    record = ["record", "lab:bench", "--seconds", "3", "--record", str(tmp_path / "r.rrd"), "--json", str(told)]
    assert main(record) in WHOLE
    devices = json.loads(told.read_text())["devices"]
    assert devices["tip"]["received"] > 2000
    for name, health in devices.items():
        assert health["dropped"] == health["skipped_bytes"] == health["silent_s"] == 0, (name, health)
        if name not in ("camera", "depth"):  # a simulated scene may be drawn too late, and says so
            assert health["lost"] == 0, (name, health)


def test_frames_and_bytes_in_the_file_agree(recorded: Path) -> None:
    from deformscope_drivers.optoforce.protocol import Decoder, Reading

    items = list(read_items(recorded))
    data = b"".join(
        item.data for item in items if isinstance(item, RawBytes) and item.device == "tip" and not item.sent
    )
    readings = [event for event in Decoder().feed(data) if isinstance(event, Reading)]
    frames = [item for item in items if isinstance(item, WrenchFrame)]
    assert len(frames) == len(readings) > 100
    assert [tuple(frame.counts) for frame in frames] == [tuple(reading.counts[0]) for reading in readings]
    assert dict([item for item in items if isinstance(item, HealthReport)][-1].devices)["tip"].received == len(frames)


def test_ctrl_c_ends_a_recording_cleanly(rig: Path, tmp_path: Path, started: list[subprocess.Popen[str]]) -> None:
    process = start(started, "record", rig, "--record", "r.rrd", cwd=tmp_path)
    wait_for(process.stderr, "Ctrl-C ends it")
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) in WHOLE
    assert check_recording(tmp_path / "r.rrd").problems == []
    assert verify_here(tmp_path / "r.rrd") in WHOLE


@pytest.mark.slow  # two processes on doubles
def test_two_recordings_of_one_device_do_not_mix(
    tmp_path: Path, started: list[subprocess.Popen[str]], capsys: Capture
) -> None:
    double = start(started, "double", "optoforce", cwd=tmp_path)
    wait_for(double.stdout, "[devices.optoforce]")
    rig = tmp_path / "rig.toml"
    port = wait_for(double.stdout, "port")
    rig.write_text(f'[devices.optoforce]\ndriver = "optoforce"\n{port}')
    first = start(started, "record", rig, "--record", "first.rrd", cwd=tmp_path)
    wait_for(first.stderr, "Ctrl-C ends it")
    assert main(["record", str(rig), "--seconds", "1", "--record", str(tmp_path / "second.rrd")]) != 0
    said = capsys.readouterr().err
    assert "another program" in said
    assert "device optoforce" in said
    assert not list(tmp_path.glob("second*"))
    first.send_signal(signal.SIGINT)
    assert first.wait(PATIENCE_S) in WHOLE
    assert verify_here(tmp_path / "first.rrd") in WHOLE


def test_a_flipped_bit_is_found(recorded: Path, tmp_path: Path, capsys: Capture) -> None:
    file = copied(recorded, tmp_path)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 4
    file.write_bytes(content)
    assert main(["verify", str(file)]) != 0
    assert "differ from what was recorded" in capsys.readouterr().err


def test_doctor_says_what_works_and_what_does_not(rig: Path, tmp_path: Path, capsys: Capture) -> None:
    assert main(["doctor", str(rig), "--seconds", "0.5"]) == 0
    assert "ok    tip (optoforce, double)" in capsys.readouterr().out
    broken = tmp_path / "broken.toml"
    broken.write_text(SMALL.replace("double = true\nsens", 'port = "/dev/ttyNONE"\nsens'))
    assert main(["doctor", str(broken), "--seconds", "0.5", "--json", str(tmp_path / "d.json")]) != 0
    findings = {entry["what"]: entry for entry in json.loads((tmp_path / "d.json").read_text())["findings"]}
    assert findings["tip (optoforce)"]["verdict"] == "FAIL"
    assert "/dev/ttyNONE" in findings["tip (optoforce)"]["told"]
    assert findings["pads (dsa, double)"]["verdict"] == "ok"


def test_devices_lists_running_doubles_with_serial_and_health(
    tmp_path: Path, started: list[subprocess.Popen[str]], capsys: Capture, monkeypatch: Patch
) -> None:
    double = start(started, "double", "optoforce", "dsa", cwd=tmp_path)
    wait_for(double.stdout, "[devices.dsa]")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert main(["devices", "--json", "-"]) == 0
    found = {entry["driver"]: entry for entry in json.loads(capsys.readouterr().out) if "double" in entry["note"]}
    assert found["optoforce"]["serial"] == "ISE0A129"
    assert found["optoforce"]["health"].startswith("ok, ")
    assert found["dsa"]["serial"] == "4321"
    assert found["dsa"]["firmware"] == "269"
    double.send_signal(signal.SIGINT)
    assert double.wait(PATIENCE_S) == 0
    assert main(["devices", "--json", "-"]) == 0
    assert not [entry for entry in json.loads(capsys.readouterr().out) if "double" in entry["note"]]


def test_devices_on_a_machine_with_none_helps(capsys: Capture, monkeypatch: Patch) -> None:
    from deformscope.cli import devices

    monkeypatch.setattr(devices, "search", list)
    assert main(["devices"]) == 0
    said = capsys.readouterr().out
    assert "No device was found" in said
    assert "record lab:bench" in said


def test_a_device_without_a_port_is_named(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f'[devices.hand]\ndriver = "sdh"\n[record]\nfolder = "{tmp_path}"\n')
    assert main(["record", str(path)]) == 2
    told = capsys.readouterr().err
    assert "expected a port or a bus; got neither" in told
    assert "device hand" in told


def test_double_wants_to_know_what(capsys: Capture) -> None:
    assert main(["double"]) == 2
    assert "deformscope double optoforce" in capsys.readouterr().err


def test_a_damaged_ledger_is_told(recorded: Path, tmp_path: Path, capsys: Capture) -> None:
    recording = copied(recorded, tmp_path)
    ledger_path(recording).write_text("{")
    assert main(["verify", str(recording)]) == 2
    assert "it is damaged" in capsys.readouterr().err


def test_a_device_that_is_gone_is_named_with_what_it_cost(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    from deformscope.lab.double_device import wire_of
    from deformscope.rig.source import RigSource
    from deformscope_drivers.interface import DRIVERS

    file, told = tmp_path / "r.rrd", tmp_path / "r.json"
    take = RigSource.take
    with wire_of("optoforce", DRIVERS["optoforce"].config(), "") as wire:
        (tmp_path / "rig.toml").write_text(f'[devices.tip]\ndriver = "optoforce"\nport = "{wire.port}"\n')

        def take_and_unplug(source: RigSource, wait_s: float) -> list[Item]:
            items = take(source, wait_s)
            if sum(isinstance(item, WrenchFrame) for item in items):
                wire.unplug()
            return items

        monkeypatch.setattr(RigSource, "take", take_and_unplug)
        command = ["record", str(tmp_path / "rig.toml"), "--seconds", "1.5", "--record", str(file), "--json", str(told)]
        assert main(command) == 3
    said = capsys.readouterr()
    found = json.loads(told.read_text())

    assert found["losses"]["tip"]["silent_s"] > 0.5
    assert found["devices"]["tip"]["lost"] > 300
    assert found["ended"].endswith("as requested")
    assert "with losses: tip: " in said.err
    assert "without any" in said.out
    assert "got none" in said.out
    assert (read_ledger(file).ended or {})["losses"] == found["losses"]

    assert verify_here(file, "--json", "-") == 3
    said = capsys.readouterr()
    verified = json.loads(said.out)
    assert verified["ok"] is True
    assert verified["losses"]["tip"] == found["losses"]["tip"]
    assert "tip: " in said.err


@pytest.mark.slow  # Ctrl-C below ends one as early
def test_a_rig_that_is_ended_early_says_so(rig: Path, tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    from deformscope.rig.source import RigSource

    file, told = tmp_path / "r.rrd", tmp_path / "r.json"
    take = RigSource.take
    ends_by = signal.SIGTERM

    def take_and_end(source: RigSource, wait_s: float) -> list[Item]:
        items = take(source, wait_s)
        if any(isinstance(item, WrenchFrame) for item in items):
            os.kill(os.getpid(), ends_by)
        return items

    monkeypatch.setattr(RigSource, "take", take_and_end)
    command = ["record", str(rig), "--overwrite", "--record", str(file), "--json", str(told)]
    assert main([*command, "--seconds", "60"]) == 128 + signal.SIGTERM
    ended = json.loads(told.read_text())["ended"]
    assert ended.startswith("by SIGTERM after")
    assert ended.endswith("earlier than the requested 60 s")
    assert ended in capsys.readouterr().err
    assert check_recording(file).problems == []
    assert verify_here(file) in WHOLE
    assert "by SIGTERM" in capsys.readouterr().out
    ends_by = signal.SIGINT
    assert main([*command, "--seconds", "60"]) == 128 + signal.SIGINT
    assert main(command) in WHOLE, "Ctrl-C is the end of a recording that has no other"
