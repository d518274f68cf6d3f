"""Outcomes of tasks, a line of JSON each when it is done: nothing is lost if the file is truncated."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deformscope.errors import InputError

PIECE = 1 << 16


class Journal(contextlib.AbstractContextManager["Journal"]):
    """A file to which one process at a time adds lines. A truncated last line is not read, and is overwritten by the
    next. A file without a whole line belongs to another program, and is not changed.

    what: kind of its lines; hint: what to try if its lines have another kind"""

    def __init__(self, path: Path, what: str, hint: str = "") -> None:
        """Raises InputError where another process adds to it or it has no whole line, and OSError."""
        self.path, self._what, self._hint = path, what, hint
        self._file = path.open("a+b", buffering=0)
        with contextlib.suppress(OSError):  # a file system without locks is used without
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                self._file.close()
                raise InputError(what, "a file that another command adds to", "wait for its end", path) from error
        self._end = self._whole()
        if not self._end and self._file.seek(0, os.SEEK_END):
            self._file.close()
            raise InputError(what, "a file without a whole line", hint, path)

    def _whole(self) -> int:
        """Bytes up to the end of the last whole line."""
        end = self._file.seek(0, os.SEEK_END)
        while end:
            start = max(0, end - PIECE)
            found = os.pread(self._file.fileno(), end - start, start).rfind(b"\n")
            if found >= 0:
                return start + found + 1
            end = start
        return 0

    def lines(self) -> Iterator[Any]:
        """Content of the lines, in their order. Raises InputError if it is no JSON."""
        with self.path.open("rb") as file:
            for number, line in enumerate(file, start=1):
                if not line.endswith(b"\n"):
                    return
                try:
                    yield json.loads(line)
                except ValueError as error:
                    raise InputError(self._what, str(error), self._hint, f"{self.path}:{number}") from error

    def add(self, *lines: object) -> None:
        """Add values of JSON's types, nan and infinities too, which survive this process. Raises OSError."""
        text = "".join(json.dumps(one, separators=(",", ":")) + "\n" for one in lines).encode()
        self._file.truncate(self._end)
        try:
            if os.write(self._file.fileno(), text) < len(text):
                self._file.truncate(self._end)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            error.filename = str(self.path)
            raise
        self._end += len(text)

    def __exit__(self, *raised: object) -> None:
        self._file.close()
