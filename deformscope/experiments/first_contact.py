"""Time of the first contact, by a recording's force sensors and tactile arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.device_stages import TOUCHING_N
from deformscope.frames import SessionNote, TactileFrame, WrenchFrame
from deformscope.recording.item_rows import Row
from deformscope.stages.map.exploration import PhaseStart
from deformscope.stages.squeeze.events import EventRule, OnsetDetector

KINDS = (WrenchFrame, TactileFrame, SessionNote, PhaseStart)
"""Kinds of frames and notes that first contact is found from."""
FOLLOW_S = 5.0
"""Time constant by which the force without contact follows the readings [s]."""


def first_contact_ns(rows: Sequence[Row]) -> int | None:
    """Session time of the first contact [ns], None = there is none. rows: a recording's rows, in order of time

    The beginning of an exploration's first press. Else by a force sensor: the first reading TOUCHING_N away from
    the force without contact. That force is followed until then as fast as sensors drift, and starts again after a
    tare. By a tactile array: the rule of `squeeze`, for each of its pads; whichever was first.
    """
    if phases := [row for row in rows if isinstance(row.item, PhaseStart)]:
        return next((row.session_ns for row in phases if row.item.name == "press"), None)
    free_n: dict[str, tuple[FloatArray, int]] = {}
    onsets: dict[str, OnsetDetector] = {}
    for row in rows:
        item = row.item
        if isinstance(item, WrenchFrame) and np.isfinite(item.force_n).all():
            force_n = item.force_n[0]
            free, before_ns = free_n.get(item.device, (force_n, row.session_ns))
            if float(np.linalg.norm(force_n - free)) > TOUCHING_N:
                return row.session_ns
            share = -math.expm1((before_ns - row.session_ns) / 1e9 / FOLLOW_S)
            free_n[item.device] = free + share * (force_n - free), row.session_ns
        elif isinstance(item, SessionNote) and item.about == "tare":
            free_n.pop(item.text, None)
        elif isinstance(item, TactileFrame):
            onset = onsets.setdefault(item.device, OnsetDetector(EventRule()))
            ends = np.cumsum([pad.size for pad in item.pressure_pa])[:-1]
            sums = np.array([float(pad.sum(dtype=np.int64)) for pad in np.split(item.counts, ends)])
            if onset.feed(row.session_ns, sums):
                return onset.first_ns
    return None
