"""When a reading was taken: one stamp, made once, on a clock that never jumps."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Stamp:
    """When something arrived.

    host_ns: monotonic host clock [ns]; for media without a clock (a video file), the media time since its start [ns]
    device_ticks: the device's own counter or clock, in its own unit; None where it has none
    """

    host_ns: int
    device_ticks: int | None = None


def now() -> Stamp:
    """The present moment on the host's monotonic clock."""
    return Stamp(time.monotonic_ns())
