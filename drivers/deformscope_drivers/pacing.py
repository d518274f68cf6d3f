"""Waiting for a moment on a device's own clock: on the host's it sleeps, on a simulated one it moves the clock on."""

from __future__ import annotations

import threading

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
        elif (left_ns := until_ns - self._clock()) > 0:
            self._woken.wait(left_ns / 1e9)
        self._woken.clear()
        return self._clock() >= then_ns

    def wake(self) -> None:
        """End a wait of another thread's; one that comes later ends at once."""
        self._woken.set()
