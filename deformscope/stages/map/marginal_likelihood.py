"""Hyper-parameters of a surface's Gaussian process by the marginal likelihood of all its points.

The start is the best of a few lengths, from long to short. L-BFGS-B then maximizes, in a basis of sines that is renewed
when the length leaves its range. The priors are so wide (a factor of 4.5 up or down) that a hundred points overrule
them; they bound the estimates of a handful of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.map.hilbert_basis import MOST_SINES, HilbertBasis, ListedPoints, WeightedBasis
from deformscope.stages.map.perception import Hyperparameters

FLOOR_M = 1e-6
"""Smallest scale of heights [m], for constant ones too."""

LONGEST = 3.0
"""Largest length, as a multiple of the data's longer side."""

COARSE = 1.7
"""Ratio of successive lengths in the first, rough search."""

LESS_NOISE = float(np.log(4.0))
"""How much less noise (in logs) is tried there too."""

RANGE = (1.3, 1.5)
"""A basis serves lengths shorter and longer than the start by these factors."""

STRIDE = 1.5
"""sigma_e and the noise move by at most this (in logs) in one round: a first step without a sense of scale goes no
farther."""

MOST_ROUNDS = 12

NEAR_BOUND = 2e-3
"""Distance from a bound (in logs) below which a value counts as at the bound."""

SETTLED = 1e-3
"""Gain of log likelihood below which the search ends."""

PRIOR_SPREAD = 1.5
"""Deviation of the priors of log sigma_e, log length and log noise scale, around the data's scales."""

FREEDOM = np.log(1e4)
"""sigma_e and the noise may be this far (in logs) from the data's scales."""

NEIGHBOURS = 8

HOPELESS = 1e9
"""Value of the log likelihood if equations cannot be solved (a sigma_e a million times the noise)."""


@dataclass(frozen=True, slots=True)
class Observations:
    """places: (n, 2) [m]; value: (n,) heights above the mean [m]; noise: (n,) its deviation [m]"""

    places: FloatArray
    value: FloatArray
    noise: FloatArray


NAMES = ("sigma_e", "length", "noise_scale")


def learn(free: Observations, known: Observations, start: Hyperparameters | None) -> Hyperparameters:
    """The likeliest hyper-parameters. free: points whose noise is known up to one factor (1 without such points);
    known: points whose noise is known; start: estimates from nearly the same points; None: a few lengths are tried
    first"""
    return _Search(free, known).run(start)


