"""The loop: every frame is recorded before its results, an experiment may speak after the last, and neither a robot nor
a computation is waited for."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from deformscope.experiments.live.live_stages import live_stages
from deformscope.frames import ColorFrame, HealthReport, Item, SessionNote
from deformscope.session import Compute, Experiment, Inline, Moment, RigExperiment, Step, ask, finish, run
from deformscope_drivers.clock import Stamp
from tests.patience import PATIENCE_S


@dataclass
class Notes:
    said: list[object] = field(default_factory=list)

    def write(self, items: Any) -> None:
        match items:
            case ColorFrame():
                self.said.append(items.index)
            case Step(moment=Moment() as moment):
                self.said.append((items.results, moment.now_ns, moment.touch))
            case Step():
                self.said.append(items)
            case _:
                self.said += items


def frames(count: int) -> list[ColorFrame]:
    return [ColorFrame(Stamp(index), index, np.zeros((2, 2), np.uint8)) for index in range(count)]


def echo() -> Experiment[str]:
    frame = yield Step(("never recorded",))
    seen = []
    while frame is not None:
        seen.append(frame.index)
        frame = yield Step((f"saw {frame.index}",))
    for index in seen:
        yield Step((f"again {index}",), frame=index)
    return "summary"


def test_order() -> None:
    notes = Notes()
    assert run(frames(2), echo(), notes) == "summary"
    assert notes.said == [
        0,
        Step(("saw 0",)),
        1,
        Step(("saw 1",)),
        Step(("again 0",), frame=0),
        Step(("again 1",), frame=1),
    ]


def test_an_experiment_may_end_early() -> None:
    def one() -> Experiment[int]:
        frame = yield Step()
        return frame.index

    notes = Notes()
    assert run(frames(3), one(), notes) == 0
    assert notes.said == [0]


def test_no_frames() -> None:
    assert run([], echo(), Notes()) == "summary"


class Rig:
    """Gives one report at each look."""

    def __init__(self) -> None:
        self.count = 0
        self.closed = False

    def take(self, wait_s: float) -> list[Item]:
        self.count += 1
        return [HealthReport(self.count, ())]

    def look(self) -> HealthReport:
        return HealthReport(-1, ())

    def rest(self) -> list[Item]:
        return [HealthReport(0, ())] if self.closed else []

    def close(self) -> None:
        self.closed = True


def test_a_rig_is_recorded_until_it_is_enough_and_nothing_is_left() -> None:
    rig, notes = Rig(), Notes()
    run(rig, live_stages((), {}, lambda items: rig.count == 3), notes)
    last = finish(rig, notes)
    assert notes.said == [HealthReport(number, ()) for number in (1, 2, 3, 0, -1)]
    assert last == HealthReport(-1, ())


def test_what_an_experiment_notes_is_recorded_before_its_results() -> None:
    def experiment() -> RigExperiment[None]:
        yield Step()
        yield Step(("a result",), notes=(SessionNote(5, "stage", "beta gives nothing: too dark"),))

    notes = Notes()
    run(Rig(), experiment(), notes)
    assert notes.said[1:3] == [
        SessionNote(5, "stage", "beta gives nothing: too dark"),
        Step(("a result",), notes=(SessionNote(5, "stage", "beta gives nothing: too dark"),)),
    ]


@pytest.mark.parametrize("made", [Inline, lambda: ThreadPoolExecutor(1)])
def test_frames_go_on_while_something_is_computed(made: Callable[[], Any]) -> None:
    """Where it is computed beside the loop, it ends only once the loop has recorded on."""
    rig, notes = Rig(), Notes()
    inline = made is Inline

    def slow(number: int) -> int:
        while not inline and rig.count < 3:
            pass
        return number + 1

    def computing() -> RigExperiment[int]:
        found: int = yield from ask(Compute(slow, (1,)), ("began",), Moment(5, 1))
        return found

    with made() as executor:
        assert run(rig, computing(), notes, executor=executor) == 2
    assert notes.said[0] == (("began",), 5, 1)
    assert rig.count >= (1 if inline else 3)


class Robot:
    """Carries out a command once it is let."""

    def __init__(self) -> None:
        self.stopped: Future[None] = Future()
        self.let = threading.Event()

    def carry_out(self, command: object, keep: object) -> Future[Any]:
        future: Future[Any] = Future()

        def work() -> None:
            assert self.let.wait(PATIENCE_S)
            if command == "fail":
                future.set_exception(ValueError("no way"))
            else:
                future.set_result(f"done: {command}")

        threading.Thread(target=work).start()
        return future

    def reports(self) -> list[Step]:
        return [Step(("a phase",), moment=Moment(7))] if not self.let.is_set() else []


def test_answers_come_and_errors_are_raised_where_they_are_waited_for() -> None:
    robot, rig, notes = Robot(), Rig(), Notes()

    def acting() -> RigExperiment[list[object]]:
        given = yield Step(command="touch")
        batches = 0
        while isinstance(given, Sequence):
            batches += 1
            if batches == 2:
                robot.let.set()
            given = yield Step()
        with pytest.raises(ValueError, match="no way"):
            yield from ask("fail")
        return [given.value if given is not None else None, batches >= 2]

    assert run(rig, acting(), notes, robot) == ["done: touch", True]
    assert (("a phase",), 7, 0) in notes.said


def test_a_robot_that_stops_by_itself_ends_what_is_computed() -> None:
    """It is heeded once: what comes after, such as a wait, is carried out."""
    robot, never = Robot(), threading.Event()
    robot.let.set()
    robot.stopped.set_exception(ValueError("force sensor silent"))

    def computing() -> RigExperiment[object]:
        with pytest.raises(ValueError, match="silent"):
            yield from ask(Compute(never.wait, (PATIENCE_S,)))
        never.set()
        answer: object = yield from ask("wait")
        return answer

    with ThreadPoolExecutor(1) as executor:
        assert run(Rig(), computing(), Notes(), robot, executor) == "done: wait"


def test_what_keeps_a_rig_from_being_recorded_ends_the_session() -> None:
    class Full(Notes):
        def write(self, items: object) -> None:
            raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk"):
        run(Rig(), live_stages((), {}, lambda items: False), Full())
