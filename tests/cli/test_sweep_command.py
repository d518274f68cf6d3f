"""`deformscope sweep` as a user calls it: each file once, whatever becomes of workers and of the command."""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

import deformscope as ds
import deformscope_drivers
from deformscope.cli import main
from deformscope.cli.common import EXIT_LOSSES
from deformscope.errors import InputError
from deformscope.executor.local import HereWorker
from deformscope.recording.ledger import add_discard, read_discards
from tests.cases import Capture, Patch, one_line, slow
from tests.executor.test_tasks import paths_of_tests
from tests.patience import PATIENCE_S
from tests.test_imports import ROOT

SHIPPED = ROOT / "recordings"
NOBODY = "a Ray cluster that answers" if importlib.util.find_spec("ray") is not None else "pip install"
FIT = ["calibrate", "beta", "--method", "gradient"]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small one: what is swept does not count."""
    from deformscope.stages.msm.solver import Msm  # not in the processes that take their functions from here
    from tests.stages.bodies import pushed

    body = pushed((4, 5), np.random.default_rng(2))
    moved = Msm(body.rest, body.clusters(3), body.held).relax(body.held_position, np.array([0.6])).position[0]
    path = tmp_path_factory.mktemp("pair") / "pair.npz"
    np.savez(path, rest=body.rest, deformed=moved, held=body.held, shape=body.shape, noise_m=1e-4)
    return path


@pytest.fixture(scope="module")
def pairs(pair: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pairs that differ, one of them twice, and a file that is none."""
    folder = tmp_path_factory.mktemp("pairs")
    (folder / "more").mkdir()
    shutil.copy(pair, folder / "p1.npz")
    with np.load(pair) as file:
        arrays = dict(file)
    arrays["deformed"] = arrays["rest"] + 0.9 * (arrays["deformed"] - arrays["rest"])
    np.savez(folder / "p2.npz", **arrays)
    shutil.copy(pair, folder / "more" / "same.npz")
    (folder / "p10.npz").write_text("no pair")
    (folder / "notes.txt").write_text("no source")
    return folder


@pytest.fixture
def here(monkeypatch: Patch) -> Iterator[None]:
    """Tasks are computed in this process, where it is not the worker that counts."""
    threads = cv2.getNumThreads()
    monkeypatch.setattr("deformscope.runs.sweep.open_workers", lambda *_, **__: contextlib.nullcontext(HereWorker()))
    yield
    cv2.setNumThreads(threads)


def sweep(folder: Path, out: Path, *flags: str, command: list[str] = FIT) -> tuple[int, dict[str, Any]]:
    """The exit status, and the JSON."""
    target = out.parent / "found.json"
    status = main(["sweep", str(folder), "--out", str(out), "--json", str(target), *flags, "--", *command])
    return status, json.loads(target.read_text())


@pytest.fixture(scope="module")
def swept(pairs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, dict[str, Any]]:
    out = tmp_path_factory.mktemp("swept") / "out"
    return out, *sweep(pairs, out, "--vary", "cluster-size=2,3", "--workers", "2")


def test_each_file_is_computed_once_in_each_way(swept: tuple[Path, int, dict[str, Any]], pairs: Path) -> None:
    out, status, found = swept
    rows = pq.read_table(out / "results.parquet").to_pylist()
    assert status == EXIT_LOSSES
    assert (found["tasks"], found["done"], found["computed"]) == (8, 6, 6)  # the same content is not computed twice
    names = [Path(row["source"]).name for row in rows]
    assert names == ["p1.npz"] * 2 + ["p2.npz"] * 2 + ["p10.npz"] * 2 + ["same.npz"] * 2
    assert [row["vary.cluster_size"] for row in rows] == [2, 3] * 4
    assert [row["status"] for row in rows] == ["done"] * 4 + ["failed"] * 2 + ["done"] * 2
    assert all("expected a pair file" in one["reason"] for one in found["failed"])
    by = {(Path(row["source"]).name, row["vary.cluster_size"]): row for row in rows}
    assert by["same.npz", 2]["beta"] == by["p1.npz", 2]["beta"]
    assert by["p1.npz", 2]["beta_low"] <= by["p1.npz", 2]["beta"] <= by["p1.npz", 2]["beta_high"]


