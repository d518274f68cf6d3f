"""A viewer that is frozen, killed or slow costs the picture alone, what it lacks is counted, and its server goes."""

import contextlib
import gc
import json
import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
import urllib.request
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.page.server.page_server import end_pages, running_pages
from deformscope.recording import live
from deformscope.recording.live import LiveFeed, Viewer, check_answers, start_viewer, wait_for_viewer
from deformscope.recording.reader import Replay
from deformscope.recording.recorder import Recorder
from tests.cases import Capture, Patch
from tests.second_user import taking_ports

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
"""How long anything is waited for that has to come: a limit against a test that hangs, no measure of speed."""


def until(happened: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.005)


class Stream:
    """A live stream. state: of its viewer: `well`, `frozen` or `gone`"""

    def __init__(self, state: str = "well") -> None:
        self.state = state
        self.shown: list[int] = []
        self.flushes = 0
        self.ended = False

    def flush(self, *, timeout_sec: float) -> None:
        self.flushes += 1
        if self.state == "frozen":
            time.sleep(0.001)
            raise TimeoutError
        if self.state == "gone":
            raise ConnectionError("severed")

    def disconnect(self) -> None:
        self.ended = True


def feed_of(stream: Stream, **options: float) -> LiveFeed[Stream]:
    feed: LiveFeed[Stream] = LiveFeed(lambda give_up: stream, period_s=0.001, **options)  # type: ignore[arg-type]
    feed.start()
    return feed


def show(feed: LiveFeed[Stream], number: int) -> None:
    feed.put(lambda stream: stream.shown.append(number), 1)


@pytest.mark.parametrize("state", ["frozen", "gone"])
def test_what_a_viewer_never_confirmed_is_counted(state: str, caplog: pytest.LogCaptureFixture) -> None:
    stream = Stream()
    feed = feed_of(stream)
    for number in range(3):
        show(feed, number)
    until(lambda: stream.shown == [0, 1, 2] and feed._unconfirmed == 0)
    stream.state = state
    show(feed, 3)  # handed over, and never confirmed
    until(lambda: len(stream.shown) == 4 and (feed._silent or feed._left.is_set()))
    for number in range(4, 10):
        show(feed, number)
    assert not feed.close(PATIENCE_S)
    assert feed.dropped == 7
    show(feed, 10)
    assert feed.dropped == 8
    assert "7 of 10 portions" in caplog.text
    assert not stream.ended


def test_a_viewer_that_does_not_answer_is_not_waited_for() -> None:
    feed = feed_of(Stream("frozen"))
    show(feed, 0)
    until(lambda: feed._silent)
    waited: list[float | None] = []
    feed._over.wait = lambda timeout=None: bool(waited.append(timeout))  # type: ignore[method-assign]
    assert not feed.close(PATIENCE_S)
    assert waited == [0.0]


def test_a_stream_that_hangs_is_never_let_go_of() -> None:
    """Dropping it waits for the viewer, for ever where that is frozen."""
    stream = Stream("frozen")
    kept = weakref.ref(stream)
    feed = feed_of(stream)
    show(feed, 0)
    for _ in range(1000):
        if feed._silent:
            break
        time.sleep(0.01)
    feed.close(0.1)
    assert feed._over.wait(PATIENCE_S)
    del stream, feed
    gc.collect()
    assert kept() is not None
    well = Stream()
    kept = weakref.ref(well)
    feed = feed_of(well)
    assert feed.close(PATIENCE_S)
    feed._thread.join()
    del well, feed
    gc.collect()
    assert kept() is None


def test_a_job_that_blocks_is_left_behind() -> None:
    free, stream = threading.Event(), Stream()
    feed = feed_of(stream)
    feed.put(lambda stream: free.wait(PATIENCE_S) and None, 1)
    until(lambda: not feed._jobs)
    show(feed, 1)
    assert not feed.close(0.05)
    assert feed.dropped == 2
    free.set()


def test_a_viewer_that_answers_again_goes_on() -> None:
    stream = Stream("frozen")
    feed = feed_of(stream)
    show(feed, 0)
    until(lambda: stream.flushes > 2)
    show(feed, 1)
    stream.state = "well"
    until(lambda: stream.shown == [0, 1])
    assert feed.close(PATIENCE_S)
    assert (feed.dropped, stream.ended) == (0, True)


def test_what_others_rest_on_is_dropped_last() -> None:
    stream = Stream("frozen")
    feed = feed_of(stream, capacity_jobs=3)
    show(feed, -1)
    until(lambda: feed._silent)
    for number in range(2):
        feed.put(lambda stream, number=number: stream.shown.append(number), 1, lasting=True)  # type: ignore[misc]
    for number in range(10, 14):
        show(feed, number)
    stream.state = "well"
    assert feed.close(PATIENCE_S) or feed._over.wait(PATIENCE_S)
    assert [number for number in stream.shown if number >= 0] in ([0, 1, 13], [])
    assert feed.dropped in (3, 7)


