"""What a call of the library writes: to whom it was given, where somebody watches stderr, and to nobody else."""

import io
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pytest

import deformscope as ds
from deformscope import terminal
from deformscope.stages.msm import quiet
from deformscope.stages.msm.quiet import GREETING, quiet_warp
from tests.cases import Capture, Patch, slow, slow_but
from tests.cli.fake_bench import use_fake_bench
from tests.experiments.toy_squeeze import use_toy_squeeze
from tests.patience import PATIENCE_S

Call = Callable[..., Any]
REST = np.stack(np.meshgrid(np.arange(5.0), np.arange(7.0), indexing="ij"), -1).reshape(-1, 2) * 0.01


def fit(**given: Any) -> object:
    pair = {"rest": REST, "deformed": REST * [1.05, 1.0], "held": np.r_[:7, 28:35]}
    return ds.calibrate_beta(pair, candidates=5, **given)


def classified(**given: Any) -> object:
    label = np.repeat(["empty", "rice"], 12)
    tactile = np.random.default_rng(0).normal(size=(24, 3)) + (label == "rice")[:, None]
    return ds.classify({"label": label, "tactile": tactile}, splits=4, curve_splits=0, **given)


def recorded(tmp_path: Path, **given: Any) -> object:
    return ds.record("lab:bench", tmp_path / "r.rrd", seconds=0.2, **given)


COMMANDS = ["explore", "squeeze", "record", "calibrate", "classify"]
quick = pytest.mark.parametrize("call", slow_but(["explore", "calibrate", "classify"], COMMANDS), indirect=True)


@pytest.fixture(params=COMMANDS)
def call(request: pytest.FixtureRequest, monkeypatch: Patch, tmp_path: Path) -> Call:
    match request.param:
        case "explore":
            use_fake_bench(monkeypatch)
            return lambda **given: ds.explore("lab:two-60-150", touches=2, **given)
        case "squeeze":
            use_toy_squeeze(monkeypatch)
            return lambda **given: ds.squeeze("lab:containers", content="rice", record=tmp_path / "s.rrd", **given)
        case "record":
            return lambda **given: recorded(tmp_path, **given)
        case "calibrate":
            return fit
        case _:
            return classified


@contextmanager
def another_thread() -> Iterator[Callable[[], None]]:
    """A thread that writes a line to stderr whenever it is asked, and has written it when the asking returns."""
    asked: Queue[int | None] = Queue()
    written: Queue[int] = Queue()

    def write() -> None:
        while (number := asked.get()) is not None:
            print(f"line {number} of another thread", file=sys.stderr, flush=True)
            written.put(number)

    count = 0

    def ask() -> None:
        nonlocal count
        asked.put(count)
        assert written.get(timeout=PATIENCE_S) == count
        count += 1

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield ask
    finally:
        asked.put(None)
        thread.join()


@quick
def test_what_another_thread_writes_meanwhile_arrives(call: Call, capsys: Capture) -> None:
    heard: list[object] = []
    with another_thread() as ask:

        def progress(*said: object) -> None:
            heard.append(said)
            ask()

        call(progress=progress)
    out, err = capsys.readouterr()
    assert out == ""
    assert heard
    assert err.splitlines() == [f"line {number} of another thread" for number in range(len(heard))]


def test_nothing_is_written_where_nobody_watches(call: Call, capfd: Capture) -> None:
    call()
    assert capfd.readouterr() == ("", "")


class Terminal(io.StringIO):
    """What a process writes to a terminal, from all of its threads."""

    def isatty(self) -> bool:
        return True


@quick
def test_progress_is_shown_at_a_terminal(call: Call, monkeypatch: Patch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    call()
    assert sys.stderr.getvalue()  # type: ignore[attr-defined]


@quick
@pytest.mark.parametrize("progress", [False, slow(lambda *said: None)])
def test_nothing_is_written_to_a_terminal_where_it_is_not_wanted(
    call: Call, progress: object, monkeypatch: Patch
) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    call(progress=progress)
    assert sys.stderr.getvalue() == ""  # type: ignore[attr-defined]


def test_a_notebook_is_watched(monkeypatch: Patch) -> None:
    stream = type("OutStream", (), {"__module__": "ipykernel.iostream", "isatty": lambda self: False})()
    assert not terminal.is_watched()
    monkeypatch.setattr(sys, "stderr", stream)
    assert terminal.is_watched()


def test_only_the_greeting_of_warp_is_left_out(capfd: Capture, monkeypatch: Patch) -> None:
    """It is written below Python, where one thread's stderr is every thread's: at warp's start, and never again."""
    warp = pytest.importorskip("warp")
    monkeypatch.setattr(quiet, "_started", False)
    monkeypatch.setattr(warp, "init", lambda: os.write(2, b"before\n" + GREETING + b": no driver\nafter\n"))
    quiet_warp()
    assert capfd.readouterr().err == "before\nafter\n"
    with monkeypatch.context() as patched:
        patched.setattr(os, "dup2", lambda *descriptors: pytest.fail("stderr was redirected again"))
        quiet_warp()


def test_the_library_redirects_no_stream_of_the_process() -> None:
    """`contextlib.redirect_stderr` does so for all threads; a command may, before it begins (`deformscope.cli`)."""
    code = {path: path.read_text() for path in Path(ds.__file__).parent.rglob("*.py") if path.parent.name != "cli"}
    assert [path for path, text in code.items() if "redirect_std" in text] == []
