"""Common parts of all pages of a robot: it moves after a person has confirmed the motion on the page, and only while
the page is present."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

from deformscope.page.devices import ShownDevices
from deformscope.page.server.messages import Outcome, PageCommand, Phase, StartSqueezing, StopRun
from deformscope.page.server.page_session import PageSession
from deformscope.terminal import Interruption


class RobotPage(ABC):
    """`PageRun` of a robot's page.

    robot: the moving part, as text; button: text of the page's button for a motion"""

    robot = button = ""

    def __init__(self, session: PageSession, ended: Interruption, shown: ShownDevices | None, reason: str = "") -> None:
        """reason: the first activity, as text; shown: shows the robot's state, None = nothing"""
        self.session = session
        self._ended, self._shown = ended, shown
        self._what = ""
        self._agreed = self._by_hand = False
        self._lock = threading.RLock()
        session.bind(self)
        session.enter("idle", reason, commands=("stop",))

    @abstractmethod
    def wait_for(self, what: str) -> None:
        """Request a confirmation of the next motion from the page. what: the motion"""

    @abstractmethod
    def go_on(self) -> None:
        """Continue after a person agreed, at the page or elsewhere, or if no agreement is needed."""

    def is_agreed(self) -> bool:
        """Whether a person at the page has confirmed the motion."""
        return self._agreed

    def reason_to_stand(self) -> str:
        """Called in each control period: why the robot must stop, if the page that confirmed the motion is not
        present."""
        return self.session.absent() if self._by_hand else ""

    def show(self, doing: str) -> None:
        """The robot's state, as text."""
        if self._shown is not None:
            self._shown(doing)

    def handle(self, command: PageCommand) -> tuple[Outcome, str]:
        """See `PageRun.handle`; a stop is handled first, and waits for no lock."""
        if isinstance(command, StopRun):
            self._ended.by = "from the page"
            self._ended.set()
            return "done", f"the {self.robot} stops"
        with self._lock:
            return self._handle(command)

    @abstractmethod
    def _handle(self, command: PageCommand) -> tuple[Outcome, str]: ...

    def _agree(self) -> None:
        with self._lock:
            self._agreed = True


class PageSqueezing(RobotPage):
    """`PageRun` of a squeeze's page: the experiment waits for it before the hand moves, and each control period checks
    whether the page that confirmed the motion is still present."""

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
