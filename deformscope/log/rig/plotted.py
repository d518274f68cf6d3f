"""Which quantities of a device are plotted, and which of its entities are in a view at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from deformscope.frames import Stream
from deformscope.log.rig.columns import root


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
    if stream.kind == "hand":
        return [(root("hand", stream.device, "position_deg"), "joint angles [deg]")]
    if stream.kind == "arm":
        return [(root("arm", stream.device, "joint_deg"), "joint angles [deg]")]
    return []


def visible_in(streams: Sequence[Stream]) -> Callable[[str], bool]:
    """Whether an entity is in a view that a rig or an exploration opens with: pictures, plots, states."""
    single = {path for stream in streams for path, _ in plotted(stream)} | {"exploration/phase", "squeeze/phase"}
    return lambda path: path in single or path.split("/")[0] in ("color", "depth", "display", "health")
