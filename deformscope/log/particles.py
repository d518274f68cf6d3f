"""Particles over the image: their rest positions, their seen positions, and those that were lost."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.canvas import Canvas, log_labels, log_legend, log_place
from deformscope.pictures.palette import LOST, OBSERVED, REST
from deformscope.stages.see.particles import ParticleGrid, Tracked

EDGE = (30, 30, 30)
REST_RADIUS, OBSERVED_RADIUS, SIMULATED_RADIUS, CROSS = 0.10, 0.22, 0.12, 0.2
"""Shares of the particles' spacing: a simulated particle on its observed one leaves a blue ring around red."""


def log_grid(rec: rr.RecordingStream, grid: ParticleGrid, canvas: Canvas, path: str = "particles") -> None:
    """Log the particles at rest. Log the lattice. It does not move, but is on the timeline from the first frame on."""
    log_rest(rec, grid.rest_px, canvas, path)


def log_rest(rec: rr.RecordingStream, rest: FloatArray, canvas: Canvas, path: str = "particles") -> None:
    """Log rest positions (K, 2) in green."""
    radius = canvas.spacing * REST_RADIUS
    log_place(rec, canvas, f"{path}/rest")
    rec.log(f"{path}/rest", rr.Points2D(rest, radii=radius, colors=REST, draw_order=30.0))
    log_legend(rec, f"{path}/legend/rest", canvas, [(0, "rest", REST)])


def log_tracked(rec: rr.RecordingStream, tracked: Tracked, canvas: Canvas, path: str = "particles") -> None:
    """Log seen particles as blue discs, and lost ones as pale crosses at their last known places."""
    seen = tracked.seen & np.isfinite(tracked.position_px).all(axis=1)
    log_observed(rec, tracked.position_px, seen, canvas, path)
    rec.log(f"{path}/observed", rr.AnyValues(noise_px=tracked.noise_px, seen=tracked.seen))


def log_observed(
    rec: rr.RecordingStream, position: FloatArray, seen: np.typing.NDArray[np.bool_], canvas: Canvas, path: str
) -> None:
    """Log positions (K, 2): blue discs for seen particles, pale crosses for others."""
    lost = ~seen & np.isfinite(position).all(axis=1)
    radius = canvas.spacing * OBSERVED_RADIUS
    log_place(rec, canvas, f"{path}/observed", f"{path}/lost")
    rec.log(f"{path}/observed", rr.Points2D(position[seen], radii=radius, colors=OBSERVED, draw_order=40.0))
    rec.log(f"{path}/lost", crosses(position[lost], canvas.spacing * CROSS))
    log_legend(rec, f"{path}/legend/observed", canvas, [(1.0, "observed", OBSERVED)])
    slot = np.array([canvas.slot(3.0)])
    lost_count = int((~seen).sum())
    if lost_count:
        rec.log(f"{path}/legend/lost", crosses(slot, canvas.mark))
        log_labels(rec, f"{path}/legend/lost/label", canvas, [(*canvas.slot(3.0), f"lost: {lost_count}")])


def crosses(center: FloatArray, arm: float) -> rr.LineStrips2D:
    """A pale cross with a dark edge, to be seen on any image, at each of (n, 2) places, with arms of length `arm`."""
    diagonal = np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]]) * arm
    strips = list((center[:, None, None, :] + diagonal).reshape(-1, 2, 2))
    radii = [arm * 0.42] * len(strips) + [arm * 0.2] * len(strips)
    tints = [EDGE] * len(strips) + [LOST] * len(strips)
    return rr.LineStrips2D(strips + strips, radii=radii, colors=tints, draw_order=55.0)