def test_numbers_are_those_of_the_command_itself(
    swept: tuple[Path, int, dict[str, Any]], pair: Path, tmp_path: Path
) -> None:
    alone = tmp_path / "alone.json"
    assert main([*FIT, str(pair), "--cluster-size", "3", "--viewer", "none", "--json", str(alone)]) == 0
    lines = [json.loads(line) for line in (swept[0] / "tasks.jsonl").read_text().splitlines()]
    (mine,) = [one for one in lines if one["source"].endswith("p1.npz") and one["settings"] == {"cluster_size": 3}]
    expected = json.loads(alone.read_text())
    assert {name: value for name, value in mine["result"].items() if name != "seconds"} == {
        name: value for name, value in expected.items() if name != "seconds"
    }


def test_the_overview_shows_distributions_failures_and_links(swept: tuple[Path, int, dict[str, Any]]) -> None:
    page = (swept[0] / "index.html").read_text()
    assert "6 of 8 tasks are done, 2 failed" in page
    assert "data:image/png;base64," in page
    assert "expected a pair file" in page
    links = re.findall(r'<a href="([^"]+)"', page)
    assert links
    assert all((swept[0] / link).is_file() for link in links)


@pytest.mark.usefixtures("here")
def test_the_same_line_tries_again_what_failed_alone(swept: tuple[Path, int, dict[str, Any]], pairs: Path) -> None:
    status, found = sweep(pairs, swept[0], "--vary", "cluster-size=2,3", "--workers", "1")
    assert (status, found["computed"], found["done"]) == (EXIT_LOSSES, 2, 6)


@pytest.mark.usefixtures("here")
def test_other_settings_are_other_tasks_and_a_moved_file_is_none(
    swept: tuple[Path, int, dict[str, Any]], pair: Path, tmp_path: Path
) -> None:
    shutil.copytree(swept[0], tmp_path / "out")
    shutil.copy(pair, tmp_path / "renamed.npz")
    found = [
        sweep(tmp_path, tmp_path / "out", *flags, "--match", "renamed*", "--workers", "1")[1]["computed"]
        for flags in (["--vary", "cluster-size=2"], ["--vary", "cluster-size=2|3", "--send"], [])
    ]
    assert found == [0, 0, 1]
    assert (
        sweep(tmp_path, tmp_path / "out", "--match", "renamed*", command=[*FIT, "--level", "0.8"])[1]["computed"] == 1
    )


@pytest.mark.usefixtures("here")
def test_files_that_a_killed_worker_left_are_made_anew(pair: Path, tmp_path: Path) -> None:
    shutil.copy(pair, tmp_path / "a.npz")
    out = tmp_path / "out"
    command = [*FIT, "--save", "{key}.npz"]
    assert sweep(tmp_path, out, "--match", "a.npz", command=command)[0] == 0
    (written,) = (out / "files").iterdir()
    assert written.stem == pq.read_table(out / "results.parquet")["key"][0].as_py()
    written.with_suffix(".rrd").write_text("left")
    (out / "tasks.jsonl").write_text("")
    assert sweep(tmp_path, out, "--match", "a.npz", command=command)[0] == 0
    assert list((out / "files").iterdir()) == [written]


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_what_decides_a_result_beside_the_file_makes_another_task(tmp_path: Path, monkeypatch: Patch) -> None:
    """The ledger, with what is discarded, a folder among the options, and the code that computes."""
    about, source = tmp_path / "about", tmp_path / "a.rrd"
    about.mkdir()
    for name in ("", ".ledger"):
        shutil.copy(f"{SHIPPED / 'tension.rrd'}{name}", f"{source}{name}")

    def computed(send: bool = False) -> int:
        return ds.sweep(seen, [source], out=tmp_path / "out", workers=1, send=send, about=str(about)).computed

    assert [computed(), computed()] == [1, 0]
    (about / "words.txt").write_text("first")
    assert [computed(), computed()] == [1, 0]
    add_discard(source, {"reason": "the clamp slipped", "episode": 0, "label": ""})
    assert [computed(send=True), computed()] == [1, 0]
    lines = [json.loads(line)["result"] for line in (tmp_path / "out" / "tasks.jsonl").read_text().splitlines()]
    assert lines == [{"files": 0, "discarded": 0}, {"files": 1, "discarded": 0}, {"files": 1, "discarded": 1}]
    newer = tmp_path / "newer"
    (newer / "__pycache__").mkdir(parents=True)
    (newer / "__init__.py").write_text("")
    monkeypatch.setattr(deformscope_drivers, "__file__", str(newer / "__init__.py"))
    assert [computed(), computed()] == [1, 0]
    (newer / "__pycache__" / "compiled.pyc").write_text("")
    assert computed() == 0


