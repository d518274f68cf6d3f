"""The last dent close up: the observed points, and the particles of the fitted model."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray
from deformscope.log.canvas import TEXT, sides_of
from deformscope.log.result_batch import ResultBatch
from deformscope.pictures.palette import OBSERVED, SIMULATED, Rgb, round_down
from deformscope.stages.map.exploration import TouchEstimate
from deformscope.stages.see.cloud import reduce_to_grid
from deformscope.stages.see.triangulation import triangulate

DENT = "display/dent"
MOST_DRAWN_OUT, SHARE = 8.0, 0.5
"""Heights are magnified until the dent is this share of the half width, up to this factor."""
HALF_M, CELL_M = 0.05, 0.0035
"""Half the side of the view, and of cells whose mean height represents their observed points."""
NEIGHBOURS = 1.3
"""Multiple of the usual distance up to which lines connect particles."""
STEPS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
FRAME: Rgb = (150, 155, 165)


def log_dent(now: ResultBatch, touch: TouchEstimate) -> None:
    """Log the dent around the contact; half the width is 1, and heights are magnified. The measured values are in the
    result."""
    observed, simulated = (_near(one - touch.xyz_m) for one in (touch.observed_m, touch.simulated_m))
    if len(observed):
        observed = reduce_to_grid(observed, CELL_M)[0]
    half = HALF_M
    top = _top(simulated)
    times = 1.0 if touch.rigid else _drawn_out(touch.depth_m, half)  # of a rigid place it would be noise
    scale = np.array([1.0, 1.0, times]) / half
    now.show_points(f"{DENT}/observed", observed * scale, OBSERVED, 0.012)
    now.show_points(f"{DENT}/simulated", top * scale, SIMULATED, 0.016)
    now.show_lines(f"{DENT}/simulated/net", _net(top) * scale, SIMULATED, 0.006)
    bar_m = round_down(half)  # about half the width
    floor = float(min((top[:, 2] * scale[2]).min(initial=0.0), (observed[:, 2] * scale[2]).min(initial=0.0)))
    ends = np.array([[-0.5 * bar_m / half, -1.15, floor], [0.5 * bar_m / half, -1.15, floor]])
    now.show_lines(f"{DENT}/scale", ends[None], FRAME, 0.012)
    drawn = f", heights drawn {times:g} times" if times > 1 else ""
    middle = ends.mean(axis=0)
    now.show_points(f"{DENT}/scale/label", middle[None], TEXT, 0.002, [f"{bar_m * 100:g} cm{drawn}"])


def _near(points: FloatArray) -> FloatArray:
    """The shown part of points (n, 3) relative to the contact [m]: within `HALF_M` along x and y."""
    return points[(np.abs(points[:, :2]) <= HALF_M + 1e-6).all(axis=1)]


def _top(particles: FloatArray) -> FloatArray:
    """Those of particles (n, 3) with no other above them: the visible part of a body made of layers."""
    if len(particles) < 2:
        return particles
    flat = cKDTree(particles[:, :2])
    near = 0.5 * float(np.median(cKDTree(particles).query(particles, k=2)[0][:, 1]))
    highest = [particles[rows, 2].max() for rows in flat.query_ball_point(particles[:, :2], near)]
    return particles[particles[:, 2] >= highest]


def _net(top: FloatArray) -> FloatArray:
    """(n, 2, 3) lines between neighbours."""
    triangles = triangulate(top[:, :2])
    if not len(triangles):
        return np.zeros((0, 2, 3))
    pairs = sides_of(triangles)
    apart = np.linalg.norm(top[pairs[:, 0], :2] - top[pairs[:, 1], :2], axis=1)
    return np.asarray(top[pairs[apart <= NEIGHBOURS * float(np.median(apart))]])


def _drawn_out(depth_m: float, half: float) -> float:
    wanted = SHARE * half / max(depth_m, 1e-6)
    return max((step for step in STEPS if step <= min(wanted, MOST_DRAWN_OUT)), default=1.0)
