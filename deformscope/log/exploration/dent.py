"""The last dent close up: what was observed, and the particles of the model that was fitted to it."""

from __future__ import annotations

import numpy as np
from deformscope.arrays import FloatArray
from deformscope.log.canvas import TEXT
from deformscope.log.exploration.moment import Moment
from deformscope.palette import OBSERVED, SIMULATED, Rgb
from deformscope.stages.exploration import TouchTold

DENT = "display/dent"
MOST_DRAWN_OUT, SHARE = 8.0, 0.35
"""Heights are drawn out until the dent is this share of the half width, and at most so many times."""
STEPS = (1.0, 2.0, 3.0, 5.0, 8.0)
FRAME: Rgb = (150, 155, 165)


def log_dent(now: Moment, touch: TouchTold) -> None:
    """Around the contact; half the width is 1, heights drawn out. The values themselves stand in the result."""
    observed, simulated = touch.observed_m - touch.xyz_m, touch.simulated_m - touch.xyz_m
    half = _half_width(observed, simulated)
    simulated = simulated[simulated[:, 2] >= _lowest(observed, touch.depth_m)]
    times = _drawn_out(touch.depth_m, half)
    scale = np.array([1.0, 1.0, times]) / half
    now.show_points(f"{DENT}/observed", observed * scale, OBSERVED, 0.013)
    now.show_points(f"{DENT}/simulated", simulated * scale, SIMULATED, 0.024)
    bar_m = _bar(half)
    floor = float(min((simulated[:, 2] * scale[2]).min(initial=0.0), (observed[:, 2] * scale[2]).min(initial=0.0)))
    ends = np.array([[-0.5 * bar_m / half, -1.15, floor], [0.5 * bar_m / half, -1.15, floor]])
    now.show_lines(f"{DENT}/scale", ends[None], FRAME, 0.012)
    drawn = f", heights drawn {times:g} times" if times > 1 else ""
    middle = ends.mean(axis=0)
    now.show_points(f"{DENT}/scale/label", middle[None], TEXT, 0.002, [f"{bar_m * 100:g} cm{drawn}"])
    marks = np.array([[-0.75, -1.45, floor], [0.45, -1.45, floor]])
    now.show_points(f"{DENT}/legend", marks, [OBSERVED, SIMULATED], 0.03, ["observed", "simulated"])


def _half_width(*clouds: FloatArray) -> float:
    return max((float(np.abs(cloud[:, :2]).max()) for cloud in clouds if len(cloud)), default=0.05)


def _lowest(observed: FloatArray, depth_m: float) -> float:
    """Below this height [m] nothing is drawn: particles inside the body, which no camera sees."""
    return float(observed[:, 2].min(initial=-depth_m)) - 0.5 * depth_m


def _drawn_out(depth_m: float, half: float) -> float:
    wanted = SHARE * half / max(depth_m, 1e-6)
    return max((step for step in STEPS if step <= min(wanted, MOST_DRAWN_OUT)), default=1.0)


def _bar(half: float) -> float:
    """A round length of about half the width [m]."""
    power = 10.0 ** np.floor(np.log10(half))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= half))
