"""A UR's own force in place of a force sensor: learned in free air, written into the rig file, explored with."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deformscope_ur import DRIVER, UrConfig, UrDouble

from deformscope.cli import main
from deformscope.rig.rig_file import load_rig
from deformscope_drivers.arm.kinematics import jacobian_of, least_singular
from deformscope_drivers.interface import DRIVERS
from tests.cases import AHEAD, COMPLIANCE, DEPTH, Capture, Patch
from tests.cli.quick_scene import use_quick_scene
from tests.cli.rig_on_a_simulated_clock import use_a_simulated_clock

ARM = """
[devices.arm]
driver = "ur"
double = true
linear_limit_m_s = 0.1
[devices.own]
driver = "arm"
"""
RIG = ARM + DEPTH + COMPLIANCE + AHEAD


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.setitem(DRIVERS._loaded, "ur", dataclasses.replace(DRIVER, name="ur"))
    monkeypatch.setitem(DRIVERS._found(), "ur", None)  # type: ignore[arg-type]
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    path = tmp_path / "ur.toml"
    path.write_text(RIG)
    return path


def explored(rig: Path, *more: str) -> list[str]:
    return ["explore", str(rig), "--touches", "1", "--beta-model", "none", "--viewer", "none", *more]


def test_it_does_not_move_before_its_own_force_is_calibrated(rig: Path, capsys: Capture) -> None:
    assert main(explored(rig)) == 2
    err = capsys.readouterr().err
    assert "calibration: [tool] force_off_n: missing" in err


@pytest.mark.slow  # two minutes of an arm in free air
def test_a_rig_without_a_force_sensor_explores_and_replays(rig: Path, tmp_path: Path, capsys: Capture) -> None:
    found, record = tmp_path / "found.json", tmp_path / "r.rrd"
    flags = ["--viewer", "none", "--json", str(found), "--record", str(tmp_path / "w.rrd")]
    assert main(["calibrate", "wrench", str(rig), *flags]) == 0, capsys.readouterr().err
    assert main(["replay", str(tmp_path / "w.rrd")]) == 0
    assert "the worth of the arm's own force computed again from its states, identical" in capsys.readouterr().err
    worth: dict[str, Any] = json.loads(found.read_text())
    assert 0.05 < worth["force_off_n"] < 0.3 < worth["raw_off_n"], "friction and bias are of half a newton and more"
    read = load_rig(rig)
    assert read.tool.force_off_n == pytest.approx(worth["force_off_n"], rel=1e-6)
    assert "wrench" in read.calibrated.ages()
    assert load_rig(rig).devices[1].config.least_singular > 0.05

    weak = f"{0.9 * worth['resolved_n']:.2f}"
    capsys.readouterr()
    assert main(explored(rig, "--set-force", weak)) == 2
    err = capsys.readouterr().err
    assert f"expected a set force of {worth['resolved_n']:.2f} N or more, for the arm's own force; got {weak} N" in err
    assert len(err.splitlines()) == 1

    assert main(explored(rig, "--record", str(record), "--json", str(found))) == 0, capsys.readouterr().err
    made = json.loads(found.read_text())
    (touch,) = made["touches"]
    low, high = touch["apparent_stiffness_interval"]
    least = 2.0 * 1.645 * worth["force_off_n"] / 3.0
    assert np.log(high / low) > least, "the error of the force is in the interval"
    assert 2.4 < made["max_force_n"] < 5.6
    assert main(["replay", str(record)]) == 0, capsys.readouterr().err


def test_a_cb3_reports_zero_near_a_singularity_without_saying_so() -> None:
    double = UrDouble(UrConfig(model="ur5"), start_deg=(0.0, -90.0, -90.0, -90.0, 0.5, 0.0))
    assert least_singular(jacobian_of(double.T_base_links)) < 0.03
    assert not np.any(double._force())