class _Search:
    def __init__(self, free: Observations, known: Observations) -> None:
        self.free, self.known = free, known
        places = np.concatenate([free.places, known.places])
        low, high = places.min(axis=0), places.max(axis=0)
        self.middle, self.half = 0.5 * (low + high), 0.5 * (high - low)
        half = self.half
        self.trials = 0
        longest = LONGEST * max(2.0 * float(half.max()), FLOOR_M)
        shortest = longest * 1e-4
        while HilbertBasis.size(half, shortest / RANGE[0], shortest * RANGE[1]) > MOST_SINES:
            shortest *= 1.05
        self.limits = (shortest, longest)
        value = np.concatenate([free.value, known.value])
        noise = roughness(free)
        self.scale = noise / float(np.median(free.noise)) if len(free.noise) else 1.0
        self.scales = np.log([max(float(value.std()), noise, FLOOR_M), 0.25 * longest / LONGEST, self.scale])

    def run(self, before: Hyperparameters | None) -> Hyperparameters:
        low, high = self.scales - FREEDOM, self.scales + FREEDOM
        low[1], high[1] = np.log(self.limits)
        if not len(self.free.value):
            low[2] = high[2] = 0.0
        if before is None:
            at = self._first()
        else:
            at = np.log([before.kernel.sigma_e, before.kernel.length_m, before.noise_scale])
        value = -np.inf
        for _ in range(MOST_ROUNDS):
            length = float(np.exp(at[1]))
            ends = length / RANGE[0], length * RANGE[1]
            here = np.clip(np.array([at - STRIDE, at + STRIDE]), low, high)
            here[:, 1] = np.clip(np.log(ends), low[1], high[1])
            at, value = self._climb(at, here.T, ends)
            stopped = (at <= here[0] + NEAR_BOUND) | (at >= here[1] - NEAR_BOUND)
            for_good = (at <= low + NEAR_BOUND) | (at >= high - NEAR_BOUND)
            if not (stopped & ~for_good).any():
                break
        bound = [
            name
            for name, x, a, b in zip(NAMES, at, low, high, strict=True)
            if a < b and (x <= a + NEAR_BOUND or x >= b - NEAR_BOUND)
        ]
        sigma_e, length, scale = (float(x) for x in np.exp(at))
        return Hyperparameters(
            kernel=Kernel.of_length(sigma_e, length),
            noise_scale=scale,
            log_likelihood=value,
            at_bound=tuple(bound),
            trials=self.trials,
        )

    def _first(self) -> FloatArray:
        """(3,) logarithms to start from: the best of a few lengths, from long to short. Each has the noise between
        neighbours, and less, because a surface that is rough between neighbours resembles noise."""
        start = self.scales
        length, best, at = 0.5 * self.limits[1] / LONGEST, -np.inf, start
        while True:
            length = max(length, self.limits[0])
            basis = HilbertBasis(self.middle, self.half, length, length)
            weighed = self._weighed(basis)
            for less in (0.0, LESS_NOISE) if len(self.free.value) else (0.0,):
                here = np.array([start[0], np.log(length), start[2] - less])
                value = basis.trial(*weighed, *(float(x) for x in np.exp(here))).value
                self.trials += 1
                if value > best:
                    best, at = value, here
            if length <= self.limits[0]:
                return at
            length /= COARSE

    def _climb(self, start: FloatArray, bounds: FloatArray, ends: tuple[float, float]) -> tuple[FloatArray, float]:
        """The likeliest logarithms (3,) within bounds (3, 2) from a start (3,), and their log posterior. ends: lengths
        [m]"""
        basis = HilbertBasis(self.middle, self.half, *ends)
        weighed = self._weighed(basis)
        free = bounds[:, 0] < bounds[:, 1]
        count = len(self.free.value) + len(self.known.value)

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            """Negative log posterior at x (3,) and its slopes (3,), each divided by the number of points."""
            self.trials += 1
            sigma_e, length, scale = np.exp(x)
            found = basis.trial(*weighed, sigma_e, length, scale)
            away = np.where(free, (x - self.scales) / PRIOR_SPREAD, 0.0)
            value = found.value if np.isfinite(found.value) else -HOPELESS
            return (0.5 * float(away @ away) - value) / count, (away / PRIOR_SPREAD - found.slope) / count

        first = np.clip(start, bounds[:, 0], bounds[:, 1])
        options = {"ftol": SETTLED / count, "gtol": 1e-2 * SETTLED, "maxiter": 60}
        found = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        x = np.asarray(found.x)
        away = np.where(free, (x - self.scales) / PRIOR_SPREAD, 0.0)
        return x, float(0.5 * away @ away - found.fun * count)

    def _weighed(self, basis: HilbertBasis) -> tuple[WeightedBasis, ListedPoints]:
        free, known = self.free, self.known
        listed = basis.list(known.places, known.value, known.noise)
        return basis.weigh(free.places, free.value, free.noise), listed


def roughness(points: Observations) -> float:
    """A robust deviation of the noise [m]: of each height from the mean of its nearest neighbours' [m]."""
    count = min(NEIGHBOURS, len(points.value) - 1)
    if count < 2:
        return FLOOR_M
    _, near = cKDTree(points.places).query(points.places, k=count + 1)
    left = points.value - points.value[near[:, 1:]].mean(axis=1)
    return max(float(1.4826 * np.median(np.abs(left)) / np.sqrt(1.0 + 1.0 / count)), FLOOR_M)
