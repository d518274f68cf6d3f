"""The live view: a separate viewer and a thread that sends data to it; nothing else waits for them."""

import contextlib
import logging
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Generic, Literal, Protocol, TypeVar

from deformscope.errors import InputError
from deformscope.page.server.pieces import Pieces
from deformscope.page.server.viewer_files import LOOPBACK, viewer_environment, viewer_executable

if TYPE_CHECKING:
    from deformscope.log.live_stream import LiveStream

ViewerKind = Literal["none", "native", "page"]


class ViewerStream(Protocol):
    """A stream to a viewer, as the feed uses it."""

    def flush(self, *, timeout_sec: float) -> None:
        """Return when the viewer has received all data. Raises TimeoutError if that takes longer, another error if the
        viewer is gone."""

    def disconnect(self) -> None: ...


StreamT = TypeVar("StreamT", bound=ViewerStream)

CAPACITY_JOBS = 256
CAPACITY_BYTES = 128 << 20
PERIOD_S = 0.1
"""Shortest period of passing jobs on to a window together."""
ASK_S = 0.02
"""Period of polling a function that depends on others."""
VIEWER_MEMORY, BACKLOG_MEMORY = "2GB", "512MB"
"""Memory limit of a window, and of its server's store."""
START_TIMEOUT_S = 20.0
FLUSH_TIMEOUT_S = 1.0

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Viewer:
    """A window that was started.

    pid: its process; messages: descriptor of a file with its standard error"""

    pid: int
    messages: int

    where: ClassVar[str] = "viewer: a separate window, which stays open after this command"

    @property
    def output(self) -> str:
        """The beginning of the viewer's output."""
        return os.pread(self.messages, 10_000, 0).decode(errors="replace")

    @property
    def url(self) -> str:
        """The address to which recordings stream, empty before the viewer listens.

        The viewer chooses the port and reports it: on a port chosen here, another user could listen first."""
        found = re.search(rf"rerun\+http://{LOOPBACK}:\d+/proxy", self.output)
        return found[0] if found else ""


def start_viewer() -> Viewer:
    """Start rerun's window on loopback and return without waiting for it; the window stays open after this process.

    Raises InputError without a display."""
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or "--headless" in window_options()
    if sys.platform.startswith("linux") and not has_display:
        raise InputError("a display for the viewer's window", "none (DISPLAY is unset)", "--viewer page or none")
    command = [str(viewer_executable()), "--bind", LOOPBACK, "--port", "0"]
    command += ["--memory-limit", VIEWER_MEMORY, "--server-memory-limit", BACKLOG_MEMORY]
    command += ["--hide-welcome-screen", "--expect-data-soon", *window_options()]
    messages, path = tempfile.mkstemp()
    with contextlib.suppress(OSError):  # its descriptor is enough
        Path(path).unlink()
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=messages,
        start_new_session=True,  # Ctrl-C ends the measurement and leaves its picture
        env=viewer_environment() | {"RUST_LOG": "error,re_grpc_server=info"},  # its port, and why it ended
    )
    process.returncode = 0  # `_ended` alone asks for it: subprocess would warn of a window that outlives this process
    return Viewer(process.pid, messages)


def window_options() -> list[str]:
    """More options of a native viewer."""
    return []


_abandoned: list[object] = []


def live_stream(
    application: str, recording_id: str, viewer: Viewer, properties: Mapping[str, object], give_up: threading.Event
) -> "LiveStream":
    """A stream that is connected to the viewer; blocks until the viewer answers."""
    import rerun as rr

    from deformscope.log.live_stream import LiveStream

    def check(timeout_s: float) -> None:
        check_running(viewer)
        check_answers(viewer, timeout_s)

    wait_for_viewer(viewer, give_up)
    rec = rr.RecordingStream(application, recording_id=recording_id)
    rec.set_sinks(rr.GrpcSink(viewer.url))
    with contextlib.suppress(RuntimeError):  # not within the time, or never: the next line knows
        rec.flush(timeout_sec=FLUSH_TIMEOUT_S)
    try:
        check_running(viewer)  # so that nobody else can have taken its port before this was connected to it
    except ConnectionError:
        _abandoned.append(rec)  # to let go of it would wait for whoever listens there now
        raise
    rec.send_property("session", rr.AnyValues(True, **properties))
    return LiveStream(rec, check)


def page_stream(
    application: str, recording_id: str, pieces: Pieces, properties: Mapping[str, object], give_up: threading.Event
) -> "LiveStream":
    """A stream for pages, which fetch their pieces when they are ready; lasting data are separate from transient
    data."""
    import rerun as rr

    from deformscope.log.live_stream import LiveStream

    streams = [rr.RecordingStream(application, recording_id=recording_id) for _ in range(2)]
    encoded = [rr.binary_stream(stream) for stream in streams]

    def cut(timeout_s: float) -> None:
        for stream, lasting in zip(encoded, (True, False), strict=True):
            if data := stream.read(flush_timeout_sec=timeout_s):
                pieces.add(data, lasting=lasting, until_ns=live.newest_ns)

    streams[0].send_property("session", rr.AnyValues(True, **properties))
    live = LiveStream(streams[0], cut, streams[1])
    return live


def wait_for_viewer(viewer: Viewer, give_up: threading.Event) -> None:
    """Return when the viewer listens; raises an error if it ends or does not start."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline and not give_up.is_set():
        check_running(viewer)
        if viewer.url:
            return
        time.sleep(0.05)
    raise ConnectionError(f"the viewer did not listen within {START_TIMEOUT_S:g} s")


def check_running(viewer: Viewer) -> None:
    """Raise ConnectionError, with the last of the viewer's output, if its process has ended."""
    if not _ended(viewer.pid):
        return
    words = " ".join(viewer.output.split())[-300:]
    raise ConnectionError(f"the viewer has ended{': ' if words else ''}{words}")


