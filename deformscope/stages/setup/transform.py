"""Rigid transforms with their uncertainty, and the least squares that estimate them.

    found = fitted(residual, start, prior)          # values, covariance, degrees of freedom
    estimate = transform_of(found, T_start)         # (4, 4) with the interval of each component

A deviation is six numbers (..., 6): a translation [m], then a small turn [rad], both in the frame that the transform
leads to: T = moved(T_estimate, deviation).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy
from scipy import optimize
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray

LEVEL = 0.9
"""Share of the intervals that hold the truth."""


@dataclass(frozen=True, slots=True)
class ErrorPrior:
    """Prior of a measurement's variance: scaled inverse chi-square.

    sd: its centre, in units of the residuals; weight: its weight in numbers of measurements, 0 = no prior"""

    sd: float
    weight: float = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquares:
    """Result of a fit.

    value: (p,); covariance: (p, p) including its scale; dof: degrees of freedom of that scale (Student's t)
    sd: deviation of a residual, prior and residuals taken together; scatter: scatter of the residuals, NaN without
    degrees of freedom"""

    value: FloatArray
    covariance: FloatArray
    dof: float
    sd: float
    scatter: float

    def half(self) -> FloatArray:
        """(p,) half widths of the intervals."""
        return half_widths(self.covariance, self.dof)


@dataclass(frozen=True, slots=True, eq=False)
class TransformEstimate:
    """A rigid transform.

    T: (4, 4); covariance: (6, 6) covariance of its deviation [m, rad]; dof: degrees of freedom of the covariance's
    scale"""

    T: FloatArray
    covariance: FloatArray
    dof: float

    def half(self) -> FloatArray:
        """(6,) half widths of the intervals: three of the translation [m], three of the turn [rad]."""
        return half_widths(self.covariance, self.dof)

    def deviation(self, T: FloatArray) -> FloatArray:
        """(6,) of another transform from this one [m, rad]."""
        return deviation(self.T, T)


def half_widths(covariance: FloatArray, dof: float) -> FloatArray:
    """(p,) of the intervals of Student's t."""
    return np.asarray(scipy.stats.t.ppf(0.5 + 0.5 * LEVEL, dof) * np.sqrt(np.diag(covariance)))


def moved(T: FloatArray, deviation: npt.ArrayLike) -> FloatArray:
    """(4, 4) a transform with a deviation (6,) added."""
    off = np.asarray(deviation, np.float64)
    made = np.array(T, np.float64)
    made[:3, :3] = Rotation.from_rotvec(off[3:]).as_matrix() @ made[:3, :3]
    made[:3, 3] += off[:3]
    return made


def deviation(T: FloatArray, other: FloatArray) -> FloatArray:
    """(..., 6) by which `other` (..., 4, 4) deviates from T (..., 4, 4): the reverse of `moved`."""
    turn = np.asarray(other)[..., :3, :3] @ np.swapaxes(np.asarray(T)[..., :3, :3], -1, -2)
    turned = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(*turn.shape[:-2], 3)
    return np.concatenate([np.asarray(other)[..., :3, 3] - np.asarray(T)[..., :3, 3], turned], axis=-1)


def rigid(rotation: npt.ArrayLike, translation_m: npt.ArrayLike) -> FloatArray:
    """(..., 4, 4) out of (..., 3, 3) and (..., 3)."""
    turn, way = np.asarray(rotation, np.float64), np.asarray(translation_m, np.float64)
    T = np.zeros((*turn.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = turn, way, 1.0
    return T


def superposed(points_m: FloatArray, onto_m: FloatArray) -> FloatArray:
    """(4, 4) that brings points (n, 3) nearest to others (n, 3) (Kabsch 1976; Umeyama 1991)."""
    middle, onto = points_m.mean(axis=0), onto_m.mean(axis=0)
    left, _, right = np.linalg.svd((onto_m - onto).T @ (points_m - middle))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rigid(turn, onto - turn @ middle)


def fitted(residual: Callable[[FloatArray], FloatArray], start: npt.ArrayLike, prior: ErrorPrior) -> LeastSquares:
    """Least squares of residuals (n,) over values (p,), with n >= p.

    Their deviation combines the prior and the residuals, so that few measurements are not trusted too much. Raises
    numpy.linalg.LinAlgError where the residuals do not depend on some value."""
    found = optimize.least_squares(residual, np.asarray(start, np.float64), method="lm", x_scale="jac")
    return judged(found.x, np.linalg.inv(found.jac.T @ found.jac), found.fun, prior)


def judged(value: FloatArray, inverse: FloatArray, left_over: FloatArray, prior: ErrorPrior) -> LeastSquares:
    """A solution (p,) with the inverse of its normal matrix (p, p), and the residuals (n,)."""
    count = len(left_over) - len(value)
    squares, dof = float(left_over @ left_over), prior.weight + count
    variance = (prior.weight * prior.sd**2 + squares) / dof
    scatter = float(np.sqrt(squares / count)) if count > 0 else float("nan")
    return LeastSquares(value, variance * inverse, dof, float(np.sqrt(variance)), scatter)


def transform_of(found: LeastSquares, T_start: FloatArray) -> TransformEstimate:
    """The transform whose deviation from T_start (4, 4) is a fit's first six values. The covariance is of a deviation
    from the estimate: for the small turns that a fit ends with, those of its values."""
    return TransformEstimate(moved(T_start, found.value[:6]), found.covariance[:6, :6], found.dof)
