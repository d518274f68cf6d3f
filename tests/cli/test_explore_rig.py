"""`explore RIG` on doubles over a simulated table, reached and moved by the code that moves a real arm: on a simulated
clock, and with threads of their own on the host's."""

import io
import json
import re
import sys
import time
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.errors import InputError
from deformscope.frames import Frame
from deformscope.recording.items import read_items
from deformscope.rig.rig_file import load_rig, parse_rig
from deformscope.robot.latch import Action
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.setup import RigParts
from deformscope.robot.supervisor import Fault, SafetyDecision
from deformscope.runs.opened_devices import setup_of_rig
from deformscope.stages.regions.touches import MapGrid
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.jaco.chains import J2N6S300
from deformscope_drivers.optoforce import Optoforce
from studies.reach import reach
from tests.cases import Capture, Patch, one_line
from tests.cli.quick_scene import use_quick_scene
from tests.cli.rig_on_a_simulated_clock import count_as_real, use_a_simulated_clock
from tests.verified import verify_here
from tools import page_robustness

RIG = page_robustness.RIG.replace('port = "/dev/double"\nrate_hz = 333', 'bus = "socketcan:can0"\nrate_hz = 100')
"""Of doubles on the host's clock, the force sensor slower and on a CAN bus."""
assert "socketcan:can0" in RIG


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


@pytest.fixture
def simulated_clock(monkeypatch: Patch) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)


