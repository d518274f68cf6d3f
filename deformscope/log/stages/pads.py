"""Centres of pressure on the picture of the hand; force and contact area of each pad over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from deformscope.frames import StageResult, Stream
from deformscope.log.rig.columns import Batch, log_series, moments, root, scalars
from deformscope.log.rig.tactile import Hand
from deformscope.log.stages.views import PLOTS
from deformscope.pictures.palette import JOINTS

MARK_MM = 1.6
CENTER = (0, 255, 220)


def log_pads_stream(rec: rr.RecordingStream, stream: Stream) -> None:
    for quantity, unit in (("force", "N"), ("area", "cm2")):
        names = [f"{pad.name} [{unit}]" for pad in stream.pads]
        tints = [JOINTS[at % len(JOINTS)] for at in range(len(names))]
        log_series(rec, f"{PLOTS}/{quantity}/{stream.device}", names, tints)


def log_pads(
    batch: Batch, stream: Stream, results: Sequence[StageResult], drawn: Sequence[StageResult], start_ns: int
) -> None:
    """results: of a tactile stage, plotted; drawn: those whose centres are marked"""
    times = moments([one.host_ns for one in results], start_ns)
    for quantity, values in (
        ("force", [one.result.force_n for one in results]),
        ("area", [one.result.area_m2 * 1e4 for one in results]),
    ):
        batch.send_columns(f"{PLOTS}/{quantity}/{stream.device}", times, scalars(values))
    hand = Hand.of(stream.pads)
    corners = np.array([(left, top) for top, left in hand.corners]) * hand.texel_mm
    centers, labels, counts = [], [], []
    for one in drawn:
        felt = np.flatnonzero(one.result.area_m2 > 0.0)
        centers.append(corners[felt] + one.result.center_m[felt] * 1e3)
        labels += [f"{one.result.force_n[pad]:.2f} N, {one.result.area_m2[pad] * 1e4:.1f} cm2" for pad in felt]
        counts.append(len(felt))
    total = sum(counts)
    columns = [
        *rr.Points2D.columns(
            positions=np.concatenate(centers), radii=[MARK_MM] * total, colors=[CENTER] * total, labels=labels
        ).partition(counts),
        *rr.Points2D.columns(show_labels=[True] * len(drawn), draw_order=[70.0] * len(drawn)),
    ]
    times = moments([one.host_ns for one in drawn], start_ns)
    batch.send_columns(root("display/tactile", stream.device, "contact"), times, columns)
