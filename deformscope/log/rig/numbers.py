"""Numeric measurements: every field of a frame, the plotted series, and those in a view."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import rerun as rr

from deformscope.frames import ArmFrame, HandFrame, Stream, WrenchFrame
from deformscope.log.rig.columns import Batch, frame_times, log_series, recorded, root, scalars
from deformscope.pictures.palette import AXES, JOINTS, Rgb

QUANTITIES: dict[str, tuple[str, ...]] = {
    "wrench": ("force_n", "torque_nm"),
    "arm": ("joint_deg", "joint_torque_nm", "force_n"),
    "hand": ("position_deg", "velocity_deg_s", "temperature_c"),
}
"""Fields of each kind's frames that are series in addition to the frames."""


def log_numbers_stream(rec: rr.RecordingStream, stream: Stream) -> None:
    """Names and colours of a device's series."""
    for quantity, names, tints in _series(stream):
        for channel in [(str(channel),) for channel in range(stream.channels)] if stream.kind == "wrench" else [()]:
            log_series(rec, root(stream.kind, stream.device, quantity, *channel), names, tints)


def _series(stream: Stream) -> Iterator[tuple[str, list[str], Sequence[Rgb]]]:
    """Quantity, names and colours."""
    joints = [f"joint {joint + 1}" for joint in range(len(JOINTS))]
    if stream.kind == "wrench":
        yield "force_n", [f"F{axis} [N]" for axis in "xyz"], AXES
        if stream.torques:
            yield "torque_nm", [f"M{axis} [N m]" for axis in "xyz"], AXES
    elif stream.kind == "arm":
        yield from ((quantity, joints, JOINTS) for quantity in ("joint_deg", "joint_torque_nm"))
        yield "force_n", [f"F{axis} [N]" for axis in "xyz"], AXES
    elif stream.kind == "hand":
        for quantity, count in zip(QUANTITIES["hand"], (7, 7, 9), strict=True):
            yield quantity, [f"axis {axis}" for axis in range(count)], JOINTS[:count]


def log_numbers(
    batch: Batch, kind: str, device: str, frames: Sequence[WrenchFrame | ArmFrame | HandFrame], start_ns: int
) -> None:
    for quantity in QUANTITIES[kind]:
        measured = [frame for frame in frames if getattr(frame, quantity) is not None]
        rows = [np.atleast_2d(getattr(frame, quantity)) for frame in measured]
        for channel in range(max(map(len, rows), default=0)):
            path = root(kind, device, quantity, *([str(channel)] if kind == "wrench" else []))
            batch.send_columns(path, frame_times(measured, start_ns), scalars([row[channel] for row in rows]))
    batch.send_columns(root(kind, device), frame_times(frames, start_ns), recorded(frames))


def plotted(stream: Stream) -> list[tuple[str, str]]:
    """(entity, title) of each plot."""
    if stream.kind == "wrench":
        quantities = [("force_n", "force", "N"), ("torque_nm", "torque", "N m")][: 2 if stream.torques else 1]
        return [
            (root("wrench", stream.device, quantity, str(channel)), f"{title}{number} [{unit}]")
            for channel in range(stream.channels)
            for number in ("" if stream.channels == 1 else f" {channel + 1}",)
            for quantity, title, unit in quantities
        ]
    if stream.kind in ("arm", "hand"):
        return [(root(stream.kind, stream.device, QUANTITIES[stream.kind][0]), "joint angles [deg]")]
    return []


def visible_in(streams: Sequence[Stream]) -> Callable[[str], bool]:
    """Whether an entity is in an initial view of a rig or an exploration: pictures, plots, states."""
    single = {path for stream in streams for path, _ in plotted(stream)} | {"exploration/phase", "squeeze/phase"}
    return lambda path: path in single or path.split("/")[0] in ("color", "depth", "display", "health")
