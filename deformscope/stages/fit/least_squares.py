"""Several parameters at once by least squares, over simulations that run many candidates side by side.

Gauss-Newton steps with finite differences, damped (Levenberg, Marquardt). Each round is two batches, one for the
derivatives and one for steps of several lengths, of which the best is taken. For uniform noise the least sum of squares
is the most likely. The sum of squares is smooth, unlike the average distance (Thesis eq. 3.18), so that its curvature
is known."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv, stdtrit

from deformscope.arrays import BoolArray, FloatArray

Simulate = Callable[[FloatArray], FloatArray]
"""Computes the compared values (B, n) from parameters (B, m); NaN if a candidate has no reliable simulation."""

DAMPINGS = (0.0, 1e-3, 1e-1, 1e1)
"""Dampings that are tried in every round, as shares of the derivatives' squares."""

NOTHING = 1e-8
"""Ratio to the largest derivative below which a parameter counts as without effect."""

ROUNDS = 25
SETTLED = 1e-4
"""Length of a step, in every parameter, below which it is the last."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """The parameters with the least sum of squares.

    at: (m,) parameters; simulated: (n,) there; jacobian: (n, m); residual: (n,) observed - simulated
    inside: (m,) whether each parameter is away from both bounds; converged: the steps ended before their limit"""

    at: FloatArray
    simulated: FloatArray
    jacobian: FloatArray
    residual: FloatArray
    inside: BoolArray
    converged: bool

    @property
    def squares(self) -> float:
        return float(self.residual @ self.residual)


def minimise(
    simulate: Simulate, observed: FloatArray, start: FloatArray, bounds: FloatArray, difference: FloatArray
) -> Minimum:
    """The minimum downhill from `start` (m,). bounds: (m, 2); difference: (m,) finite steps; observed: (n,)"""
    low, high = bounds.T
    at = np.clip(np.asarray(start, dtype=np.float64), low, high)
    m = len(at)
    here = jacobian = np.zeros(0)
    converged = False
    for _ in range(ROUNDS):
        ahead, behind = np.minimum(at + difference, high), np.maximum(at - difference, low)
        tried = np.repeat(at[None], 2 * m + 1, axis=0)
        tried[np.arange(m), np.arange(m)], tried[np.arange(m, 2 * m), np.arange(m)] = ahead, behind
        found = simulate(tried)
        here = found[-1]
        jacobian = ((found[:m] - found[m : 2 * m]) / (ahead - behind)[:, None]).T
        residual = observed - here
        if converged or not np.isfinite(jacobian).all():
            break
        uphill = jacobian.T @ residual
        # a parameter that pushes against its bound stays there
        open_ = ~(((at <= low) & (uphill <= 0.0)) | ((at >= high) & (uphill >= 0.0)))
        square = jacobian.T @ jacobian
        steps = np.zeros((len(DAMPINGS), m))
        for row, damping in enumerate(DAMPINGS):
            part = square[np.ix_(open_, open_)]
            damped = part + damping * np.diag(np.diag(part))
            steps[row, open_] = np.linalg.lstsq(damped, uphill[open_], rcond=1e-12)[0]
        trials = np.clip(at + steps, low, high)
        squares = np.sum((observed - simulate(trials)) ** 2, axis=1)
        best = int(np.nanargmin(squares)) if np.isfinite(squares).any() else 0
        if not squares[best] < residual @ residual:
            converged = bool(np.abs(trials[best] - at).max() <= 10.0 * SETTLED + difference.max())
            break
        converged = bool(np.abs(trials[best] - at).max() <= SETTLED)
        at = trials[best]
    return Minimum(at, here, jacobian, observed - here, (at > low) & (at < high), converged)


@dataclass(frozen=True, slots=True)
class Noise:
    """Variation between repeats of an observation.

    deviation: deviation of one observed number; shared: variance of the mean of all numbers, over that with independent
    errors; held: (r, n) variation of the simulation in repeats of the prescribed positions' noise; none (0, n) if they
    are exact"""

    deviation: float
    held: FloatArray
    shared: float = 1.0

    def variance_along(self, direction: FloatArray) -> float:
        """Variance of the noise along a direction (n,) of any length."""
        size = float(direction @ direction)
        if size <= 0.0:
            return self.shared * self.deviation**2
        held = float(np.mean((self.held @ direction) ** 2)) / size if len(self.held) else 0.0
        return self.shared * self.deviation**2 + held

    def covariance(self, jacobian: FloatArray) -> FloatArray:
        """Covariance (m, m) of a least squares estimate with these derivatives (n, m). A parameter, or a combination,
        without effect on the observed numbers has a very large variance."""
        size = np.linalg.norm(jacobian, axis=0)
        size = np.maximum(size, NOTHING * size.max(initial=0.0)) if size.any() else np.ones_like(size)
        across, strength, along = np.linalg.svd(jacobian / size, full_matrices=False)
        inverse = (along.T / np.maximum(strength, NOTHING)) / size[:, None]  # (m, m), of the directions `across`
        held = self.held @ across @ inverse.T
        own = self.shared * self.deviation**2 * inverse @ inverse.T
        return np.asarray(own + held.T @ held / len(held) if len(held) else own)


def shared_noise(residual: FloatArray, parameters: int, held: FloatArray, tried: float, least: float) -> Noise:
    """The noise that observed and prescribed positions share, by the residuals (n,), but not below `least`: the stated
    noise, or the resolution of numbers.

    held: (r, n) changes of the simulated positions in r draws of the prescribed positions' noise, whose standard
    deviation is `tried`; they explain a part of the residuals"""
    share = float(np.mean(held**2)) / tried**2 if len(held) else 0.0
    deviation = max(deviation_of(residual, parameters) / float(np.sqrt(1.0 + share)), least)
    return Noise(deviation, held * (deviation / tried))


def deviation_of(residual: FloatArray, parameters: int) -> float:
    """Standard deviation of one number, from the residual (n,) of a fit with this number of parameters, in its unit."""
    return float(np.sqrt(residual @ residual / max(residual.size - parameters, 1)))


def half_width(covariance: FloatArray, level: float, freedom: int) -> FloatArray:
    """Half widths (m,) of the intervals at `level`."""
    wide = stdtrit(max(freedom, 1), 0.5 + 0.5 * level)  # Student's t; scipy.stats takes a second to import
    return np.asarray(wide * np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def worse_than(level: float) -> float:
    """Number of noise variances by which a sum of squares may exceed the least, in `level` of all repeats."""
    return float(2.0 * gammaincinv(0.5, level))  # chi-squared with one degree of freedom
