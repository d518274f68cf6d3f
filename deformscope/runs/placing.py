"""Who places an arm that does not move by itself: somebody at the terminal."""

from __future__ import annotations

import select
import sys
from typing import TYPE_CHECKING

from deformscope.errors import InputError
from deformscope.terminal import say

if TYPE_CHECKING:
    from deformscope.robot.by_hand import PlaceRequest


class PersonAtTerminal:
    """Reads a line for each request (`robot.by_hand.Person`)."""

    def ask(self, request: PlaceRequest) -> None:
        say(request.words)

    def answered(self) -> str | None:
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return None
        if not (line := sys.stdin.readline()):
            raise InputError("somebody at the terminal who places the arm", "the end of its input", "a terminal")
        return line.strip()
