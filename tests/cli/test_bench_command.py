"""`deformscope bench`: no figure is asserted here, only that it measures what it says, and tells all of it."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from deformscope.bench import report
from deformscope.bench.plan import BenchPlan, Note
from deformscope.bench.timing import Contestant, Timing, TimingRow, compare
from deformscope.cli import EXIT_INPUT, EXIT_INTERRUPTED, main
from tests.cases import Capture, Patch

SHORT = ["bench", "--quick", "--device", "cpu", "--sizes", "64", "--repeats", "3"]
TOP = {"format", "complete", "machine", "settings", "rows"}
OF_ROWS = {
    *("case", "what", "who", "unit", "median", "iqr", "repeats", "samples"),
    *("costs", "beside", "facts", "note", "doubt"),
}


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow  # three rounds
def test_a_table_and_all_of_it_as_json(capsys: Capture) -> None:
    assert main([*SHORT, "--only", "step", "--json", "bench.json"]) == 0
    out, err = capsys.readouterr()
    told = json.loads(Path("bench.json").read_text(encoding="utf-8"))
    assert told.keys() == TOP
    assert told["complete"] is True
    assert {"cpu", "cores", "load", "device", "gpu", "warp", "numpy", "deformscope", "date"} <= told["machine"].keys()
    assert told["settings"]["sizes"] == [64]
    assert all(row.keys() == OF_ROWS for row in told["rows"])
    (ours,) = told["rows"]
    assert (ours["case"], ours["who"]) == ("step", "deformscope")
    assert (ours["repeats"], len(ours["samples"]), ours["costs"]) == (3, 3, None)
    assert "ms/step" in out
    assert "64 particles, clusters of 3^3" in out
    assert "step: 64 particles" in err


@pytest.mark.slow
@pytest.mark.parametrize("case", ["call", "relax"])
def test_every_case_gives_rows(case: str) -> None:
    assert main([*SHORT, "--repeats", "1", "--only", case, "--json", "bench.json"]) == 0
    rows = json.loads(Path("bench.json").read_text(encoding="utf-8"))["rows"]
    assert {row["case"] for row in rows} == {case}
    assert all(row["facts"]["converged"] == row["facts"]["candidates"] for row in rows if case == "relax")
    assert all(row["repeats"] == 1 and row["median"] > 0 for row in rows)


def rows_as_measured(monkeypatch: Patch, *samples: float) -> None:
    def measured(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
        yield TimingRow("step", "64 particles", "deformscope", "ms/step", samples)

    monkeypatch.setattr(report, "MEASURES", ((frozenset({"step"}), measured),))


def told_rows() -> list[dict[str, object]]:
    return list(json.loads(Path("bench.json").read_text(encoding="utf-8"))["rows"])


def test_json_has_stdout_to_itself(monkeypatch: Patch, capsys: Capture) -> None:
    rows_as_measured(monkeypatch, 2.0)
    assert main([*SHORT, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told.keys() == TOP
    assert all(row.keys() == OF_ROWS for row in told["rows"])


def test_samples_that_disagree_are_said(monkeypatch: Patch, capsys: Capture) -> None:
    rows_as_measured(monkeypatch, 1.0, 2.0, 3.0)
    assert main([*SHORT, "--json", "bench.json"]) == 0
    assert told_rows()[0]["doubt"] == "samples spread by 50%"
    assert "spread by 50%" in " ".join(capsys.readouterr().out.split())


def test_a_time_that_no_clock_gives_fails(monkeypatch: Patch, capsys: Capture) -> None:
    rows_as_measured(monkeypatch, 1.0, -0.04, 1.0)
    assert main([*SHORT, "--json", "bench.json"]) == EXIT_INPUT
    assert str(told_rows()[0]["doubt"]).startswith("FAILED")
    assert "-0.04 ms/step" in capsys.readouterr().err


def test_contestants_take_turns_and_are_compared_within_rounds() -> None:
    ran: list[str] = []

    def runs(name: str, seconds: list[float]) -> Contestant:
        def run() -> Timing:
            ran.append(name)
            return Timing(seconds[ran.count(name) - 1], 0.0)

        return Contestant("a step", name, run, "ms/step")

    ours = runs("ours", [9.0, 1.0, 2.0, 4.0])
    theirs = runs("theirs", [9.0, 3.0, 8.0, 8.0])
    first, second = compare(
        "step", [ours, Contestant("a step", "theirs", theirs.run, "steps/s", 2.0, beside=ours)], lambda seconds: 3
    )
    assert ran == ["ours", "theirs"] * 4
    assert first.samples == (1000.0, 2000.0, 4000.0)
    assert (first.median, first.spread, first.costs) == (2000.0, 1500.0, None)
    assert second.samples == (2 / 3, 2 / 8, 2 / 8)
    assert second.costs == 1.5  # the middle one of 3/1, 8/2 and 8/4, for two steps instead of one


def test_what_was_measured_is_kept_when_it_is_interrupted(monkeypatch: Patch, capsys: Capture) -> None:
    def interrupted(plan: BenchPlan, note: Note) -> Iterator[TimingRow]:
        yield TimingRow("step", "64 particles", "deformscope", "ms/step", (1.5,))
        raise KeyboardInterrupt

    monkeypatch.setattr(report, "MEASURES", ((frozenset({"step"}), interrupted),))
    assert main([*SHORT, "--json", "bench.json"]) == EXIT_INTERRUPTED
    out, err = capsys.readouterr()
    told = json.loads(Path("bench.json").read_text(encoding="utf-8"))
    assert told["complete"] is False
    assert [row["samples"] for row in told["rows"]] == [[1.5]]
    assert "64 particles" in out
    assert "rows are missing" in out
    assert "interrupted" in err


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (["--sizes", "1000,1001"], "1001"),
        (["--sizes", "27"], "cubes of 4 or more"),
        (["--only", "step,walk"], "'walk'"),
        (["--only", "fit"], "step, call, relax"),
        (["--repeats", "0"], "1 or more"),
    ],
)
def test_what_cannot_be_measured_is_refused(args: list[str], told: str, capsys: Capture) -> None:
    assert main(["bench", *args]) == EXIT_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line


def test_a_gpu_that_is_not_there_is_said() -> None:
    wp = pytest.importorskip("warp")
    if wp.is_cuda_available():
        pytest.skip("warp finds a CUDA device")
    assert main(["bench", "--device", "cuda"]) == EXIT_INPUT
