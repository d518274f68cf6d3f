"""The page's side of a fit: all is computed in a process of its own (`deformscope.page.fit`)."""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.calibrate import PushFlags
from deformscope.page.server.fit_messages import FitState
from deformscope.page.server.messages import FitDrawn, Outcome, PageCommand, StopRun
from deformscope.page.server.page_server import PageServer
from deformscope.processes import END_S, RENEW_S, child_process
from deformscope.terminal import say

MOST_CHANGES = 1000
"""Number of newest pictures whose delay until display is stored."""


class FitProcess:
    """`PageRun` of a fit, and its process.

    config: the command's options, with which it begins; read_force: reads the force of these, and its log, in the
    process; state: the state that was shown last; commands: commands that are possible then; changed: called with the
    state after every change, in the thread that receives from the process
    drawn_ms: time from a change on the page until the page has drawn it [ms]"""

    def __init__(
        self,
        config: BetaConfig | ThetaConfig,
        read_force: Callable[[PushFlags], Any],
        state: FitState,
        page: PageServer,
        changed: "Callable[[FitProcess], None]",
    ) -> None:
        self._target = partial(_fit, config, read_force)
        self._page, self._changed = page, changed
        self.state = state
        self.commands: tuple[str, ...] = ()
        self.goes_on = True
        self.ending = False
        self.outcome: BetaConfig | ThetaConfig | Exception = RuntimeError("its process has died")
        self.drawn_ms: deque[float] = deque(maxlen=MOST_CHANGES)
        self._out: queue.SimpleQueue[PageCommand | None] = queue.SimpleQueue()
        self.thread = threading.Thread(target=self._listen, name="deformscope-fit", daemon=True)

    def start(self) -> "FitProcess":
        """Begin. An interrupted start can still be closed."""
        self.thread.start()
        return self

    def handle(self, command: PageCommand) -> tuple[Outcome, str]:
        """See `PageRun.handle`."""
        if isinstance(command, FitDrawn):
            self.drawn_ms.append(command.after_ms)
            return "done", ""
        self._out.put(command)
        return "begun", ""

    def result(self) -> BetaConfig | ThetaConfig:
        """The options that were set last, once a page has stopped the fit. Raises its error."""
        while self.thread.is_alive():
            self.thread.join(RENEW_S)
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome

    def end(self) -> None:
        """End the fit immediately, from any thread; `thread` then ends. The command of the numbers is printed at the
        terminal."""
        if not self.ending:
            # What has not begun yet handles no command: it ends once its pipe does.
            self._until_s = time.monotonic() + (END_S if self.commands else 0.0)
            self.ending = True
            self._out.put(StopRun(0))
            if self.state.command:
                say(f"as set on the page: {self.state.command}")

    def close(self) -> None:
        """End it, and wait for its end."""
        self.end()
        if self.thread.ident is not None:
            self.thread.join(3 * END_S)

    def _listen(self) -> None:
        try:
            with child_process("fit", self._target) as pipe:
                threading.Thread(target=self._send, args=(pipe,), daemon=True).start()
                while not self.ending or time.monotonic() < self._until_s:
                    if not pipe.poll(0.5):
                        continue
                    kind, *what = pipe.recv()
                    if kind == "end":
                        (self.outcome,) = what
                        break
                    self._take(kind, *what)
        except (EOFError, OSError):
            pass
        finally:
            self.goes_on = False
            self._out.put(None)
            self._changed(self)

    def _send(self, pipe: Connection) -> None:
        while (message := self._out.get()) is not None:
            try:
                pipe.send(message)
            except (OSError, ValueError):  # it has ended
                return

    def _take(self, kind: str, *what: Any) -> None:
        """Results of the process."""
        match kind:
            case "note":
                self._page.session.show(reason=what[0])
            case "file" if not self.ending:  # else it may be one of another fit's by now
                self._page.offer(*what)
            case "fit":
                self.state, self.commands = what
                self._changed(self)


def _fit(config: BetaConfig | ThetaConfig, read_force: Callable[[PushFlags], Any], pipe: Connection) -> None:
    """In the process, which alone loads the simulation."""
    from deformscope.page.fit import run_fit

    run_fit(config, read_force, pipe)
