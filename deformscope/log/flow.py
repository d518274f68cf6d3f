"""Optical flow as arrows over the image."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.canvas import LABEL, Canvas, log_color_bar, log_legend
from deformscope.pictures.palette import colors, round_up
from deformscope.stages.see.flow import FlowField

ARROWS_ALONG = 34
"""Number of arrows along the longer side of the image: more would hide it."""
STILL_PX = 0.25
"""Length below which an arrow would show the flow's noise."""


def log_flow(rec: rr.RecordingStream, flow: FlowField, canvas: Canvas, path: str = "flow") -> None:
    """Log the motion since the previous frame, at the particles or on a sparse grid, coloured by its length."""
    origin, vector, step_px = _sparse(flow.flow_px, canvas)
    length_px = np.hypot(vector[:, 0], vector[:, 1])
    end_px = round_up(float(np.max(length_px, initial=0.0)))
    times = _stretch(length_px, step_px)
    moving = length_px >= STILL_PX
    rec.log(
        f"{path}/arrows",
        rr.Arrows2D(
            origins=origin[moving],
            vectors=vector[moving] * times,
            radii=step_px * 0.08,
            colors=colors(length_px[moving] / end_px),
            draw_order=40.0,
        ),
    )
    log_color_bar(rec, f"{path}/legend", canvas, end_px, "px")
    note = "arrows at true length" if times == 1 else f"arrows drawn {times:g} times their length"
    log_legend(rec, f"{path}/legend/note", canvas, [(2.0, note, LABEL)], row=1)


def _sparse(flow_px: FloatArray, canvas: Canvas) -> tuple[FloatArray, FloatArray, float]:
    """(n, 2) origins [px] and (n, 2) vectors [px], and their distance [px]."""
    height, width = flow_px.shape[:2]
    step_px = max(max(height, width) / ARROWS_ALONG, 4.0)
    if canvas.particles is not None:
        # at the particles alone: beside the thing the flow is a guess, often a wild one
        every = -(-len(canvas.particles) // ARROWS_ALONG**2)
        origin, step_px = canvas.particles[::every], max(canvas.spacing, 4.0)
    else:
        x, y = (np.arange(step_px / 2, side - 1, step_px) for side in (width, height))
        origin = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    columns, rows = np.rint(origin).astype(np.intp).T.clip(0, [[width - 1], [height - 1]])
    vector = flow_px[rows, columns]
    known = np.isfinite(vector).all(axis=1)
    return origin[known], vector[known], step_px


def _stretch(length_px: FloatArray, step_px: float) -> float:
    """How many times longer arrows are drawn, to fill the grid without touching.

    A power of two, so that it stays put from frame to frame and a reader can divide by it."""
    typical = float(np.quantile(length_px, 0.95)) if length_px.size else 0.0
    if typical < STILL_PX:
        return 1.0
    return float(2.0 ** np.floor(np.log2(step_px / typical)))
