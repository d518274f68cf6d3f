"""A sample of possible surfaces, and what contacts on them are expected to measure.

Maps of regions have a rival hypothesis, whose stiffness changes smoothly: Gaussian processes."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.gaussian_process import gaussian_between
from deformscope.stages.regions.levels import Readings, RegionPrior, mixed_stiffness
from deformscope.stages.regions.partitions import Partitions


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


Expected = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True)
class RegionHypotheses:
    """A sample of possible surfaces: weighted maps, with levels from soft to stiff, and smooth fields.

    maps: for each number of regions its maps (none for one region), their levels (n, k) and covariances (n, k, k), and
    weights (n,); smooth: kernels with their weights; all weights add up to 1; forces_add: as in `RegionPrior`
    scatter: for each number of regions the scatter of its maps (n,)"""

    maps: tuple[tuple[Partitions | None, FloatArray, FloatArray, FloatArray], ...]
    smooth: tuple[tuple[SmoothField, float], ...]
    forces_add: bool
    scatter: tuple[FloatArray, ...] = ()

    def predict(self, places_m: FloatArray, blur_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean and variance (h, p) of contacts at places (p, 2) under each hypothesis, and its probability (h,)."""
        parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        for maps, level, cov, weight in self.maps:
            shares = np.ones((1, len(places_m), 1)) if maps is None else maps.shares(places_m, blur_m)
            if self.forces_add:
                mean, shares = mixed_stiffness(shares, level)
            else:
                mean = (shares @ level[..., None])[..., 0]
            parts.append((mean, ((shares @ cov) * shares).sum(axis=-1), weight))
        for smooth, share in self.smooth:
            mean, variance = smooth.predict(places_m)
            parts.append((mean[None], variance[None], np.array([share])))
        mean, variance, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
        return mean, variance, weight / weight.sum()


@dataclass(frozen=True, slots=True)
class RelatedTouches:
    """Touches at places `at_m` (p, 2), which share scatter with those made so far, at `readings`, the more the nearer
    they are. The deviation of a neighbour is expected again, so that a touch next to it adds little information.
    own_sd: deviation of a touch alone"""

    at_m: FloatArray
    readings: Readings
    prior: RegionPrior
    own_sd: float

    def take(self, index: IntArray) -> "RelatedTouches":
        """The touches at the places of these indices."""
        return replace(self, at_m=self.at_m[index])

    def expected(self, hypotheses: RegionHypotheses, blur_m: float) -> Expected:
        """Under each hypothesis mean, variance due to the levels and total deviation (h, p) of the readings, and its
        weight (h,): the predictive distribution given the map and its scatter (universal kriging, Cressie 1993,
        3.4.2)."""
        made, places = self.readings, np.concatenate([self.at_m, self.readings.xy_m])
        new, measured, shared = len(self.at_m), made.value + made.centre, self.prior.error.shared(self.at_m, made.xy_m)
        parts: list[Expected] = []
        for (maps, level, cov, weight), scatter in zip(hypotheses.maps, hypotheses.scatter, strict=True):
            shares = np.ones((1, len(places), 1)) if maps is None else maps.shares(places, blur_m)
            off2 = (self.prior.mixed_share * made.spread * 2.0 * (1.0 - (shares**2).sum(axis=-1))) ** 2
            slope = shares
            if hypotheses.forces_add:
                mean, slope = mixed_stiffness(shares, level)
            else:
                mean = (shares @ level[..., None])[..., 0]
            square = scatter[:, None, None] ** 2
            errors = square * made.related + np.eye(len(measured)) * (made.variance + off2[:, None, new:])
            again = (square * shared) @ np.linalg.inv(errors)
            lever = slope[:, :new] - again @ slope[:, new:]
            variance = ((lever @ cov) * lever).sum(axis=-1)
            left = scatter[:, None] ** 2 * (1.0 - (again * shared).sum(axis=-1)) + off2[:, :new] + self.own_sd**2
            mean = mean[:, :new] + (again @ (measured - mean[:, new:])[..., None])[..., 0]
            parts.append((mean, variance, np.sqrt(variance + left), weight))
        for smooth, share in hypotheses.smooth:
            _, variance = smooth.predict(self.at_m)
            mean, both = smooth.predict(self.at_m, smooth.scatter**2 * shared)
            sd = np.sqrt(both + smooth.scatter**2 + self.own_sd**2)
            parts.append((mean[None], variance[None], sd[None], np.array([share])))
        mean, variance, sd, weight = (np.concatenate(one) for one in zip(*parts, strict=True))
        return mean, variance, sd, weight / weight.sum()
