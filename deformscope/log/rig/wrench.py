"""Forces and torques, and their plots."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from deformscope.frames import Stream, WrenchFrame
from deformscope.log.rig.columns import Batch, frame_times, log_series, recorded, root, scalars
from deformscope.pictures.palette import AXES


def log_wrench_stream(rec: rr.RecordingStream, stream: Stream) -> None:
    for channel in range(stream.channels):
        for quantity, letter, unit in (("force_n", "F", "N"), ("torque_nm", "M", "N m")):
            if quantity == "torque_nm" and not stream.torques:
                continue
            names = [f"{letter}{axis} [{unit}]" for axis in "xyz"]
            log_series(rec, root("wrench", stream.device, quantity, str(channel)), names, AXES)


def log_wrench(batch: Batch, device: str, frames: Sequence[WrenchFrame], start_ns: int) -> None:
    for quantity in ("force_n", "torque_nm"):
        measured = [frame for frame in frames if getattr(frame, quantity) is not None]
        if not measured:
            continue
        times = frame_times(measured, start_ns)
        rows = [getattr(frame, quantity) for frame in measured]
        for channel in range(max(len(row) for row in rows)):
            path = root("wrench", device, quantity, str(channel))
            batch.send_columns(path, times, scalars([row[channel] for row in rows]))
    batch.send_columns(root("wrench", device), frame_times(frames, start_ns), recorded(frames))
