"""Particles over the image: at rest, where they were seen, and those that were lost; optical flow as arrows."""

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.canvas import LABEL, Canvas, log_color_bar, log_labels, log_legend, log_place
from deformscope.pictures.palette import LOST, OBSERVED, REST, colors, round_up
from deformscope.stages.see.flow import FlowField
from deformscope.stages.see.particles import Tracked

EDGE = (30, 30, 30)
REST_RADIUS, OBSERVED_RADIUS, SIMULATED_RADIUS, CROSS = 0.10, 0.22, 0.12, 0.2
"""Shares of the particles' spacing: a simulated particle on its observed one leaves a blue ring around red."""


def log_rest(rec: rr.RecordingStream, rest: FloatArray, canvas: Canvas) -> None:
    """Log rest positions (K, 2) in green."""
    radius = canvas.spacing * REST_RADIUS
    log_place(rec, canvas, "particles/rest")
    rec.log("particles/rest", rr.Points2D(rest, radii=radius, colors=REST, draw_order=30.0))
    log_legend(rec, "particles/legend/rest", canvas, [(0, "rest", REST)])


def log_tracked(rec: rr.RecordingStream, tracked: Tracked, canvas: Canvas) -> None:
    """Log seen particles as blue discs, and lost ones as pale crosses at their last known places."""
    seen = tracked.seen & np.isfinite(tracked.position_px).all(axis=1)
    log_observed(rec, tracked.position_px, seen, canvas)
    rec.log("particles/observed", rr.AnyValues(noise_px=tracked.noise_px, seen=tracked.seen))


def log_observed(
    rec: rr.RecordingStream, position: FloatArray, seen: np.typing.NDArray[np.bool_], canvas: Canvas
) -> None:
    """Log positions (K, 2): blue discs for seen particles, pale crosses for others."""
    lost = ~seen & np.isfinite(position).all(axis=1)
    radius = canvas.spacing * OBSERVED_RADIUS
    log_place(rec, canvas, "particles/observed", "particles/lost")
    rec.log("particles/observed", rr.Points2D(position[seen], radii=radius, colors=OBSERVED, draw_order=40.0))
    rec.log("particles/lost", crosses(position[lost], canvas.spacing * CROSS))
    log_legend(rec, "particles/legend/observed", canvas, [(1.0, "observed", OBSERVED)])
    slot = np.array([canvas.slot(3.0)])
    lost_count = int((~seen).sum())
    if lost_count:
        rec.log("particles/legend/lost", crosses(slot, canvas.mark))
        log_labels(rec, "particles/legend/lost/label", canvas, [(*canvas.slot(3.0), f"lost: {lost_count}")])


def crosses(center: FloatArray, arm: float) -> rr.LineStrips2D:
    """A pale cross with a dark edge, to be seen on any image, at each of (n, 2) places, with arms of length `arm`."""
    diagonal = np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]]) * arm
    strips = list((center[:, None, None, :] + diagonal).reshape(-1, 2, 2))
    radii = [arm * 0.42] * len(strips) + [arm * 0.2] * len(strips)
    tints = [EDGE] * len(strips) + [LOST] * len(strips)
    return rr.LineStrips2D(strips + strips, radii=radii, colors=tints, draw_order=55.0)


ARROWS_ALONG = 34
"""Number of arrows along the longer side of the image: more would hide it."""
STILL_PX = 0.25
"""Length below which an arrow would show the flow's noise."""


def log_flow(rec: rr.RecordingStream, flow: FlowField, canvas: Canvas) -> None:
    """Log the motion since the previous frame, at the particles or on a sparse grid, coloured by its length."""
    origin, vector, step_px = _sparse(flow, canvas)
    length_px = np.hypot(vector[:, 0], vector[:, 1])
    end_px = round_up(float(np.max(length_px, initial=0.0)))
    times = _stretch(length_px, step_px)
    moving = length_px >= STILL_PX
    rec.log(
        "flow/arrows",
        rr.Arrows2D(
            origins=origin[moving],
            vectors=vector[moving] * times,
            radii=step_px * 0.08,
            colors=colors(length_px[moving] / end_px),
            draw_order=40.0,
        ),
    )
    log_color_bar(rec, "flow/legend", canvas, end_px, "px")
    note = "arrows at true length" if times == 1 else f"arrows drawn {times:g} times their length"
    log_legend(rec, "flow/legend/note", canvas, [(2.0, note, LABEL)], row=1)


def _sparse(flow: FlowField, canvas: Canvas) -> tuple[FloatArray, FloatArray, float]:
    """(n, 2) origins [px] and (n, 2) vectors [px], and their distance [px]."""
    height, width = flow.flow_px.shape[:2]
    step_px = max(max(height, width) / ARROWS_ALONG, 4.0)
    if canvas.particles is not None:
        # at the particles alone: outside the thing the flow is a guess, often a wild one
        every = -(-len(canvas.particles) // ARROWS_ALONG**2)
        origin, step_px = canvas.particles[::every], max(canvas.spacing, 4.0)
    else:
        x, y = (np.arange(step_px / 2, side - 1, step_px) for side in (width, height))
        origin = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    columns, rows = np.rint(flow.inside(origin)).astype(np.intp).T.clip(0, [[width - 1], [height - 1]])
    vector = flow.flow_px[rows, columns]
    known = np.isfinite(vector).all(axis=1)
    return origin[known], vector[known], step_px


def _stretch(length_px: FloatArray, step_px: float) -> float:
    """How many times longer arrows are drawn, to fill the grid without touching.

    A power of two, so that it stays put from frame to frame and a reader can divide by it."""
    typical = float(np.quantile(length_px, 0.95)) if length_px.size else 0.0
    if typical < STILL_PX:
        return 1.0
    return float(2.0 ** np.floor(np.log2(step_px / typical)))
