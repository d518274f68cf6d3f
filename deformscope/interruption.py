"""Ctrl-C, a request to end or a closed terminal, as an event."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from deformscope.terminal import say


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