def test_jobs_of_one_period_are_confirmed_together() -> None:
    stream = Stream()
    feed: LiveFeed[Stream] = LiveFeed(lambda give_up: stream, period_s=PATIENCE_S)
    feed.start()
    show(feed, 0)
    until(lambda: stream.flushes == 1)
    for number in range(1, 100):
        show(feed, number)
    assert feed.close(PATIENCE_S)
    assert stream.shown == list(range(100))
    assert stream.flushes == 2


@contextlib.contextmanager
def server(answer: bytes | None) -> Iterator[Viewer]:
    """Something on a port. answer: to whatever it is asked; None = it accepts and says nothing, as a stopped process"""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()

        def serve() -> None:
            with contextlib.suppress(OSError):
                connection, _ = listening.accept()
                with connection:
                    connection.recv(1000)
                    connection.sendall(answer or b"")

        if answer is not None:
            threading.Thread(target=serve, daemon=True).start()
        said = os.memfd_create("said")
        os.write(said, f"rerun+http://127.0.0.1:{listening.getsockname()[1]}/proxy".encode())
        yield Viewer(0, said)


def test_whether_a_viewer_answers() -> None:
    with server(b"HTTP/1.1 400 Bad Request\r\n\r\n") as viewer:
        check_answers(viewer, PATIENCE_S)
    with server(None) as viewer, pytest.raises(TimeoutError):
        check_answers(viewer, 0.05)
    with server(b"") as viewer, pytest.raises(ConnectionError):
        check_answers(viewer, PATIENCE_S)
    with pytest.raises(ConnectionError):
        check_answers(viewer, PATIENCE_S)  # nobody listens there any more


def program(folder: Path, script: str) -> Path:
    path = folder / "viewer"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return path


SERVING = """
    import sys, time
    from deformscope import cli
    from deformscope.errors import InputError
    from deformscope.page.server.page_server import PageServer
    def command(args):
        page = PageServer("bench")
        page.open()
        print(page.address, flush=True)
        raise InputError("more", "less")
    cli._dispatch = command
    status = cli.main([])
    print("left", flush=True)
    sys.exit(status)
"""


def serve_command(**options: int) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "drivers")])}
    command = [sys.executable, "-c", textwrap.dedent(SERVING)]
    return subprocess.Popen(command, env=environment, text=True, **{"stdout": subprocess.PIPE, **options})  # type: ignore[call-overload,no-any-return]


def test_a_page_ends_with_the_command() -> None:
    process = serve_command(stdin=subprocess.DEVNULL)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert said.splitlines()[1] == "left"


