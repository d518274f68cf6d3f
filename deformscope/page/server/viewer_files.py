"""rerun's programs in the installed wheel: its viewer for windows, and the web viewer for pages that it holds."""

import importlib.util
import mmap
import os
import re
import sys
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import BinaryIO

from deformscope.errors import InputError

NAMES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
LOOPBACK = "127.0.0.1"
PART_BYTES = 256 << 10
NOT_PASSED_ON = {"FORCE_RERUN_ANALYTICS", "NO_PROXY", "no_proxy"}
SILENT = {
    "CI": "true",  # rerun collects no usage data there
    "TELEMETRY_ENABLED": "false",
    "ALL_PROXY": f"http://{LOOPBACK}:0",  # nowhere: its window asks GitHub for a newer version, and has no other switch
    "RERUN_APP_ONLY": "true",
}
_SCRIPT = re.compile(rb"let wasm_bindgen = .*?\n\}\)\(\{ __proto__: null \}\);\n", re.DOTALL)
_MODULE = b"\0asm\1\0\0\0"
_SECTION = re.compile(rb"[\0-\x0d]([\x80-\xff]{0,4}[\0-\x7f])")
_EXECUTABLES = {"win32": "rerun.exe", "darwin": "Rerun.app/Contents/MacOS/Rerun"}


def viewer_executable() -> Path:
    """The viewer of the installed wheel: never another version from the search path."""
    package = importlib.util.find_spec("rerun_cli")
    folder = Path(package.origin or "").parent if package is not None else Path()
    found = folder / _EXECUTABLES.get(sys.platform, "rerun")
    if not found.exists():
        raise InputError(
            "the viewer that comes with rerun-sdk", "none", "pip install --force-reinstall rerun-sdk", found
        )
    return found


def viewer_environment() -> dict[str, str]:
    """Environment of rerun's processes: with it, they connect to no other machine."""
    return {name: value for name, value in os.environ.items() if name not in NOT_PASSED_ON} | SILENT


class ViewerFiles:
    """Both files of the web viewer: 43 MB, which are not held in memory. The viewer's files, found at the first
    request.

    They are read from the executable itself. rerun would also serve them, but another user of this machine may take
    that port first and serve other files."""

    def __init__(self) -> None:
        self._file: BinaryIO | None = None
        self._places: dict[str, tuple[int, int]] = {}
        self._lock = threading.Lock()

    def size(self, name: str) -> int:
        """Bytes of one of `NAMES`. Raises OSError or InputError without such a file."""
        with self._lock:
            if self._file is None:
                # start and length of each of `NAMES` in it [bytes]
                executable = viewer_executable()
                with executable.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    script, module = _SCRIPT.search(content), content.find(_MODULE)
                    end = module + len(_MODULE)
                    while header := _SECTION.match(content, end):
                        end = header.end() + sum((byte & 0x7F) << 7 * place for place, byte in enumerate(header[1]))
                    if script is None or module < 0 or end > len(content):
                        advice = "pip install --force-reinstall rerun-sdk"
                        raise InputError("a rerun that holds its web viewer", "none", advice, executable)
                self._places = dict(
                    zip(NAMES, [(script.start(), script.end() - script.start()), (module, end - module)], strict=True)
                )
                self._file = viewer_executable().open("rb")
            return self._places[name][1]

    async def parts(self, name: str) -> AsyncIterator[bytes]:
        """The file's parts, for one of `NAMES`, after `size`. They are in the system's file cache: a thread for each
        would take longer."""
        assert self._file is not None
        at, left = self._places[name]
        while left > 0:
            part = os.pread(self._file.fileno(), min(PART_BYTES, left), at)
            yield part
            at, left = at + len(part), left - len(part)

    def close(self) -> None:
        """Close the files until the next request."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None
