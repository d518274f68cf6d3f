"""Commands of a robot in its own thread: in order, answered or failed one by one, at rest between them."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from deformscope.experiments.commanded_robot import CommandedRobot
from tests.patience import PATIENCE_S


class Adder(CommandedRobot):
    """Its commands are numbers; the answer is the sum so far, and the thread of the command."""

    def __init__(self) -> None:
        super().__init__("adder", keep_every=2)
        self.sum, self.rested = 0.0, threading.Event()

    def perform(self, command: object) -> Callable[[], Any]:
        self.sum += float(str(command))
        answer = (self.sum, threading.current_thread().name)
        return lambda: answer

    def rest(self) -> bool:
        self.rested.set()
        return True


def test_a_thread_answers_in_order_goes_on_after_an_error_and_rests_between() -> None:
    robot = Adder()
    with robot.in_a_thread():
        given = [robot.carry_out(command, lambda: None) for command in (1, "no number", 2)]
        with pytest.raises(ValueError, match="no number"):
            given[1].result(PATIENCE_S)
        assert [given[at].result(PATIENCE_S) for at in (0, 2)] == [(1.0, "adder"), (3.0, "adder")]
        robot.rested.clear()
        assert robot.rested.wait(PATIENCE_S)


def test_without_a_thread_a_command_is_done_at_once_and_periods_are_recorded_from_time_to_time() -> None:
    robot, kept = Adder(), list[int]()
    robot.cycled()
    answer = robot.carry_out(4, lambda: kept.append(1))
    for _ in range(4):
        robot.cycled()
    assert answer.done()
    assert answer.result() == (4.0, threading.current_thread().name)
    assert len(kept) == 2
