"""Fields over a surface from a few touches: log stiffness, or beta, as an exact Gaussian process (Thesis 4.2).

    field = fit_field(places_m, log_stiffness, log_sd, FieldPrior())
    found = field.on(grid)                 # mean and deviation on cells of 0.5 cm

Each touch has its own variance. The additional scatter of touches at one place is the *nugget*, the same for all
touches. A few touches do not identify the hyper-parameters: each has a weak prior (`FieldPrior`). The prediction
averages over the hyper-parameters' posterior, not only its mode, so that a map of three touches has its full
uncertainty.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import Kernel, ProcessPrediction
from deformscope.stages.regions.touches import SCATTER_MEDIAN, MapGrid

FREEDOM = 3.0
"""Number of deviations from their priors within which hyper-parameters are searched."""

BEYOND = 1.4
"""Hyper-parameters are averaged over points this many deviations (times the root of their number) from the likeliest.
With 1.1, the usual choice, 89 % of values drawn from the priors lay in the 90 % bands; with 1.4, 90 % (3 to 20 touches,
250 seeds)."""

STEP = 1e-3
"""Step in logarithms over which the posterior's curvature is computed."""

LEAST_CURVATURE, LEAST_SHARE = 0.5, 1e-4
"""Curvature is at least this share of the priors' own; points of a smaller share of the mass are dropped."""

LEAST_SD = 1e-6
"""Smallest deviation of a touch, so that touches at one place stay distinct."""

Cost = Callable[[FloatArray], tuple[float, FloatArray]]
"""Negative log posterior of hyper-parameters (3,) and its slopes."""


@dataclass(frozen=True, slots=True)
class FieldPrior:
    """Log-normal priors of the hyper-parameters: a median, and a spread in natural logarithms.

    sigma_e: deviation of the field [its unit]; length_m [m]; nugget: deviation from touch to touch at one place
    level_sd: deviation of the constant mean around that of the touches; large, so that only touches determine it. The
    defaults are for log stiffness: foams that differ by a factor of 1.2 to 3, regions of 10 to 40 cm, and the scatter
    of touches in `stages.regions.touches`. For beta, 0 to 1, `BETA_PRIOR`."""

    sigma_e: float = 0.5
    sigma_e_spread: float = 0.8
    length_m: float = 0.15
    length_spread: float = 0.6
    nugget: float = SCATTER_MEDIAN
    nugget_spread: float = 0.6  # wider than that of regions' scatter: a field may be of anything
    level_sd: float = 2.0

    def median(self) -> FloatArray:
        """(3,) natural logarithms of the prior medians of sigma_e, length [m] and nugget."""
        return np.log([self.sigma_e, self.length_m, self.nugget])

    def spread(self) -> FloatArray:
        """(3,) standard deviations of the three logarithms in the prior."""
        return np.array([self.sigma_e_spread, self.length_spread, self.nugget_spread])


BETA_PRIOR = FieldPrior(sigma_e=0.25, nugget=0.05, nugget_spread=0.7, level_sd=1.0)


@dataclass(frozen=True, slots=True)
class FieldMap:
    """A field on a grid. mean, deviation: (rows, columns), mean and deviation of the field itself, without a touch's
    noise"""

    grid: MapGrid
    mean: FloatArray
    deviation: FloatArray


@dataclass(frozen=True, slots=True)
class _State:
    """The process under one choice of hyper-parameters. factor: (n, n) Cholesky; weight: (n,) K^-1 (v - level)"""

    kernel: Kernel
    level_sd: float
    factor: FloatArray
    weight: FloatArray
    share: float


@dataclass(frozen=True)
class Field:
    """A field given its touches.

    places_m: (n, 2) [m]; value, sd: (n,) value and standard deviation of the touches; level: the constant that the mean
    varies around; kernel, nugget: the likeliest ones; states: hyper-parameters of the average"""

    places_m: FloatArray
    value: FloatArray
    sd: FloatArray
    level: float
    kernel: Kernel
    nugget: float
    states: tuple[_State, ...]

    def at(self, places_m: FloatArray) -> ProcessPrediction:
        """Mean (m,) and deviation (m,) of the field at places (m, 2) [m] (Thesis eq. 4.3 and 4.4)."""
        places = np.atleast_2d(np.asarray(places_m, dtype=np.float64))
        first, second = np.zeros(len(places)), np.zeros(len(places))
        with threadpool_limits(1):
            for state in self.states:
                across = state.kernel.between(self.places_m, places) + state.level_sd**2
                whitened = solve_triangular(state.factor, across, lower=True)
                mean = across.T @ state.weight
                variance = state.kernel.sigma_e**2 + state.level_sd**2 - np.sum(whitened**2, axis=0)
                first += state.share * mean
                second += state.share * (variance.clip(0.0) + mean**2)
        return ProcessPrediction(first + self.level, np.sqrt((second - first**2).clip(0.0)))

    def on(self, grid: MapGrid) -> FieldMap:
        """The field at the centres of a grid's cells."""
        found = self.at(grid.centres_m)
        return FieldMap(grid, found.mean.reshape(grid.shape), found.deviation.reshape(grid.shape))


