"""Workers of this machine: lasting processes with one thread each, threads, or this process; opening any workers."""

import os
from collections.abc import Callable, Collection, Iterator
from concurrent import futures
from concurrent.futures import Future
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.pool import ThreadPool
from typing import Any

from deformscope.executor.tasks import WorkerLost, Workers
from deformscope.processes import RENEW_S, SPAWN, follow_parent, starting


class HereWorker:
    """This process as a worker: an attempt is finished as soon as it is begun, and the end of this process ends all."""

    capacity = 1

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        attempt = Future[Any]()
        try:
            attempt.set_result(function(*arguments))
        except Exception as error:
            attempt.set_exception(error)
        return attempt

    def ready(self, under_way: Collection[Future[Any]]) -> set[Future[Any]]:
        return futures.wait(under_way, RENEW_S, futures.FIRST_COMPLETED).done

    def result(self, attempt: Future[Any]) -> Any:
        return attempt.result()

    def give_up(self, attempt: Future[Any]) -> None:
        """An attempt in this process cannot be ended."""

    def close(self) -> None:
        """There is nothing to end."""


class ThreadWorkers(HereWorker):
    """Threads of this process, for computations outside the interpreter; an interrupted program ends without them."""

    def __init__(self, count: int) -> None:
        self.capacity, self._pool = count, ThreadPool(count)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        attempt = Future[Any]()
        self._pool.apply_async(function, arguments, callback=attempt.set_result, error_callback=attempt.set_exception)
        return attempt

    def close(self) -> None:
        self._pool.terminate()


class LocalWorkers:
    """Processes, started when needed; one that ends is replaced. An attempt is the pipe to its process."""

    def __init__(self, count: int) -> None:
        self.capacity = count
        self._free: list[Connection] = []
        self._processes: dict[Connection, SpawnProcess] = {}

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Connection:
        pipe = self._free.pop() if self._free else self._begin()
        try:
            pipe.send((function, arguments))
        except OSError:  # it ended while it waited
            self._end(pipe)
            return self.submit(function, *arguments)
        return pipe

    def _begin(self) -> Connection:
        ours, theirs = SPAWN.Pipe()
        process = SPAWN.Process(target=_work, args=(theirs,))
        with starting():
            process.start()
        theirs.close()
        self._processes[ours] = process
        return ours

    def ready(self, under_way: Collection[Connection]) -> set[Any]:
        """Workers that have finished, or whose process has ended: one that it forked may hold its pipe open."""
        return {*wait(under_way, RENEW_S), *(one for one in under_way if not self._processes[one].is_alive())}

    def result(self, attempt: Connection) -> Any:
        try:
            if not attempt.poll():
                raise EOFError
            done, value = attempt.recv()
        except (EOFError, OSError) as error:
            self._end(attempt)
            raise WorkerLost("its process ended: killed, short of memory, or ended by a library") from error
        self._free.append(attempt)
        if not done:
            raise value
        return value

    def give_up(self, attempt: Connection) -> None:
        self._processes[attempt].kill()  # native code that never returns to Python is ended too

    def close(self) -> None:
        for process in self._processes.values():
            process.kill()
        for pipe in list(self._processes):
            self._end(pipe)

    def _end(self, pipe: Connection) -> None:
        process = self._processes.pop(pipe)
        pipe.close()
        process.kill()
        process.join()


def _work(pipe: Connection) -> None:
    """Compute the items from the pipe, one after another, until it is closed or the parent ends."""
    follow_parent()
    while True:
        answer: tuple[bool, Any]
        try:
            function, arguments = pipe.recv()
            answer = True, function(*arguments)
        except (Exception, SystemExit) as error:  # a function that exits is no lost process
            answer = False, error if isinstance(error, Exception) else RuntimeError(f"it exited: {error}")
        try:
            pipe.send(answer)
        except OSError:
            return
        except Exception as error:  # what cannot pass between processes
            pipe.send((False, RuntimeError(f"{type(error).__name__}: {error}")))


def one_thread() -> None:
    """First call in a worker, after which OpenCV uses one thread too."""
    import cv2

    cv2.setNumThreads(1)


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_workers(
    executor: str, address: str | None, workers: int | None, tasks: int | None = None, *, apart: bool = False
) -> Iterator[Workers]:
    """The workers, which are ended at the end of the context, even during a computation.

    executor: `local`, or `ray` at this address; workers: most workers, default: one for each core of this machine or of
    the cluster; tasks: how many there are, None = not known; apart: use a child process even for a single worker.
    Raises InputError if nothing answers at the address."""
    made: Workers
    if executor == "ray":
        from deformscope.executor.ray_cluster import RayWorkers

        made = RayWorkers(address or "", workers)
    else:
        count = core_count() if workers is None else workers
        count = max(count if tasks is None else min(count, tasks), 1)
        made = LocalWorkers(count) if apart or count > 1 else HereWorker()
    try:
        yield made
    finally:
        made.close()
