"""`explore` as a user calls it, through the real drivers on doubles."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope.ledger import check_ledger


def test_a_simulated_table_is_explored_recorded_and_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, told, picture = tmp_path / "e.rrd", tmp_path / "e.json", tmp_path / "e.png"
    arguments = ["explore", "lab:two-60-150", "--touches", "2", "--viewer", "none", "--beta-model", "none"]
    arguments += ["--record", str(record), "--json", str(told), "--picture", str(picture)]

    assert main(arguments) == 0, capsys.readouterr().err
    shown = capsys.readouterr()
    found = json.loads(told.read_text())
    assert found["scenario"] == "lab:two-60-150"
    assert len(found["touches"]) == 2
    assert found["region_count"] == 2
    assert found["stop_reason"] == "budget"
    assert found["truth"]["region_count"] == 2
    assert 0.5 < found["truth"]["iou"] <= 1.0
    assert 2.9 < found["max_force_n"] < 8.0
    assert found["seconds"]["session"] > 10.0
    stiff, soft = (one["apparent_stiffness_n_per_mm"] for one in found["touches"])
    assert stiff > 1.5 * soft
    assert "ok  force sensor: tare" in shown.err
    assert "2 regions" in shown.out
    assert picture.read_bytes().startswith(b"\x89PNG")

    assert check_ledger(record) == []
    assert main(["verify", str(record)]) == 0, capsys.readouterr().err
    assert "tip/frames" in capsys.readouterr().out
    assert main(["replay", str(record)]) == 0
    assert "identical" in capsys.readouterr().err


def test_scenes_are_listed_without_a_rig(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", "--list-scenarios"]) == 0
    shown = capsys.readouterr().out
    assert "lab:two-60-150" in shown
    assert "lab:gradient" in shown


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["explore"], "--list-scenarios"),
        (["explore", "lab:nowhere"], "a scene"),
        (["explore", "lab:disc", "--set-force", "9"], "up to 5 N"),
        (["explore", "lab:disc", "--touches", "0"], "1 or more"),
        (["explore", "rig.toml"], "lab:NAME"),
    ],
)
def test_what_cannot_be_explored_is_said_in_one_line(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)

    assert main(arguments) != 0
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
