"""The web viewer of the installed rerun: its program and its script, which no file of the wheel holds by itself."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import AsyncIterator
from pathlib import Path
from typing import BinaryIO

from deformscope.errors import InputError

NAMES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
LOOPBACK = "127.0.0.1"
START_S = 30.0
PART_BYTES = 256 << 10


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


def free_port() -> int:
    """A port on loopback that nobody listens on at present."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class ViewerFiles:
    """Both files, in a temporary one without a name: 43 MB that no memory holds. Made when the first is asked for."""

    def __init__(self) -> None:
        self._file: BinaryIO | None = None
        self._places: dict[str, tuple[int, int]] = {}
        self._lock = threading.Lock()

    def size(self, name: str) -> int:
        """Bytes of one of `NAMES`; takes a second the first time. Raises OSError or InputError where there is none."""
        with self._lock:
            if self._file is None:
                self._file = self._made()
            return self._places[name][1]

    async def parts(self, name: str) -> AsyncIterator[bytes]:
        """Of one of `NAMES`, after `size`. They are at hand in memory: a thread for each would take longer."""
        assert self._file is not None
        at, left = self._places[name]
        while left > 0:
            part = os.pread(self._file.fileno(), min(PART_BYTES, left), at)
            yield part
            at, left = at + len(part), left - len(part)

    def close(self) -> None:
        """Forget them, until one is asked for again."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None

    def _made(self) -> BinaryIO:
        """rerun's own server of its web viewer gives them; it has no recording, and lives a second."""
        file = tempfile.TemporaryFile()  # noqa: SIM115  # it lasts as long as this object
        port = free_port()
        command = [str(viewer_executable()), "--bind", LOOPBACK, "--port", str(free_port())]
        serving = subprocess.Popen(
            [*command, "--serve-web", "--web-viewer-port", str(port)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "RERUN_APP_ONLY": "true", "RUST_LOG": "off"},
        )
        try:
            for name in NAMES:
                at = file.tell()
                _copy(f"http://{LOOPBACK}:{port}/{name}", file, serving)
                self._places[name] = at, file.tell() - at
        except BaseException:
            file.close()
            raise
        finally:
            serving.kill()
            serving.wait()
        file.flush()
        return file


def _copy(address: str, file: BinaryIO, serving: subprocess.Popen[bytes]) -> None:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # no proxy for loopback
    deadline = time.monotonic() + START_S
    while True:
        with contextlib.suppress(urllib.error.URLError), opener.open(address, timeout=START_S) as answer:
            while part := answer.read(PART_BYTES):
                file.write(part)
            return
        if serving.poll() is not None or time.monotonic() > deadline:
            raise ConnectionError("rerun did not give its web viewer")
        time.sleep(0.02)
