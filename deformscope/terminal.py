"""What is said to somebody at a terminal while something runs: all of it on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from deformscope.errors import printable


def say(remark: str) -> None:
    """One line of progress or a remark; never folded."""
    print(printable(remark), file=sys.stderr, flush=True)


@contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """A line that the next one replaces, gone at the end; nothing where stderr is no terminal. Yields what shows one:
    an empty one before anything else is said."""
    shown = False

    def show(text: str) -> None:
        nonlocal shown
        if sys.stderr.isatty() and (text or shown):
            print(f"\r\x1b[K{printable(text)}", end="", file=sys.stderr, flush=True)
            shown = bool(text)

    try:
        yield show
    finally:
        show("")
