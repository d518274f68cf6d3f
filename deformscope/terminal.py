"""Messages to a person at a terminal during a run: all of them on stderr."""

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType
from typing import TYPE_CHECKING

from deformscope.errors import printable

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

Say = Callable[[str], None]
Progress = Callable[[str, int, int], None]
"""A function that is called with what is being done, how much is done, and of how much (0 = unknown)."""

SAY_EVERY_S = 20.0
"""Seconds between lines about long work where no bar can be shown."""

_listener: ContextVar[Say | None] = ContextVar("listener", default=None)
"""The function that receives remarks instead of stderr. It belongs to the call that set it: other threads have their
own."""


def say(remark: str) -> None:
    """Print one line of progress or a remark, without wrapping."""
    if (listener := _listener.get()) is not None:
        listener(remark)
    else:
        print(printable(remark), file=sys.stderr, flush=True)


def is_watched() -> bool:
    """Whether a person reads stderr during the run: at a terminal, or in a notebook."""
    return sys.stderr.isatty() or type(sys.stderr).__module__.startswith("ipykernel")


@contextmanager
def messages_to(progress: Say | bool | None) -> Iterator[None]:
    """Messages within a call of the library: to this function; True: messages go to stderr; None: to stderr if that is
    a terminal or a notebook; False: no output."""
    shown = is_watched() if progress is None else progress
    token = _listener.set(shown if callable(shown) else None if shown else lambda remark: None)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """A line that the next one replaces, gone at the end; nothing where stderr is no terminal. Yields what shows one:
    an empty one before anything else is said."""
    shown, wanted = False, _listener.get() is None  # the robot's thread, which shows it, has no listener of its own

    def show(text: str) -> None:
        nonlocal shown
        if wanted and sys.stderr.isatty() and (text or shown):
            print(f"\r\x1b[K{printable(text)}", end="", file=sys.stderr, flush=True)
            shown = bool(text)

    try:
        yield show
    finally:
        show("")


@contextmanager
def shown_progress(progress: Progress | bool | None) -> Iterator[Progress | None]:
    """Progress of a call of the library: to this function; otherwise as in `messages_to`."""
    if callable(progress):
        yield progress
    elif is_watched() if progress is None else progress:
        with fit_progress() as note:
            yield note
    else:
        yield None


@contextmanager
def fit_progress() -> Iterator[Progress]:
    """A bar on stderr that names what the work is at; where stderr is no terminal, a line now and then."""
    said = time.monotonic()
    began: dict[str, tuple[float, int]] = {}
    tasks: dict[str, TaskID] = {}
    with contextlib.ExitStack() as ending:
        bars: Bars | None = None
        if sys.stderr.isatty():  # what draws a bar is slow to import
            from rich import console, progress

            columns = (*progress.Progress.get_default_columns(), progress.TimeElapsedColumn())
            where = console.Console(stderr=True)
            bars = ending.enter_context(progress.Progress(*columns, console=where, transient=True))

        def note(what: str, done: int, total: int) -> None:
            nonlocal said
            what = printable(what)
            if what not in began:
                said = time.monotonic()
                began[what] = said, done
            if bars is not None:
                if what not in tasks:
                    for earlier in tasks.values():
                        bars.update(earlier, visible=False)
                    tasks[what] = bars.add_task(what, total=total or None)
                bars.update(tasks[what], completed=done, total=total)
            elif time.monotonic() - said > SAY_EVERY_S:
                said = time.monotonic()
                since, first = began[what]
                left = f" after {said - since:.0f} s"
                if total and done > first:
                    left += f", some {(said - since) / (done - first) * (total - done):.0f} s left"
                print(f"{what}: {done} of {total or 'an unknown number'}{left}", file=sys.stderr, flush=True)

        yield note


# Ctrl-C, a request to end or a closed terminal, as an event


class Interruption(threading.Event):
    """An event that is set when a person has requested the end. signal_number: with what; 0 before, and where it was
    otherwise: by, in words"""

    signal_number = 0
    by = ""


@contextlib.contextmanager
def until_interrupted() -> Iterator[Interruption]:
    """An event that Ctrl-C, a request to end or a closed terminal sets once; the second Ctrl-C interrupts as usual."""
    asked = Interruption()

    def stop(number: int, frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.signal_number = number
        asked.set()
        say("ending; Ctrl-C again to leave immediately")

    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for number in kept:
            signal.signal(number, stop)
    except ValueError:  # not in the main thread: whoever runs this there ends it by other means
        yield asked
        return
    try:
        yield asked
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
