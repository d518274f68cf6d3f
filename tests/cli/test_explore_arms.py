"""`explore RIG` with arms other than the Jaco: one that a person places, and a KUKA through RSI."""

import faulthandler
import importlib.metadata
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.lab.arms import SimulatedPerson
from deformscope.recording.items import read_items
from deformscope.robot import finger
from deformscope.robot.preflight import FORCE_TURNED
from deformscope_drivers import kuka
from deformscope_drivers.interface import DRIVERS, GROUP
from tests.cases import COMPLIANCE, DEPTH, SURFACE, Capture, Patch, slow
from tests.cli.quick_scene import use_quick_scene
from tests.cli.rig_on_a_simulated_clock import count_as_real, use_a_simulated_clock
from tests.verified import verify_here

ROOT = Path(__file__).parents[2]
PLACED = """
[devices.arm]
driver = "placed"
double = true
start_m = [0.3, 0.2, 0.28]
"""
TIP = """
[devices.tip]
driver = "optoforce"
double = true
bus = "socketcan:can0"
rate_hz = 333
"""
WORKSPACE = """
[workspace]
low_m = [-0.1, -0.4, 0.0]
high_m = [0.9, 0.5, 0.75]
travel_speed_m_s = 0.15
"""
REST = TIP + DEPTH + COMPLIANCE + WORKSPACE + SURFACE
KUKA = """
[devices.arm]
driver = "kuka"
double = true
model = "kr6r900sixx"
"""
PLACES = {
    "kuka": "T_arm_surface = [[0, -1, 0, 0.75], [1, 0, 0, -0.3], [0, 0, 1, 0], [0, 0, 0, 1]]",
    "placed": "T_arm_surface = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
}
SHAPE = f"""
[shape]                                # drawn, and taken out of the picture, as its URDF has it
urdf = "{kuka.__path__[0]}/kr6r900sixx.urdf"
cables = [{{ points_m = [[0.03, 0, 0.02], [0.03, 0, -0.1]], radius_m = 0.01 }}]
"""
RIGS = {"placed": PLACED + REST + PLACES["placed"], "kuka": KUKA + REST + PLACES["kuka"] + SHAPE}


def explored(kind: str, touches: int, tmp_path: Path, capsys: Capture, *more: str) -> dict[str, Any]:
    rig, found = tmp_path / f"{kind}.toml", tmp_path / "found.json"
    rig.write_text(RIGS[kind])
    arguments = ["explore", str(rig), "--touches", str(touches), "--beta-model", "none", "--json", str(found), *more]
    assert main(arguments) == 0, capsys.readouterr().err
    return json.loads(found.read_text())  # type: ignore[no-any-return]


