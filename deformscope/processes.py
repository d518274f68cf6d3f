"""Child processes that compute or simulate."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.connection import Connection, wait
from types import ModuleType
from typing import Any

from deformscope.errors import show_remarks

SPAWN = multiprocessing.get_context("spawn")
"""Start method of processes: locks of other threads do not survive a fork."""
END_S = 5.0
"""Time limit for a process to end, after which it is killed."""
NICE, LAST_NICE = 10, 19
"""Child processes of a robot run leave the processor to the control loop; those that follow devices leave it to all
others."""
RENEW_S = 0.5
"""Period of renewing long waits of the main thread: a signal that arrives just before a wait begins does not end it,
and its handler runs only after the wait."""
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def release_memory() -> None:
    """Return freed memory to the system. glibc keeps it, and grows without end where large arrays come
    and go between small ones that stay. It does nothing with another C library."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """A context in which processes start with one thread of BLAS. They do not import the user's script: it would run
    again in each, unless it is guarded by `if __name__ == "__main__"`. A Ctrl-C does not end them during their start,
    which takes seconds; this process handles it afterwards."""
    kept = {name: os.environ.get(name) for name in BLAS_THREADS}
    main = sys.modules["__main__"]
    os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))
    sys.modules["__main__"] = ModuleType("__main__")
    passed_on = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, passed_on)
        sys.modules["__main__"] = main
        for name, value in kept.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def computing(begin: Callable[..., object], *given: Any, nice: int = NICE) -> Iterator[ProcessPoolExecutor]:
    """A process of low priority that calls `begin(*given)` first; at the end of the context it is ended, even during a
    computation."""
    with starting():
        executor = ProcessPoolExecutor(1, SPAWN, _follow_low, (nice, begin, *given))
        process_id = executor.submit(os.getpid)
    try:
        yield executor
    finally:
        began = process_id.done()
        with contextlib.suppress(Exception):  # it may have ended
            os.kill(process_id.result(0.0), signal.SIGKILL)
        executor.shutdown(wait=began, cancel_futures=True)


def _follow_low(nice: int, begin: Callable[..., object], *given: Any) -> None:
    follow_parent()
    if nice:
        os.setpriority(os.PRIO_PROCESS, 0, max(nice, os.getpriority(os.PRIO_PROCESS, 0)))
    begin(*given)


@contextlib.contextmanager
def child_process(name: str, target: Callable[..., None], *arguments: Any, nice: int = 0) -> Iterator[Connection]:
    """Run `target(pipe, *arguments)` in such a process, which is to end when the pipe does; yields the other end.

    nice: its priority, unless this process's is lower; 0 = that of this process"""
    ours, theirs = SPAWN.Pipe()
    given = (nice, target, theirs, *arguments)
    process = SPAWN.Process(target=_follow_low, args=given, name=name, daemon=True)
    with starting():
        process.start()
    theirs.close()
    try:
        yield ours
    finally:
        ours.close()
        process.join(END_S)
        if process.is_alive():
            process.kill()
            process.join()


def follow_parent(*pipes: Connection) -> None:
    """First call in such a process: it ends with its parent, for any reason, or with the other end of a pipe, and
    leaves signals to its parent. A Ctrl-C at a terminal reaches all of them."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    show_remarks()
    threading.Thread(target=_end_with, args=pipes, name="parent", daemon=True).start()


def _end_with(*pipes: Connection) -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel, *pipes])
        os._exit(1)
