"""The delay of one sensor relative to another, from taps that both measure.

y(t) = a x(t - d) + b + noise, with d the offset. Every offset of a fine grid has the likelihood of its residual, with
a, b and noise integrated out; the interval is that of the posterior.
"""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.transform import LEVEL

REACH_S = 0.5
"""Evaluated offsets, in both directions."""
COARSE_S, STEP_S = 2e-3, 2.5e-4
"""Between offsets: of all, and of those FINE_S around the best."""
FINE_S, NEAR_S = 0.04, 0.1
LEAST_SHARE = 0.5
"""Share of the variance of y that taps must explain."""
LEAST_PEAK = 6.0
"""Smallest peak of a tap, in deviations of the signal at rest."""


@dataclass(frozen=True, slots=True, eq=False)
class TimeOffset:
    """offset_s: delay of y relative to x; low_s, high_s: its interval; share: share of y's variance that x explains
    offsets_s, density: (n,) the posterior over the grid [1/s]"""

    offset_s: float
    low_s: float
    high_s: float
    share: float
    offsets_s: FloatArray
    density: FloatArray


def time_offset(x_time_s: FloatArray, x: FloatArray, y_time_s: FloatArray, y: FloatArray) -> TimeOffset:
    """The offset between a dense signal x (n,) and another y (m,) at their times [s], each by its own clock. Raises
    InputError for signals without a tap, that do not go together, or whose offset is at the end of the reach."""
    for name, signal in (("first", x), ("second", y)):
        if len(signal) < 20 or not np.isfinite(signal).all():
            raise InputError(f"20 readings or more of the {name} signal", str(len(signal)))
        if (peak := _peak(signal)) < LEAST_PEAK:
            came = f"{peak:.1f} deviations of it at rest"
            wanted = f"a tap that appears in the {name} signal as a peak"
            raise InputError(wanted, came, "tap harder, with rest between taps")
    inside = (y_time_s > x_time_s[0] + REACH_S) & (y_time_s < x_time_s[-1] - REACH_S)
    when, seen = np.asarray(y_time_s)[inside], np.asarray(y, np.float64)[inside]
    if len(when) < 20:
        raise InputError(f"{2 * REACH_S + 1:g} s that both signals have", f"{np.ptp(when) if len(when) else 0.0:.1f} s")
    coarse = np.arange(-REACH_S, REACH_S + 0.5 * COARSE_S, COARSE_S)
    shares = _explained(when, seen, coarse, x_time_s, x)
    best = int(np.argmax(shares))
    if shares[best] < LEAST_SHARE:
        came = f"{100 * shares[best]:.0f} % of the second explained by the first"
        raise InputError(f"{100 * LEAST_SHARE:g} % or more", came, "signals that a tap moves alike; one tap a second")
    if best in (0, len(coarse) - 1):
        raise InputError(f"an offset within {REACH_S:g} s", "one at the end of that", "clocks that are set")
    others = np.abs(coarse - coarse[best]) > NEAR_S
    if others.any() and shares[others].max() > shares[best] - 0.25 * (1.0 - LEAST_SHARE):
        away_s = coarse[others][np.argmax(shares[others])] - coarse[best]
        came = f"another {away_s:+.2f} s from it that fits equally well"
        raise InputError("one offset that fits", came, "taps at uneven times")
    offsets = coarse[best] + np.arange(-FINE_S, FINE_S + 0.5 * STEP_S, STEP_S)
    left = 1.0 - _explained(when, seen, offsets, x_time_s, x)
    best = int(np.argmin(left))
    # The effective number of independent residuals, by the correlation of neighbours.
    model = np.interp(when - offsets[best], x_time_s, x)
    design = np.column_stack([model, np.ones(len(model))])
    left_over = seen - design @ np.linalg.lstsq(design, seen, rcond=None)[0]
    alike = float(left_over[1:] @ left_over[:-1]) / max(float(left_over @ left_over), 1e-300)
    alike = min(max(alike, 0.0), 0.99)
    count = len(seen) * (1.0 - alike) / (1.0 + alike)
    log = -0.5 * max(count - 2.0, 1.0) * np.log(left / left[best])
    density = np.exp(log - log.max())
    density /= density.sum() * STEP_S
    cumulated = np.cumsum(density) * STEP_S
    tail = 0.5 * (1.0 - LEVEL)
    low, high = (float(np.interp(share, cumulated, offsets + 0.5 * STEP_S)) for share in (tail, 1.0 - tail))
    mean = float((density * offsets).sum() * STEP_S)
    return TimeOffset(mean, low, high, float(1.0 - left[best]), offsets, density)


def _explained(
    when: FloatArray, seen: FloatArray, offsets: FloatArray, x_time_s: FloatArray, x: FloatArray
) -> FloatArray:
    """(k,) share of what is seen (m,) that x explains, for each offset (k,)."""
    model = np.interp(when - offsets[:, None], x_time_s, x)
    model -= model.mean(axis=1, keepdims=True)
    centred = seen - seen.mean()
    power = np.maximum((model**2).sum(axis=1), 1e-300)
    return np.asarray((model @ centred) ** 2 / power / (centred @ centred))


def _peak(signal: FloatArray) -> float:
    """The largest deviation of a signal (n,) from its median, in robust standard deviations of it, which a few taps do
    not change."""
    off = np.abs(np.asarray(signal, np.float64) - np.median(signal))
    rest = 1.4826 * float(np.median(off))
    return float(off.max()) / max(rest, 1e-12 * float(off.max()) + 1e-300)
