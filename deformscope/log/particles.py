"""Particles over the image: where they rest, where they were seen, and which were lost."""

from __future__ import annotations

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray
from deformscope.log.canvas import LOST, OBSERVED, REST, Canvas, log_legend
from deformscope.stages.particles import ParticleGrid, Tracked

REST_RADIUS, OBSERVED_RADIUS, SIMULATED_RADIUS, CROSS = 0.10, 0.22, 0.12, 0.16
"""Shares of the particles' spacing: a simulated particle on its observed one leaves a blue ring around red."""


def log_grid(rec: rr.RecordingStream, grid: ParticleGrid, canvas: Canvas, path: str = "particles") -> None:
    """The particles at rest. They do not move, but belong to the timeline from the first frame on."""
    log_rest(rec, grid.rest_px, canvas, path)


def log_rest(rec: rr.RecordingStream, rest: FloatArray, canvas: Canvas, path: str = "particles") -> None:
    """(K, 2) rest positions in green."""
    radius = canvas.spacing * REST_RADIUS
    rec.log(f"{path}/rest", rr.Points2D(rest, radii=radius, colors=REST, draw_order=30.0))
    log_legend(rec, f"{path}/legend/rest", canvas, [(0, "rest", REST)])


def log_tracked(rec: rr.RecordingStream, tracked: Tracked, canvas: Canvas, path: str = "particles") -> None:
    """Seen particles as blue discs; lost ones as grey crosses where they were last known."""
    seen = tracked.seen & np.isfinite(tracked.position_px).all(axis=1)
    log_observed(rec, tracked.position_px, seen, canvas, path)
    rec.log(f"{path}/observed", rr.AnyValues(noise_px=tracked.noise_px, seen=tracked.seen))


def log_observed(
    rec: rr.RecordingStream, position: FloatArray, seen: np.typing.NDArray[np.bool_], canvas: Canvas, path: str
) -> None:
    """(K, 2) positions: blue discs where seen, grey crosses elsewhere."""
    lost = ~seen & np.isfinite(position).all(axis=1)
    radius = canvas.spacing * OBSERVED_RADIUS
    rec.log(f"{path}/observed", rr.Points2D(position[seen], radii=radius, colors=OBSERVED, draw_order=40.0))
    rec.log(f"{path}/lost", crosses(position[lost], canvas.spacing * CROSS))
    entries = [(1.0, "observed", OBSERVED)]
    if (~seen).any():
        entries.append((3.0, f"lost ({int((~seen).sum())})", LOST))
    log_legend(rec, f"{path}/legend/observed", canvas, entries)


def crosses(center: FloatArray, arm: float) -> rr.LineStrips2D:
    """A grey cross at each of (n, 2) places, with arms of length `arm`."""
    diagonal = np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]]) * arm
    strips = (center[:, None, None, :] + diagonal).reshape(-1, 2, 2)
    return rr.LineStrips2D(list(strips), radii=arm * 0.22, colors=LOST, draw_order=42.0)
