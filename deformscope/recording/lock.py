"""Which recording is being written: a lock on its file, held until the run ends, in whatever way."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


def create_locked(path: Path) -> BinaryIO:
    """A new, empty file that is locked until the returned file is closed, or the process ends. Raises FileExistsError
    and other OSErrors."""
    file = path.open("xb")
    # Waits for whoever probes it at this moment; a file system without locks is used without.
    with contextlib.suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX)
    return file


def is_being_written(path: Path) -> bool:
    """Whether a running process holds this file."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


@contextlib.contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """A context that only one run at a time enters for the same folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
