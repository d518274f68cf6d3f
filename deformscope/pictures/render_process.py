"""Pictures drawn in a separate process while a robot is held.

Drawing needs Python's lock for a tenth of a second per picture, and the robot's control waits for that lock."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor
from concurrent.futures.process import BrokenProcessPool
from typing import ParamSpec, TypeVar

from deformscope.pictures import exploration
from deformscope.processes import computing

P = ParamSpec("P")
Drawn = TypeVar("Drawn")

_process: Executor | None = None


@contextlib.contextmanager
def render_process() -> Iterator[None]:
    """A context in which `drawn` draws in a process of low priority."""
    global _process
    with computing(exploration.text_png, "warm") as _process:  # fonts are looked up with the first picture
        try:
            yield
        finally:
            _process = None


def render(draw: Callable[P, Drawn], *given: P.args, **named: P.kwargs) -> Drawn:
    """Result of `draw`, a function of a module; without a process for it, or after the end of that, it is drawn
    here."""
    if (process := _process) is not None:
        with contextlib.suppress(BrokenProcessPool, CancelledError, RuntimeError):
            return process.submit(draw, *given, **named).result()
    return draw(*given, **named)
