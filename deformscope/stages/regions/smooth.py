"""Surfaces whose stiffness changes smoothly: Gaussian processes, the rival hypothesis of maps of regions."""

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deformscope.arrays import FloatArray
from deformscope.stages.gaussian_process import gaussian_between
from deformscope.stages.regions.levels import Readings


@dataclass(frozen=True, slots=True)
class SmoothKernel:
    """Kernel of log stiffness: a constant of deviation `level_sd`, a plane of random slope about `middle_m` (2,) [m],
    and a squared exponential part of `sd` and `length_m`."""

    level_sd: float
    middle_m: FloatArray
    slope_per_m: float
    sd: float
    length_m: float

    def covariance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(n, m) prior covariance between places (n, 2) and (m, 2)."""
        plane = self.slope_per_m**2 * (a - self.middle_m) @ (b - self.middle_m).T
        return cast(FloatArray, self.level_sd**2 + plane + self.sd**2 * gaussian_between(a, b, self.length_m))


class SmoothField:
    """A Gaussian process through the touches, which scatter. log_evidence: its evidence, with `log_prior`"""

    def __init__(self, readings: Readings, kernel: SmoothKernel, scatter: float, log_prior: float) -> None:
        self.kernel, self.readings_of, self.scatter, self.log_evidence = kernel, readings, scatter, log_prior
        if count := len(readings.value):
            own = kernel.covariance(readings.xy_m, readings.xy_m) + np.outer(readings.arm, readings.arm)
            own += scatter**2 * readings.related + np.diag(readings.variance)
            self._factor, _ = cho_factor(own, lower=True)
            self._weight = cho_solve((self._factor, True), readings.value)
            square, logs = readings.value @ self._weight, 2.0 * np.log(np.diag(self._factor)).sum()
            self.log_evidence += float(-0.5 * (square + logs + count * np.log(2.0 * np.pi)))

    def predict(self, xy_m: FloatArray, shared: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Mean (p,) and variance (p,) of log stiffness at places (p, 2) [m]. shared: (p, t) covariance of their scatter
        with that of the touches, if the prediction includes scatter; the variance of the scatter is not included"""
        k, readings = self.kernel, self.readings_of
        prior = k.level_sd**2 + k.sd**2 + k.slope_per_m**2 * ((xy_m - k.middle_m) ** 2).sum(axis=1)
        if not len(readings.xy_m):
            return np.full(len(xy_m), readings.centre), prior
        cross = k.covariance(xy_m, readings.xy_m) + shared
        explained = (cross.T * cho_solve((self._factor, True), cross.T)).sum(axis=0)
        return cross @ self._weight + readings.centre, np.maximum(prior - explained, 0.0)
