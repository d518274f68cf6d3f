"""The question before a real arm moves: what a person may answer, and that what was checked still holds after it."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from deformscope.errors import InputError
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.robot.checks import Check, Preflight
from deformscope.runs.skeleton import permitted
from deformscope.session import Inline, Step, run
from deformscope.terminal import until_interrupted
from tests.cases import Capture, Patch

WELL, BAD = (Preflight((Check("arm: still", passed, "at rest", "what came"),)) for passed in (True, False))


class Asked:
    """A robot that was checked."""

    format_forces = "3 N"

    def __init__(self, *checked: Preflight) -> None:
        self.checked = list(checked)
        self.wishes: list[str] = []
        self.moves: list[Preflight] = []
        self.stopped: Future[None] = Future()

    def carry_out(self, command: object, keep: object) -> Future[Any]:
        return Inline().submit(self.preflight)

    def preflight(self) -> Preflight:
        if self.wishes:
            raise KeyError("stopped: a person asked")
        return self.checked.pop(0)

    def reports(self) -> list[Step]:
        return []

    def ask_to_stop(self, reason: str) -> None:
        self.wishes.append(reason)

    def let_move(self, preflight: Preflight) -> None:
        if not preflight.passed:
            raise InputError("a preflight that passed", "none")
        self.moves.append(preflight)


@pytest.fixture
def ask(monkeypatch: Patch) -> Iterator[Callable[..., None]]:
    """Ask at a terminal where somebody does this; devices are recorded meanwhile."""
    reading, writing = os.pipe()
    terminal = os.fdopen(reading)

    def at_terminal(robot: Asked, answer: Callable[[int, int], None]) -> int:
        stdin = SimpleNamespace(isatty=lambda: True, fileno=terminal.fileno, readline=terminal.readline)
        monkeypatch.setattr("sys.stdin", stdin)
        setup: Any = SimpleNamespace(simulated=False, person=None)
        portions: list[object] = []

        def take(wait_s: float) -> list[Any]:
            portions.append(wait_s)
            answer(writing, len(portions))
            return []

        recorder: Any = SimpleNamespace(write=lambda one: portions.append(one) if isinstance(one, Step) else None)
        source: Any = SimpleNamespace(take=take)
        with until_interrupted() as asked:
            experiment = permitted(robot, setup, ExploreOptions(), {}, asked, yes=False)  # type: ignore[arg-type]
            run(source, experiment, recorder, robot)
        return len(portions)

    yield at_terminal
    os.close(writing)
    terminal.close()


def says(words: bytes, after: int = 3) -> Callable[[int, int], None]:
    """Somebody writes this once the devices were recorded a few times."""
    return lambda writing, portion: (os.write(writing, words), None)[1] if portion == after else None


def test_yes_lets_it_move_if_the_checks_still_pass(ask: Callable[..., int]) -> None:
    robot = Asked(WELL, WELL)
    assert ask(robot, says(b"yes\n")) >= 3
    assert robot.moves == [WELL]
    assert not robot.checked


def test_what_was_moved_while_the_question_waited_is_noticed(ask: Callable[..., int], capsys: Capture) -> None:
    robot = Asked(WELL, BAD)
    with pytest.raises(InputError, match="preflight"):
        ask(robot, says(b"yes\n"))
    assert not robot.moves
    assert "NO  arm: still" in capsys.readouterr().err


def test_the_first_ctrl_c_ends_the_question(ask: Callable[..., int]) -> None:
    robot = Asked(WELL, WELL)
    with pytest.raises(KeyError, match="a person asked"):
        ask(robot, lambda writing, portion: signal.raise_signal(signal.SIGINT) if portion == 3 else None)
    assert robot.wishes == ["Ctrl-C"]
    assert not robot.moves


@pytest.mark.parametrize("answer", [b"\n", b"no\n", b"y\n"])
def test_nothing_else_lets_it_move(ask: Callable[..., int], answer: bytes) -> None:
    robot = Asked(WELL, WELL)
    with pytest.raises(InputError, match="nothing has moved"):
        ask(robot, says(answer))
    assert not robot.moves
