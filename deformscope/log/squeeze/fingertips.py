"""Pressures on the squeezing fingertips, on the picture of the hand: centre of pressure and principal axis (fig.
2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr

from deformscope.frames import Stream
from deformscope.log.result_batch import ResultBatch
from deformscope.log.rig.columns import root
from deformscope.log.rig.tactile import Hand
from deformscope.log.stages.pads import CENTER, MARK_MM
from deformscope.stages.squeeze.trial import FingertipPressure

FORCE = "display/squeeze/force"
AXIS_MM = 16.0
"""Length of the principal axis of pressures on a line; for a round distribution it is 0."""


@dataclass(frozen=True, slots=True)
class Fingertips:
    """stream: the tactile device; pads: places of the squeezing fingertips among its pads"""

    stream: Stream
    pads: tuple[int, ...]


def log_fingertips(now: ResultBatch, felt: FingertipPressure, fingertips: Fingertips) -> None:
    now.show(FORCE, rr.Scalars(felt.force_n))
    hand = Hand.of(fingertips.stream.pads)
    touched = [at for at in range(len(fingertips.pads)) if felt.area_m2[at] > 0.0]
    centers, lines, labels = [], [], []
    for at in touched:
        top, left = hand.corners[fingertips.pads[at]]
        center = np.array([left, top]) * hand.texel_mm + felt.center_m[at] * 1e3
        half = 0.5 * AXIS_MM * felt.elongation[at] * np.array([np.cos(felt.axis_rad[at]), np.sin(felt.axis_rad[at])])
        centers.append(center)
        lines.append(np.nan_to_num(np.stack([center - half, center + half]), nan=0.0))
        labels.append(f"{felt.force_n[at]:.2f} N, {felt.area_m2[at] * 1e4:.1f} cm2")
    path = root("display/tactile", fingertips.stream.device)
    points = np.array(centers).reshape(-1, 2)
    now.show(
        f"{path}/contact",
        rr.Points2D(points, radii=MARK_MM, colors=CENTER, labels=labels, show_labels=True, draw_order=70.0),
    )
    strips = np.array(lines).reshape(-1, 2, 2)
    now.show(f"{path}/axis", rr.LineStrips2D(strips, radii=0.4 * MARK_MM, colors=CENTER, draw_order=65.0))
