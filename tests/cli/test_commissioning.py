"""From an empty rig file, doctor's list alone leads to an exploration, on doubles that nobody knows the place of."""

import faulthandler
import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.lab.live_lab import LiveLab
from deformscope.lab.randomized_rig import RandomizedRig
from deformscope.rig.rig_edit import Values, edited
from deformscope.rig.rig_file import load_rig
from deformscope.robot.placement import Placement
from deformscope.robot.setup import RigParts
from deformscope.runs.opened_devices import table_of
from deformscope.stages.setup.transform import deviation
from tests.cases import Capture, Patch
from tests.cli.rig_on_a_simulated_clock import use_a_simulated_clock
from tests.verified import verify_here

SCENE, HIDDEN = "two-60-150", 2


def doctors_next(rig: Path, capsys: Capture) -> str:
    capsys.readouterr()
    main(["doctor", str(rig), "--seconds", "0.1", "--json", "-"])
    return str(json.loads(capsys.readouterr().out)["next"])


def check_found(rig: Path, randomized: RandomizedRig) -> None:
    """Every transform inside its interval."""
    made = load_rig(rig)
    truth = randomized.placement
    found = Placement(np.array(made.surface.T_arm_surface), made.tool)
    section = made.calibrated
    camera = truth.T_base_surface @ randomized.T_surface_camera
    assert made.camera.T_arm_camera is not None
    for name, one, other in (
        ("tip", found.T_ee_center, truth.T_ee_center),
        ("place", found.T_base_surface, truth.T_base_surface),
        ("camera", np.array(made.camera.T_arm_camera), camera),
    ):
        off, kept = deviation(one, other), getattr(section, name)
        half = np.array([*kept.half_m, *np.radians(kept.half_deg)])
        # a tip's turn about its own stick is what `calibrate force` finds
        wanted = slice(0, 5) if name == "tip" else slice(None)
        assert (np.abs(off) <= half)[wanted].all(), (name, off, half)
    assert made.tool.R_tip_force is not None
    # the sensor's axes to the arm's end, whichever way the tip's frame is turned about the stick
    ours = found.T_ee_center[:3, :3] @ made.tool.R_tip_force
    theirs = truth.T_ee_center[:3, :3] @ randomized.R_tip_force
    between = ours @ theirs.T
    assert np.linalg.det(between) == pytest.approx(1.0, abs=1e-6)
    turned_deg = np.degrees(np.arccos(np.clip(0.5 * (np.trace(between) - 1.0), -1.0, 1.0)))
    assert turned_deg <= section.force.half_deg[2] + 1.5


def truth_of(randomized: RandomizedRig) -> Values:
    """What the rig file would say if everything were known."""
    truth = randomized.placement
    return {
        "tool": {"T_ee_tip": truth.tool.T_ee_tip or (), "R_tip_force": randomized.R_tip_force.tolist()},
        "surface": {"T_arm_surface": truth.T_base_surface.tolist()},
        "camera": {"T_arm_camera": (truth.T_base_surface @ randomized.T_surface_camera).tolist()},
    }


