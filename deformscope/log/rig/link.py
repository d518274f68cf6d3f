"""A device's wire: its bytes and the times of its connection; and remarks of people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deformscope.frames import LinkChange, RawBytes, SessionNote, Stream
from deformscope.log.rig.columns import Batch, moments, recorded, root, scalars, states
from deformscope.log.rig.numbers import plotted
from deformscope.pictures.palette import BAD, GOOD, IDLE, WARN
from deformscope_drivers.health import Link

COLORS = {Link.CONNECTED: GOOD, Link.LOST: WARN, Link.FAILED: BAD, Link.CLOSED: IDLE}
LEVELS = {Link.CONNECTED: "INFO", Link.LOST: "WARN", Link.FAILED: "ERROR", Link.CLOSED: "INFO"}


def log_link_stream(rec: rr.RecordingStream, device: str) -> None:
    rec.log(root("link", device), states(COLORS), static=True)


def log_link(
    batch: Batch, device: str, changes: Sequence[LinkChange], start_ns: int, streams: Sequence[Stream]
) -> None:
    events = [change.event for change in changes]
    words = [f"{event.link}: {event.reason}" if event.reason else str(event.link) for event in events]
    columns = [
        *rr.TextLog.columns(text=words, level=[LEVELS[event.link] for event in events]),
        *rr.StateChange.columns(state=[str(event.link) for event in events]),
        *recorded(changes),
    ]
    batch.send_columns(root("link", device), moments([event.host_ns for event in events], start_ns), columns)
    ends = [event.host_ns for event in events if event.link != Link.CONNECTED]
    for path, _ in [plot for stream in streams if stream.device == device for plot in plotted(stream)]:
        if ends:  # a line goes no further: nobody knows what was between
            batch.send_columns(path, moments(ends, start_ns), scalars([np.zeros(0)] * len(ends)))


def log_notes(batch: Batch, notes: Sequence[SessionNote], start_ns: int) -> None:
    words = [note.text if note.about == "note" else f"{note.about}: {note.text}" for note in notes]
    columns = [
        *rr.TextLog.columns(
            text=words, level=["WARN" if note.about in ("alarm", "stage") else "INFO" for note in notes]
        ),
        *recorded(notes),
    ]
    batch.send_columns("note", moments([note.host_ns for note in notes], start_ns), columns)


def log_raw(batch: Batch, device: str, pieces: Sequence[RawBytes], start_ns: int) -> None:
    batch.send_columns(root("raw", device), moments([piece.host_ns for piece in pieces], start_ns), recorded(pieces))
