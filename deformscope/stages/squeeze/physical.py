"""Physical quantities of a squeeze: contact, force, indentation, stiffness of the wall, relaxation.

These features complement the thesis's raw features, and mean the same on another hand and another container."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.see.tactile import tactile_contact
from deformscope.stages.squeeze.trial import PHYSICAL

LEVEL = 0.9
LEAST_INDENTATION_M = 2e-4
"""Least indentation for a slope of force over indentation."""


@dataclass(frozen=True, slots=True)
class Physical:
    """The physical features of one squeeze, SI units.

    values: (13,) in the order of `PHYSICAL`, NaN where it could not be measured. orientation: orientation of the
    principal axis of pressure, from the pad's columns towards its rows, in (-pi/2, pi/2]; elongation: 0 round to 1 a
    line; indentation: how far each finger went from first contact to steady state; onset_rate: mean slope of the
    force's first half; stiffness: stiffness of one wall, with its 90 % interval; relaxation: share of the force lost
    after steady state"""

    values: FloatArray

    def __getitem__(self, name: str) -> float:
        return float(self.values[PHYSICAL.index(name)])


def physical_features(
    time_s: FloatArray,
    pressure_pa: Sequence[Sequence[FloatArray]],
    texel_m: tuple[float, float],
    indentation_m: FloatArray,
    first_contact_s: float,
    steady_s: float,
) -> Physical:
    """The features of a squeeze from first contact to the end of its hold.

    time_s: (n,) times of the tactile frames; pressure_pa: for each frame one (rows, columns) array for each finger in
    contact [Pa]
    texel_m: (width, height); indentation_m: (n,) way of each finger into the wall since first contact, their mean [m]
    Raises InputError where there is no frame between the two events."""
    time, depth = np.asarray(time_s, dtype=np.float64), np.asarray(indentation_m, dtype=np.float64)
    if not len(time) == len(depth) == len(pressure_pa):
        raise InputError("as many times as frames and indentations", f"{len(time)}, {len(pressure_pa)}, {len(depth)}")
    during = np.flatnonzero((time >= first_contact_s) & (time <= steady_s))
    if not len(during):
        raise InputError("tactile frames from first contact to steady state", "none", "a slower squeeze")
    sizes = [texel_m] * len(pressure_pa[0])
    contacts = [tactile_contact(list(frame), sizes) for frame in pressure_pa]
    force = np.array([contact.force_n.mean() for contact in contacts])
    last = int(during[-1])
    steady, way = contacts[last], float(depth[last])
    center = np.nanmean(steady.center_m, axis=0) if np.isfinite(steady.center_m).any() else np.full(2, np.nan)
    angle, elongation = _orientation([np.asarray(one, dtype=np.float64) for one in pressure_pa[last]], texel_m)
    shape = (angle, elongation, steady.peak_pa.mean(), way)
    rates = (_onset_rate(time[during], force[during]), *_slope(depth[during], force[during]), _relaxation(force[last:]))
    return Physical(np.array([force[last], steady.area_m2.mean(), *center, *shape, *rates], dtype=np.float64))


def pressure_axis(pressure_pa: FloatArray, texel_m: tuple[float, float]) -> tuple[float, float]:
    """Orientation [rad] in (-pi/2, pi/2] from the columns towards the rows, and elongation (0 round to 1 a line) of the
    pressures (rows, columns) on one pad. Both are computed from the second moments (as drawn in Thesis fig. 2.4); NaN
    without contact."""
    weight = np.maximum(np.asarray(pressure_pa, dtype=np.float64), 0.0)
    total = weight.sum()
    if not total > 0.0:
        return float("nan"), float("nan")
    column, row = np.meshgrid(np.arange(weight.shape[1]) * texel_m[0], np.arange(weight.shape[0]) * texel_m[1])
    x, y = column - (weight * column).sum() / total, row - (weight * row).sum() / total
    xx, yy, xy = ((weight * a * b).sum() / total for a, b in ((x, x), (y, y), (x, y)))
    spread = float(np.hypot(xx - yy, 2.0 * xy))
    elongation = spread / (xx + yy) if xx + yy > 0.0 else 0.0
    return float(0.5 * np.arctan2(2.0 * xy, xx - yy)), float(elongation)


def _orientation(pads: Sequence[FloatArray], texel_m: tuple[float, float]) -> tuple[float, float]:
    """Angle [rad] and elongation of the pressure on pads (rows, columns), means over pads; angles are averaged doubled,
    since an axis has no sense, and weighted by elongation."""
    found = [pressure_axis(pad, texel_m) for pad in pads]
    kept = [(angle, elongation) for angle, elongation in found if np.isfinite(angle)]
    if not kept:
        return float("nan"), float("nan")
    mean = sum(elongation * np.exp(2j * angle) for angle, elongation in kept)
    return float(0.5 * np.angle(mean)), float(np.mean([elongation for _, elongation in kept]))


def _onset_rate(time: FloatArray, force: FloatArray) -> float:
    """Mean rate of the force (n,) [N] over time (n,) [s] up to half of its last value [N/s]."""
    half = int(np.argmax(force >= 0.5 * force[-1]))
    if half < 1 or not time[half] > time[0]:
        return float("nan")
    return float((force[half] - force[0]) / (time[half] - time[0]))


def _slope(depth: FloatArray, force: FloatArray) -> tuple[float, float, float]:
    """Force over indentation [N/m] and its interval, by least squares. Neighbouring residuals go together, so that the
    interval counts as many samples as are independent at their first autocorrelation."""
    if len(depth) < 4 or np.ptp(depth) < LEAST_INDENTATION_M:
        return float("nan"), float("nan"), float("nan")
    fit = scipy.stats.linregress(depth, force)
    left = force - fit.intercept - fit.slope * depth
    spread = float(left @ left)
    together = float(np.clip(left[1:] @ left[:-1] / spread, 0.0, 0.95)) if spread > 0.0 else 0.0
    count = max(len(depth) * (1.0 - together) / (1.0 + together), 3.0)
    wider = np.sqrt((len(depth) - 2.0) / (count - 2.0))
    half = float(scipy.stats.t.ppf(0.5 + LEVEL / 2.0, count - 2.0) * fit.stderr * wider)
    return float(fit.slope), float(fit.slope - half), float(fit.slope + half)


def _relaxation(force: FloatArray) -> float:
    """Share of the first force (n,) at steady state that is lost at the end, the mean of the last quarter."""
    if len(force) < 4 or not force[0] > 0.0:
        return float("nan")
    return float(1.0 - force[-max(len(force) // 4, 1) :].mean() / force[0])


# The tactile feature of a squeeze: 36 cells of each of two fingertip arrays, in counts (Thesis 5.1)

CELLS = 36
"""6x6 of each array."""
End = Literal["first", "last"]


def tactile_feature(arrays: Sequence[npt.NDArray[np.generic]], end: End = "first") -> FloatArray:
    """(36 n,) cells at one end of each of n fingertip arrays (rows, columns), row by row, float64.

    end: the first 36 as the controller sends them, as in the thesis, or the last. It is not published which of the two
    ends is at the fingertip: touch one and look in `deformscope live`."""
    short = [array.size for array in arrays if array.size < CELLS]
    if short:
        raise InputError(f"arrays of {CELLS} cells or more", f"{short[0]}")
    cells = [np.asarray(array, np.float64).ravel() for array in arrays]
    return np.concatenate([one[:CELLS] if end == "first" else one[-CELLS:] for one in cells])


def series_of(time_s: FloatArray, features: FloatArray, step_s: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """The feature over a squeeze: (k,) times 0, 0.1, 0.2... [s] until the last frame, and (k, p) the newest features
    then.

    time_s: (n,) times of the frames since first contact, rising; features: (n, p) features of each. Raises InputError
    without any frame at or after first contact."""
    if not len(time_s) or not time_s[-1] >= 0.0:
        raise InputError("tactile frames after first contact", "none")
    steps = np.arange(int(np.floor(float(time_s[-1]) / step_s + 1e-9)) + 1) * step_s
    newest = np.maximum(np.searchsorted(time_s, steps + 1e-9, side="right") - 1, 0)
    return steps, np.asarray(features, np.float64)[newest]
