"""A squeeze that is begun, watched and stopped from a page.

Nothing of it moves by itself: the experiment asks it before the hand moves, and its watch asks in each control period
whether somebody is still there who confirmed the motion under way.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence

from deformscope.interruption import Interruption
from deformscope.page.devices import ShownDevices
from deformscope.page.server.desk import Desk
from deformscope.page.server.messages import Outcome, PageCommand, Phase, StartSqueezing, StopRun


class PageSqueezing:
    """`PageRun` of a squeeze's page. show: what the hand does, in words"""

    def __init__(self, desk: Desk, ended: Interruption, show: ShownDevices) -> None:
        self.desk = desk
        self.show = show
        self._ended = ended
        self._what = ""
        self._agreed = self._by_hand = False
        self._lock = threading.Lock()
        desk.attend(self)
        desk.enter("idle", commands=("stop",))

    # From the experiment ---------------------------------------------------------------------------------------------

    def wait_for(self, what: str) -> None:
        """Have the page ask for what moves next, and confirm it. what: will move"""
        with self._lock:
            self._what, self._agreed, self._by_hand = what, False, False
        phase: Phase = "idle" if self.desk.state.phase == "idle" else "paused"
        self.desk.enter(phase, f"waits for Squeeze: {what}", commands=("stop", "squeeze"))

    def is_agreed(self) -> bool:
        """Whether somebody at the page has confirmed it."""
        return self._agreed

    def go_on(self) -> None:
        """It was agreed to, at the page or elsewhere, or need not be."""
        with self._lock:
            self._by_hand = self._agreed
        self.desk.enter("squeezing", commands=("stop",), pending=None)

    def reason_to_stand(self) -> str:
        """In each control period: why it may not go on, where nobody watches what they confirmed on the page."""
        return self.desk.absent() if self._by_hand else ""

    # As `PageRun`, from the server -----------------------------------------------------------------------------------

    def obey(self, command: PageCommand) -> tuple[Outcome, str]:
        """As `PageRun.obey`."""
        match command:
            case StopRun():
                self._ended.by = "from the page"
                self._ended.set()
                return "done", "the hand stops"
            case StartSqueezing():
                self.desk.ask(self._what, self._agree, self.desk.remark)
                return "begun", "waits for a confirm"
            case _:
                return "refused", "not while something is squeezed"

    def _agree(self) -> None:
        with self._lock:
            self._agreed = True


def show_squeezed(desk: Desk, table: Iterable[Sequence[object]]) -> None:
    """Say what came of it, on a page that may outlive the squeeze. table: rows of a name and words"""
    rows = [(str(name), str(words)) for name, words in table]
    for name, words in reversed(rows):
        desk.remark(f"{name}: {words}", bad=name == "discarded")
    known = dict(rows)
    says = [f"{name}: {known[name]}" for name in ("first contact", "named", "discarded") if name in known]
    desk.enter("stopped", says[-1] if says else "squeezed")
