"""A hand's joints."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from deformscope.frames import HandFrame, Stream
from deformscope.log.rig.columns import Batch, frame_times, log_series, recorded, root, scalars
from deformscope.pictures.palette import JOINTS

QUANTITIES = ("position_deg", "velocity_deg_s", "temperature_c")


def log_hand_stream(rec: rr.RecordingStream, stream: Stream) -> None:
    for quantity, count in zip(QUANTITIES, (7, 7, 9), strict=True):
        names = [f"axis {axis}" for axis in range(count)]
        log_series(rec, root("hand", stream.device, quantity), names, JOINTS[:count])


def log_hand(batch: Batch, device: str, frames: Sequence[HandFrame], start_ns: int) -> None:
    times = frame_times(frames, start_ns)
    for quantity in QUANTITIES:
        rows = [getattr(frame, quantity) for frame in frames]
        batch.send_columns(root("hand", device, quantity), times, scalars(rows))
    batch.send_columns(root("hand", device), times, recorded(frames))
