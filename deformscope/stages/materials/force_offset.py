"""The force at a video's frames, by a log whose clock, zero and lag are its own.

At the right time the log is a smooth function of the depth that starts at zero: a cubic polynomial, as a display with a
time constant shows it. The likeliest offset and time constant are the estimate; their probability has the errors' own
correlation in time, the readings' scatter and step, and `LIKELY`: a lag and a later offset explain a rise alike."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.estimate import Posterior
from deformscope.stages.materials.press_cycle import PressForce

SHARED, RISEN = 0.8, 0.5
"""Share of the depth whose rise must lie in what both have seen, and which the fit must explain; the same of the force,
which a slow display may not have shown in full at the last frame."""
DEGREE = 3
LAGS_S = np.append(0.0, np.geomspace(0.1, 1.5, 16))
"""Time constants of a display: 0, and those of kitchen scales; less than these looks like a delay."""
LIKELY = np.append(1.0, 0.3 * (_falling := np.exp(-LAGS_S[1:] / 0.3)) / _falling.sum())
"""Probability of each, up to a factor: three of four displays show at once, and long lags are rare."""
UNSHOWN = 1.2
"""Largest force at the last frame, as a share of what the log shows at any time."""
TRIED, FINE = 6000, 1201
"""Most offsets that are tried at first, and near the best of them."""
NEAR_S = 2.5
"""How far around the first best offset others are tried: a lag looks like a delay at first."""
HINT = "--force-offset-s with the log's time at the first frame, or a log of the whole push"


@dataclass(frozen=True, slots=True)
class ForceOffset:
    """The log's time at the first frame [s], and its interval; lag_s: time constant of its display

    force_n: (T,) force at each frame, less the log's zero and lag [N]; force_sd_n: standard deviation of the last, by
    offset and lag"""

    value: float
    interval: tuple[float, float]
    lag_s: float
    force_n: FloatArray
    force_sd_n: float


def find_offset(
    time_s: FloatArray, depth: FloatArray, log: PressForce, level: float, given: float | None = None
) -> ForceOffset:
    """The force of a log. time_s, depth: (T,) time after the first frame, and depth of the push in any unit; given: the
    offset, if it is known. Raises InputError where it is not determined: both share no rise, or no edge of one."""
    log = _SmoothForce(log.time_s, log.force_n, log.zero_sd_n)
    steps = [float(np.median(np.diff(one))) for one in (time_s, log.time_s)]
    step = min(steps)
    if given is None:
        begin, end = float(log.time_s[0]) - float(time_s[-1]), float(log.time_s[-1])
        offsets = np.linspace(begin, end, min(TRIED, int((end - begin) / step) + 2))
        errors, _ = _errors(offsets, time_s, _lagged(time_s, depth, 0.0), log)
        if not np.isfinite(errors).any() or not np.ptp(log.force_n):
            came = f"one of {np.ptp(log.force_n):.2g} N over {np.ptp(log.time_s):.3g} s that does not overlap with it"
            raise InputError("a force log that has the push of the video", came, HINT)
        offsets = offsets[int(np.nanargmin(errors))] + np.linspace(-NEAR_S, 0.2 * NEAR_S, FINE)
    else:
        offsets = np.array([given])
    columns = [_lagged(time_s, depth, float(lag)) for lag in LAGS_S]
    least = 1.0 if given is None else 0.0
    both = np.stack([_errors(offsets, time_s, one, log, least) for one in columns])
    errors, forces = both[:, 0], both[:, 1]  # (lags, offsets)
    errors[forces > UNSHOWN * np.ptp(log.force_n)] = np.nan
    if not np.isfinite(errors).any():
        return ForceOffset(float(offsets[0]), (float(offsets[0]),) * 2, 0.0, log.at(time_s + offsets[0]), 0.0)
    lag, at = np.unravel_index(int(np.nanargmin(errors)), errors.shape)
    _, left, _ = _at(float(offsets[at]), time_s, columns[lag], log)
    worth = 0.5 * len(left) * (1.0 - _correlation(left)) / (1.0 + _correlation(left))
    reading = log.zero_sd_n**2 + np.diff(np.unique(log.force_n)).min(initial=np.inf) ** 2 / 12.0
    noise = reading + (2e-4 * float(np.ptp(log.force_n))) ** 2
    chance = np.log(LIKELY)[:, None] - worth * np.log(np.where(np.isfinite(errors), errors + noise, np.inf))
    chance = np.exp(chance - chance.max())
    lag, at = np.unravel_index(int(chance.argmax()), chance.shape)
    order = np.argsort(forces[chance > 1e-4])
    weights, ends = chance[chance > 1e-4][order], forces[chance > 1e-4][order]
    ends = np.interp([0.16, 0.84], np.cumsum(weights) / weights.sum(), ends)
    spread, best = 0.5 * float(ends[1] - ends[0]), float(offsets[at])
    measured, _, force_n = _at(best, time_s, columns[lag], log)
    if given is not None:
        return ForceOffset(given, (given, given), float(LAGS_S[lag]), force_n, spread)
    density = chance.sum(axis=0)
    low, high = Posterior(offsets, density / np.trapezoid(density, offsets)).shortest(level, best)
    rising = time_s[(depth > 0.1 * depth.max()) & (depth < 0.9 * depth.max())]
    share = 1.0 - float(errors[lag, at]) / max(float(np.var(measured)), 1e-300)
    if share < SHARED or high - low > max(float(np.ptp(rising)) if len(rising) else 0.0, 2.0 * step):
        came = f"not determined: {low:.3g} to {high:.3g} s, of which {max(share, 0.0):.0%} of the force is explained"
        raise InputError("a force log whose rise is that of the motion", came, HINT)
    half = 0.25 * max(steps)  # what happens between readings, or frames, is not known
    return ForceOffset(best, (low - half, high + half), float(LAGS_S[lag]), force_n, spread)


@dataclass(frozen=True)
class _SmoothForce(PressForce):
    """A log between whose readings lies a smooth curve: straight lines would cut the corners of a slow scale."""

    @cached_property
    def _curve(self) -> PchipInterpolator:
        return PchipInterpolator(self.time_s, self.force_n)

    def at(self, time_s: FloatArray) -> FloatArray:
        return np.asarray(self._curve(np.clip(time_s, self.time_s[0], self.time_s[-1])))

    def has(self, time_s: FloatArray) -> BoolArray:
        """Which times (n,) lie within the log."""
        return np.asarray((time_s >= self.time_s[0]) & (time_s <= self.time_s[-1]))


def _lagged(time_s: FloatArray, depth: FloatArray, lag_s: float) -> FloatArray:
    """(T, 2 DEGREE + 1) powers of the depth from 1 on as a display with a time constant shows them, 1, and the powers
    themselves."""
    share = depth / max(float(np.abs(depth).max()), 1e-300)
    powers = np.stack([share**power for power in range(1, DEGREE + 1)], axis=1)
    shown = powers.copy()
    for row in range(1, len(shown)) if lag_s else ():
        gap = time_s[row] - time_s[row - 1]
        behind = (powers[row] - powers[row - 1]) * lag_s / gap
        shown[row] = powers[row] - behind + (shown[row - 1] - powers[row - 1] + behind) * np.exp(-gap / lag_s)
    return np.column_stack([shown, np.ones(len(share)), powers])


def _at(
    offset: float, time_s: FloatArray, columns: FloatArray, log: _SmoothForce
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) the log at the frames that it has, and errors of the best polynomial there; and (T,) the log at each frame,
    less its zero, and with what its display has not shown yet."""
    inside = log.has(time_s + offset)
    shown, powers = columns[:, : DEGREE + 1], columns[:, DEGREE + 1 :]
    measured = log.at(time_s[inside] + offset)
    found = np.linalg.lstsq(shown[inside], measured, rcond=None)[0]
    force = log.at(time_s + offset) - found[-1] + (powers - shown[:, :DEGREE]) @ found[:-1]
    return measured, measured - shown[inside] @ found, np.asarray(force)


