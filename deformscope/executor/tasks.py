"""Tasks that workers compute: each is tried until it is done or refused, and a failed one does not end the others.

A worker takes a function of a module and an item; its computation depends on nothing else. At most `capacity` tasks are
under way, so that memory does not grow with their number."""

import contextlib
import errno
import fcntl
import functools
import json
import os
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from deformscope.errors import InputError, printable
from deformscope.version import __version__

# Outcomes of tasks, a line of JSON each when it is done: nothing is lost if the file is truncated

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


T = TypeVar("T")
R = TypeVar("R")

ATTEMPTS = 3
"""Number of attempts of a task if its worker or the system failed: another attempt may succeed."""


class WorkerLost(Exception):
    """The worker ended while it computed a task, or was ended."""


class OtherVersion(InputError):
    """A worker runs another version of deformscope: no task can be computed there."""


AGAIN = (WorkerLost, OSError, MemoryError)
"""Errors after which a task is repeated; other errors, and refusals, are final."""


@dataclass(frozen=True, slots=True)
class TaskOutcome(Generic[T, R]):
    """Outcome of a task. error: why the last attempt failed, None = it succeeded; reasons: why each attempt failed, in
    a line

    seconds: duration of the last attempt in its worker"""

    item: T
    value: R | None
    error: Exception | None = None
    reasons: tuple[str, ...] = ()
    seconds: float = 0.0


class Workers(Protocol):
    """Where tasks are computed. The value of `submit` represents one attempt."""

    @property
    def capacity(self) -> int:
        """Largest number of attempts under way."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Begin an attempt."""

    def ready(self, under_way: Collection[Any]) -> Collection[Any]:
        """Wait a little for any of them; returns those that ended."""

    def result(self, attempt: Any) -> Any:
        """The task's return value. Raises its error, or WorkerLost."""

    def give_up(self, attempt: Any) -> None:
        """End an attempt, which is then lost."""

    def close(self) -> None:
        """End the workers, whatever they compute."""


def compute(
    workers: Workers,
    function: Callable[[T], R],
    items: Iterable[T],
    *,
    attempts: int = ATTEMPTS,
    limit_s: float | None = None,
    begin: Callable[[], None] | None = None,
) -> Iterator[TaskOutcome[T, R]]:
    """The outcome of each item as it is ready.

    items: cases; each is taken only when a worker is free for it; attempts: most attempts of each task
    limit_s: an attempt that takes longer is ended; the start of its worker counts too; begin: a function of a module
    too, called in each worker before its first task. Raises OtherVersion; errors of attempts become outcomes."""
    coming, again = iter(items), deque[tuple[T, tuple[str, ...]]]()
    under_way: dict[Any, tuple[T, tuple[str, ...], float]] = {}
    while True:
        while len(under_way) < workers.capacity:
            if again:
                item, reasons = again.popleft()
            else:
                try:
                    item, reasons = next(coming), ()
                except StopIteration:
                    break
            attempt = workers.submit(run_attempt, __version__, begin, function, item)
            under_way[attempt] = item, reasons, time.monotonic()
        if not under_way:
            return
        for attempt in workers.ready(under_way):
            item, reasons, began = under_way.pop(attempt)
            try:
                value, seconds = workers.result(attempt)
            except OtherVersion:
                raise
            except Exception as error:
                late = limit_s is not None and isinstance(error, WorkerLost) and time.monotonic() - began > limit_s
                reasons = (*reasons, f"it took longer than {limit_s:g} s" if late else reason_of(error))
                if isinstance(error, AGAIN) and not late and len(reasons) < attempts:
                    again.append((item, reasons))
                else:
                    yield TaskOutcome(item, None, error=error, reasons=reasons)
            else:
                yield TaskOutcome(item, value, reasons=reasons, seconds=seconds)
        if limit_s is not None:
            for attempt, (_, _, began) in under_way.items():
                if time.monotonic() - began > limit_s:
                    workers.give_up(attempt)


def compute_all(workers: Workers, function: Callable[[T], R], items: Iterable[T], done: Callable[[], None]) -> list[R]:
    """The results in the order of the items; `done` is called at each, and the first error ends it."""
    found: dict[int, R] = {}
    try:
        for outcome in compute(workers, lambda numbered: function(numbered[1]), enumerate(items), attempts=1):
            if outcome.error is not None:
                raise outcome.error
            found[outcome.item[0]] = outcome.value  # type: ignore[assignment]
            done()
    finally:
        workers.close()
    return [found[index] for index in sorted(found)]


def run_attempt(version: str, begin: Callable[[], None] | None, function: Callable[[T], R], item: T) -> tuple[R, float]:
    """Result of one attempt in a worker, and its duration [s]. version: version of the program that requests it"""
    if version != __version__:
        raise OtherVersion(f"workers of version {version}", f"one of {__version__}", "install the same on all nodes")
    if begin is not None:
        _begun(begin)
    began = time.perf_counter()
    try:
        value = function(item)
    except Exception as error:
        raise _carried(error) from error
    return value, time.perf_counter() - began


@functools.cache
def _begun(begin: Callable[[], None]) -> None:
    begin()


def reason_of(error: BaseException) -> str:
    """Why an attempt failed, in a line."""
    words = " ".join(printable(str(error)).split())[:500]
    if isinstance(error, InputError | WorkerLost):
        return words
    if isinstance(error, OSError) and error.strerror:
        return f"the system refused: {error.strerror}" + ("" if error.filename is None else f" | {error.filename}")
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def _carried(error: Exception) -> Exception:
    """The error, or one of its words where it cannot pass between processes."""
    try:
        same: Exception = ForkingPickler.loads(ForkingPickler.dumps(error))
    except Exception:
        return RuntimeError(reason_of(error))
    return error if type(same) is type(error) else RuntimeError(reason_of(error))
