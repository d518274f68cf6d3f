"""The question before a real arm moves: what a person may answer, and that what was checked still holds after it."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from deformscope.cli.exploring import let_move
from deformscope.cli.rigs import until_interrupted
from deformscope.errors import InputError
from deformscope.experiments.explore import ExploreOptions
from deformscope.robot.preflight import Check, Preflight

WELL, BAD = (Preflight((Check("arm: still", passed, "at rest", "what came"),)) for passed in (True, False))


class Asked:
    """A robot that was checked."""

    forces_told = "3 N"

    def __init__(self, *checked: Preflight) -> None:
        self.checked = list(checked)
        self.wishes: list[str] = []
        self.moves: list[Preflight] = []

    def preflight(self, calibrated: object, places_m: object = None) -> Preflight:
        if self.wishes:
            raise KeyError("stopped: a person asked")
        return self.checked.pop(0)

    def ask_to_stop(self, reason: str) -> None:
        self.wishes.append(reason)

    def let_move(self, preflight: Preflight) -> None:
        if not preflight.passed:
            raise InputError("a preflight that passed", "none")
        self.moves.append(preflight)


@pytest.fixture
def ask(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Ask at a terminal where somebody does this."""

    def at_terminal(robot: Asked, answer: Callable[[str], str]) -> None:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
        monkeypatch.setattr("builtins.input", answer)
        setup: Any = SimpleNamespace(simulated=False)
        with until_interrupted() as asked:
            let_move(robot, setup, ExploreOptions(), {}, asked, yes=False)  # type: ignore[arg-type]

    return at_terminal


def test_yes_lets_it_move_if_the_checks_still_pass(ask: Callable[..., None]) -> None:
    robot = Asked(WELL, WELL)
    ask(robot, lambda question: "yes")
    assert robot.moves == [WELL]
    assert not robot.checked


def test_who_moved_something_while_the_question_waited_is_told(
    ask: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    robot = Asked(WELL, BAD)
    with pytest.raises(InputError, match="preflight"):
        ask(robot, lambda question: "yes")
    assert not robot.moves
    assert "NO  arm: still" in capsys.readouterr().err


def test_the_first_ctrl_c_ends_the_question(ask: Callable[..., None]) -> None:
    def interrupted(question: str) -> str:
        signal.raise_signal(signal.SIGINT)
        return "yes"  # never: the terminal would wait on for an answer

    robot = Asked(WELL, WELL)
    with pytest.raises(KeyError, match="a person asked"):
        ask(robot, interrupted)
    assert robot.wishes == ["Ctrl-C"]
    assert not robot.moves


@pytest.mark.parametrize("answer", ["", "no", "y", None])
def test_nothing_else_lets_it_move(ask: Callable[..., None], answer: str | None) -> None:
    def answered(question: str) -> str:
        if answer is None:
            raise EOFError
        return answer

    robot = Asked(WELL, WELL)
    with pytest.raises(InputError, match="nothing has moved"):
        ask(robot, answered)
    assert not robot.moves
