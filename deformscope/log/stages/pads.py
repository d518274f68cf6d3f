"""Centres of pressure on the picture of the hand; force and contact area of each pad over time."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.frames import Stream
from deformscope.log.rig.columns import Batch, log_series, moments, root, scalars
from deformscope.log.rig.tactile import Hand
from deformscope.log.stages.group import StageGroup
from deformscope.log.stages.views import PLOTS
from deformscope.pictures.palette import tints_of

MARK_MM = 1.6
CENTER = (0, 255, 220)


def log_pads_stream(rec: rr.RecordingStream, stream: Stream) -> None:
    for quantity, unit in (("force", "N"), ("area", "cm2")):
        names = [f"{pad.name} [{unit}]" for pad in stream.pads]
        log_series(rec, f"{PLOTS}/{quantity}/{stream.device}", names, tints_of(len(names)))


def log_pads(batch: Batch, group: StageGroup) -> None:
    assert group.pads is not None
    times = moments([one.host_ns for one in group.results], group.start_ns)
    for quantity, values in (
        ("force", [one.result.force_n for one in group.results]),
        ("area", [one.result.area_m2 * 1e4 for one in group.results]),
    ):
        batch.send_columns(f"{PLOTS}/{quantity}/{group.device}", times, scalars(values))
    hand = Hand.of(group.pads.pads)
    corners = np.array([(left, top) for top, left in hand.corners]) * hand.texel_mm
    centers, labels, counts = [], [], []
    for one in group.drawn:
        felt = np.flatnonzero(one.result.area_m2 > 0.0)
        centers.append(corners[felt] + one.result.center_m[felt] * 1e3)
        labels += [f"{one.result.force_n[pad]:.2f} N, {one.result.area_m2[pad] * 1e4:.1f} cm2" for pad in felt]
        counts.append(len(felt))
    total = sum(counts)
    columns = [
        *rr.Points2D.columns(
            positions=np.concatenate(centers), radii=[MARK_MM] * total, colors=[CENTER] * total, labels=labels
        ).partition(counts),
        *rr.Points2D.columns(show_labels=[True] * len(group.drawn), draw_order=[70.0] * len(group.drawn)),
    ]
    times = moments([one.host_ns for one in group.drawn], group.start_ns)
    batch.send_columns(root("display/tactile", group.device, "contact"), times, columns)
