"""`squeeze --place` as a command: what it says and keeps, also of a run that is cut off."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deformscope.cli import doctor, main
from deformscope.lab.container_setup import container_lab
from deformscope.recording.items import read_results
from deformscope.rig.rig_file import load_rig
from deformscope.runs.opened_devices import SqueezeOpening
from deformscope.session import RigExperiment
from deformscope.stages.squeeze.placement import ContainerSighting, HandPlacement
from tests.cases import Capture, Patch
from tests.patience import PATIENCE_S


def test_an_arm_that_a_rig_lacks_is_named(tmp_path: Path, capsys: Capture) -> None:
    rig = tmp_path / "rig.toml"
    hand = '[devices.hand]\ndriver = "sdh"\nport = "/dev/null"\n[devices.pads]\ndriver = "dsa"\nport = "/dev/zero"\n'
    rig.write_text(hand)
    assert main(["squeeze", str(rig), "--content", "rice", "--place", "kuka"]) == 2
    assert 'one device with driver = "kuka"' in capsys.readouterr().err
    jaco = '[devices.arm]\ndriver = "jaco"\nmodel = "j2n6s300"\n'
    rig.write_text(hand + jaco + '[devices.camera]\ndriver = "realsense"\n')
    assert main(["squeeze", str(rig), "--content", "rice", "--place", "jaco"]) == 2
    said = capsys.readouterr().err
    for missing in ("[hand] T_arm_hand", "[camera] T_arm_camera", "[surface] T_arm_surface", "[workspace] low_m"):
        assert missing in said


def test_an_arm_that_the_laboratory_lacks_is_named(capsys: Capture) -> None:
    assert main(["squeeze", "lab:containers", "--content", "rice", "--place", "franka"]) == 2
    assert "expected --place jaco or kuka in lab:containers; got 'franka'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["jaco", "kuka"])
def test_it_is_recorded_and_replayed_to_the_last_bit(arm: str, tmp_path: Path) -> None:
    out, file = tmp_path / "r.json", tmp_path / "r.rrd"
    given = ["squeeze", "lab:containers", "--content", "rice", "--container", "cylinder-02", "--seed", "8"]
    assert main([*given, "--place", arm, "--record", str(file), "--json", str(out), "--viewer", "none"]) == 0
    found = json.loads(out.read_text())
    assert found["placement"]["refused"][-1] == ""
    assert found["placement"]["seed"] == 8
    assert [one["when"] for one in found["container_seen"]] == ["before", "placed", "after"]
    assert found["container_seen"][2]["change"]["kind"] == "stands"
    assert found["features"]["vision"] == 3721
    assert len(list(read_results(file, (HandPlacement,), trust=True))) == 3
    assert main(["replay", str(file)]) == 0


@pytest.mark.slow
def test_a_run_that_is_killed_on_the_way_leaves_a_recording_that_is_read(tmp_path: Path) -> None:
    file = tmp_path / "r.rrd"
    given = ["squeeze", "lab:containers", "--content", "rice", "--place", "kuka", "--seed", "3", "--record", str(file)]
    process = subprocess.Popen(
        [sys.executable, "-m", "deformscope", *given, "--viewer", "none"], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    end = time.monotonic() + 4 * PATIENCE_S
    while "place: way" not in process.stderr.readline():  # the arm sets out
        assert time.monotonic() < end
    time.sleep(3.0)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stderr.close()
    assert main(["recover", str(tmp_path / "r.part.rrd")]) == 0
    (whole,) = [one for one in tmp_path.glob("*.rrd") if "part" not in one.name]
    assert [one.item.when for one in read_results(whole, (ContainerSighting,), trust=True)] == ["before"]
    assert [one.item.reached for one in read_results(whole, (HandPlacement,), trust=True)] == [""]


def test_doctor_lists_what_a_rig_lacks_for_it(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    devices = {"hand": "sdh", "pads": "dsa", "arm": "jaco", "camera": "realsense"}
    lines = [f'[devices.{name}]\ndriver = "{driver}"\n' for name, driver in devices.items()]
    lines[0] += 'port = "/dev/null"\n'
    lines[1] += 'port = "/dev/zero"\n'
    file.write_text("".join(lines))
    (found,) = doctor._placing(load_rig(file))
    assert found.verdict == "look"
    assert found.told.startswith("squeeze --place jaco lacks [hand] T_arm_hand, [camera] T_arm_camera,")
    file.write_text("".join(lines[:2]))
    assert doctor._placing(load_rig(file)) == []


@pytest.mark.slow
def test_a_real_arm_is_asked_for_and_everything_is_looked_at_again(tmp_path: Path, monkeypatch: Patch) -> None:
    """The doubles, told to be real: the same way, with its questions."""
    asked: list[str] = []

    def opening(*given: object, **named: object) -> SqueezeOpening:
        made = container_lab("rice", "box-03", seed=5, camera_hz=2.0, arm="kuka")
        return SqueezeOpening(dataclasses.replace(made.setup, simulated=False), {}, "rice", "box-03")

    def agree(asking: object, page: object, what: str, **named: object) -> RigExperiment[None]:
        asked.append(what)
        yield from ()

    monkeypatch.setattr("deformscope.runs.squeeze_run.squeeze_setup_of", opening)
    monkeypatch.setattr("deformscope.runs.squeeze_run.agree", agree)
    out = tmp_path / "r.json"
    assert main(["squeeze", "rig.toml", "--content", "rice", "--place", "kuka", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert asked[1:] == ["the arm brings the hand to the container"]
    assert not found["simulated"]
    assert found["placement"]["reached"] == "retreat"
    assert [one["when"] for one in found["container_seen"]] == ["before", "asked", "placed", "after"]
