"""`reproduce table41` as a user calls it: the table, planner beside planner, and what was cut off."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from deformscope.cli import main
from deformscope.executor.journal import Journal
from deformscope.reproduce.table41_runs import RUNS, MapAfter, TableJob, TableRun, add_runs
from deformscope.stages.map.map_score import MapScore
from deformscope.stages.map.plan import Planner
from tests.executor.test_tasks import paths_of_tests
from tests.patience import PATIENCE_S

ONE = ["reproduce", "table41", "--workers", "1"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scenes", "moon"], "a scene"),
        (["--planners", "luck"], "planners out of"),
        (["--seeds", "0"], "1 or more"),
        (["--workers", "0"], "1 or more"),
        (["--closed-form", "--pace", "quick"], "which has no travel"),
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

    assert main(["reproduce", "table41", *arguments]) != 0
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


@pytest.mark.slow
def test_the_table_is_written_and_goes_on_where_it_was_cut_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Slow: the next test goes on from runs that were not computed."""
    arguments = [*ONE, "--scenes", "homogeneous-110", "--touches", "1", "--out", str(tmp_path), "--resume"]
    assert main([*arguments, "--seeds", "1"]) == 0
    assert "homogeneous-110 regions" in capsys.readouterr().out
    assert (tmp_path / "table41.csv").read_text().startswith("scene,planner,touches")
    assert (tmp_path / "table41.png").exists()
    (row,) = json.loads((tmp_path / "table41.json").read_text())["rows"]
    assert row["right"] == 1.0
    assert row["field_rms"] < 0.1
    (first,) = (tmp_path / "runs.jsonl").read_text().splitlines()

    assert main([*arguments, "--seeds", "2"]) == 0
    runs = (tmp_path / "runs.jsonl").read_text().splitlines()
    assert runs[0] == first  # with the seconds that it took then
    assert [json.loads(line)["job"]["seed"] for line in runs] == [0, 1]
    assert "2 layouts a scene" in capsys.readouterr().out


def test_planners_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of runs that an earlier command left: one planner is twice as fast."""

    def run(planner: Planner, seed: int, gain: float) -> TableRun:
        after = []
        for touches in range(1, 11):
            iou = min(gain * touches, 1.0)
            score = MapScore(2, "regions", True, iou, iou, 0.01, True, None, 1.0, 0.1, 0.9)
            place = (0.05 * touches, 0.2)
            one = MapAfter(touches, 0.2 * touches, 8.0 * touches, 0.1, place, 0.0, 0.05, False, 0.0, True, score, {})
            after.append(one)
        return TableRun(TableJob("disc", seed, planner, 10, go_on=True), 2, tuple(after), 3.0, None, 1.0)

    with Journal(tmp_path / "runs.jsonl", *RUNS) as journal:
        for seed in range(2):
            add_runs(journal, [run("regions", seed, 0.2), run("max-variance", seed, 0.1)])
    arguments = ["--scenes", "disc", "--planners", "regions,max-variance", "--seeds", "2", "--touches", "10"]
    assert main([*ONE, *arguments, "--out", str(tmp_path), "--resume"]) == 0

    assert "disc, IoU 0.8: regions / max-variance" in capsys.readouterr().out
    with (tmp_path / "planners.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["iou"] for row in rows] == ["0.8", "0.85", "0.9"]
    assert all(float(row["touches_ratio"]) == pytest.approx(0.53, abs=0.04) for row in rows)


KILLED = """
import sys
from deformscope.cli import main
sys.exit(main(sys.argv[1:]))
"""


def without_times(path: Path) -> list[dict[str, Any]]:
    """The runs in a file, by what was asked, but for what a clock measured."""
    runs = [json.loads(line) for line in path.read_text().splitlines()]
    for one in runs:
        del one["seconds"]
        for after in one["after"]:
            del after["compute_s"]
    return sorted(runs, key=lambda one: (one["job"]["scene"], one["job"]["seed"]))


@pytest.mark.slow
def test_a_command_that_was_killed_goes_on_with_the_same_numbers(tmp_path: Path) -> None:
    """Killed by -9 with its workers at work; then by workers, and all of it in one process."""
    arguments = ["reproduce", "table41", "--closed-form", "--scenes", "disc,two-60-150", "--seeds", "4"]
    arguments += ["--touches", "4", "--viewer", "none"]
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    command = [sys.executable, "-c", KILLED, *arguments, "--workers", "2", "--resume", "--out", str(killed)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=paths_of_tests()
    ) as running:
        until = time.monotonic() + PATIENCE_S
        while not (killed / "runs.jsonl").exists() or (killed / "runs.jsonl").read_bytes().count(b"\n") < 3:
            assert running.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        running.kill()
    kept = (killed / "runs.jsonl").read_text().splitlines(keepends=True)

    assert main([*arguments, "--workers", "2", "--resume", "--out", str(killed)]) == 0
    assert main([*arguments, "--workers", "1", "--out", str(whole)]) == 0
    after = (killed / "runs.jsonl").read_text().splitlines(keepends=True)
    assert 3 <= len(kept) <= len(after) == 8
    assert after[: len(kept) - 1] == kept[:-1]  # with the seconds that they took then
    assert without_times(killed / "runs.jsonl") == without_times(whole / "runs.jsonl")
