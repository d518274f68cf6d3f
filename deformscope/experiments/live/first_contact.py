"""Time of the first contact, by a recording's force sensors and tactile arrays."""

import math
from collections.abc import Sequence

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.live.device_stages import TOUCHING_N
from deformscope.frames import SessionNote, TactileFrame, WrenchFrame
from deformscope.recording.item_rows import Row
from deformscope.stages.map.exploration import PhaseStart
from deformscope.stages.squeeze.events import EventRule, OnsetDetector

KINDS = (WrenchFrame, TactileFrame, SessionNote, PhaseStart)
"""Kinds of frames and notes from which first contact is found."""
FOLLOW_S = 5.0
"""Time constant by which the force without contact follows the readings [s]."""


def first_contact_ns(rows: Sequence[Row]) -> int | None:
    """Session time of the first contact [ns], None without contact. rows: a recording's rows, in order of time

    The beginning of an exploration's first press. Otherwise a force sensor decides: the first reading that differs by
    TOUCHING_N from the force without contact. The force without contact follows the sensor's drift until then, and
    starts again after a tare. A tactile array decides by the rule of `squeeze` for each pad; the earliest contact
    counts."""
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
