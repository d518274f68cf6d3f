"""The operator of a run: a person at the terminal, at the page if the run has one, or a script with given consent."""

import contextlib
import os
import select
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from deformscope.errors import InputError
from deformscope.robot.jogging import LEAVE
from deformscope.session import RigExperiment, Step
from deformscope.terminal import Interruption, say

if TYPE_CHECKING:
    from deformscope.robot.by_hand import PlaceRequest

POLL_S = 0.1
Keys = Callable[[], str]
"""The keys that were pressed since the last call."""


@dataclass(frozen=True, slots=True)
class RunOperator:
    """The person who permits motion.

    asked: set when a person requests the end of the run; agreed: a person has agreed at the page, None without one"""

    asked: Interruption
    agreed: Callable[[], bool] | None = None

    def line(self, prompt: str) -> RigExperiment[str]:
        """The typed line; frames continue to come meanwhile. It is empty after a person ends the run, and yes after the
        page has confirmed."""
        print(prompt, end="", file=sys.stderr, flush=True)
        listens = self.agreed is None or at_terminal()
        while not self.asked.is_set():
            if self.agreed is not None and self.agreed():
                return "yes"
            if select.select([sys.stdin] if listens else [], [], [], POLL_S)[0]:
                return sys.stdin.readline().strip().lower()
            yield Step()
        return ""

    def confirm(self, prompt: str, *, or_ended: bool = False) -> RigExperiment[None]:
        """Ask as `line`; raises InputError unless a person answers yes. or_ended: a person who ends the run does not
        cause the error either"""
        if self.agreed is None and not at_terminal():
            raise InputError("a person who confirms", "no terminal for questions", "--yes")
        if (yield from self.line(prompt)) != "yes" and not (or_ended and self.asked.is_set()):
            raise InputError("yes", f"{self.asked.by or 'something else'}: nothing has moved")


class PersonAtTerminal:
    """Places an arm without motors: a line for each request (`robot.by_hand.Person`)."""

    def ask(self, request: "PlaceRequest") -> None:
        say(request.words)

    def answered(self) -> str | None:
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return None
        if not (line := sys.stdin.readline()):
            raise InputError("a person at the terminal who places the arm", "the end of its input", "a terminal")
        return line.strip()


def at_terminal() -> bool:
    """Whether a person at the terminal can answer."""
    return sys.stdin.isatty()


def wait_for_enter(words: str) -> None:
    """Raises InputError at the end of the standard input."""
    say(f"{words}: press Enter")
    if not sys.stdin.readline():
        raise InputError("Enter on the standard input for every frame", "its end", "--pace fast")


@contextlib.contextmanager
def terminal_keys() -> Iterator[Keys]:
    """The keys of the terminal, each when it is pressed. Raises InputError without a terminal."""
    import termios
    import tty

    if not at_terminal():
        raise InputError("a terminal, whose keys move the arm", "none", "run it in a terminal")
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)

    def pressed() -> str:
        if not select.select([descriptor], [], [], 0.0)[0]:
            return ""
        return os.read(descriptor, 64).decode(errors="replace") or LEAVE

    try:
        tty.setcbreak(descriptor)
        yield pressed
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