def explored_recorded_and_replayed(rig: Path, tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """All is asked of the doubles that is asked of real devices."""
    count_as_real(monkeypatch)
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
    assert verify_here(record) == 0, capsys.readouterr().err
    assert {item.device for item in read_items(record) if hasattr(item, "device")} == {"arm", "tip", "depth"}
    assert main(["replay", str(record)]) == 0, capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("simulated_clock")
def test_with_clocks_apart_it_is_explored_recorded_and_replayed(
    rig: Path, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    """`calibrate time` found the arm 20 ms late: all its stamps are put back, and a replay gives the same results."""
    rig.write_text(RIG + '[calibrated.time]\ndate = 2026-01-02\noffset_s = 0.02\ndevice = "arm"\nbeside = "tip"\n')
    explored_recorded_and_replayed(rig, tmp_path, capsys, monkeypatch)
    late = {(item.device, item.stamp.late_ns) for item in read_items(tmp_path / "r.rrd") if isinstance(item, Frame)}
    assert late == {("arm", 20_000_000), ("tip", None), ("depth", None)}
    assert "identical to the recorded numbers" in " ".join("".join(capsys.readouterr()).split())


def test_a_device_later_than_it_may_be_silent_is_refused(rig: Path) -> None:
    """It would stop the robot as if it were silent."""
    late = '[calibrated.time]\ndate = 2026-01-02\noffset_s = {}\ndevice = "tip"\nbeside = "arm"\n'
    rig.write_text(RIG + late.format(0.4))
    RigParts.of(load_rig(rig))
    rig.write_text(RIG.replace("force_silent_s = 0.5", "force_silent_s = 0.4") + late.format(0.4))
    with pytest.raises(InputError, match="tip with a delay below its limit on silence"):
        RigParts.of(load_rig(rig))


@pytest.mark.realtime
def test_a_rig_of_doubles_is_explored_on_the_hosts_clock(
    rig: Path, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    explored_recorded_and_replayed(rig, tmp_path, capsys, monkeypatch)


MOST_MS = 30.0
"""Of the supervisor's gaps all but one in a thousand: half the time in which a fault of the force is noticed."""


@pytest.mark.slow
@pytest.mark.realtime
def test_the_supervisor_looks_in_time_while_plans_and_maps_are_computed(
    rig: Path, tmp_path: Path, capsys: Capture
) -> None:
    found = tmp_path / "r.json"
    arguments = ["explore", str(rig), "--touches", "20", "--threshold", "0.001", "--json", str(found)]
    assert main([*arguments, "--record", str(tmp_path / "r.rrd")]) in (0, 3), capsys.readouterr().err
    gaps_ms = json.loads(found.read_text())["supervisor_gaps_ms"]
    idle_ms, period_s, until = [], 0.01, time.monotonic() + 60.0
    due = last = time.monotonic()
    while last < until:
        due = max(due + period_s, last + 0.5 * period_s)
        time.sleep(max(0.0, due - time.monotonic()))
        idle_ms.append(1e3 * (time.monotonic() - last))
        last = time.monotonic()
    with capsys.disabled():
        print(f"\nsupervisor: {gaps_ms}; an idle loop: at most {max(idle_ms):.1f} ms")
    assert gaps_ms["count"] > 10_000
    assert gaps_ms["p99_9"] <= MOST_MS


@pytest.mark.usefixtures("simulated_clock")
def test_a_real_arm_does_not_move_unless_somebody_says_yes(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    count_as_real(monkeypatch)
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\n"))
    moved: list[Any] = []
    monkeypatch.setattr("deformscope.robot.robot.Robot.let_move", lambda robot, preflight: moved.append(preflight))
    assert main(["explore", str(rig), "--touches", "1"]) == 2
    assert "--yes" in capsys.readouterr().err
    assert not moved


@pytest.mark.usefixtures("simulated_clock")
def test_an_arm_that_is_not_calibrated_does_not_move(rig: Path, capsys: Capture, monkeypatch: Patch) -> None:
    rig.write_text(rig.read_text().replace("compliance_m_per_n = 2e-4\ncompliance_sd = 2e-5", ""))
    count_as_real(monkeypatch, calibrated={"[tool] compliance_m_per_n": False, "[camera] T_arm_camera": False})
    assert main(["explore", str(rig), "--touches", "1", "--yes", "--record", "r.rrd"]) == 2
    assert not list(rig.parent.glob("*.rrd"))  # there was nothing to record yet
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
        ("rate_hz = 100", "rate_hz = 0", "rate_hz of 3 or more for tip"),
        ("[tool]\n", '[tool]\ntip = "flat"\n', 'tip = "sphere"'),
        ("-0.30], [0, 1", "-3.0], [0, 1", "within the arm's reach"),
    ],
)
def test_a_rig_that_cannot_explore_is_refused_in_one_line(
    old: str, new: str, words: str, rig: Path, capsys: Capture
) -> None:
    text = rig.read_text()
    assert old in text
    changed = text.replace(old, new)
    if "dsa" in new:
        changed = changed.replace("state_hz = 100\ncommand_deadline_s = 0.5\n", "")
    rig.write_text(changed)
    assert main(["explore", str(rig)]) == 2
    assert words in one_line(capsys)


@pytest.mark.usefixtures("simulated_clock")
@pytest.mark.parametrize(
    ("what", "error", "words"),
    [
        (
            Optoforce,
            SettingsRefused("still readings", "a shaking tip", "hold on"),
            "a shaking tip | try: hold on | device tip",
        ),
        (
            Robot,
            RobotStopped(SafetyDecision(Action.STOP, Fault.ARM_SILENT, "no state")),
            "arm silent: no state | try: see to",
        ),
    ],
)
def test_what_goes_wrong_before_the_checks_is_told_in_one_line(
    what: type, error: Exception, words: str, rig: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    def fail(device: object) -> None:
        raise error

    monkeypatch.setattr(what, "zero" if what is Optoforce else "cycle", fail)
    assert main(["explore", str(rig), "--touches", "1"]) == 2
    assert words in one_line(capsys)


def test_faults_are_for_simulated_scenes(rig: Path, capsys: Capture) -> None:
    assert main(["explore", str(rig), "--fault", "storm@1"]) == 2
    assert "lab:two-60-150" in capsys.readouterr().err


@pytest.mark.usefixtures("simulated_clock")
def test_the_compliance_of_an_arm_is_measured_and_written_into_its_rig_file(rig: Path, tmp_path: Path) -> None:
    before = '"two-60-150"', "compliance_m_per_n = 2e-4\ncompliance_sd = 2e-5"
    rig.write_text(rig.read_text().replace(before[0], '"homogeneous-rigid"').replace(before[1], ""))
    found, recording = tmp_path / "a.json", tmp_path / "a.rrd"
    assert main(["calibrate", "arm", str(rig), "--touches", "1", "--json", str(found), "--record", str(recording)]) == 0
    measured, written = json.loads(found.read_text()), load_rig(rig)
    assert measured["kind"] == "arm"
    assert len(measured["touches"]) == 1
    assert written.tool.compliance_m_per_n == pytest.approx(measured["compliance_m_per_n"], rel=1e-6)
    assert written.tool.compliance_sd == pytest.approx(measured["compliance_sd"], rel=1e-6)
    assert written.calibrated.arm is not None
    assert verify_here(recording) == 0


@pytest.mark.parametrize("at", ["9,9", "-0.1,0.2", "0.3,0.41"])
def test_an_arm_is_not_sent_beside_the_surface(at: str, rig: Path, capsys: Capture) -> None:
    assert main(["calibrate", "arm", str(rig), f"--at={at}", "--yes"]) == 2
    assert "between 0,0 and 0.6,0.4 m" in capsys.readouterr().err


def test_doctor_says_whether_a_rig_can_explore(rig: Path, capsys: Capture) -> None:
    rig.write_text(rig.read_text().replace("two-60-150", "tow-60-150"))
    assert main(["doctor", str(rig), "--seconds", "0.5"]) == 0
    (told,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("look") and "explore" in line]
    assert "try: two-60-150" in told


def test_doctor_lists_what_there_is_to_do_once(rig: Path, capsys: Capture) -> None:
    rig.unlink()
    assert main(["rig", "new", str(rig), "--doubles"]) == 0
    assert main(["doctor", str(rig), "--seconds", "0.1"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("place ") == 1
    assert "lacks" not in shown
    assert "T_arm" not in shown
    assert "(about 1 min)" in shown


def test_doctor_sends_nobody_to_explore_without_a_box(rig: Path, capsys: Capture) -> None:
    """Doubles at the poses of the file, as one has them who tries a force sensor of one's own over simulated foam."""
    rig.unlink()
    assert main(["rig", "new", str(rig), "--doubles"]) == 0
    rig.write_text(re.sub(r"(?m)^hidden = .*\n", "", rig.read_text()))
    for box in ("", "low_m = [-0.34, -0.6, 0.0]\nhigh_m = [0.34, -0.1, 0.3]\n"):
        rig.write_text(re.sub(r"(?m)^(\[workspace\].*\n)", rf"\1{box}", rig.read_text()))
        assert main(["doctor", str(rig), "--seconds", "0.1"]) == 0
        shown = capsys.readouterr().out
        assert ("next: deformscope explore" in shown) == bool(box)
        assert ("Add low_m and high_m" in shown) != bool(box)


def test_the_example_fits_together_once_its_lines_are_uncommented(rig: Path, capsys: Capture) -> None:
    example = (resources.files("deformscope") / "lab" / "rig-example.toml").read_text(encoding="utf-8")
    for name in ("T_arm_surface", "T_arm_camera", "compliance_m_per_n", "compliance_sd", "scene"):
        example = example.replace(f"# {name} =", f"{name} =")
    for driver in ("optoforce", "jaco", "depth_camera"):
        example = example.replace(f'driver = "{driver}"\n', f'driver = "{driver}"\ndouble = true\n')
    told = parse_rig(example, "example.toml")
    setup = setup_of_rig(told)
    low_m, high_m = np.array(told.workspace.low_m), np.array(told.workspace.high_m)
    grid = MapGrid(setup.size_m, 0.05)
    places_m = np.column_stack([grid.centres_m, np.full(len(grid.centres_m), 0.19)])
    in_base_m = np.array([setup.placement.point_in_base_m(place_m) for place_m in places_m])
    assert all(setup.calibrated.values())
    assert ((in_base_m > low_m) & (in_base_m < high_m)).all()
    touching_m = np.column_stack([grid.centres_m, np.full(len(grid.centres_m), 0.06)])
    assert reach(J2N6S300, setup.placement, touching_m[::7]).reached.all()