def test_at_a_terminal_a_page_stays_until_ctrl_c() -> None:
    ours, theirs = pty.openpty()
    process = serve_command(stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    try:
        said = ""

        def hears(words: str) -> bool:
            nonlocal said
            if select.select([ours], [], [], 0.1)[0]:
                said += os.read(ours, 10_000).decode()
            return words in said

        until(lambda: hears("stays open until Ctrl-C: http://127.0.0.1:"))
        assert said.index("expected more") < said.index("stays open until Ctrl-C")  # what came of it is said first
        with urllib.request.urlopen(said.split()[0], timeout=PATIENCE_S) as answer:
            assert b"deformscope" in answer.read()
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        until(lambda: hears("left"))
        assert process.wait(PATIENCE_S) == 2
    finally:
        os.close(ours)
        process.kill()
        process.wait()


def test_why_a_viewer_ended_is_said(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setattr(live, "viewer_executable", lambda: program(tmp_path, "echo no port is free >&2; exit 1"))
    monkeypatch.setenv("DISPLAY", ":0")
    with pytest.raises(ConnectionError, match="no port is free"):
        wait_for_viewer(start_viewer(), threading.Event())


@pytest.mark.parametrize(
    "command",
    [["calibrate", "theta", "PAIR", "PAIR", "--json", "-"], ["record", "lab:bench", "--seconds", ".1", "--json", "-"]],
)
def test_a_command_prints_the_address(tmp_path: Path, capsys: Capture, command: list[str], monkeypatch: Patch) -> None:
    from tests.log import synthetic

    pair = tmp_path / "pair.npz"
    seen = synthetic.pair_in_plane()
    np.savez(pair, rest=seen.rest, deformed=seen.observed, held=seen.held)
    monkeypatch.chdir(tmp_path)
    assert main([str(pair) if word == "PAIR" else word for word in command] + ["--viewer", "page"]) in (0, 3)
    out, err = capsys.readouterr()
    assert re.search(
        r"^viewer: http://127\.0\.0\.1:\d+/[\w-]{32}/ \(open it in a browser on this machine\)$", err, re.M
    )
    assert running_pages() == []
    assert isinstance(json.loads(out), dict | list)


def listeners(pid: int) -> set[int]:
    """Ports on which a process listens for TCP."""
    own = {str(handle.readlink()) for handle in Path(f"/proc/{pid}/fd").iterdir()}
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {int(line[1].split(":")[1], 16) for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in own}


def test_another_user_gets_no_data_for_a_window(monkeypatch: Patch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(live, "window_options", lambda: ["--serve-grpc"])  # a window without a window
    with taking_ports() as taken:
        for _ in range(10):
            viewer = start_viewer()
            try:
                wait_for_viewer(viewer, threading.Event())
                assert int(viewer.url.split(":")[-1].split("/")[0]) in listeners(viewer.pid)
            finally:
                os.kill(viewer.pid, signal.SIGKILL)
                os.waitpid(viewer.pid, 0)
        assert taken() == []


def test_no_data_follows_for_a_window_that_ended_as_it_opened(tmp_path: Path, monkeypatch: Patch) -> None:
    """Its port is free again, and whoever takes it then is connected to."""
    ended, got, taking = tmp_path / "ended", list[bytes](), list[socket.socket]()
    os.mkfifo(ended)
    listen, running, listens = live.wait_for_viewer, live.check_running, threading.Event()

    def wait(viewer: live.Viewer, give_up: threading.Event) -> None:
        listen(viewer, give_up)
        listens.set()

    def check(viewer: live.Viewer) -> None:
        if listens.is_set():  # however slowly a busy machine ends it: else the stream would wait for the other for ever
            os.waitid(os.P_PID, viewer.pid, os.WEXITED | os.WNOWAIT)
        running(viewer)

    def take() -> None:
        taking.append(foreign.accept()[0])
        ended.write_text("\n")
        while part := taking[0].recv(100_000):
            got.append(part)

    with socket.create_server(("127.0.0.1", 0)) as foreign:
        script = f"echo rerun+http://127.0.0.1:{foreign.getsockname()[1]}/proxy >&2; read line < {ended}"
        monkeypatch.setattr(live, "viewer_executable", lambda: program(tmp_path, script))
        monkeypatch.setattr(live, "wait_for_viewer", wait)
        monkeypatch.setattr(live, "check_running", check)
        monkeypatch.setenv("DISPLAY", ":0")
        thread = threading.Thread(target=take)
        thread.start()
        with pytest.raises(ConnectionError, match="ended"):
            live.live_stream("application", "recording", start_viewer(), {"secret": "zebra"}, threading.Event())
        with taking[0]:
            taking[0].shutdown(socket.SHUT_RDWR)
            thread.join()
    assert b"PRI * HTTP" in b"".join(got)
    assert b"zebra" not in b"".join(got)


RECORDING = """
    import os, signal, sys, threading, time
    from pathlib import Path
    from deformscope.recording import live, recorder
    from tests.log import synthetic
    os.environ["DISPLAY"] = ":0"
    live.window_options = lambda: ["--serve-grpc"]  # a window without a window
    start, started = recorder.start_viewer, []
    recorder.start_viewer = lambda: started.append(start()) or started[0]
    with recorder.Recorder(Path(sys.argv[1]), "native", {}) as made:
        for frame in synthetic.frames(60):
            made.write(frame)
            if frame.index == 20:
                given, feed = threading.Event(), made._outputs.feed
                made._put(given.set, 0)  # once the writer has handed over what came before
                given.wait()
                while feed._unconfirmed or feed._jobs:
                    time.sleep(0.005)
                os.kill(started[0].pid, signal.Signals[sys.argv[2]])
    print("dropped", made.summary().dropped)
    os.kill(started[0].pid, signal.SIGKILL)
"""


@pytest.mark.parametrize("how", ["SIGSTOP", pytest.param("SIGKILL", marks=pytest.mark.slow)])
def test_a_frozen_or_killed_viewer_does_not_keep_the_process_from_ending(tmp_path: Path, how: str) -> None:
    path = tmp_path / "run.rrd"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "drivers")])}
    command = [sys.executable, "-c", textwrap.dedent(RECORDING), str(path), how]
    ended = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False
    )  # one that waits for the viewer waits for ever
    assert ended.returncode == 0, ended.stderr
    dropped = int(ended.stdout.split()[1])
    assert 0 < dropped <= 39
    assert f"did not confirm {dropped} of" in ended.stderr
    replay = Replay(path)
    assert replay.frame_count == 60
    assert replay.outcome["live_dropped"] == dropped


def test_a_page_that_follows_lacks_nothing(tmp_path: Path) -> None:
    from tests.log import synthetic

    with Recorder(tmp_path / "run.rrd", "page", {}) as made:
        for frame in synthetic.frames(20):
            made.write(frame)
    end_pages()
    assert made.summary().dropped == 0