def seen(source: str, *, about: str) -> dict[str, Any]:
    return {"files": len(list(Path(about).iterdir())), "discarded": len(read_discards(Path(source)))}


@pytest.mark.usefixtures("here")
def test_a_command_that_ends_with_a_warning_is_marked(tmp_path: Path) -> None:
    shutil.copy(SHIPPED / "tension.rrd", tmp_path / "a.rrd")
    status, found = sweep(tmp_path, tmp_path / "out", "--workers", "1", command=["verify"])
    (row,) = pq.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    assert (status, found["done"], row["exit_status"]) == (0, 1, EXIT_LOSSES)
    assert "1 of them with an exit status that is not 0" in (tmp_path / "out" / "index.html").read_text()


def test_a_function_in_a_worker_has_one_thread(pair: Path, tmp_path: Path) -> None:
    assert ds.sweep(threads_of, [pair], out=tmp_path, workers=1).table["threads"].to_pylist() == [1]


def threads_of(source: str) -> dict[str, int]:
    return {"threads": cv2.getNumThreads()}


def test_the_documented_line_for_a_cluster_is_taken(tmp_path: Path, monkeypatch: Patch) -> None:
    """With a worker of this process: those of a cluster are looked at in `tests/executor/test_ray.py`."""
    page = (ROOT / "docs" / "howto" / "sweep.md").read_text(encoding="utf-8")
    line = page.split("\ndeformscope sweep /shared/pokes --out runs/beta ")[1].split("\n```")[0].replace("\\\n", "")
    (tmp_path / "p.npz").write_text("no pair")
    asked: list[object] = []

    def opened(*given: object, **_: object) -> contextlib.nullcontext[HereWorker]:
        asked.append(given[:2])
        return contextlib.nullcontext(HereWorker())

    monkeypatch.setattr("deformscope.runs.sweep.open_workers", opened)
    assert main(["sweep", str(tmp_path), "--out", str(tmp_path / "out"), *line.split()]) == EXIT_LOSSES
    assert asked == [("ray", "10.0.0.5:6379")]


@pytest.mark.parametrize(
    ("flags", "command", "words"),
    [
        ([], ["calibrat", "beta"], "a command out of"),
        ([], ["calibrate", "gamma"], "after calibrate"),
        ([], ["demo"], "a command with one SOURCE"),
        ([], ["flow"], "a command with one SOURCE"),
        ([], [*FIT, "--record", "all.rrd"], "a file for each task after --record"),
        ([], [*FIT, "--record", "sub/{key}.rrd"], "a file for each task after --record"),
        ([], [*FIT, "--json", "-"], "without --json"),
        ([], [*FIT, "--cluster-siz", "3"], "--cluster-size"),
        (["--vary", "cluster-size=one"], FIT, "cluster-size"),
        (["--vary", "cluster-size"], FIT, "FLAG=VALUE"),
        (["--match", "*.rrd"], FIT, "recordings, pair files or videos like"),
        (["--executor", "ray"], FIT, "--address"),
        (["--address", "127.0.0.1:1"], FIT, "--executor ray"),
        (["--executor", "ray", "--address", "127.0.0.1:1"], FIT, NOBODY),
    ],
)
def test_what_cannot_be_swept_is_said_in_one_line(
    flags: list[str], command: list[str], words: str, pairs: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["sweep", str(pairs), "--out", str(tmp_path / "out"), *flags, "--", *command]) == 2
    assert words in one_line(capsys)


