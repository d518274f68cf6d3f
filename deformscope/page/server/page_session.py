"""The state that every page shows and the commands that every page may give: one source of truth, on the server."""

import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from deformscope.page.server import messages

NEXT: dict[messages.Phase, frozenset[messages.Phase]] = {
    "idle": frozenset({"live", "recording", "exploring", "squeezing", "paused", "stopped"}),
    "live": frozenset({"recording", "stopped"}),
    "recording": frozenset({"live", "stopped"}),
    "exploring": frozenset({"paused", "stopped"}),
    "squeezing": frozenset({"paused", "stopped"}),
    "paused": frozenset({"exploring", "squeezing", "stopped"}),
    "stopped": frozenset(),
}
"""The possible next phases of each phase."""
REMARKS = 50
"""Number of newest remarks that are stored."""
CONFIRM_S = 10.0
"""Time limit of a confirmation, from the time when the page has drawn the request."""
UNSEEN_S = 30.0
"""Longest delay until a busy page draws a request."""
BEAT_S = 0.3
"""Default time after a page's last heartbeat at which motions stop that it confirmed."""

GONE = "no motion waits for this confirmation: it has expired, or another was requested"


class PageRun(Protocol):
    """The object that carries out the commands of pages."""

    def handle(self, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        """Carry out a command, or begin with it, immediately; returns the outcome as text. From the server's thread,
        which must not; wait: a slower command has begun, and its end becomes a remark."""


class PageSession:
    """The session of a page, which may be used from any thread. Functions given to `watch` are called after every
    change."""

    def __init__(self, title: str = "", clock: Callable[[], float] = time.monotonic, beat_s: float = BEAT_S) -> None:
        self._clock = clock
        self._began_s = clock()
        self._state = messages.PageState(title=title, beat_s=beat_s)
        self._run: PageRun | None = None
        self._beats: dict[str, tuple[float, bool]] = {}
        self._moves = 0
        self._answers: tuple[Callable[[], None], Callable[[str], None]] = (_nothing, _nothing)
        self._pages: list[str] = []
        self._watchers: list[Callable[[], None]] = []
        self._lock = threading.RLock()

    @property
    def state(self) -> messages.PageState:
        """The present state."""
        with self._lock:
            return msgspec.structs.replace(self._state, now_s=self._now_s())

    def watch(self, call: Callable[[], None]) -> Callable[[], None]:
        """call: after every change, in any thread; returns the function that ends it."""
        with self._lock:
            self._watchers.append(call)
        return lambda: self._watchers.remove(call)

    # For what goes on ------------------------------------------------------------------------------------------------

    def bind(self, run: PageRun) -> None:
        """From now on this run gets the commands."""
        self._run = run

    def enter(self, phase: messages.Phase, reason: str = "", **changes: Any) -> None:
        """Change to another phase, or stay in this one; changes: fields of the state. Raises ValueError if the phase
        may not follow."""
        with self._lock:
            if phase != self._state.phase and phase not in NEXT[self._state.phase]:
                raise ValueError(f"{phase} does not follow {self._state.phase}")
            if phase == "stopped" != self._state.phase:
                over = {
                    "commands": (),
                    "tares": (),
                    "episode": "",
                    "recording": "",
                    "pending": None,
                    "next_place": None,
                }
                changes = over | changes
            self.show(phase=phase, reason=reason, **changes)

    def show(self, **changes: Any) -> None:
        """Change fields of the state."""
        with self._lock:
            self._state = msgspec.structs.replace(self._state, **changes)
            watchers = tuple(self._watchers)
        for call in watchers:
            call()

    def remark(self, words: str, *, bad: bool = False) -> None:
        """Add a remark for the pages."""
        with self._lock:
            before = self._state.remarks
            number = before[-1].number + 1 if before else 1
            one = messages.Remark(number, self._now_s(), " ".join(words.split())[:500], bad)
            self.show(remarks=(*before, one)[-REMARKS:])

    def recording_began(self, file: str, **changes: Any) -> None:
        """Note that a file is being written."""
        self.enter("recording", recording=file, recorded_since_s=self._now_s(), recorded_bytes=0, **changes)

    def ask(self, what: str, confirmed: Callable[[], None], let_be: Callable[[str], None]) -> None:
        """Request a confirmation of a motion from the page that steers. One of the two functions is called, from any
        thread. It is `let_be`, with the reason, if the motion is cancelled, or not confirmed within CONFIRM_S after the
        page has drawn it. If the page does not report that, the time counts from now. An earlier request is
        cancelled."""
        self._drop("another move was requested")
        with self._lock:
            self._moves += 1
            self._answers = confirmed, let_be
            number = self._moves
            self.show(pending=messages.PendingMove(number, what, self._now_s() + CONFIRM_S))
        self._drop_after(UNSEEN_S, number, seen=False)

    def _drop_after(self, wait_s: float, number: int, *, seen: bool) -> None:
        """Cancel it without an answer by then. seen: as it is to be at that time, else another waits for it"""

        def expire() -> None:
            pending = self._state.pending
            if pending is not None and pending.seen == seen:
                self._drop(_expired(), number)

        timer = threading.Timer(wait_s, expire)
        timer.daemon = True
        timer.start()

    def _drop(self, reason: str, number: int | None = None) -> bool:
        """Cancel the request for a confirmation, if there is one (of this number); whether it was cancelled."""
        with self._lock:
            pending, (_, let_be) = self._state.pending, self._answers
            if pending is None or number not in (None, pending.number):
                return False
            self.show(pending=None)
        let_be(reason)  # without the lock: it may take another, whose holder waits for this one
        return True

    def absent(self) -> str:
        """Why no page steers at this moment: empty while the controlling page is connected and visible, and reports
        often enough. Whether the page is absent; returns immediately, as it is called in each control period, from any
        thread."""
        state = self._state
        if not state.controls:
            return "no page has the controls"
        beat_s, visible = self._beats.get(state.controls, (-1e9, True))
        if not visible:
            return "the page that has the controls is hidden"
        silent_s = self._clock() - beat_s
        return f"no heartbeat of the page for {1e3 * min(silent_s, 99.0):.0f} ms" if silent_s > state.beat_s else ""

    # For pages -------------------------------------------------------------------------------------------------------

    def come(self, page: str) -> None:
        """Note a new page; it steers if no other page does."""
        with self._lock:
            self._pages.append(page)
            self.show(pages=len(self._pages), controls=self._state.controls or page)

    def leave(self, page: str) -> None:
        """Note that a page is gone."""
        with self._lock:
            self._pages.remove(page)
            if page not in self._pages:
                self._beats.pop(page, None)
            gone = page == self._state.controls and page not in self._pages
            self.show(pages=len(self._pages), controls="" if gone else self._state.controls)

    def beat(self, page: str, *, visible: bool) -> None:
        """Note that a page is present, and whether it is visible."""
        self._beats[page] = (self._clock(), visible)

    def command(self, page: str, command: messages.PageCommand) -> messages.CommandReply:
        """Carry out a page's command, or refuse it."""
        outcome, words = self._answer(page, command)
        return messages.CommandReply(command.id, outcome, words)

    def _answer(self, page: str, command: messages.PageCommand) -> tuple[messages.Outcome, str]:
        state = self.state
        if state.phase == "stopped":
            return "refused", f"it has stopped: {state.reason}" if state.reason else "it has stopped"
        if isinstance(command, messages.TakeControls):
            self.show(controls=page)
            self._drop("another page took the controls over")
            return "done", "this page has the controls"
        if state.controls != page and not isinstance(command, messages.StopRun):
            return "refused", "another page has the controls: take them over first"
        if isinstance(command, messages.ConfirmMove | messages.CancelMove):
            return self._decide(command)
        if isinstance(command, messages.SeeMove):
            with self._lock:
                pending = self._state.pending
                if pending is None or pending.number != command.number or pending.seen:
                    return "refused", GONE
                until_s = self._now_s() + CONFIRM_S
                self.show(pending=msgspec.structs.replace(pending, until_s=until_s, seen=True))
            self._drop_after(CONFIRM_S, command.number, seen=True)
            return "done", pending.what
        kind = str(command.__struct_config__.tag)
        if self._run is None or kind not in state.commands:
            possible = ", ".join(state.commands) or "none"
            return "refused", f"no {kind} while it is {state.phase}; possible: {possible}"
        try:
            return self._run.handle(command)
        except Exception as error:  # whatever a command does, the server goes on
            return "refused", " ".join(str(error).split()) or type(error).__name__

    def _decide(self, command: messages.ConfirmMove | messages.CancelMove) -> tuple[messages.Outcome, str]:
        if isinstance(command, messages.CancelMove):
            return (
                ("done", "nothing moves")
                if self._drop("cancelled: nothing moved", command.number)
                else ("refused", GONE)
            )
        with self._lock:
            pending, (confirmed, _) = self._state.pending, self._answers
            if pending is None or pending.number != command.number:
                return "refused", GONE
            late = self._now_s() >= pending.until_s
            absent = self.absent()
            if not late and not absent:
                self.show(pending=None)
        if late:
            self._drop(_expired(), command.number)
            return "refused", f"not confirmed within {CONFIRM_S:g} s: nothing moves"
        if absent:
            return "refused", absent
        confirmed()
        return "done", pending.what

    def _now_s(self) -> float:
        return self._clock() - self._began_s


def _expired() -> str:
    return f"not confirmed within {CONFIRM_S:g} s: nothing moved"


def _nothing(*given: object) -> None:
    pass
