"""Two recordings on a page, on one timeline: zero is the first contact of each."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.frames import ArmFrame, HandFrame, TactileFrame, WrenchFrame
from deformscope.log.rig.aligned import CONTACT_TIMELINE, AlignedSeries, aligned_rrd
from deformscope.page.server.messages import Chapter, Playback
from deformscope.page.server.page_server import RECORDING, PageServer
from deformscope.recording.item_rows import Row, read_rows
from deformscope.recording.items import read_streams
from deformscope.recording.reader import Replay

STEP_NS = 10_000_000
AROUND_NS = -1_000_000_000, 5_000_000_000
"""Time around the contact in its chapter."""
FREE_NS = -1_200_000_000, -200_000_000
"""Time before the contact, without a touch."""


def align_on_page(first: Replay, second: Replay) -> tuple[PageServer, tuple[float, float]]:
    """Serve the measurements of the devices of two recordings on a page that plays them; its address is printed. Also
    returns when each recording's first contact was, from its start [s].

    Raises InputError for a recording without a contact in a force sensor or a tactile array."""
    names = _names(first.path, second.path)
    series, contacts_s = aligned_series(first, second, names)
    page = PageServer(f"{names[0]} and {names[1]}", first.path)
    page.offer(RECORDING, aligned_rrd(series, names), "application/octet-stream")
    begins_ns = min(int(one.since_ns[0]) for one in series)
    ends_ns = max(int(one.since_ns[-1]) for one in series)
    around = Chapter("around the contact", max(AROUND_NS[0], begins_ns), min(AROUND_NS[1], ends_ns))
    page.session.show(playback=Playback(CONTACT_TIMELINE, ends_ns, STEP_NS, (around,), from_ns=begins_ns))
    page.open()
    print(page.where, file=sys.stderr, flush=True)
    return page, contacts_s


def aligned_series(
    first: Replay, second: Replay, names: tuple[str, str] = ("first", "second")
) -> tuple[list[AlignedSeries], tuple[float, float]]:
    """Measurements of the devices of two recordings since the first contact of each, and its time since the start [s].
    Raises InputError for a recording without a contact in a force sensor or a tactile array."""
    from deformscope.experiments.live.first_contact import KINDS, first_contact_ns

    series: list[AlignedSeries] = []
    contacts_s = []
    for which, recording in enumerate((first, second)):
        rows = list(read_rows(recording, (*KINDS, ArmFrame, HandFrame)))
        contact_ns = first_contact_ns(rows)
        if contact_ns is None:
            came = "one without a contact in a force sensor or a tactile array"
            raise InputError("a recording with a contact, for the alignment", came, where=recording.path)
        contacts_s.append(contact_ns / 1e9)
        series += _series(rows, recording, contact_ns, which, names[which])
    return series, (contacts_s[0], contacts_s[1])


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Short, and different."""
    return (first.stem, second.stem) if first.stem != second.stem else (str(first), str(second))


def _series(rows: list[Row], recording: Replay, contact_ns: int, which: int, name: str) -> Iterator[AlignedSeries]:
    areas = {stream.device: [pad.texel_m for pad in stream.pads] for stream in read_streams(recording.path, trust=True)}
    by_device: dict[str, list[Row]] = {}
    for row in rows:
        if isinstance(row.item, WrenchFrame | TactileFrame | ArmFrame | HandFrame):
            by_device.setdefault(row.item.device, []).append(row)
    for device, mine in by_device.items():
        since_ns = np.array([row.session_ns - contact_ns for row in mine], np.int64)
        low, high, end = np.searchsorted(since_ns, (*FREE_NS, 0))
        free = slice(low, max(high, low + 1))
        quantity, values = _measured([row.item for row in mine], free, max(end - 1, 0), areas.get(device, []))
        yield AlignedSeries(quantity, f"{name}: {device}", which, since_ns, values)


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
