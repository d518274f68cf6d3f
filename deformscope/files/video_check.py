"""Checks whether a video gave all its frames: compares the container's list with the readable frames and their times.

A damaged video is read without an error, because a decoder conceals or omits undecodable parts."""

import math
import re
import statistics
import struct
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

HEAD_BYTES = 1 << 16
EVEN_SHARE, EVEN_WITHIN = 0.9, 0.25
"""A video has a constant rate where this share of its steps is within this share of the median."""
ROUNDED_S = 0.0015
"""Rounding of times: in Matroska they are whole milliseconds."""


class VideoCheck:
    """Receives each frame that is read, and each that cannot be read; `problems` lists missing parts after the end.

    claimed: how many frames the container is said to hold, 0 = not known; rate_hz: stated frame rate. Only a container
    with a table of its frames (MP4, MOV, AVI) is relied on; elsewhere the count comes from a duration, which may be
    that of the sound. A gap in the times counts only if the other times are even.
    """

    def __init__(self, path: Path, claimed: float, rate_hz: float) -> None:
        self._path = path
        self._claimed = round(claimed) if math.isfinite(claimed) and 0 < claimed < 1e9 else 0
        self._rate_hz = rate_hz if math.isfinite(rate_hz) and 0 < rate_hz < 1e6 else 0.0
        self._times_s: list[float] = []
        self._failed = self._unreadable = 0

    def read(self, time_s: float) -> None:
        """A frame; time_s: times of the frames in the container."""
        self._times_s.append(time_s)
        self._unreadable += self._failed
        self._failed = 0

    def fail(self) -> None:
        """Note a frame that could not be read, or the end."""
        self._failed += 1

    def problems(self) -> list[str]:
        """Missing parts, one line each; empty = none detected."""
        found = []
        count = len(self._times_s)
        layout = _layout(self._path)
        period_s = _even_period_s(self._times_s)
        gaps = [] if period_s is None or layout.paced else _gaps(self._times_s, period_s)
        if layout.slotted and period_s is None and count:  # what was not filmed anew is listed, and empty
            count = max(count, round((self._times_s[-1] - self._times_s[0]) * self._rate_hz) + 1)
        if layout.cut_off:
            found.append("the file is truncated")
        if self._unreadable:
            found.append(f"{self._unreadable} frames could not be decoded")
        if layout.listed and self._claimed:
            held = self._claimed if layout.shown_s is None else min(self._claimed, layout.shown_s * self._rate_hz)
            tolerated = 0 if held == self._claimed else 2  # a cut at a time lies between frames
            if math.floor(held) - count > tolerated:
                found.append(f"the container lists {math.floor(held)} frames, {count} could be read")
            elif not found:
                gaps = []  # every frame that there ever was has been read: the rate varies
        elif layout.silent and self._claimed and self._rate_hz and period_s is not None:
            short_s = self._claimed / self._rate_hz - (self._times_s[-1] - self._times_s[0] + period_s)
            if short_s > 2.5 * period_s:
                found.append(
                    f"its stated duration is {self._claimed / self._rate_hz:.3g} s, {short_s:.3g} s more than "
                    "the real one"
                )
        return found + [f"{missing} frames are missing after {time_s:.3g} s" for time_s, missing in gaps]


class _Layout:
    """Structure of a container file, by its own tables.

    listed: it has a table of its frames; shown_s: how long it is to be shown, None = all of it; cut_off: it says that
    it is longer than the file; silent: without sound, so that its duration is the picture's; paced: an animation, with
    delays on purpose; slotted: frames of a varying rate lie in places of an even one"""

    def __init__(self) -> None:
        self.listed = self.cut_off = self.silent = self.paced = self.slotted = False
        self.shown_s: float | None = None


