"""Time of the next point: slots of 10 ms on an absolute schedule, and statistics of their delays."""

from __future__ import annotations

from collections import deque

import numpy as np

LATENESS_KEPT = 1000


class SlotPacer:
    """Slots of equal length. A missed slot is counted and not sent later: no burst follows a stall."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.slots = 0
        self.missed = 0
        self.latest_ns = 0
        self.due_ns = 0
        self._lateness_ns: deque[int] = deque(maxlen=LATENESS_KEPT)

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
