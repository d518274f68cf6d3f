"""The time of a force log at a video's first frame, by the rise of the force against the rise of the motion.

At the right offset the force is a smooth function of the depth. It is fitted as a cubic polynomial; the offset with the
least error is the estimate, and its interval has the errors' own correlation in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.estimate import Posterior
from deformscope.stages.materials.press_cycle import PressForce

SHARED = 0.8
"""Share of the depth and of the force whose rise must lie in what both have seen, and which the fit must explain."""
DEGREE = 3
TRIED = 4000
"""Most offsets that are tried at first."""
HINT = "--force-offset-s with the log's time at the first frame, or a log of the whole push"


@dataclass(frozen=True, slots=True)
class ForceOffset:
    """The log's time at the first frame [s]: value, interval, and posterior, None where it was given."""

    value: float
    interval: tuple[float, float]
    posterior: Posterior | None = None


def find_offset(time_s: FloatArray, depth: FloatArray, force: PressForce, level: float) -> ForceOffset:
    """The offset of a log. time_s, depth: (T,) time after the first frame, and depth of the push in any unit. Raises
    InputError where the offset is not determined: both share no rise, or no edge of one."""
    begin, end = float(force.time_s[0]) - float(time_s[-1]), float(force.time_s[-1])
    step = min(float(np.median(np.diff(time_s))), float(np.median(np.diff(force.time_s))))
    coarse = np.linspace(begin, end, min(TRIED, int((end - begin) / step) + 2))
    errors, counts = _errors(coarse, time_s, depth, force)
    if not np.isfinite(errors).any():
        came = f"one of {np.ptp(force.force_n):.2g} N over {np.ptp(force.time_s):.3g} s that does not overlap with it"
        raise InputError("a force log that has the push of the video", came, HINT)
    best = float(coarse[int(np.nanargmin(errors))])
    width = float(coarse[1] - coarse[0])
    near = np.linspace(best - 40.0 * width, best + 40.0 * width, 3201)
    errors, counts = _errors(near, time_s, depth, force)
    at = int(np.nanargmin(errors))
    share = 1.0 - float(errors[at]) / float(np.var(force.at(time_s + near[at])))
    correlation = _correlation(_left(near[at], time_s, depth, force)[0])
    worth = 0.5 * counts[at] * (1.0 - correlation) / (1.0 + correlation)
    floor = (1e-3 * float(force.force_n.max())) ** 2
    log_density = np.where(np.isfinite(errors), -worth * np.log(np.maximum(errors, floor)), -np.inf)
    density = np.exp(log_density - log_density.max())
    posterior = Posterior(near, density / np.trapezoid(density, near))
    low, high = posterior.shortest(level, float(near[at]))
    rising = time_s[(depth > 0.1 * depth.max()) & (depth < 0.9 * depth.max())]
    rise_s = float(np.ptp(rising)) if len(rising) else 0.0
    if share < SHARED or high - low > max(rise_s, 2.0 * step):
        came = f"not determined: {low:.3g} to {high:.3g} s, of which {max(share, 0.0):.0%} of the force is explained"
        raise InputError("a force log whose rise is that of the motion", came, HINT)
    half = 0.5 * float(near[1] - near[0]) + 0.25 * step
    return ForceOffset(float(near[at]), (low - half, high + half), posterior)


def _left(
    offset: float, time_s: FloatArray, depth: FloatArray, force: PressForce
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) errors of a polynomial of the depth, and force and depth, at the frames that the log has."""
    inside = (time_s + offset >= force.time_s[0]) & (time_s + offset <= force.time_s[-1])
    measured, some = force.at(time_s[inside] + offset), depth[inside]
    if len(some) <= DEGREE + 2:
        return np.zeros(0), measured, some
    columns = np.vander(some / max(float(np.abs(some).max()), 1e-300), DEGREE + 1)
    found = np.linalg.lstsq(columns, measured, rcond=None)[0]
    return measured - columns @ found, measured, some


def _errors(
    offsets: FloatArray, time_s: FloatArray, depth: FloatArray, force: PressForce
) -> tuple[FloatArray, FloatArray]:
    """(n,) mean squared error at each offset [N^2], NaN where log and video do not share the rise, and the number of
    frames."""
    errors, counts = np.full(len(offsets), np.nan), np.zeros(len(offsets))
    for row, offset in enumerate(offsets):
        left, measured, some = _left(float(offset), time_s, depth, force)
        is_shared = len(left) and np.ptp(measured) >= SHARED * np.ptp(force.force_n)
        if is_shared and np.ptp(some) >= SHARED * np.ptp(depth):
            errors[row], counts[row] = np.mean(left**2), len(left)
    return errors, counts


def _correlation(left: FloatArray) -> float:
    """Of neighbouring errors, 0 to 0.95."""
    size = float(left @ left)
    return float(np.clip(left[1:] @ left[:-1] / size, 0.0, 0.95)) if size else 0.0
