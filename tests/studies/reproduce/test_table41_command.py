"""`reproduce table41` as a user calls it: the table, planner beside planner, and what was killed."""

import csv
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from studies.__main__ import main
from studies.map_score import MapScore
from studies.reproduce import table41
from studies.reproduce.table41_runs import MapAfter, TableJob, TableRun
from tests.cases import Capture, Patch, one_line
from tests.executor.test_tasks import paths_of_tests
from tests.patience import PATIENCE_S

ONE = ["reproduce", "table41", "--jobs", "1"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scenes", "moon"], "a scene"),
        (["--planners", "luck"], "planners out of"),
        (["--seeds", "0"], "1 or more"),
        (["--jobs", "0"], "1 or more"),
        (["--closed-form", "--pace", "quick"], "which has no travel"),
    ],
)
def test_what_cannot_be_explored_is_said_in_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "table41", *arguments]) != 0
    assert words in one_line(capsys)


@pytest.mark.slow  # presses finite elements
def test_the_table_is_written(tmp_path: Path, capsys: Capture) -> None:
    arguments = ["--scenes", "homogeneous-110", "--touches", "1", "--out", str(tmp_path), "--seeds", "1"]
    assert main([*ONE, *arguments, "--json", str(tmp_path / "t.json")]) == 0
    assert "homogeneous-110 regions" in capsys.readouterr().out
    assert (tmp_path / "table41.csv").read_text().startswith("scene,planner,touches")
    assert (tmp_path / "table41.png").exists()
    (row,) = json.loads((tmp_path / "t.json").read_text())["rows"]
    assert row["right"] == 1.0
    assert row["field_rms"] < 0.1


def test_planners_are_compared(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """Of runs that are not computed: one planner is twice as fast."""

    def run(job: TableJob) -> TableRun:
        after, gain = [], 0.2 if job.planner == "regions" else 0.1
        for touches in range(1, 11):
            iou = min(gain * touches, 1.0)
            score = MapScore(2, "regions", True, iou, iou, 0.01, True, None, 1.0, 0.1, 0.9)
            place = (0.05 * touches, 0.2)
            one = MapAfter(touches, 0.2 * touches, 8.0 * touches, 0.1, place, 0.0, 0.05, False, 0.0, True, score, {})
            after.append(one)
        return TableRun(job, 2, tuple(after), 3.0, None, 1.0)

    monkeypatch.setattr(table41, "run_table", run)
    arguments = ["--scenes", "disc", "--planners", "regions,max-variance", "--seeds", "2", "--touches", "10"]
    assert main([*ONE, *arguments, "--out", str(tmp_path)]) == 0
    assert "disc, IoU 0.8: regions / max-variance" in capsys.readouterr().out
    with (tmp_path / "planners.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["iou"] for row in rows] == ["0.8", "0.85", "0.9"]
    assert all(float(row["touches_ratio"]) == pytest.approx(0.53, abs=0.04) for row in rows)


def without_times(path: Path) -> list[dict[str, Any]]:
    """The runs in a file, by what was asked, but for what a clock measured."""
    runs = [json.loads(line)[-1] for line in path.read_text().splitlines()]
    for one in runs:
        del one["seconds"]
        for after in one["after"]:
            del after["compute_s"]
    return sorted(runs, key=lambda one: (one["job"]["scene"], one["job"]["seed"]))


@pytest.mark.slow
def test_a_study_that_was_killed_goes_on_with_the_same_numbers(tmp_path: Path) -> None:
    """Killed by -9 with its workers at work; then by workers, and all of it in one process."""
    arguments = ["reproduce", "table41", "--closed-form", "--scenes", "disc,two-60-150", "--seeds", "4"]
    arguments += ["--touches", "4", "--viewer", "none", "--out", str(tmp_path / "out")]
    killed, whole = tmp_path / "killed.jsonl", tmp_path / "whole.jsonl"
    command = [sys.executable, "-m", "studies", *arguments, "--resume", str(killed)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=paths_of_tests()
    ) as running:
        until = time.monotonic() + PATIENCE_S
        while not killed.exists() or killed.read_bytes().count(b"\n") < 3:
            assert running.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        running.kill()
    kept = killed.read_text().splitlines(keepends=True)
    assert main([*arguments, "--resume", str(killed)]) == 0
    assert main([*arguments, "--jobs", "1", "--resume", str(whole)]) == 0
    after = killed.read_text().splitlines(keepends=True)
    assert 3 <= len(kept) <= len(after) == 8
    assert after[: len(kept) - 1] == kept[:-1]  # with the seconds that they took then
    assert without_times(killed) == without_times(whole)
