"""What a recording waits for that falls behind: room on the disk, the disk, or the processor."""

from __future__ import annotations

import shutil
import time
from contextlib import suppress
from pathlib import Path

from deformscope.errors import InputError

TASKS = Path("/proc/self/task")
FILE_WRITER = "file_writer"
"""rerun's name of a thread that writes a file."""
FREE_BYTES = 64 << 20
WAITED, BUSY = 0.5, 0.8
"""Shares of the looks at which the disk is the reason, and of a core at which more of it would not help. Chosen."""
OTHER_DISK = "another disk"


class RecordingError(InputError):
    """The recording cannot go on: the disk is full, gone or too slow, or the processor is."""


def check_room(path: Path, hint: str = OTHER_DISK) -> None:
    """Raise RecordingError where the disk has too little room for a file there. hint: what to try then"""
    free = shutil.disk_usage(path.parent).free
    if free < FREE_BYTES:
        raise RecordingError(f"{FREE_BYTES >> 20} MiB free on the disk", f"{free >> 20} MiB free", hint, path)


def writes_are_held_up() -> bool:
    """Whether the system has one of rerun's threads wait at this moment for a file that it writes."""
    with suppress(OSError):
        for task in TASKS.iterdir():
            with suppress(OSError):  # a thread that has just ended
                if (task / "comm").read_text().strip() == FILE_WRITER and _waits(task):
                    return True
    return False


def _waits(task: Path) -> bool:
    """Whether a thread waits for something else than more to write, as for a disk."""
    state = (task / "stat").read_text().rpartition(") ")[2][:1]
    where = (task / "wchan").read_text().strip()
    return state == "D" or (state == "S" and where not in ("", "0") and "futex" not in where)


class Lateness:
    """Looked at with every job that is handed over, while more than `late_bytes` wait.

    thread_id: the system's, of the thread that encodes
    """

    def __init__(self, late_bytes: int, thread_id: int | None) -> None:
        self._late_bytes, self._task = late_bytes, TASKS / str(thread_id)
        self._began: tuple[float, float] | None = None
        self._looks = self._held_up = 0

    def look(self, waiting_bytes: int) -> None:
        """Note how many bytes wait; called from the thread that hands jobs over."""
        if waiting_bytes < self._late_bytes:
            self._began = None
            return
        if self._began is None:
            self._began = time.monotonic(), self._ran_s()
            self._looks = self._held_up = 0
        self._looks += 1
        self._held_up += writes_are_held_up()

    def error(self, waiting_bytes: int, path: Path) -> RecordingError:
        """Why so much waits to be written to the file there."""
        try:
            check_room(path)
        except RecordingError as full:
            return full
        self.look(max(waiting_bytes, self._late_bytes))
        began_s, ran_s = self._began or (0.0, 0.0)
        lasted_s = max(time.monotonic() - began_s, 1e-3)
        held_up, core = self._held_up / self._looks, min((self._ran_s() - ran_s) / lasted_s, 1.0)
        behind = f"{waiting_bytes >> 20} MiB wait"
        if held_up >= WAITED:
            came = f"one that held the writing up {held_up:.0%} of the time; {behind}"
            return RecordingError("a disk that keeps up", came, OTHER_DISK, path)
        came = f"{core:.0%} of a core for it (the disk held it up {held_up:.0%} of the time); {behind}"
        hint = "fewer or smaller images" if core >= BUSY else "end other programs, or fewer stages or images"
        return RecordingError("a processor that keeps up with the encoding", came, hint, path)

    def _ran_s(self) -> float:
        """Of the thread that encodes, on a processor so far [s]."""
        with suppress(OSError, ValueError, IndexError):
            return int((self._task / "schedstat").read_text().split()[0]) / 1e9
        return 0.0
