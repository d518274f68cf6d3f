"""A squeeze that is begun, watched and stopped from a page.

The page starts no motion: the experiment queries it before the hand moves. Its watch checks in each control period
whether the page that confirmed the motion is still present."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from deformscope.page.robot_page import RobotPage
from deformscope.page.server.messages import Outcome, PageCommand, Phase, StartSqueezing
from deformscope.page.server.page_session import PageSession


class PageSqueezing(RobotPage):
    """`PageRun` of a squeeze's page."""

    robot, button = "hand", "Squeeze"

    def wait_for(self, what: str) -> None:
        """See `RobotPage.wait_for`."""
        with self._lock:
            self._what, self._agreed, self._by_hand = what, False, False
        phase: Phase = "idle" if self.session.state.phase == "idle" else "paused"
        self.session.enter(phase, f"waits for Squeeze: {what}", commands=("stop", "squeeze"))

    def go_on(self) -> None:
        """See `RobotPage.go_on`."""
        with self._lock:
            self._by_hand = self._agreed
        self.session.enter("squeezing", commands=("stop",), pending=None)

    def _handle(self, command: PageCommand) -> tuple[Outcome, str]:
        if not isinstance(command, StartSqueezing):
            return "refused", "not during a squeeze"
        self.session.ask(self._what, self._agree, self.session.remark)
        return "begun", "waits for a confirmation"


def show_squeezed(session: PageSession, table: Iterable[Sequence[object]]) -> None:
    """Report the outcome, on a page that may outlive the squeeze. table: rows of a name and words"""
    rows = [(str(name), str(words)) for name, words in table]
    for name, words in reversed(rows):
        session.remark(f"{name}: {words}", bad=name == "discarded")
    known = dict(rows)
    says = [f"{name}: {known[name]}" for name in ("first contact", "named", "discarded") if name in known]
    session.enter("stopped", says[-1] if says else "squeezed")
