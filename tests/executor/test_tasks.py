"""Tasks that workers compute: all outcomes, each with its reason, whatever becomes of a worker."""

import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from deformscope.errors import InputError
from deformscope.executor.local import HereWorker, LocalWorkers, ThreadWorkers, open_workers
from deformscope.executor.tasks import ATTEMPTS, OtherVersion, Workers, compute, compute_all, run_attempt
from deformscope.processes import BLAS_THREADS
from tests.patience import PATIENCE_S


def paths_of_tests() -> dict[str, str]:
    """The environment in which a process imports what this one does."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


@pytest.fixture(
    params=[HereWorker, lambda: ThreadWorkers(2), lambda: LocalWorkers(2)], ids=["here", "threads", "processes"]
)
def workers(request: pytest.FixtureRequest) -> Iterator[Workers]:
    made: Workers = request.param()
    yield made
    made.close()


@pytest.fixture
def two() -> Iterator[LocalWorkers]:
    made = LocalWorkers(2)
    yield made
    made.close()


def square(number: int) -> tuple[int, int]:
    if number == 13:
        raise InputError("a number that is liked", str(number))
    return number * number, os.getpid()


def test_all_are_computed_by_warm_workers_and_what_is_refused_is_not_tried_again(workers: Workers) -> None:
    found = {one.item: one for one in compute(workers, square, range(20))}
    assert {item: one.value[0] for item, one in found.items() if one.value} == {
        number: number**2 for number in range(20) if number != 13
    }
    assert isinstance(found[13].error, InputError)
    assert found[13].reasons == ("expected a number that is liked; got 13",)
    assert len({one.value[1] for one in found.values() if one.value}) <= workers.capacity
    assert list(compute(workers, square, [])) == []


def test_one_worker_is_this_process_unless_it_is_to_stand_apart() -> None:
    with open_workers("local", None, 1) as here:
        assert [one.value for one in compute(here, square, [2])] == [(4, os.getpid())]
    with open_workers("local", None, 1, apart=True) as apart:
        assert [one.value != (4, os.getpid()) for one in compute(apart, square, [2])] == [True]


def test_results_come_in_the_order_of_their_items_and_the_first_error_ends_it() -> None:
    done: list[None] = []
    squares = compute_all(ThreadWorkers(3), square, range(12), lambda: done.append(None))
    assert [value for value, _ in squares] == [number**2 for number in range(12)]
    assert len(done) == 12
    with pytest.raises(InputError, match="liked; got 13"):
        compute_all(ThreadWorkers(3), square, [13] + [1] * 100, lambda: None)


def ends_its_worker(task: tuple[Path, int]) -> int:
    """As a library does that ends the process: always, or the first time alone. task: folder of traces, number"""
    folder, number = task
    with (folder / str(number)).open("a") as file:
        file.write("begun\n")
    if number == 3 or (number == 5 and (folder / "5").read_text().count("begun") == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_task_that_ends_its_worker_is_tried_again_and_ends_no_other(two: LocalWorkers, tmp_path: Path) -> None:
    found = {one.item[1]: one for one in compute(two, ends_its_worker, [(tmp_path, number) for number in range(9)])}
    assert {number: one.value for number, one in found.items()} == {**{n: n for n in range(9)}, 3: None}
    assert [len(found[number].reasons) for number in (2, 3, 5)] == [0, ATTEMPTS, 1]
    assert all("its process ended" in reason for reason in found[3].reasons)
    begun = Counter({path.name: path.read_text().count("begun") for path in tmp_path.iterdir()})
    assert begun == {**dict.fromkeys("01246 78".replace(" ", ""), 1), "3": ATTEMPTS, "5": 2}


def leaves_a_process(note: Path) -> None:
    """It ends while a process that it forked, which has its pipe too, goes on."""
    if (helper := os.fork()) == 0:
        time.sleep(3600.0)
    note.write_text(str(helper))
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_whose_forked_process_goes_on_is_lost(two: LocalWorkers, tmp_path: Path) -> None:
    note = tmp_path / "helper"
    (found,) = compute(two, leaves_a_process, [note], attempts=1)
    os.kill(int(note.read_text()), signal.SIGKILL)
    assert "its process ended" in found.reasons[0]


def refused_by_the_system(folder: Path) -> int:
    tries = folder / "tries"
    tries.write_text(tries.read_text() + "x" if tries.exists() else "x")
    if len(tries.read_text()) < ATTEMPTS:
        raise OSError(28, "No space left on device", "frames.bin")
    return len(tries.read_text())


def test_a_full_disk_at_a_worker_is_named_and_tried_again(workers: Workers, tmp_path: Path) -> None:
    (found,) = compute(workers, refused_by_the_system, [tmp_path])
    assert found.value == ATTEMPTS
    assert found.reasons == ("the system refused: No space left on device | frames.bin",) * (ATTEMPTS - 1)


def an_hour(item: str) -> str:
    if item == "an hour":
        time.sleep(3600.0)
    return item


def test_what_takes_too_long_is_ended_and_named(two: LocalWorkers) -> None:
    assert len(list(compute(two, an_hour, ["short", "short"]))) == 2  # both have begun: that counts too
    found = {one.item: one for one in compute(two, an_hour, ["an hour", "short"], attempts=2, limit_s=1.0)}
    assert found["short"].value == "short"
    assert found["an hour"].reasons == ("it took longer than 1 s",)


class Unfit(Exception):
    """It cannot pass between processes."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first)