def fit_field(places_m: FloatArray, value: FloatArray, sd: FloatArray, prior: FieldPrior) -> Field:
    """The field through touches at places (n, 2) [m] with values (n,) and their deviations (n,).

    Several touches at one place are replicates and identify the nugget. Raises InputError without a touch, and for
    values that are not finite."""
    places, value, sd = (np.asarray(one, dtype=np.float64) for one in (places_m, value, sd))
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise InputError("touches at places (n, 2) [m], one at least", f"shape {places.shape}")
    if value.shape != (len(places),) or sd.shape != (len(places),):
        raise InputError(f"a value and a deviation of each of {len(places)} touches", f"{value.shape} and {sd.shape}")
    if not (np.isfinite(places).all() and np.isfinite(value).all()):
        raise InputError("finite touches", "NaN or infinity", "leave that touch out")
    if not (np.isfinite(sd).all() and (sd >= 0.0).all()):
        raise InputError("a finite deviation of each touch, 0 or more", f"{float(np.min(sd)):g}")
    with threadpool_limits(1):
        return _Fit(places, value, np.maximum(sd, LEAST_SD), prior).run()


class _Fit:
    def __init__(self, places: FloatArray, value: FloatArray, sd: FloatArray, prior: FieldPrior) -> None:
        self.places, self.sd, self.prior = places, sd, prior
        weight = 1.0 / (sd**2 + prior.nugget**2)
        self.level = float(weight @ value / weight.sum())
        self.value, self.left = value, value - self.level
        self.square = np.sum((places[:, None] - places) ** 2, axis=2)

    def run(self) -> Field:
        median, spread = self.prior.median(), self.prior.spread()
        low, high = median - FREEDOM * spread, median + FREEDOM * spread

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            value, slope = self.likelihood(x)
            away = (x - median) / spread
            return -value + 0.5 * float(away @ away), -slope + away / spread

        starts = [median, *(median + step for step in ([0.0, -1.0, 0.0], [0.0, 1.0, 0.0]))]
        bounds = np.column_stack([low, high])
        found = [
            minimize(cost, np.clip(start, low, high), jac=True, method="L-BFGS-B", bounds=bounds) for start in starts
        ]
        at = np.asarray(min(found, key=lambda one: float(one.fun)).x)
        return self.field(at, self._around(at, low, high, cost))

    def field(self, at: FloatArray, around: Sequence[tuple[FloatArray, float]]) -> Field:
        """at: (3,) likeliest hyper-parameters, as in `likelihood`; around: those to average over, and their shares"""
        return Field(
            places_m=self.places,
            value=self.value,
            sd=self.sd,
            level=self.level,
            kernel=Kernel.of_length(float(np.exp(at[0])), float(np.exp(at[1]))),
            nugget=float(np.exp(at[2])),
            states=tuple(self._state(x, share) for x, share in around),
        )

    def likelihood(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Log marginal likelihood at x (3,), the logarithms of sigma_e, length [m] and nugget, and its slopes (3,)."""
        signal, noise, covariance = self._covariance(x)
        factor = cholesky(covariance, lower=True)
        weight = cho_solve((factor, True), self.left)
        inverse = cho_solve((factor, True), np.eye(len(weight)))
        inner = np.outer(weight, weight) - inverse
        length2 = np.exp(2.0 * x[1])
        slope = [np.sum(inner * signal), 0.5 * np.sum(inner * signal * self.square) / length2, noise * np.trace(inner)]
        value = -0.5 * self.left @ weight - np.log(np.diag(factor)).sum() - 0.5 * len(weight) * np.log(2.0 * np.pi)
        return float(value), np.array(slope)

    def _covariance(self, x: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """Covariance (n, n) of the field at the touches, the nugget's variance, and covariance (n, n) of the
        measurements, with the unknown level and all noise. x: (3,) as in `likelihood`"""
        sigma_e, length, nugget = np.exp(x)
        signal = sigma_e**2 * np.exp(-0.5 * self.square / length**2)
        covariance = signal + self.prior.level_sd**2
        covariance.flat[:: len(covariance) + 1] += self.sd**2 + nugget**2
        return signal, float(nugget**2), covariance

    def _state(self, x: FloatArray, share: float) -> _State:
        factor = cholesky(self._covariance(x)[2], lower=True)
        sigma_e, length, _ = (float(one) for one in np.exp(x))
        weight = cho_solve((factor, True), self.left)
        return _State(Kernel.of_length(sigma_e, length), self.prior.level_sd, factor, weight, share)

    def _around(self, at: FloatArray, low: FloatArray, high: FloatArray, cost: Cost) -> list[tuple[FloatArray, float]]:
        """Hyper-parameters (3,) to average over and their shares: the mode, and points around it on a sphere of the
        posterior's deviations, with Gaussian weights corrected by the posterior (Rue et al. 2009, 6.5: a central
        composite design)."""
        size = len(at)
        curvature = np.empty((size, size))
        for row in range(size):
            step = STEP * (1.0 if at[row] + STEP <= high[row] else -1.0) * np.eye(size)[row]
            curvature[row] = (cost(at + step)[1] - cost(at)[1]) / step[row]
        value, vector = np.linalg.eigh(0.5 * (curvature + curvature.T))
        deviation = 1.0 / np.sqrt(np.maximum(value, LEAST_CURVATURE / self.prior.spread().max() ** 2))
        radius = BEYOND * np.sqrt(size)
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=size))) / np.sqrt(size)
        away = radius * np.concatenate([corners, np.eye(size), -np.eye(size)])
        points, logs = [at], [np.log(1.0 - BEYOND**-2.0)]
        here = cost(at)[0]
        for one in away:
            x = np.clip(at + vector @ (deviation * one), low, high)
            points.append(x)
            logs.append(here - cost(x)[0] + 0.5 * radius**2 - np.log(len(away) * BEYOND**2))
        share = np.exp(np.array(logs) - max(logs))
        share /= share.sum()
        return [(x, float(one)) for x, one in zip(points, share, strict=True) if one > LEAST_SHARE]
