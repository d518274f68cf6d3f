"""Measurements of a recording's devices on a timeline that is zero at its first contact, which its force sensors and
tactile arrays give."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.live.device_stages import TOUCHING_N
from deformscope.frames import ArmFrame, HandFrame, SessionNote, TactileFrame, WrenchFrame
from deformscope.recording.items import read_streams
from deformscope.recording.reader import Replay, Row, read_rows
from deformscope.stages.map.exploration import PhaseStart
from deformscope.stages.squeeze.events import EventRule, OnsetDetector

FREE_NS = -1_200_000_000, -200_000_000
"""Time before the contact, without a touch."""
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


@dataclass(frozen=True, slots=True, eq=False)
class AlignedSeries:
    """Measurements of a device. quantity: quantity with its unit; since_ns: (n,) time since the recording's first
    contact [ns]; values: (n,)"""

    quantity: str
    since_ns: IntArray
    values: FloatArray


def aligned_series(recording: Replay) -> dict[str, AlignedSeries]:
    """Measurements of each device since the recording's first contact. Raises InputError without a contact in a force
    sensor or a tactile array."""
    rows = list(read_rows(recording, (*KINDS, ArmFrame, HandFrame)))
    contact_ns = first_contact_ns(rows)
    if contact_ns is None:
        came = "one without a contact in a force sensor or a tactile array"
        raise InputError("a recording with a contact, for the alignment", came, where=recording.path)
    areas = {stream.device: [pad.texel_m for pad in stream.pads] for stream in read_streams(recording.path, trust=True)}
    by_device: dict[str, list[Row]] = {}
    for row in rows:
        if isinstance(row.item, WrenchFrame | TactileFrame | ArmFrame | HandFrame):
            by_device.setdefault(row.item.device, []).append(row)
    found = {}
    for device, mine in by_device.items():
        since_ns = np.array([row.session_ns - contact_ns for row in mine], np.int64)
        low, high, end = np.searchsorted(since_ns, (*FREE_NS, 0))
        free = slice(low, max(high, low + 1))
        quantity, values = _measured([row.item for row in mine], free, max(end - 1, 0), areas.get(device, []))
        found[device] = AlignedSeries(quantity, since_ns, values)
    return found


def _measured(
    items: list[Any], free: slice, before: int, texels_m: list[tuple[float, float]]
) -> tuple[str, FloatArray]:
    """A number of each frame, and its name. free: frames in which nothing touched yet; before: the last before the
    contact"""
    match items[0]:
        case WrenchFrame():
            forces_n = np.array([item.force_n[0] for item in items])
            known = np.isfinite(forces_n).all()
            signal = forces_n if known else np.array([item.counts[:3] for item in items], np.float64)
            change = np.linalg.norm(signal - np.median(signal[free], axis=0), axis=1)
            return f"force, relative to the force before the contact [{'N' if known else 'counts'}]", change
        case TactileFrame():
            areas = [width * height for width, height in texels_m]
            sums_pa = np.array([[float(pad.sum()) for pad in item.pressure_pa] for item in items])
            if sums_pa.shape[1] == len(areas) and np.isfinite(sums_pa).all():
                return "force on the pads [N]", sums_pa @ np.array(areas)
            return "sum of the texels [counts]", np.array([float(item.counts.sum(dtype=np.int64)) for item in items])
        case ArmFrame():
            at_mm = 1e3 * np.array([item.position_m for item in items])
            return "travel of the arm since the contact [mm]", np.linalg.norm(at_mm - at_mm[before], axis=1)
        case _:
            angles_deg = np.array([item.position_deg for item in items])
            turned_deg = np.abs(angles_deg - angles_deg[before]).max(axis=1)
            return "largest turn of an axis since the contact [deg]", turned_deg
