"""Who hands jobs over never waits for them, and learns of their failure. Nothing here depends on how fast anything is:
what takes long waits for an event."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from deformscope.recording.portions import arrays_size
from deformscope.recording.writer import Writer
from tests.patience import PATIENCE_S


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """Opened at the latest when the test has ended."""
    opened = threading.Event()
    yield opened
    opened.set()


def nothing() -> None:
    pass


def started(tick: object = None, jobs: int = 1000, most_bytes: int = 1000, overrun: object = None) -> Writer:
    writer = Writer(tick or nothing, 0.01, jobs, most_bytes, overrun)  # type: ignore[arg-type]
    writer.start()
    return writer


def blocked(writer: Writer, gate: threading.Event, size: int = 0) -> None:
    """Return once a job is under way that waits for the gate."""
    begun = threading.Event()

    def wait() -> None:
        begun.set()
        gate.wait(PATIENCE_S)

    writer.put(wait, size)
    assert begun.wait(PATIENCE_S)


def test_jobs_are_done_in_order_and_nobody_waits(gate: threading.Event) -> None:
    writer, order = started(), list[int]()
    blocked(writer, gate)
    for number in range(100):
        writer.put(lambda number=number: order.append(number), 1)  # type: ignore[misc]
    assert order == []
    assert not gate.is_set()  # all were handed over while the first still waited
    gate.set()
    assert writer.close(PATIENCE_S)
    assert order == list(range(100))
    assert writer.waiting_bytes == 0


def test_a_failure_ends_it_and_reaches_whoever_comes_next(gate: threading.Event) -> None:
    writer, order = started(), list[int]()

    def fail() -> None:
        raise OSError("no disk")

    blocked(writer, gate)
    writer.put(fail, 0)
    writer.put(lambda: order.append(1), 0)
    gate.set()
    assert writer.close(PATIENCE_S)
    assert order == []
    for _ in range(2):
        with pytest.raises(OSError, match="no disk"):
            writer.put(nothing, 0)


def test_it_looks_about_while_there_is_nothing_to_do() -> None:
    looks, seen = list[int](), threading.Event()

    def tick() -> None:
        looks.append(1)
        if len(looks) == 5:
            seen.set()
            raise OSError("the disk is full")

    writer = started(tick)
    assert seen.wait(PATIENCE_S)
    assert writer.close(PATIENCE_S)
    with pytest.raises(OSError, match="full"):
        writer.put(nothing, 0)


def test_too_much_that_waits_is_an_error_where_nobody_can_wait(gate: threading.Event) -> None:
    writer = started(most_bytes=1000, overrun=lambda waiting: OSError(f"{waiting} bytes behind"))
    blocked(writer, gate, 400)
    writer.put(nothing, 600)
    for _ in range(2):
        with pytest.raises(OSError, match="1000 bytes behind"):
            writer.put(nothing, 1)
    gate.set()
    assert writer.close(PATIENCE_S)


def test_one_job_of_any_size_fits() -> None:
    writer, done = started(most_bytes=10), list[int]()
    writer.put(lambda: done.append(1), 1000)
    assert writer.close(PATIENCE_S)
    assert done == [1]


@pytest.mark.parametrize(("jobs", "size"), [(3, 0), (1000, 400)], ids=["by count", "by bytes"])
def test_whoever_can_wait_waits_for_room(gate: threading.Event, jobs: int, size: int) -> None:
    writer, done, handed = started(jobs=jobs), list[int](), list[int]()
    blocked(writer, gate)
    full = threading.Event()

    def hand_over() -> None:
        for number in range(20):
            writer.put(lambda number=number: done.append(number), size)  # type: ignore[misc]
            handed.append(number)
            if len(handed) == 2:
                full.set()

    source = threading.Thread(target=hand_over)
    source.start()
    assert full.wait(PATIENCE_S)
    assert len(handed) <= 3
    gate.set()
    source.join(PATIENCE_S)
    assert writer.close(PATIENCE_S, lambda: done.append(20))
    assert done == list(range(21))


def test_one_that_waits_for_room_learns_of_the_failure(gate: threading.Event) -> None:
    writer, told, waits = started(jobs=1), list[Exception](), threading.Event()

    def fail() -> None:
        gate.wait(PATIENCE_S)
        raise OSError("no disk")

    def hand_over() -> None:
        try:
            for number in range(3):
                waits.set()
                writer.put(fail if number == 0 else nothing, 0)
        except OSError as error:
            told.append(error)

    source = threading.Thread(target=hand_over)
    source.start()
    assert waits.wait(PATIENCE_S)
    gate.set()
    source.join(PATIENCE_S)
    assert [str(one) for one in told] == ["no disk"]


def test_one_that_hangs_is_left_behind_and_one_that_gets_on_is_not(gate: threading.Event) -> None:
    writer = started(jobs=1)
    blocked(writer, gate, 7)
    writer.put(nothing, 0)
    assert not writer.close(0.01, nothing)  # which waits for no room either
    assert writer.waiting_bytes == 7
    gate.set()
    assert writer.close(PATIENCE_S)


def test_what_a_result_holds_within_others_counts_as_waiting() -> None:
    pose = np.zeros((4, 4))
    track = Track((Pose(pose), Pose(pose)), {"depth": np.zeros(10, np.float32)}, "name")
    assert arrays_size(track) == 2 * pose.nbytes + 40
    assert arrays_size((track, [pose])) == 3 * pose.nbytes + 40


@dataclass(frozen=True)
class Pose:
    matrix: Any


@dataclass(frozen=True)
class Track:
    poses: tuple[Pose, ...]
    images: dict[str, Any]
    name: str