def check_answers(viewer: Viewer, timeout_s: float) -> None:
    """Return once the viewer's server answers. Raises TimeoutError if it does not, ConnectionError if it is gone.

    A connection is not sufficient: the system accepts it, and a hundred kilobytes, even for a stopped process."""
    port = int(viewer.url.rsplit(":", 1)[1].split("/")[0])
    with socket.create_connection((LOOPBACK, port), timeout=timeout_s) as connection:
        connection.sendall(f"GET / HTTP/1.1\r\nHost: {LOOPBACK}\r\nConnection: close\r\n\r\n".encode())
        if not connection.recv(1):  # any answer will do: it is no page, and says so
            raise ConnectionError("the viewer closed the connection")


def _ended(pid: int) -> bool:
    try:
        return os.waitpid(pid, os.WNOHANG)[0] == pid
    except ChildProcessError:
        return True


class LiveFeed(Generic[StreamT]):
    """Passes jobs to a live stream from a separate thread; drops the oldest when the viewer is too slow.

    connect: opens the stream, in the feed's thread; gives up when its event is set
    period_s: shortest period of passing jobs on together; a function is polled until it has passed"""

    def __init__(
        self,
        connect: Callable[[threading.Event], StreamT],
        capacity_jobs: int = CAPACITY_JOBS,
        capacity_bytes: int = CAPACITY_BYTES,
        period_s: float | Callable[[], float] = PERIOD_S,
    ) -> None:
        self._connect = connect
        self._capacity = capacity_jobs, capacity_bytes
        self._period_s = period_s if callable(period_s) else lambda: period_s
        self._jobs: deque[tuple[Callable[[StreamT], None], int, bool]] = deque()
        self._bytes = 0
        self._given = self._lost = 0
        self._unconfirmed = 0
        self._silent = False
        self._left = threading.Event()
        self._closing = threading.Event()
        self._over = threading.Event()
        self._stays = False
        self._ready = threading.Condition()
        # A daemon: a viewer that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._work, name="deformscope-live", daemon=True)

    @property
    def dropped(self) -> int:
        """Number of jobs without the viewer's confirmation: while the feed runs, dropped jobs; after its end also those
        that were never confirmed."""
        with self._ready:
            return self._lost

    def start(self) -> None:
        self._thread.start()

    def put(self, job: Callable[[StreamT], None], size: int, *, lasting: bool = False) -> None:
        """Add a job; returns immediately. size: bytes that it keeps alive; lasting: later jobs depend on this job, so
        that it is dropped last"""
        with self._ready:
            self._given += 1
            if self._left.is_set() or self._closing.is_set():
                self._lost += 1
                return
            self._jobs.append((job, size, lasting))
            self._bytes += size
            while len(self._jobs) > 1 and (len(self._jobs) > self._capacity[0] or self._bytes > self._capacity[1]):
                place = next((at for at, (_, _, lasting) in enumerate(self._jobs) if not lasting), 0)
                self._bytes -= self._jobs[place][1]
                del self._jobs[place]
                self._lost += 1
            self._ready.notify()

    def close(self, timeout_s: float) -> bool:
        """Show waiting jobs, within the time; return whether the stream ended normally.

        It does not wait for a viewer that has not answered for a while. Jobs without its confirmation are counted as
        dropped. A stream without a normal end is never released: releasing it would wait for the viewer, and so would
        the end of the process, unless rerun's part in it is cancelled."""
        with self._ready:
            self._closing.set()
            self._ready.notify()
            patience_s = 0.0 if self._silent else timeout_s
        if not self._over.wait(patience_s):
            _logger.warning("the viewer does not answer; it gets no more data, and the recording is not affected")
        self._leave()
        if self._lost:
            _logger.warning("the viewer did not confirm %d of %d portions", self._lost, self._given)
        return self._over.is_set() and not self._stays

    def _work(self) -> None:
        stream: StreamT | None = None
        try:
            stream = self._connect(self._left)
            while jobs := self._take():
                began = time.monotonic()
                for job, _, _ in jobs:
                    job(stream)
                self._confirm(stream)
                while (rest_s := began + self._period_s() - time.monotonic()) > 0.0 and not self._closing.is_set():
                    self._closing.wait(min(rest_s, ASK_S))
            stream.disconnect()
        except Exception as error:
            # A lost viewer costs the picture, never the measurement.
            if not self._left.is_set():
                _logger.warning("the live view ended (%s); the recording continues", error)
            self._stays = stream is not None
            self._leave()
        self._over.set()
        while self._stays:  # see `close`
            threading.Event().wait()

    def _take(self) -> list[tuple[Callable[[StreamT], None], int, bool]]:
        """All that waits, once something does; nothing at the end."""
        with self._ready:
            while not self._jobs and not self._closing.is_set():
                self._ready.wait()
            jobs = list(self._jobs)
            self._jobs.clear()
            self._bytes = 0
            self._unconfirmed = len(jobs)
            return jobs

    def _confirm(self, stream: StreamT) -> None:
        """Wait until the viewer has confirmed its jobs, for any time."""
        while True:
            try:
                stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
            except TimeoutError:
                self._silent = True
                if self._left.is_set():
                    raise
                continue
            with self._ready:
                self._silent = False
                self._unconfirmed = 0
                return

    def _leave(self) -> None:
        """Count jobs without the viewer's confirmation; from now on nothing is passed on."""
        with self._ready:
            self._left.set()
            self._lost += len(self._jobs) + self._unconfirmed
            self._unconfirmed = 0
            self._jobs.clear()
