"""`record --stage` and the replay of what it computed, as a user runs them, on doubles."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import pytest

from deformscope.cli import main
from deformscope.config.rigs import StageOptions, StageWord
from deformscope.errors import InputError
from deformscope.experiments.live.device_stages import NEEDS, StageName
from deformscope.recording.items import read_stage_results

RIG = """
[devices.pads]
driver = "dsa"
double = true

[devices.camera]
driver = "webcam"
double = true
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def test_what_stages_find_is_recorded_counted_and_found_again(rig: Path, tmp_path: Path) -> None:
    file, told, again = (tmp_path / name for name in ("r.rrd", "r.json", "again.json"))
    command = ["record", str(rig), "--record", str(file), "--overwrite", "--json", str(told)]
    command += ["--stage", "tactile", "--stage", "flow", "--stage", "tactile"]

    stages: dict[str, dict[str, Any]] = {}
    for seconds in ("1.5", "6", "24"):  # until a busy machine has its first flow
        assert main([*command, "--seconds", seconds]) in (0, 3)
        stages = json.loads(told.read_text())["stages"]
        if all(one["results"] for one in stages.values()):
            break
    assert list(stages) == ["tactile", "flow"]
    for name, pending in (("tactile", 0), ("flow", 1)):  # the first image has none before it
        counts = stages[name]
        assert counts["results"] > 0
        assert counts["failures"] == 0
        assert counts["results"] + counts["skipped"] + pending == counts["frames"]
        assert counts["rate_hz"] > 0.0
        assert sum(counts["skipped_by"].values()) == counts["skipped"]
        assert (counts["reasons"], counts["nothing"]) == ({}, "")
        assert 0.0 < counts["lag_ms"]["p50"] <= counts["lag_ms"]["p95"] <= counts["lag_ms"]["max"]
    results = read_stage_results(file)
    assert len(results) == stages["tactile"]["results"] + stages["flow"]["results"]
    flows = [one for one in results if one.stage == "flow"]
    assert all(one.used[-1].device == "camera" for one in flows)
    assert all(flow.used[0].first == before.used[-1].last for before, flow in pairwise(flows))

    assert main(["replay", str(file), "--json", str(again)]) == 0

    found = json.loads(again.read_text())
    assert found["stages"] == {"results": len(results), "different": {"flow": 0.0, "tactile": 0.0}, "failures": []}
    assert found["identical"]


def test_a_rig_without_the_device_is_refused_before_anything_opens(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "r.rrd"
    assert main(["record", str(rig), "--seconds", "1", "--stage", "surface", "--record", str(file)]) == 2
    said = capsys.readouterr().err
    assert "expected a depth device for --stage surface; got none in the rig" in said
    assert "opening" not in said
    assert list(tmp_path.iterdir()) == [rig]


def test_flags_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(InputError, match="--grid or --spacing-px"):
        StageOptions(stage=("beta",), grid=(3, 3), spacing_px=4.0)
    with pytest.raises(InputError, match="WIDTH,HEIGHT with --held contact"):
        StageOptions(stage=("beta",), held=("contact",))
    with pytest.raises(InputError, match="--longest-px"):
        StageOptions(stage=("flow",), longest_px=8)


def test_flags_and_stages_have_the_same_names() -> None:
    asked: tuple[StageWord, ...] = get_args(StageWord)
    assert StageOptions(stage=(*asked, "flow")).names == asked
    assert tuple(NEEDS) == asked == get_args(StageName)