def raises_unfit(item: int) -> int:
    raise Unfit("one", "two")


def test_an_error_that_cannot_pass_between_processes_passes_as_words(two: LocalWorkers) -> None:
    (found,) = compute(two, raises_unfit, [1])
    assert found.reasons == ("RuntimeError: Unfit: one",)


def environment(item: int) -> list[str | None]:
    return [os.getenv(name) for name in BLAS_THREADS]


def test_a_task_that_exits_is_a_reason_and_is_not_tried_again(two: LocalWorkers) -> None:
    (outcome,) = compute(two, sys.exit, ["no data in it"])
    assert str(outcome.error) == "it exited: no data in it"
    assert outcome.reasons == ("RuntimeError: it exited: no data in it",)


def test_each_has_one_thread(two: LocalWorkers) -> None:
    assert [one.value for one in compute(two, environment, [0, 1])] == [["1", "1", "1"]] * 2


def test_no_more_is_taken_than_there_is_room_for(workers: Workers) -> None:
    """So that memory does not grow with the number of tasks."""
    taken = 0

    def items() -> Iterator[int]:
        nonlocal taken
        for number in range(1000):
            taken = number + 1
            yield number

    for done, _ in enumerate(compute(workers, square, items()), start=1):
        assert taken - done <= 2 * workers.capacity


def test_a_worker_of_another_version_ends_it() -> None:
    with pytest.raises(OtherVersion, match=r"workers of version 0\.0\.7; got one of"):
        run_attempt("0.0.7", None, square, 3)


def process_or_hour(item: str) -> int:
    an_hour(item)
    return os.getpid()


@pytest.mark.parametrize("how", ["Ctrl-C", "no further item is wanted"])
def test_what_is_computed_is_given_up_where_the_caller_breaks_off(how: str) -> None:
    workers = LocalWorkers(2)
    coming = compute(workers, process_or_hour, ["the process"] * 8 + ["an hour"] * 8)
    seen = {next(coming).value for _ in range(8)}
    if how == "Ctrl-C":
        with pytest.raises(KeyboardInterrupt):
            coming.throw(KeyboardInterrupt)  # type: ignore[attr-defined]
    workers.close()
    assert not any(Path(f"/proc/{one}").exists() for one in seen)


MISSED = """
import signal, threading, time
from deformscope.executor.local import LocalWorkers, ThreadWorkers
from deformscope.executor.tasks import compute

def interrupt_late():
    time.sleep(2.0)
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)
    time.sleep(3600.0)

if __name__ == "__main__":
    threading.Thread(target=interrupt_late, daemon=True).start()
    workers = WORKERS(2)
    try:
        for _ in compute(workers, time.sleep, [3600.0] * 2): pass
    finally:
        workers.close()
"""


@pytest.mark.parametrize("kind", ["LocalWorkers", "ThreadWorkers"])
def test_a_ctrl_c_that_does_not_end_a_wait_is_handled(kind: str, tmp_path: Path) -> None:
    """Taken by another thread it wakes the main one as little as one that comes just before its wait begins."""
    script = tmp_path / "script.py"
    script.write_text(MISSED.replace("WORKERS", kind))
    command = [sys.executable, str(script)]
    ran = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, check=False, env=paths_of_tests())
    assert b"KeyboardInterrupt" in ran.stderr


def holds_the_interpreter(item: str) -> str:
    """Native code that never returns to Python: no thread of the process runs while it does."""
    return re.sub(r"(a+)+$", "", "a" * 64 + "b") if item == "hangs" else item


def test_what_never_returns_to_python_is_ended_too(two: LocalWorkers) -> None:
    list(compute(two, an_hour, ["short", "short"]))
    found = {one.item: one for one in compute(two, holds_the_interpreter, ["hangs", "short"], limit_s=1.0)}
    assert found["short"].value == "short"
    assert found["hangs"].reasons == ("it took longer than 1 s",)


def unfit_value(item: int) -> object:
    return lambda: item


def test_a_value_that_cannot_pass_between_processes_is_a_reason(two: LocalWorkers) -> None:
    (found,) = compute(two, unfit_value, [1])
    assert "pickle" in found.reasons[0]
