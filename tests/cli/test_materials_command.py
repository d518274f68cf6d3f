"""`calibrate axes` and `calibrate yield` as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("tyro")
pytest.importorskip("warp")

from deformscope.cli import main
from deformscope.stages.msm.materials import AxisBeta
from deformscope.stages.msm.solver import Msm
from tests.cli.recorded import assert_shows
from tests.stages.bodies import pushed
from tests.stages.materials.test_plasticity import BETA, pressed


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A pair of betas 0.3 and 0.85 along axes turned by 30 degrees, without noise."""
    body = pushed((5, 6), np.random.default_rng(1))
    turn = np.deg2rad(30.0)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    engine = Msm(body.rest, body.clusters(3), body.held)
    deformed = engine.relax(body.held_position, AxisBeta(np.array([0.3, 0.85]), axes)).position[0]
    path = tmp_path / "pair.npz"
    np.savez(path, rest=body.rest, deformed=deformed, held=body.held, held_noise_m=0.0)
    return path


@pytest.fixture
def press(tmp_path: Path) -> Path:
    motion = pressed((6, 4), 0.07)
    path = tmp_path / "press.npz"
    np.savez(path, rest=motion.rest, motion=motion.position, held=motion.held)
    return path


def run_json(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> Any:
    assert main([*arguments, "--json", "-"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def failure(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) <= 5
    assert "Traceback" not in said
    return said


@pytest.mark.slow  # kernels that nothing else needs; stages/materials proves the numbers
def test_axes_tells_a_beta_for_each(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "r.rrd"
    told = run_json(["calibrate", "axes", str(pair), "--turn-deg", "30", "--record", str(record)], capsys)
    assert_shows(record, says="the axes differ", beside_particles=True)
    assert [each["value"] for each in told["axes"]] == pytest.approx([0.3, 0.85], abs=1e-3)
    assert told["axes"][0]["axis"] == pytest.approx([np.sqrt(0.75), 0.5])
    assert told["anisotropic"]
    assert main(["calibrate", "axes", str(pair), "--turn-deg", "30"]) == 0
    shown = capsys.readouterr().out
    assert "beta along (0.87, 0.5)" in shown
    assert "the axes differ" in shown
    assert "100% of the motion beyond a rigid one" in shown


@pytest.mark.slow  # stages/materials proves the numbers
def test_yield_tells_the_strain_and_draws(press: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "press.png"
    files = ["--picture", str(picture), "--record", str(tmp_path / "r.rrd")]
    told = run_json(["calibrate", "yield", str(press), "--beta", str(BETA), *files], capsys)
    assert_shows(tmp_path / "r.rrd", says="yield strain", beside_particles=True)
    assert told["value"] == pytest.approx(0.07, rel=0.06)
    assert told["interval"][0] < told["value"] < told["interval"][1]
    assert told["beta"] == {"value": BETA, "interval": [BETA, BETA], "given": True}
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_yield_says_where_nothing_yielded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion = pressed((6, 4), 5.0)
    path = tmp_path / "elastic.npz"
    np.savez(path, rest=motion.rest, motion=motion.position, held=motion.held)
    assert main(["calibrate", "yield", str(path), "--beta", str(BETA)]) == 0
    shown = capsys.readouterr().out
    assert "yield strain               above 0." in shown
    assert "unidentified: nothing that yielded is sure" in shown


def test_what_cannot_be_used_is_refused_in_a_line(
    pair: Path, press: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "expected a pair file" in failure(["calibrate", "axes", str(tmp_path / "none.npz")], capsys)
    assert "PAIR.npz" in failure(["calibrate", "axes"], capsys)
    assert "motion in the motion file" in failure(["calibrate", "yield", str(pair)], capsys)
    assert "time between frames" in failure(["calibrate", "yield", str(press), "--creep", "fit"], capsys)
    assert "none, fit or a rate" in failure(["calibrate", "yield", str(press), "--creep", "soon"], capsys)
    assert "--beta of at most" in failure(["calibrate", "yield", str(press), "--beta", "1.5"], capsys)
    assert "ends in .png" in failure(["calibrate", "yield", str(press), "--picture", "a.jpg"], capsys)