def _layout(path: Path) -> _Layout:
    found = _Layout()
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        if head[:4] == b"RIFF" and head[8:12] == b"AVI ":
            found.listed = found.slotted = True
        elif head[:4] in (b"GIF8", b"\x89PNG"):
            found.paced = True
        elif head[:4] == b"\x1a\x45\xdf\xa3":  # Matroska, WebM: a track's codec is named A_... for sound
            found.silent = re.search(rb"\x86[\x80-\xa0]A_[A-Z]", head) is None
        elif head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
            _read_boxes(file, path.stat().st_size, found)
    return found


def _read_boxes(file: BinaryIO, size: int, found: _Layout) -> None:
    """MP4 and MOV are boxes within boxes, each with its length: the last one ends where the file does."""
    for kind, start, end in _boxes(file, 0, size):
        found.cut_off |= end > size
        if kind == b"moov" and end <= size:
            inner = {kind: (start, end) for kind, start, end in _boxes(file, start, end)}
            found.listed = b"mvex" not in inner  # with it, the frames are listed piece by piece behind
            if b"mvhd" in inner:
                version, *_ = _unpack(file, ">B", inner[b"mvhd"][0])
                ticks_hz = _unpack(file, ">I", inner[b"mvhd"][0] + (20 if version else 12))[0]
                found.shown_s = _shown_s(file, start, end, ticks_hz)


def _shown_s(file: BinaryIO, start: int, end: int, ticks_hz: int) -> float | None:
    """Shown part of the picture by its edit list [s]; None without one."""
    for kind, track_start, track_end in _boxes(file, start, end):
        inner = {kind: (low, high) for kind, low, high in _boxes(file, track_start, track_end) if kind != b"trak"}
        if kind != b"trak" or b"edts" not in inner or b"mdia" not in inner:
            continue
        handlers = [low for kind, low, _ in _boxes(file, *inner[b"mdia"]) if kind == b"hdlr"]
        if not handlers or _unpack(file, ">4s", handlers[0] + 8)[0] != b"vide":
            continue
        for edit, low, _ in _boxes(file, *inner[b"edts"]):
            if edit == b"elst" and ticks_hz:
                version, count = _unpack(file, ">B3xI", low)
                entry = ">qqI" if version else ">IiI"
                step = struct.calcsize(entry)
                entries = [_unpack(file, entry, low + 8 + step * index) for index in range(min(count, 1000))]
                return float(sum(length for length, begins, _ in entries if begins >= 0)) / ticks_hz
    return None


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """(kind, start of its content, its end) of the boxes that lie one after the other."""
    while start + 8 <= end:
        length, kind = _unpack(file, ">I4s", start)
        content = start + 8
        if length == 1:
            length = _unpack(file, ">Q", content)[0]
            content += 8
        elif length == 0:
            length = end - start
        if length < 8:
            return
        yield kind, content, start + length
        start += length


def _unpack(file: BinaryIO, layout: str, at: int) -> tuple[Any, ...]:
    """Values of a file; zeros behind its end."""
    file.seek(at)
    size = struct.calcsize(layout)
    return struct.unpack(layout, file.read(size).ljust(size, b"\0"))


def _even_period_s(times_s: Sequence[float]) -> float | None:
    """The time between frames [s] where it is the same for nearly all of them, else None."""
    steps = [after - before for before, after in pairwise(times_s)]
    if len(steps) < 8:
        return None
    median = statistics.median(steps)
    within = max(EVEN_WITHIN * median, ROUNDED_S)
    even = sum(abs(step - median) <= within for step in steps)
    return (
        statistics.mean(step for step in steps if abs(step - median) <= within)
        if (median > 0 and even >= EVEN_SHARE * len(steps))
        else None
    )


def _gaps(times_s: Sequence[float], period_s: float) -> list[tuple[float, int]]:
    """(time before it [s], frames that are missing) of each gap."""
    return [
        (before, round((after - before) / period_s) - 1)
        for before, after in pairwise(times_s)
        if after - before > 1.75 * period_s + ROUNDED_S
    ]
