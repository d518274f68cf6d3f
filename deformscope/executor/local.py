"""Workers of this machine: processes that stay, each with one thread; threads; or this process."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.pool import ThreadPool
from typing import Any

from deformscope.executor.tasks import WorkerLost
from deformscope.processes import RENEW_S, SPAWN, follow_parent, starting


class HereWorker:
    """This process: an attempt is done when it is begun, and what ends the process ends all."""

    capacity = 1

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        attempt = Future[Any]()
        try:
            attempt.set_result(function(*arguments))
        except Exception as error:
            attempt.set_exception(error)
        return attempt

    def ready(self, under_way: Collection[Future[Any]]) -> list[Future[Any]]:
        return list(under_way)

    def result(self, attempt: Future[Any]) -> Any:
        return attempt.result()

    def give_up(self, attempt: Future[Any]) -> None:
        """It is done already."""

    def close(self) -> None:
        """There is nothing to end."""


class ThreadWorkers:
    """Threads of this process, for what is computed below Python of arrays that are here; they keep no program alive
    that is interrupted."""

    def __init__(self, count: int) -> None:
        self.capacity, self._pool = count, ThreadPool(count)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        attempt = Future[Any]()
        self._pool.apply_async(function, arguments, callback=attempt.set_result, error_callback=attempt.set_exception)
        return attempt

    def ready(self, under_way: Collection[Future[Any]]) -> set[Future[Any]]:
        return wait(under_way, RENEW_S, FIRST_COMPLETED).done

    def result(self, attempt: Future[Any]) -> Any:
        return attempt.result()

    def give_up(self, attempt: Future[Any]) -> None:
        """A thread cannot be ended."""

    def close(self) -> None:
        self._pool.terminate()


@dataclass(frozen=True, slots=True)
class _Process:
    """pool: of one process, so that it is known which task a process ended with; ours: the process ends with it"""

    pool: ProcessPoolExecutor
    ours: Connection

    @classmethod
    def new(cls) -> _Process:
        ours, theirs = SPAWN.Pipe()
        return cls(ProcessPoolExecutor(1, SPAWN, follow_parent, (theirs,)), ours)


class LocalWorkers:
    """So many processes, begun as they are needed; one that ends is replaced."""

    def __init__(self, count: int) -> None:
        self.capacity = count
        self._free: list[_Process] = []
        self._busy: dict[Future[Any], _Process] = {}

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        process = self._free.pop() if self._free else _Process.new()
        try:
            with starting():
                attempt: Future[Any] = process.pool.submit(function, *arguments)
        except BrokenProcessPool:  # it ended while it waited
            _end(process)
            return self.submit(function, *arguments)
        self._busy[attempt] = process
        return attempt

    def ready(self, under_way: Collection[Future[Any]]) -> set[Future[Any]]:
        return wait(under_way, RENEW_S, FIRST_COMPLETED).done

    def result(self, attempt: Future[Any]) -> Any:
        process = self._busy.pop(attempt)
        try:
            found = attempt.result()
        except BrokenProcessPool as error:
            _end(process)
            raise WorkerLost("its process ended: killed, short of memory, or ended by a library") from error
        except Exception:
            self._free.append(process)
            raise
        self._free.append(process)
        return found

    def give_up(self, attempt: Future[Any]) -> None:
        self._busy[attempt].ours.close()

    def close(self) -> None:
        every = [*self._free, *self._busy.values()]
        self._free, self._busy = [], {}
        for process in every:
            process.ours.close()
        for process in every:
            _end(process)


def _end(process: _Process) -> None:
    process.ours.close()
    process.pool.shutdown(cancel_futures=True)


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
