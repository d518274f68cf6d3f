"""A squeeze that is begun, watched and stopped from a page.

Nothing of it moves by itself: the experiment asks it before the hand moves, and its watch asks in each control period
whether somebody is still there who confirmed the motion under way.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence

from deformscope.interruption import Interruption
from deformscope.page.devices import ShownDevices
from deformscope.page.server.messages import Outcome, PageCommand, Phase, StartSqueezing, StopRun
from deformscope.page.server.page_session import PageSession


class PageSqueezing:
    """`PageRun` of a squeeze's page. show: what the hand does, in words"""

    def __init__(self, session: PageSession, ended: Interruption, show: ShownDevices) -> None:
        self.session = session
        self.show = show
        self._ended = ended
        self._what = ""
        self._agreed = self._by_hand = False
        self._lock = threading.Lock()
        session.bind(self)
        session.enter("idle", commands=("stop",))

    # From the experiment ---------------------------------------------------------------------------------------------

    def wait_for(self, what: str) -> None:
        """Have the page ask for what moves next, and confirm it. what: will move"""
        with self._lock:
            self._what, self._agreed, self._by_hand = what, False, False
        phase: Phase = "idle" if self.session.state.phase == "idle" else "paused"
        self.session.enter(phase, f"waits for Squeeze: {what}", commands=("stop", "squeeze"))

    def is_agreed(self) -> bool:
        """Whether somebody at the page has confirmed it."""
        return self._agreed

    def go_on(self) -> None:
        """It was agreed to, at the page or elsewhere, or need not be."""
        with self._lock:
            self._by_hand = self._agreed
        self.session.enter("squeezing", commands=("stop",), pending=None)

    def reason_to_stand(self) -> str:
        """In each control period: why it may not go on, where nobody watches what they confirmed on the page."""
        return self.session.absent() if self._by_hand else ""

    # As `PageRun`, from the server -----------------------------------------------------------------------------------

    def handle(self, command: PageCommand) -> tuple[Outcome, str]:
        """As `PageRun.handle`."""
        match command:
            case StopRun():
                self._ended.by = "from the page"
                self._ended.set()
                return "done", "the hand stops"
            case StartSqueezing():
                self.session.ask(self._what, self._agree, self.session.remark)
                return "begun", "waits for a confirm"
            case _:
                return "refused", "not while something is squeezed"

    def _agree(self) -> None:
        with self._lock:
            self._agreed = True


def show_squeezed(session: PageSession, table: Iterable[Sequence[object]]) -> None:
    """Say what came of it, on a page that may outlive the squeeze. table: rows of a name and words"""
    rows = [(str(name), str(words)) for name, words in table]
    for name, words in reversed(rows):
        session.remark(f"{name}: {words}", bad=name == "discarded")
    known = dict(rows)
    says = [f"{name}: {known[name]}" for name in ("first contact", "named", "discarded") if name in known]
    session.enter("stopped", says[-1] if says else "squeezed")
