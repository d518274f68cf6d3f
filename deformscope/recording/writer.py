"""A thread that does jobs in their order, so that the caller never waits for a disk."""

import threading
from collections import deque
from collections.abc import Callable

Job = Callable[[], None]


class Writer:
    """Does jobs that any thread may `put`, one after the other in a separate thread.

    tick: called after each job and at the least every `tick_s`; the first job or tick that fails ends the thread, and
    every later `put` raises its error; capacity_jobs, capacity_bytes: largest number and size of jobs that wait
    overrun: makes the error, from the number of waiting bytes, if too many wait; None = the caller waits instead, as
    for a file or a simulation"""

    def __init__(
        self,
        tick: Job,
        tick_s: float,
        capacity_jobs: int,
        capacity_bytes: int,
        overrun: Callable[[int], Exception] | None = None,
    ) -> None:
        self.failure: Exception | None = None
        self._tick, self._tick_s = tick, tick_s
        self._capacity, self._overrun = (capacity_jobs, capacity_bytes), overrun
        self._jobs: deque[tuple[Job, int]] = deque()
        self._bytes = self._given = self._done = 0
        self._closing = False
        self._changed = threading.Condition()
        # A daemon: a disk that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._work, name="deformscope-writer", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, job: Job, size: int) -> None:
        """Add a job. size: bytes of memory that it holds. Raises the writer's error."""
        with self._changed:
            while self._is_full(size) and self.failure is None:
                if self._overrun is not None:
                    self.failure = self._overrun(self._bytes)
                    break
                self._changed.wait()
            if self.failure is not None:
                raise self.failure
            self._jobs.append((job, size))
            self._bytes += size
            self._given += 1
            self._changed.notify_all()

    def check(self) -> None:
        """Raise the writer's error."""
        if self.failure is not None:
            raise self.failure

    def settle(self, timeout_s: float) -> None:
        """Return when all jobs are done, the writer has failed, or the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._done == self._given or self.failure is not None, timeout_s)

    @property
    def thread_id(self) -> int | None:
        """The system's number of the thread; None before it began."""
        return self._thread.native_id

    @property
    def waiting_bytes(self) -> int:
        """Memory of the waiting jobs."""
        return self._bytes

    def close(self, timeout_s: float, last: Job | None = None) -> bool:
        """Do waiting jobs, then the last one, unless one of them takes longer than the time; return whether the thread
        has ended."""
        with self._changed:
            if last is not None and self.failure is None:
                self._jobs.append((last, 0))
            self._closing = True
            self._changed.notify_all()
        done = -1
        while self._thread.is_alive() and self._done != done:
            done = self._done
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _is_full(self, size: int) -> bool:
        jobs, most_bytes = self._capacity
        return len(self._jobs) >= jobs or (self._bytes > 0 and self._bytes + size > most_bytes)

    def _work(self) -> None:
        try:
            while (entry := self._next()) is not None:
                job, size = entry
                job()
                self._tick()
                with self._changed:
                    self._bytes -= size
                    self._done += job is not _nothing
                    self._changed.notify_all()
                del job, entry  # what a job keeps alive is freed while the next is waited for
        except Exception as error:
            with self._changed:
                self.failure = self.failure or error
                self._jobs.clear()
                self._changed.notify_all()

    def _next(self) -> tuple[Job, int] | None:
        """The next job, or one that does nothing where none came in time; None at the end."""
        with self._changed:
            if not self._jobs and not self._closing:
                self._changed.wait(self._tick_s)
            if self.failure is not None:
                return None
            if self._jobs:
                return self._jobs.popleft()
            return None if self._closing else (_nothing, 0)


def _nothing() -> None:
    pass