@pytest.mark.parametrize(("kind", "first_m"), [slow("kuka", (0.42, 0.11)), slow("placed", None)])
def test_another_arm_explores_records_and_replays(
    kind: str, first_m: tuple[float, float] | None, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    count_as_real(monkeypatch)
    asked = asked_of_the_person(monkeypatch)
    record = tmp_path / "r.rrd"

    there = [] if first_m is None else ["--first", "{},{}".format(*first_m)]
    found = explored(kind, 1, tmp_path, capsys, "--yes", "--record", str(record), *there)

    shown = capsys.readouterr()
    assert ("keep the emergency stop in your hand" in shown.out + shown.err) == (kind == "kuka")
    assert ("ok  force sensor: finger" in shown.err) == (kind == "kuka")  # nothing else guards it
    assert "Press the tip" not in shown.err  # it was the laboratory's own
    assert {item.device for item in read_items(record) if hasattr(item, "device")} == {"arm", "tip", "depth"}
    (touch,) = found["touches"]
    if first_m is not None:
        np.testing.assert_allclose(touch["xy_m"], first_m, atol=1e-9)
    assert not touch["rigid"]
    assert 0.2 < touch["apparent_stiffness_n_per_mm"] < 3.0
    assert 2.7 < found["max_force_n"] < 3.8
    above = [request for request in asked if request.words.startswith("lift the tip, and place it")]
    assert len(above) == (kind == "placed")
    for request in above:
        np.testing.assert_allclose(request.T_base_ee[:2, 3], touch["xy_m"], atol=1e-9)
    assert all("mm above the table" in request.words for request in asked)
    assert len(asked) in (range(5, 41) if kind == "placed" else [0])
    assert verify_here(record) == 0, capsys.readouterr().err
    assert main(["replay", str(record)]) == 0, capsys.readouterr().err


def asked_of_the_person(monkeypatch: Patch) -> list[Any]:
    """What the simulated person is asked for from now on."""
    asked: list[Any] = []
    ask = SimulatedPerson.ask
    monkeypatch.setattr(SimulatedPerson, "ask", lambda person, request: (asked.append(request), ask(person, request)))
    return asked


@pytest.mark.slow
@pytest.mark.parametrize("kind", RIGS)
def test_another_arm_maps_two_foams(kind: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    use_a_simulated_clock(monkeypatch)
    found = explored(kind, 8, tmp_path, capsys)
    with capsys.disabled():
        print(f"\n{kind}: IoU {found['truth']['iou']:.3f} after {len(found['touches'])} touches")
    assert found["truth"]["iou"] >= 0.9


@pytest.mark.slow  # a second touch; of one the test above says so
def test_each_place_of_the_plan_is_asked_for(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    asked = asked_of_the_person(monkeypatch)
    found = explored("placed", 2, tmp_path, capsys)
    above = [request for request in asked if request.words.startswith("lift the tip, and place it")]
    places = [request.T_base_ee[:2, 3] for request in above]
    np.testing.assert_allclose(places, [touch["xy_m"] for touch in found["touches"]], atol=1e-9)
    assert all("mm above the table" in request.words for request in asked)
    assert 10 < len(asked) < 80


@pytest.mark.slow
def test_a_dry_run_makes_the_motion_of_the_first_touch_in_the_air(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    count_as_real(monkeypatch)
    record = tmp_path / "dry.rrd"
    found = explored("kuka", 8, tmp_path, capsys, "--yes", "--dry-run", "--first", "0.35,0.15", "--record", str(record))
    said = capsys.readouterr().err
    assert found["touches"] == []
    assert found["stop_reason"] == "stopped: dry run"
    assert found["fault"] is None
    assert found["max_force_n"] == 0.0
    assert found["arm_stands"]
    assert "dry run: the first touch, 10 cm above (35, 15) cm, made no contact; the tip stayed 9." in said
    assert verify_here(record) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "more", "words"),
    [
        ("kuka", ["--first", "0.9,0.1"], "--first on the surface: between 0,0 and 0.6,0.4 m"),
        ("placed", ["--dry-run"], "an arm that moves on commands"),
    ],
)
def test_what_makes_no_sense_is_refused(
    kind: str, more: list[str], words: str, tmp_path: Path, capsys: Capture
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIGS[kind])
    assert main(["explore", str(rig), *more]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("presses", [slow(True), False])
def test_a_person_is_asked_to_press_the_tip_of_an_arm_without_joint_torques(
    presses: bool, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    count_as_real(monkeypatch, press=None)
    monkeypatch.setattr(finger, "PATIENCE_S", 4.0)
    tip_force_n = finger._tip_force_n
    periods = itertools.count()
    push_n = np.array([0.0, 0.0, 8.0])
    monkeypatch.setattr(
        finger, "_tip_force_n", lambda robot: tip_force_n(robot) + push_n * (presses and 100 < next(periods) < 200)
    )
    rig = tmp_path / "kuka.toml"
    rig.write_text(RIGS["kuka"])
    status = main(["explore", str(rig), "--touches", "1", "--yes", "--dry-run", "--first", "0.35,0.15"])
    said = capsys.readouterr().err
    assert said.count("Press the tip straight up from below with a finger") == 1
    if presses:
        assert status == 0, said
        assert "Measured 8.0 N, 0 deg from straight up: release." in said
        assert "ok  force sensor: finger" in said
    else:
        assert status == 2
        assert "NO  force sensor: finger" in said
        assert "deformscope calibrate force RIG" in said
        assert "force sensor: finger: nothing" in said


def test_an_arm_without_joint_torques_wants_calibrate_force(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    count_as_real(monkeypatch, calibrated={FORCE_TURNED: False})
    rig = tmp_path / "kuka.toml"
    rig.write_text(RIGS["kuka"])
    assert main(["explore", str(rig), "--touches", "1", "--yes"]) == 2
    said = capsys.readouterr().err
    assert "NO  calibration: [tool] R_tip_force" in said
    assert "calibration: [tool] R_tip_force: deformscope calibrate force RIG" in said
    assert "force sensor: finger" not in said  # first things first


def know_ur(monkeypatch: Patch) -> None:
    """A stranger's arm: Universal Robots' package is known by its entry point alone."""
    monkeypatch.syspath_prepend(str(ROOT / "drivers" / "packages" / "ur"))
    entry = importlib.metadata.EntryPoint("ur", "deformscope_ur:DRIVER", GROUP)
    monkeypatch.setattr(DRIVERS, "_entries", {**DRIVERS._found(), "ur": entry})


@pytest.mark.parametrize(
    ("arm", "fault", "kind"),
    [
        ("ur", "arm-turns", "arm takes no commands"),
        ("kuka", "arm-frozen", "arm frozen"),
        ("jaco", "arm-silent", "arm silent"),
        slow("kuka", "arm-cable", "link lost"),
        slow("kuka", "arm-silent", "arm silent"),
        slow("kuka", "arm-late", "arm silent"),
        slow("ur", "arm-cable", "link lost"),
        slow("ur", "arm-silent", "arm silent"),
        slow("ur", "arm-late", "arm silent"),
        slow("ur", "arm-frozen", "arm frozen"),
        slow("ur", "arm-invalid", "arm's pose not a number"),
        slow("ur", "force-silent", "force sensor silent"),
        slow("ur", "camera-frozen", "depth camera frozen"),
    ],
)
def test_a_fault_of_any_arm_stops_it(
    arm: str, fault: str, kind: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    use_quick_scene(monkeypatch)
    know_ur(monkeypatch)
    found = tmp_path / "found.json"
    given = ["explore", "lab:two-60-150", "--clean", "--touches", "1", "--beta-model", "none", "--viewer", "none"]
    assert main([*given, "--arm", arm, "--fault", f"{fault}@1", "--json", str(found)]) == 2
    assert kind in capsys.readouterr().err
    stopped = json.loads(found.read_text())
    assert stopped["fault"]["kind"] == kind
    # a rate three times as fast is seen from the first motion on
    assert 0.0 < stopped["fault"]["noticed_after_s"] < (2.0 if fault == "arm-turns" else 0.2)
    assert stopped["max_force_n"] < 8.0


def test_a_fault_that_stops_nothing_is_said(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """Motor currents show a collision only some time after the motion has changed; here it comes earlier."""
    use_quick_scene(monkeypatch)
    given = ["explore", "lab:two-60-150", "--clean", "--touches", "1", "--beta-model", "none", "--viewer", "none"]
    assert main([*given, "--arm", "kuka", "--fault", "collision@1", "--json", str(tmp_path / "found.json")]) == 0
    assert "--fault collision@1 was injected, and stopped nothing" in capsys.readouterr().err


@pytest.mark.slow
def test_every_arm_of_the_laboratory_finds_the_same_foam(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    faulthandler.cancel_dump_traceback_later()
    use_quick_scene(monkeypatch)
    know_ur(monkeypatch)
    made: dict[str, Any] = {}
    for arm in ("", "jaco", "kuka", "ur"):
        found = tmp_path / f"{arm}.json"
        given = ["explore", "lab:two-60-150", "--clean", "--touches", "2", "--beta-model", "none", "--viewer", "none"]
        assert main([*given, *(["--arm", arm] if arm else []), "--json", str(found)]) == 0, capsys.readouterr().err
        made[arm] = json.loads(found.read_text())
    usual = made.pop("")
    for one in made.values():
        assert [touch["xy_m"] for touch in one["touches"]] == [touch["xy_m"] for touch in usual["touches"]]
        for touch, other in zip(one["touches"], usual["touches"], strict=True):
            assert touch["peak_force_n"] == pytest.approx(other["peak_force_n"], abs=0.3)
        assert one["max_force_n"] == pytest.approx(usual["max_force_n"], abs=0.3)
        assert one["truth"]["iou"] == pytest.approx(usual["truth"]["iou"], abs=0.03)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--arm", "franka"], "--arm jaco, kuka"),
        (["--arm", "placed"], "--arm jaco, kuka"),
        (["--arm", "kuka", "--fault", "arm-turns@1"], "arm-cable, arm-silent, arm-frozen, arm-late, collision"),
        (["--arm", "kuka", "--robot", "gripper"], "without --robot"),
    ],
)
def test_an_arm_that_the_laboratory_cannot_have_is_named(given: list[str], expected: str, capsys: Capture) -> None:
    assert main(["explore", "lab:two-60-150", "--touches", "1", "--viewer", "none", *given]) == 2
    assert expected in capsys.readouterr().err
