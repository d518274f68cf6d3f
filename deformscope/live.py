"""The live view: a viewer of its own, fed by a thread of its own, which nothing ever waits for."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, Protocol, TypeVar

from deformscope.errors import InputError

ViewerKind = Literal["none", "native", "page"]


class Stream(Protocol):
    """What the feed itself wants of a rerun stream."""

    def flush(self, *, timeout_sec: float) -> None: ...

    def disconnect(self) -> None: ...


StreamT = TypeVar("StreamT", bound=Stream)

CAPACITY_JOBS = 256
CAPACITY_BYTES = 128 << 20
VIEWER_MEMORY = "2GB"
BACKLOG_MEMORY = "512MB"
START_TIMEOUT_S = 20.0
FLUSH_TIMEOUT_S = 2.0
LOOPBACK = "127.0.0.1"

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Viewer:
    """A viewer that was started, and that outlives this process.

    pid: its process; url: where recordings stream to; page: where a browser finds it, empty for a window
    """

    pid: int
    url: str
    page: str


def start_viewer(kind: Literal["native", "page"]) -> Viewer:
    """Start the viewer that belongs to the installed rerun, on loopback, and return without waiting for it."""
    if kind == "native" and sys.platform.startswith("linux") and not _has_display():
        raise InputError("a display for the viewer's window", "none (DISPLAY is unset)", "--viewer page or none")
    port = _free_port()
    command = [str(viewer_executable()), "--bind", LOOPBACK, "--port", str(port)]
    page = ""
    if kind == "page":
        page_port = _free_port()
        command += ["--serve-web", "--web-viewer-port", str(page_port), "--server-memory-limit", VIEWER_MEMORY]
        url = f"rerun+http://{LOOPBACK}:{port}/proxy"
        page = f"http://{LOOPBACK}:{page_port}?url={url.replace(':', '%3A').replace('/', '%2F').replace('+', '%2B')}"
    else:
        command += ["--memory-limit", VIEWER_MEMORY, "--server-memory-limit", BACKLOG_MEMORY]
        command += ["--hide-welcome-screen", "--expect-data-soon", *window_options()]
    quiet = {"RERUN_APP_ONLY": "true", "RUST_LOG": "error"}
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C ends the measurement and leaves its picture
        env={**os.environ, **quiet},
    )
    process.returncode = 0  # that it runs on is the point: nobody waits for it, nor warns that nobody does
    return Viewer(process.pid, f"rerun+http://{LOOPBACK}:{port}/proxy", page)


def window_options() -> list[str]:
    """More options of a native viewer."""
    return []


def wait_for_viewer(viewer: Viewer, give_up: threading.Event) -> None:
    """Return once it accepts connections; raise where it ends or stays away."""
    port = int(viewer.url.rsplit(":", 1)[1].split("/")[0])
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline and not give_up.is_set():
        if _ended(viewer.pid):
            raise ConnectionError("the viewer ended at once")
        with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=0.5):
            return
        time.sleep(0.05)
    raise ConnectionError(f"the viewer did not listen within {START_TIMEOUT_S:g} s")


def _ended(pid: int) -> bool:
    try:
        return os.waitpid(pid, os.WNOHANG)[0] == pid
    except ChildProcessError:
        return True


def _has_display() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")) or "--headless" in window_options()


def viewer_executable() -> Path:
    """The viewer of the installed wheel: never another version from the search path."""
    package = importlib.util.find_spec("rerun_cli")
    folder = Path(package.origin or "").parent if package is not None else Path()
    found = folder / ("rerun.exe" if sys.platform == "win32" else "rerun")
    if not found.exists():
        raise InputError(
            "the viewer that comes with rerun-sdk", "none", "pip install --force-reinstall rerun-sdk", found
        )
    return found


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class LiveFeed(Generic[StreamT]):
    """Passes jobs on to a live stream from a thread of its own; drops the oldest when the viewer cannot follow.

    connect: opens the stream, in the feed's thread; dropped: jobs that were never shown
    """

    def __init__(
        self,
        connect: Callable[[threading.Event], StreamT],
        capacity_jobs: int = CAPACITY_JOBS,
        capacity_bytes: int = CAPACITY_BYTES,
    ) -> None:
        self.dropped = 0
        self._connect = connect
        self._capacity = capacity_jobs, capacity_bytes
        self._jobs: deque[tuple[Callable[[StreamT], None], int]] = deque()
        self._bytes = 0
        self._busy = False
        self._dead = False
        self._closing = threading.Event()
        self._ready = threading.Condition()
        # A daemon: a viewer that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._work, name="deformscope-live", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, job: Callable[[StreamT], None], size: int) -> None:
        """Hand a job over; returns at once. size: bytes that it keeps alive."""
        with self._ready:
            if self._dead or self._closing.is_set():
                self.dropped += 1
                return
            self._jobs.append((job, size))
            self._bytes += size
            while len(self._jobs) > 1 and (len(self._jobs) > self._capacity[0] or self._bytes > self._capacity[1]):
                _, lost = self._jobs.popleft()
                self._bytes -= lost
                self.dropped += 1
            self._ready.notify()

    def close(self, timeout_s: float) -> bool:
        """Show what still waits, within the time; return whether the thread has ended."""
        with self._ready:
            self._closing.set()
            self._ready.notify()
        self._thread.join(timeout_s)
        with self._ready:
            stuck = self._thread.is_alive()
            self._dead = True
            self.dropped += len(self._jobs) + (1 if stuck and self._busy else 0)
            self._jobs.clear()
        return not stuck

    def _work(self) -> None:
        try:
            stream = self._connect(self._closing)
            while (job := self._take()) is not None:
                job(stream)
                with self._ready:
                    self._busy = False
            # The last of it is on its way now; a viewer that is gone is no reason to wait.
            stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
            stream.disconnect()
        except Exception as error:
            self._give_up(error)

    def _take(self) -> Callable[[StreamT], None] | None:
        with self._ready:
            while not self._jobs and not self._closing.is_set():
                self._ready.wait()
            if not self._jobs or self._dead:
                return None
            job, size = self._jobs.popleft()
            self._bytes -= size
            self._busy = True
            return job

    def _give_up(self, error: Exception) -> None:
        """A lost viewer costs the picture, never the measurement."""
        with self._ready:
            self._dead = True
            self.dropped += len(self._jobs) + (1 if self._busy else 0)
            self._jobs.clear()
            self._busy = False
        _logger.warning("the live view ended (%s); the recording goes on", error)