def _errors(
    offsets: FloatArray, time_s: FloatArray, columns: FloatArray, log: PressForce, least: float = 1.0
) -> FloatArray:
    """(2, n) mean squared error at each offset [N^2], NaN where log and video do not share the rise, and the force at
    the last frame of `_at` [N]. least: 0 = they may share any part"""
    first = np.searchsorted(time_s, log.time_s[0] - offsets - 1e-9)
    last = np.searchsorted(time_s, log.time_s[-1] - offsets + 1e-9, side="right")
    errors, forces = np.full((2, len(offsets)), np.nan)
    unshown = np.append((columns[-1, DEGREE + 1 :] - columns[-1, :DEGREE]), -1.0)
    for begin, end in np.unique(np.stack([first, last], axis=1), axis=0):
        rows = np.flatnonzero((first == begin) & (last == end))
        some, depth = columns[begin:end, : DEGREE + 1], columns[begin:end, DEGREE + 1]
        if end - begin <= DEGREE + 3 or not np.ptp(depth) >= least * SHARED * np.ptp(columns[:, DEGREE + 1]):
            continue
        measured = log.at(time_s[begin:end] + offsets[rows, None])
        found = measured @ np.linalg.pinv(some).T
        left = measured - found @ some.T
        forces[rows] = log.at(time_s[-1] + offsets[rows]) + found @ unshown
        enough = np.ptp(measured, axis=1) >= least * RISEN * np.ptp(log.force_n)
        errors[rows] = np.where(enough, np.mean(left**2, axis=1), np.nan)
    return np.stack([errors, forces])


def _correlation(left: FloatArray) -> float:
    """Correlation of neighbouring errors, 0 to 0.95."""
    size = float(left @ left)
    return float(np.clip(left[1:] @ left[:-1] / size, 0.0, 0.95)) if size else 0.0
