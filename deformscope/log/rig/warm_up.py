"""The first call of each kind costs up to half a second: made once, on small things, before any device is opened."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from deformscope.frames import (
    ColorFrame,
    DepthFrame,
    HealthReport,
    Item,
    LinkChange,
    RawBytes,
    TactileFrame,
    WrenchFrame,
)
from deformscope_drivers.clock import Stamp
from deformscope_drivers.health import Health, Link, LinkEvent

if TYPE_CHECKING:
    from collections.abc import Iterator


def small_items() -> Iterator[Item]:
    """One of each kind that costs something at first."""
    stamp, nothing = Stamp(0), np.zeros(3)
    yield WrenchFrame(stamp, 0, np.zeros(3, np.int64), nothing[None])
    yield TactileFrame(stamp, 0, np.zeros(4, np.uint16), (np.zeros((2, 2)),))
    yield ColorFrame(stamp, 0, np.zeros((16, 16, 3), np.uint8), "color")
    yield DepthFrame(stamp, 0, np.full((16, 16), 1000, np.uint16), 0.001)
    yield RawBytes(0, b"\0", False, "wrench")
    yield LinkChange(LinkEvent(0, Link.CONNECTED), "wrench")
    yield HealthReport(0, (("wrench", Health(Link.CONNECTED)),))


def nowhere() -> rr.RecordingStream:
    """A stream whose data go nowhere."""
    rec = rr.RecordingStream("deformscope-warm-up", send_properties=False)
    rec.memory_recording()
    return rec
