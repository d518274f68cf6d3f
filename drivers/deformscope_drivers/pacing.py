"""Waiting for a moment on a device's own clock, slots on an absolute schedule, and threads that run before others."""

import contextlib
import os
import threading
from collections import deque
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from deformscope_drivers.clock import Clock
from deformscope_drivers.memory import SimulatedClock


class Pacer:
    """Times for devices that produce readings at a rate.

    clock: the device's; a simulated one advances during the wait"""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._woken = threading.Event()

    def wait_until(self, then_ns: int, timeout_s: float) -> bool:
        """Wait for a moment [ns], `timeout_s` at most; whether it has come. `wake` ends the wait early."""
        until_ns = min(then_ns, self._clock() + round(max(timeout_s, 0.0) * 1e9))
        if isinstance(self._clock, SimulatedClock):
            self._clock.advance_to(until_ns)
        else:
            self._woken.wait(max(until_ns - self._clock(), 0) / 1e9)
            self._woken.clear()
        return self._clock() >= then_ns

    def wake(self) -> None:
        """End a wait of another thread's; one that comes later ends at once."""
        self._woken.set()


LATENESS_COUNT = 1000


class SlotPacer:
    """Slots of equal length. A missed slot is counted and not sent later: no burst follows a stall."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.slots = 0
        self.missed = 0
        self.latest_ns = 0
        self.due_ns = 0
        self._lateness_ns: deque[int] = deque(maxlen=LATENESS_COUNT)

    def start(self, now_ns: int) -> None:
        """The first slot is due now."""
        self.due_ns = now_ns

    def enter(self, now_ns: int) -> int:
        """Enter the slot that is due: how late [ns]. The next one is due at its own time on the same schedule."""
        late_ns = max(0, now_ns - self.due_ns)
        missed = late_ns // self.period_ns
        self.slots += 1
        self.missed += missed
        self.latest_ns = max(self.latest_ns, late_ns)
        self._lateness_ns.append(late_ns)
        self.due_ns += (missed + 1) * self.period_ns
        return late_ns

    def lateness_ms(self) -> tuple[float, float, float]:
        """Median and 99th percentile over the last thousand slots, and the greatest of all [ms]."""
        lately = list(self._lateness_ns)
        if not lately:
            return 0.0, 0.0, 0.0
        median, high = np.percentile(lately, (50, 99)) / 1e6
        return float(median), float(high), self.latest_ns / 1e6


STEERING, READING, SENDING = 10, 11, 12
"""Priorities of threads that move an arm or a hand, that read its devices, and of a simulated device, which shares the
machine with them; of 1 to 99, below the system's own (interrupts have 50). Chosen."""


def be_prompt(priority: int) -> bool:
    """Have the calling thread run as soon as it is ready, under any load of the machine (SCHED_RR). Returns whether the
    system allows this user to. Elsewhere the thread is unchanged. Its child processes are ordinary, at nice 0.

    Such a thread should mostly wait. Another thread of the same program that holds Python's lock still holds it up."""
    with contextlib.suppress(AttributeError, OSError):  # no Linux; not allowed
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        return True
    return False


def may_be_prompt() -> bool:
    """Whether the system allows this user such threads."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(be_prompt, SENDING).result()