def test_the_doubles_of_a_new_rig_show_the_board_tilted_enough_for_the_lens(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    """Where the arm reaches, the board leans one way alone: it has to lean more and less."""
    rig = tmp_path / "rig.toml"
    assert main(["rig", "new", str(rig), "--doubles"]) == 0
    table, _ = table_of(RigParts.of(load_rig(rig)))
    assert isinstance(table, LiveLab)
    use_a_simulated_clock(monkeypatch)
    assert main(["calibrate", "camera", str(rig)]) == 0, capsys.readouterr().err
    lens = table.view.intrinsics
    assert load_rig(rig).camera.focal_px == pytest.approx((lens.fx_px, lens.fy_px), rel=0.03)


@pytest.mark.slow
def test_a_load_on_a_scale_gives_the_gain_of_a_sensor_that_nobody_knows(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    faulthandler.cancel_dump_traceback_later()
    rig = tmp_path / "rig.toml"
    assert main(["rig", "new", str(rig), "--doubles"]) == 0
    rig.write_text(rig.read_text().replace("hidden = 1 ", f"hidden = {HIDDEN} "))
    _, randomized = table_of(RigParts.of(load_rig(rig)))
    rig.write_text(edited(rig.read_text(), truth_of(randomized)))
    use_a_simulated_clock(monkeypatch)
    assert main(["calibrate", "force", str(rig), "--weight", "5", "--record", str(tmp_path / "force.rrd")]) == 0
    made = load_rig(rig)
    assert abs(made.tool.force_gain - randomized.force_gain) <= (made.calibrated.force.half_gain or 0.0) < 0.02
    assert abs(randomized.force_gain - 1.0) > 0.001


@pytest.mark.slow
def test_taps_are_found_in_their_recording_again(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """The same frames, but for those before the taps, give the same offset."""
    faulthandler.cancel_dump_traceback_later()
    rig, recording, found = tmp_path / "rig.toml", tmp_path / "taps.rrd", tmp_path / "time.json"
    assert main(["rig", "new", str(rig), "--doubles"]) == 0
    use_a_simulated_clock(monkeypatch)
    offsets = []
    for more in (["--record", str(recording)], ["--measured", str(recording)]):
        assert main(["calibrate", "time", str(rig), "--json", str(found), *more]) == 0
        offsets.append(json.loads(found.read_text()))
        shown = capsys.readouterr()
        assert "arm late" in shown.out
        assert "next: deformscope calibrate tip" in shown.err
    assert offsets[0]["low_s"] - 1e-3 < offsets[1]["offset_s"] < offsets[0]["high_s"] + 1e-3
    assert main(["calibrate", "tip", str(rig), "--measured", str(recording)]) == 2
    assert "ends in .npz" in capsys.readouterr().err


@pytest.mark.slow
def test_doctor_s_list_leads_from_an_empty_file_to_an_exploration(
    tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    faulthandler.cancel_dump_traceback_later()  # on a busy machine it takes longer than what is reported as a hang
    rig = tmp_path / "rig.toml"
    rig.write_text("")
    first = shlex.split(doctors_next(rig, capsys))
    assert first == ["deformscope", "rig", "new", str(rig)]
    assert main([*first[1:], "--doubles"]) == 0
    text = rig.read_text().replace("hidden = 1 ", f"hidden = {HIDDEN} ")
    rig.write_text(text + f'\n[record]\nfolder = "{tmp_path}"\n')
    done = []
    while "explore" not in (following := doctors_next(rig, capsys)):
        arguments = shlex.split(following)
        assert arguments[:2] == ["deformscope", "calibrate"]
        assert arguments[2] not in done, following
        done.append(arguments[2])
        with monkeypatch.context() as simulated:
            use_a_simulated_clock(simulated)
            recording = tmp_path / f"{arguments[2]}.rrd"
            assert main([*arguments[1:], "--record", str(recording)]) == 0
            assert verify_here(recording) == 0
    assert done == ["tip", "place", "camera", "force"]
    _, randomized = table_of(RigParts.of(load_rig(rig)))
    assert randomized is not None
    check_found(rig, randomized)

    with monkeypatch.context() as simulated:
        use_a_simulated_clock(simulated)
        known = tmp_path / "known.toml"
        known.write_text(edited(rig.read_text(), truth_of(randomized)))
        overlaps = []
        for name in (following.split()[-1], str(known)):
            found = tmp_path / "found.json"
            assert main(["explore", name, "--beta-model", "none", "--json", str(found)]) == 0
            overlaps.append(json.loads(found.read_text())["truth"]["iou"])
    with capsys.disabled():
        print(f"\nIoU with what was found {overlaps[0]:.3f}, with what is known {overlaps[1]:.3f}")
    assert overlaps[0] >= overlaps[1] - 0.05
