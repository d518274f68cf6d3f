"""Registry of running doubles for other processes: each writes its port to a small file while it runs."""

from __future__ import annotations

import contextlib
import json
import os
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class RunningDouble:
    """A double that another process runs. driver: name of the package with its driver; port: its end of the wire"""

    driver: str
    port: str
    name: str
    pid: int


def announcements() -> Path:
    """The folder in which running doubles write their ports; it may not exist."""
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"deformscope-doubles-{os.getuid()}"


@contextlib.contextmanager
def announced(driver: str, port: str, name: str) -> Iterator[None]:
    """Announce to other processes that a double runs here, until the end of the context."""
    folder = announcements()
    folder.mkdir(mode=0o700, exist_ok=True)
    if not _is_ours(folder):  # made by another user, who could lead what is written here elsewhere
        yield
        return
    path = folder / f"{os.getpid()}-{name}.json"
    path.write_text(json.dumps({"driver": driver, "port": port, "name": name, "pid": os.getpid()}), encoding="utf-8")
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def running_doubles() -> list[RunningDouble]:
    """The doubles whose processes live; what dead ones left is removed."""
    found = []
    folder = announcements()
    for path in sorted(folder.glob("*.json")) if _is_ours(folder) else []:
        try:
            double = RunningDouble(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            continue
        try:
            os.kill(double.pid, 0)
        except ProcessLookupError:
            path.unlink(missing_ok=True)
            continue
        except PermissionError:  # it lives, and is another user's
            pass
        found.append(double)
    return found


def _is_ours(folder: Path) -> bool:
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
