"""`reproduce squeezes` as a user calls it: what it leaves, and that it goes on where it was cut off."""

import json
from pathlib import Path

import pytest

from deformscope.files.squeeze_dataset import SqueezeDataset
from studies.__main__ import main
from studies.reproduce import squeeze_truth


@pytest.mark.slow
def test_errors_a_data_set_and_a_figure_are_left_and_taken_up_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = [
        "reproduce",
        "squeezes",
        "--trials",
        "1",
        "--jobs",
        "1",
        "--out",
        str(tmp_path),
        "--resume",
        str(tmp_path / "kept.jsonl"),
    ]
    assert main([*arguments, "--json", str(tmp_path / "s.json")]) == 0
    shown = capsys.readouterr().out
    assert "first contact, all frames" in shown
    (entry,) = SqueezeDataset(tmp_path / "squeezes").entries()
    assert entry.container == "box-101"
    (one,) = json.loads((tmp_path / "s.json").read_text())["squeezes"]
    assert one["trial"] == entry.trial
    assert (tmp_path / "squeezes.png").exists()
    monkeypatch.setattr(squeeze_truth, "squeeze_trial", lambda *_: pytest.fail("squeezed again"))
    assert main(arguments) == 0
    assert capsys.readouterr().out == shown
