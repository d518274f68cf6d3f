"""Functions of the library that do what a command does: their `to_dict()` is that command's JSON."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.recording.facts import gather_facts
from tests.cases import Capture, Patch

SHIPPED = Path(__file__).resolve().parents[2] / "recordings"


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: Patch) -> Path:
    """Its content is read in this process, as by `tests.verified`."""
    monkeypatch.setattr("deformscope.runs.verification.read_facts", gather_facts)
    for name in ("squeeze.rrd", "squeeze.rrd.ledger"):
        shutil.copy(SHIPPED / name, tmp_path)
    return tmp_path / "squeeze.rrd"


def told(capsys: Capture, *command: object, status: int = 0) -> Any:
    capsys.readouterr()
    assert main([*map(str, command), "--json", "-"]) == status
    return json.loads(capsys.readouterr().out)


def test_verify_says_what_the_command_says(recording: Path, capsys: Capture) -> None:
    found = ds.verify(recording, stages=True, privacy=True)
    assert found.ok
    assert found.error is None
    assert found.to_dict() == told(capsys, "verify", recording, "--stages", "--privacy")
    raw = bytearray(recording.read_bytes())
    raw[len(raw) // 2] ^= 1
    recording.write_bytes(raw)
    flipped = ds.verify(recording)
    assert flipped.ok is False
    assert flipped.error is not None
    assert "a whole recording" in str(flipped.error)
    assert flipped.to_dict() == told(capsys, "verify", recording, status=2)
    with pytest.raises(ds.InputError, match="nothing there"):
        ds.verify(recording.with_name("none.rrd"))


def test_recover_makes_a_whole_recording(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(recording.read_bytes()[: 3 * recording.stat().st_size // 4])
    saved = ds.verify(ds.recover(cut, tmp_path / "saved.rrd").found["recovered"])
    assert saved.ok
    assert "it was recovered" in saved.losses[0]
    with pytest.raises(ds.InputError, match="a new file"):
        ds.recover(cut, tmp_path / "saved.rrd")


def test_export_catalog_report_and_discard_are_the_commands(recording: Path, tmp_path: Path, capsys: Capture) -> None:
    found = ds.export(recording, tmp_path / "a", to="csv", only=("tactile",))
    other = told(capsys, "export", recording, "--to", "csv", "--out", tmp_path / "b", "--only", "tactile")
    assert found.to_dict() | {"folder": other["folder"]} == other
    written = [(tmp_path / "a" / one["file"]).read_bytes() for one in other["files"]]
    assert written == [(tmp_path / "b" / one["file"]).read_bytes() for one in other["files"]]
    ds.discard(recording, "the tip slipped")
    assert [one.reason for one in ds.open_recording(recording).discarded()] == ["the tip slipped"]
    listed = ds.catalog(tmp_path)
    assert listed.table["path"].to_pylist() == ["squeeze.rrd"]
    assert listed.to_dict()["recordings"] == told(capsys, "catalog", tmp_path)["recordings"]
    assert ds.compare_recordings(recording, recording).to_dict() == told(
        capsys, "catalog", "compare", recording, recording
    )
    page = ds.report(recording)
    assert page.page().startswith("<!DOCTYPE html>")
    assert page.to_dict() == {
        key: value
        for key, value in told(capsys, "report", recording, "--out", tmp_path / "r.html").items()
        if key != "report"
    }


def test_what_parameters_are_called_in_python(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="unexpected options: sorted"):
        ds.export(recording, tmp_path / "a", to="csv", sorted=True)
    with pytest.raises(ds.InputError, match="out of csv, parquet"):
        ds.export(recording, tmp_path / "a", to="xls")  # type: ignore[arg-type]


def test_viscous_is_the_command(capsys: Capture) -> None:
    found = ds.calibrate_viscous("sample:press")
    assert found.estimate.verdict == "plastic"
    assert found.to_dict() == told(capsys, "calibrate", "viscous", "sample:press")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "sample"), [("axes", "sample:pair"), ("field", "sample:pair"), ("yield", "sample:press")]
)
def test_calibrations_are_the_commands(name: str, sample: str, capsys: Capture) -> None:
    found = getattr(ds, f"calibrate_{name}")(sample)
    assert found.to_dict() == told(capsys, "calibrate", name, sample)
    assert found.figures()[0].png.startswith(b"\x89PNG")