def test_a_second_sweep_into_the_same_folder_is_refused(pairs: Path, tmp_path: Path) -> None:
    from deformscope.executor.tasks import Journal

    (tmp_path / "out").mkdir()
    with Journal(tmp_path / "out" / "tasks.jsonl", "tasks"), pytest.raises(InputError, match="another command"):
        ds.sweep(ds.calibrate_beta, pairs, out=tmp_path / "out")


TRACES = "DEFORMSCOPE_TEST_TRACES"


def spread(source: str, *, scale: float = 1.0) -> dict[str, float]:
    """Of the numbers in a file; a line is left when it is done, and sometimes the process ends before."""
    folder = Path(os.environ[TRACES])
    values = np.load(source)["values"]
    time.sleep(0.002)
    with (folder / f"{os.getpid()}").open("a") as file:
        file.write(f"{Path(source).name}\n")
    return {"mean": scale * float(values.mean()), "spread": scale * float(values.std())}


def generated(folder: Path, count: int) -> Path:
    folder.mkdir()
    drawn = np.random.default_rng(3)
    for number in range(count):
        np.savez(folder / f"{number}.npz", values=drawn.normal(size=50))
    return folder


SCRIPT = """
import sys
from pathlib import Path
import deformscope as ds
from tests.cli.test_sweep_command import spread
ds.sweep(spread, Path(sys.argv[1]), out=sys.argv[2], workers=2, scale=2.0, progress=False)
"""


@pytest.mark.slow
@pytest.mark.parametrize("count", [80, 1000])
def test_a_sweep_that_is_killed_three_times_computes_each_once(tmp_path: Path, count: int, monkeypatch: Patch) -> None:
    """Killed by -9 three times: each is in the journal once, and equal to what one process computes."""
    folder, out, traces = generated(tmp_path / "in", count), tmp_path / "out", tmp_path / "traces"
    traces.mkdir()
    monkeypatch.setenv(TRACES, str(traces))
    command = [sys.executable, "-c", SCRIPT, str(folder), str(out)]
    journal = out / "tasks.jsonl"
    for kill in range(1, 4):
        with subprocess.Popen(command, env=paths_of_tests()) as running:
            until = time.monotonic() + PATIENCE_S
            while not journal.exists() or len(journal.read_bytes().splitlines()) < kill * count // 4:
                assert running.poll() is None
                assert time.monotonic() < until
                time.sleep(0.005)
            os.kill(running.pid, signal.SIGKILL)
    before = len(journal.read_bytes().splitlines())
    assert subprocess.run(command, env=paths_of_tests(), timeout=PATIENCE_S, check=False).returncode == 0
    assert before < count
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    assert Counter(Counter(line["source"] for line in lines).values()) == {1: count}
    alone = {str(path): spread(str(path), scale=2.0) for path in folder.iterdir()}
    assert {line["source"]: line["result"] for line in lines} == alone
    rows = pq.read_table(out / "results.parquet").to_pylist()
    assert {row["source"]: {"mean": row["mean"], "spread": row["spread"]} for row in rows} == alone


@pytest.mark.usefixtures("here")
def test_a_function_of_the_library_is_swept(pairs: Path, tmp_path: Path) -> None:
    found = ds.sweep(
        ds.calibrate_beta, [pairs / "p1.npz"], out=tmp_path, vary={"cluster_size": [2, 3]}, workers=1, method="gradient"
    )
    assert [row["vary.cluster_size"] for row in found.table.to_pylist()] == [2, 3]
    assert found.failed == []
    assert "2 of 2" in str(found)
    assert found.table["beta"][1].as_py() == ds.calibrate_beta(pairs / "p1.npz", method="gradient").value


