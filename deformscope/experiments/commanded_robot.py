"""A robot that carries out a session's commands, one at a time, in its own thread or at once."""

import abc
import contextlib
import gc
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from deformscope.session import Inline, Step
from deformscope_drivers.pacing import STEERING, be_prompt

IDLE_S = 0.02
"""Period at which a robot that does not rest in control periods checks for a command."""
SWITCH_S = 5e-4
"""Time after which a thread that waits for Python's lock gets it. With Python's default of 5 ms, a control period is
late if other threads write and draw, as it waits for the interpreter several times."""


@contextlib.contextmanager
def without_long_pauses() -> Iterator[None]:
    """Exempt loaded objects from Python's garbage collection, which would stop all threads for 0.1 s and more, in the
    middle of a motion; and switch threads more often."""
    gc.collect()
    gc.freeze()
    as_before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(as_before_s)
        gc.unfreeze()


class CommandedRobot(abc.ABC):
    """Carries out the commands of a session; a `SessionRobot`.

    stopped: fails with the reason when the robot stops without a command"""

    def __init__(self, name: str, keep_every: int) -> None:
        """name: of its thread; keep_every: control periods of a simulated clock between two portions of the
        recording"""
        self.stopped: Future[None] = Future()
        self._name, self._keep_every = name, keep_every
        self._reports: list[Step] = []
        self._keep: Callable[[], object] | None = None
        self._periods = 0
        self._commands: queue.SimpleQueue[tuple[object, Future[Any]]] | None = None

    @property
    def may_move(self) -> bool:
        """Whether it may move: its thread then gets the priority of one that steers."""
        return True

    @abc.abstractmethod
    def perform(self, command: object) -> Callable[[], Any]:
        """Carry a command out; the returned function assembles the answer, which may take longer than a control
        period."""

    def rest(self) -> bool:
        """Called between commands, in its thread: rest for a control period; returns whether it did."""
        return False

    def cycled(self) -> None:
        """Called in each control period."""
        self._periods += 1
        if self._keep is not None and self._periods % self._keep_every == 0:
            self._keep()

    def reports(self) -> list[Step]:
        """Actions that began since the last call."""
        taken, self._reports = self._reports, []
        return taken

    def carry_out(self, command: object, keep: Callable[[], object]) -> Future[Any]:
        """Begin with a command: in the robot's thread if it has one, else immediately."""
        if self._commands is None:
            self._keep = keep
            return Inline().submit(lambda: self.perform(command)())
        future: Future[Any] = Future()
        self._commands.put((command, future))
        return future

    @contextlib.contextmanager
    def in_a_thread(self) -> Iterator[None]:
        """Carry commands out in a thread: devices on their own clock are recorded meanwhile."""
        commands = self._commands = queue.SimpleQueue()
        over = threading.Event()

        def work() -> None:
            rested = prompt = False
            while not over.is_set():
                asked: tuple[object, Future[Any]] | None = None
                with contextlib.suppress(queue.Empty):
                    asked = commands.get(block=not rested, timeout=IDLE_S)
                if self.may_move and not prompt:
                    prompt = True
                    be_prompt(STEERING)
                rested = True
                if asked is None:
                    rested = self.rest()
                    continue
                command, future = asked
                try:
                    answers.submit(_give, future, self.perform(command))
                except BaseException as error:
                    future.set_exception(error)

        thread = threading.Thread(target=work, name=self._name, daemon=True)
        with ThreadPoolExecutor(1, "answers") as answers:
            thread.start()
            try:
                yield
            finally:
                over.set()
                thread.join()


def _give(future: Future[Any], answer: Callable[[], Any]) -> None:
    try:
        future.set_result(answer())
    except BaseException as error:
        future.set_exception(error)
