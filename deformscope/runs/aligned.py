"""Measurements of a recording's devices on a timeline that is zero at its first contact."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.live.first_contact import KINDS, first_contact_ns
from deformscope.frames import ArmFrame, HandFrame, TactileFrame, WrenchFrame
from deformscope.recording.item_rows import Row, read_rows
from deformscope.recording.items import read_streams
from deformscope.recording.reader import Replay

FREE_NS = -1_200_000_000, -200_000_000
"""Time before the contact, without a touch."""


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