def described(source: str, *, about: str) -> dict[str, Any]:
    """With names that the sweep has, too."""
    return {
        "words": Path(about).read_text(),
        "status": "failed",
        "seconds": "long",
        "size": Path(source).stat().st_size,
    }


@pytest.mark.usefixtures("here")
def test_a_file_among_the_options_that_changed_is_read_again(pair: Path, tmp_path: Path) -> None:
    about, source = tmp_path / "about.txt", tmp_path / "a.npz"
    shutil.copy(pair, source)
    for words in ("first", "second"):
        about.write_text(words)
        found = ds.sweep(described, [source], out=tmp_path / "out", workers=1, about=str(about))
        assert found.computed == 1
        assert found.table["words"].to_pylist() == [words]
        assert found.table["status"].to_pylist() == ["done"]
        assert found.table["seconds"][0].as_py() >= 0.0


@pytest.mark.usefixtures("here")
def test_a_file_that_is_gone_or_of_any_name_ends_nothing(pair: Path, tmp_path: Path) -> None:
    about, odd = tmp_path / "about.txt", tmp_path / os.fsdecode(b"\xff.npz")
    about.write_text("words")
    shutil.copy(pair, odd)
    sources = [tmp_path / "none.npz", odd]
    found = ds.sweep(described, sources, out=tmp_path / "out", workers=1, send=True, about=str(about))
    assert found.table["status"].to_pylist() == ["failed", "done"]
    assert found.table["source"].to_pylist()[1].endswith("ff.npz")


def test_a_function_that_workers_would_not_find_is_refused(pair: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a function of a module"):
        ds.sweep(lambda source: 1, [pair], out=tmp_path)


def test_a_ctrl_c_leaves_what_is_done_as_a_table(tmp_path: Path, monkeypatch: Patch) -> None:
    folder, out, traces = generated(tmp_path / "in", 300), tmp_path / "out", tmp_path / "traces"
    traces.mkdir()
    monkeypatch.setenv(TRACES, str(traces))
    command = [sys.executable, "-c", SCRIPT, str(folder), str(out)]
    journal = out / "tasks.jsonl"
    with subprocess.Popen(command, env=paths_of_tests(), stderr=subprocess.PIPE) as running:
        until = time.monotonic() + PATIENCE_S
        while not journal.exists() or len(journal.read_bytes().splitlines()) < 20:
            assert time.monotonic() < until
            time.sleep(0.005)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=PATIENCE_S)
    assert b"KeyboardInterrupt" in said
    kept = len(journal.read_bytes().splitlines())
    assert pq.read_table(out / "results.parquet").num_rows == kept < 300
    assert f"{kept} of {kept} tasks are done" in (out / "index.html").read_text()


@pytest.mark.parametrize("room", [1000, slow(3000)])
def test_a_full_disk_ends_it_in_one_line(room: int, pairs: Path, tmp_path: Path) -> None:
    """By a limit on the size of files, which the system refuses alike."""
    limited = f"import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))\n"
    limited += "from deformscope.cli import main; sys.exit(main(sys.argv[1:]))"
    flags = ["--match", "p1.npz", "--workers", "1", "--out", str(tmp_path / "out"), "--", *FIT]
    command = [sys.executable, "-B", "-c", limited, "sweep", str(pairs), *flags]
    ran = subprocess.run(
        command, env=paths_of_tests(), capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False
    )
    assert ran.returncode == 2
    assert [line for line in ran.stderr.splitlines() if "error" in line] == [ran.stderr.splitlines()[-1]]
    written = r"(tasks\.jsonl|results\.parquet|index\.html)"
    assert re.search(rf"the system refused: .* \| {tmp_path}/out/{written}$", ran.stderr.strip())
