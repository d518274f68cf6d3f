"""Limits of a slow recording: room on the disk, the disk, or the processor."""

import shutil
import time
from contextlib import suppress
from pathlib import Path

from deformscope.errors import InputError

TASKS = Path("/proc/self/task")
FILE_WRITER = "file_writer"
"""rerun's name of a thread that writes a file."""
FREE_BYTES = 64 << 20
RESERVE_S, MOST_RESERVE_BYTES = 5.0, 1 << 30
"""A recording is ended while the disk still has room for this time, at its filling rate, or for this amount."""
ANNOUNCED_S = (60.0, 300.0, 1200.0)
"""Times until the disk is full at which a remark is made, once each."""
WINDOW_S = 10.0
"""Time over which the rate of a filling disk is measured."""
WAITED, BUSY = 0.5, 0.8
"""Shares of the checks at which the disk is the reason, and of a core at which more of it would not help. Chosen."""
OTHER_DISK = "another disk"


class RecordingError(InputError):
    """The recording cannot continue: the disk is full, gone or too slow, or the processor is."""


def check_room(path: Path, reserve: int = 0) -> None:
    """Raise RecordingError if the disk has too little space for a file there. reserve: bytes that it needs at least, if
    that is more than the usual reserve"""
    free, need = shutil.disk_usage(path.parent).free, max(FREE_BYTES, reserve)
    if free < need:
        raise RecordingError(f"{need >> 20} MiB free on the disk", f"{free >> 20} MiB free", OTHER_DISK, path)


class DiskForecast:
    """Forecast of when the disk will be full, from the rate at which its free space shrinks, whatever fills it."""

    def __init__(self) -> None:
        self._since: tuple[float, int] | None = None
        self._announced = len(ANNOUNCED_S)
        self.bytes_per_s = 0.0

    @property
    def reserve(self) -> int:
        """Free space for ending the recording in time [bytes]."""
        return min(round(self.bytes_per_s * RESERVE_S), MOST_RESERVE_BYTES)

    def look(self, free: int, now_s: float) -> str:
        """Store the free space [bytes], at a time [s]; the remark on it, empty = nothing new."""
        began_s, before = self._since or (now_s, free)
        self._since = began_s, before
        if now_s - began_s < WINDOW_S:
            return ""
        self.bytes_per_s, self._since = max(0.0, (before - free) / (now_s - began_s)), (now_s, free)
        left_s = (free - max(FREE_BYTES, self.reserve)) / self.bytes_per_s if self.bytes_per_s else float("inf")
        within = sum(left_s > limit_s for limit_s in ANNOUNCED_S)
        if within >= self._announced:
            return ""
        self._announced = within
        lasts = f"{left_s / 60:.0f} min" if left_s > 90 else f"{max(left_s, 0):.0f} s"
        return f"the disk will be full in {lasts} ({free / 1e9:.1f} GB free, {self.bytes_per_s / 1e6:.1f} MB/s)"


def writes_are_held_up() -> bool:
    """Whether one of rerun's threads waits at present for the system to write a file."""
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
    """Checks with every job, while more than `late_bytes` wait, why the recording is late.

    thread_id: the system's number of the thread that encodes"""

    def __init__(self, late_bytes: int, thread_id: int | None) -> None:
        self._late_bytes, self._task = late_bytes, TASKS / str(thread_id)
        self._began: tuple[float, float] | None = None
        self._looks = self._held_up = 0

    def look(self, waiting_bytes: int) -> None:
        """Note how many bytes wait; called by the thread that gives the jobs."""
        if waiting_bytes < self._late_bytes:
            self._began = None
            return
        if self._began is None:
            self._began = time.monotonic(), self._ran_s()
            self._looks = self._held_up = 0
        self._looks += 1
        self._held_up += writes_are_held_up()

    def error(self, waiting_bytes: int, path: Path) -> RecordingError:
        """Why the data for the file are delayed."""
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
        """Processor time of the thread that encodes, so far [s]."""
        with suppress(OSError, ValueError, IndexError):
            return int((self._task / "schedstat").read_text().split()[0]) / 1e9
        return 0.0
