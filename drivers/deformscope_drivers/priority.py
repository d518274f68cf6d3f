"""Threads that a robot waits for, preferred by the system over everything that is not real time."""

from __future__ import annotations

import contextlib
import os
from concurrent.futures import ThreadPoolExecutor

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
