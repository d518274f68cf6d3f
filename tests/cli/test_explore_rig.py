"""`explore RIG` on devices with threads of their own and the host's clock: doubles over a simulated table, reached and
moved by the code that moves a real arm."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from deformscope.cli import main
from deformscope.experiments.explore_rig import RigBench
from deformscope.rig_replay import read_items
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.supervisor import Action, Fault, Verdict
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.optoforce import Optoforce

RIG = """
[devices.arm]
driver = "jaco"
double = true
state_hz = 100
command_deadline_s = 0.5
[devices.tip]
driver = "optoforce"
double = true
rate_hz = 1000
[devices.depth]
driver = "depth_camera"
double = true
fps = 5
[surface]
scene = "two-60-150"
T_arm_surface = [[1, 0, 0, -0.30], [0, 1, 0, -0.55], [0, 0, 1, 0], [0, 0, 0, 1]]
[tool]
compliance_m_per_n = 2e-4
compliance_sd = 2e-5
[workspace]
low_m = [-0.40, -0.66, 0.0]
high_m = [0.45, 0.10, 0.75]
# doubles share a busy machine with what reads them
force_silent_s = 0.5
arm_silent_s = 0.5
camera_silent_s = 0.5
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def test_a_rig_of_doubles_is_explored_recorded_and_replayed(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RigBench, "simulated", False)  # all is asked of it that is asked of real devices
    monkeypatch.setattr(RigBench, "calibrated", property(lambda bench: dict.fromkeys(("all",), True)))
    record, told = tmp_path / "r.rrd", tmp_path / "r.json"
    arguments = ["explore", str(rig), "--touches", "1", "--beta-model", "none", "--record", str(record)]

    assert main([*arguments, "--yes", "--json", str(told)]) == 0, capsys.readouterr().err

    found = json.loads(told.read_text())
    (touch,) = found["touches"]
    assert found["stop_reason"] == "budget"
    assert not touch["rigid"]
    assert 0.2 < touch["apparent_stiffness_n_per_mm"] < 3.0
    assert 2.7 < found["max_force_n"] < 3.6
    shown = capsys.readouterr()
    assert "keep the emergency stop in your hand" in shown.out + shown.err
    assert main(["verify", str(record)]) == 0, capsys.readouterr().err
    assert {item.device for item in read_items(record) if hasattr(item, "device")} == {"arm", "tip", "depth"}
    assert main(["replay", str(record)]) == 0, capsys.readouterr().err


def test_a_real_arm_does_not_move_unless_somebody_says_yes(
    rig: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RigBench, "simulated", False)
    monkeypatch.setattr(RigBench, "calibrated", property(lambda bench: dict.fromkeys(("all",), True)))
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\n"))
    moved: list[Any] = []
    monkeypatch.setattr("deformscope.robot.robot.Robot.let_move", lambda robot, preflight: moved.append(preflight))

    assert main(["explore", str(rig), "--touches", "1"]) == 2

    said = capsys.readouterr().err
    assert "--yes" in said
    assert not moved


def test_an_arm_that_is_not_calibrated_does_not_move(
    rig: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.write_text(rig.read_text().replace("compliance_m_per_n = 2e-4\ncompliance_sd = 2e-5", ""))
    monkeypatch.setattr(RigBench, "simulated", False)

    assert main(["explore", str(rig), "--touches", "1", "--yes"]) == 2

    said = capsys.readouterr().err
    assert "calibration: [tool] compliance_m_per_n: missing" in said
    assert "[camera] T_arm_camera: missing" in said


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('scene = "two-60-150"', "", "all doubled with a [surface] scene"),
        ('scene = "two-60-150"', 'scene = "moon"', "a scene"),
        ('driver = "jaco"\ndouble = true', 'driver = "jaco"', "double = true for arm, tip, depth"),
        ('[devices.arm]\ndriver = "jaco"', '[devices.arm]\ndriver = "dsa"', 'driver = "jaco"'),
        ("state_hz = 100", "state_hz = 2", "state_hz of 3 or more for arm"),
        ("rate_hz = 1000", "rate_hz = 0", "rate_hz of 3 or more for tip"),
        ("[tool]\n", '[tool]\ntip = "flat"\n', 'tip = "sphere"'),
        ("-0.30], [0, 1", "-3.0], [0, 1", "within the arm's reach"),
    ],
)
def test_a_rig_that_cannot_explore_is_refused_in_one_line(
    old: str, new: str, words: str, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = rig.read_text()
    assert old in text
    changed = text.replace(old, new)
    if "dsa" in new:
        changed = changed.replace("state_hz = 100\ncommand_deadline_s = 0.5\n", "")
    rig.write_text(changed)

    assert main(["explore", str(rig)]) == 2

    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("what", "error", "words"),
    [
        (
            Optoforce,
            SettingsRefused("still readings", "a shaking tip", "hold on"),
            "a shaking tip | try: hold on | device tip",
        ),
        (Robot, RobotStopped(Verdict(Action.STOP, Fault.ARM_SILENT, "no state")), "arm silent: no state | try: see to"),
    ],
)
def test_what_goes_wrong_before_the_checks_is_told_in_one_line(
    what: type,
    error: Exception,
    words: str,
    rig: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(device: object) -> None:
        raise error

    monkeypatch.setattr(what, "zero" if what is Optoforce else "cycle", fail)

    assert main(["explore", str(rig), "--touches", "1"]) == 2

    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_faults_are_for_simulated_scenes(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", str(rig), "--fault", "storm@1"]) == 2
    assert "lab:two-60-150" in capsys.readouterr().err
