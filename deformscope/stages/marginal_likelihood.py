"""Hyper-parameters of a surface's Gaussian process by the marginal likelihood of all its points.

A rough look at a few lengths, from long to short, tells where to start; then L-BFGS-B climbs, in a basis of sines that
is laid out anew wherever the length leaves what it is good for. The priors are so wide (a factor of 4.5 either way)
that a hundred points overrule them; they keep a handful of points from running off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.hilbert_basis import MOST_SINES, HilbertBasis, Listed, Weighed

FLOOR_M = 1e-6
"""Heights are not told apart below this [m]: constant ones still have a scale."""

LONGEST = 3.0
"""The length is at most this many times the longer side of the data."""

COARSE = 1.7
"""Ratio of lengths in the rough look."""

RANGE = (1.3, 1.5)
"""A basis serves lengths shorter and longer than the start by these factors."""

MOST_ROUNDS = 8

PRIOR_SPREAD = 1.5
"""Deviation of the priors of log sigma_e, log length and log noise scale, around the data's scales."""

FREEDOM = np.log(1e4)
"""sigma_e and the noise may be this far (in logs) from the data's scales."""

NEIGHBOURS = 8


@dataclass(frozen=True, slots=True)
class Points:
    """places: (n, 2) [m]; value: (n,) above the mean [m]; noise: (n,) its deviation [m]"""

    places: FloatArray
    value: FloatArray
    noise: FloatArray


@dataclass(frozen=True, slots=True)
class Given:
    """Hyper-parameters that the user fixed; None: to be learned."""

    sigma_e: float | None = None
    sigma_w: float | None = None
    noise_scale: float | None = None


@dataclass(frozen=True, slots=True)
class Learned:
    """kernel; noise_scale: what the free points' noise is multiplied by; log_likelihood: marginal, of all points
    at_bound: which of "sigma_e", "length", "noise_scale" came to rest at a bound of what was searched
    trials: how often the likelihood was found"""

    kernel: Kernel
    noise_scale: float
    log_likelihood: float
    at_bound: tuple[str, ...]
    trials: int


NAMES = ("sigma_e", "length", "noise_scale")


def learn(free: Points, known: Points, given: Given) -> Learned:
    """The likeliest hyper-parameters. free: points whose noise is known up to one factor; known: whose noise is known."""
    places = np.concatenate([free.places, known.places])
    low, high = places.min(axis=0), places.max(axis=0)
    search = _Search(free, known, 0.5 * (low + high), 0.5 * (high - low))
    return search.run(given)


class _Search:
    def __init__(self, free: Points, known: Points, middle: FloatArray, half: FloatArray) -> None:
        self.free, self.known, self.middle, self.half = free, known, middle, half
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

    def run(self, given: Given) -> Learned:
        told = [
            given.sigma_e,
            None if given.sigma_w is None else Kernel(1.0, given.sigma_w).length_m,
            given.noise_scale if len(self.free.value) else 1.0,
        ]
        fixed = [None if one is None else float(np.log(one)) for one in told]
        low, high = self.scales - FREEDOM, self.scales + FREEDOM
        low[1], high[1] = np.log(self.limits)
        start = np.array([s if f is None else f for s, f in zip(self.scales, fixed, strict=True)])
        for i, one in enumerate(fixed):
            if one is not None:
                low[i] = high[i] = one
        if fixed[1] is None:
            start[1] = self._first_length(start)
        at, value = start, -np.inf
        for _ in range(MOST_ROUNDS):
            length = float(np.exp(at[1]))
            ends = length / RANGE[0], length * RANGE[1]
            here = np.array([low, high])
            here[:, 1] = np.clip(np.log(ends), low[1], high[1])
            at, value = self._climb(at, here.T, ends)
            inside = here[0, 1] + 1e-3 < at[1] < here[1, 1] - 1e-3
            if inside or at[1] <= low[1] + 1e-3 or at[1] >= high[1] - 1e-3:
                break
        bound = [
            name
            for name, f, x, a, b in zip(NAMES, fixed, at, low, high, strict=True)
            if f is None and (x <= a + 2e-3 or x >= b - 2e-3)
        ]
        sigma_e, length, scale = (float(x) for x in np.exp(at))
        return Learned(Kernel.of_length(sigma_e, length), scale, value, tuple(bound), self.trials)

    def _first_length(self, start: FloatArray) -> float:
        """Logarithm of the best of a few lengths, from long to short."""
        length, best, at, worse = 0.5 * self.limits[1] / LONGEST, -np.inf, float(start[1]), 0
        sigma_e, scale = np.exp(start[0]), np.exp(start[2])
        while worse < 2:
            length = max(length, self.limits[0])
            basis = HilbertBasis(self.middle, self.half, length, length)
            value = basis.trial(*self._weighed(basis), sigma_e, length, scale).value
            self.trials += 1
            worse = 0 if value > best else worse + 1
            if value > best:
                best, at = value, float(np.log(length))
            if length <= self.limits[0]:
                break
            length /= COARSE
        return at

    def _climb(self, start: FloatArray, bounds: FloatArray, ends: tuple[float, float]) -> tuple[FloatArray, float]:
        basis = HilbertBasis(self.middle, self.half, *ends)
        weighed = self._weighed(basis)
        best = [-np.inf, start]

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            self.trials += 1
            sigma_e, length, scale = np.exp(x)
            found = basis.trial(*weighed, sigma_e, length, scale)
            if not np.isfinite(found.value):
                return 1e300, np.zeros(3)
            away = (x - self.scales) / PRIOR_SPREAD
            free = bounds[:, 0] < bounds[:, 1]
            if found.value > best[0]:
                best[0] = found.value
            return -found.value + 0.5 * float(away[free] @ away[free]), -found.slope + away / PRIOR_SPREAD

        first = np.clip(start, bounds[:, 0], bounds[:, 1])
        options = {"ftol": 1e-7, "gtol": 1e-3, "maxiter": 60}
        found = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        x = np.asarray(found.x)
        away = ((x - self.scales) / PRIOR_SPREAD)[bounds[:, 0] < bounds[:, 1]]
        return x, float(0.5 * away @ away - found.fun)

    def _weighed(self, basis: HilbertBasis) -> tuple[Weighed, Listed]:
        free, known = self.free, self.known
        listed = basis.list(known.places, known.value, known.noise)
        return basis.weigh(free.places, free.value, free.noise), listed


def roughness(points: Points) -> float:
    """A robust deviation of the noise [m]: of each height from the mean of its nearest neighbours' [m]."""
    count = min(NEIGHBOURS, len(points.value) - 1)
    if count < 2:
        return FLOOR_M
    _, near = cKDTree(points.places).query(points.places, k=count + 1)
    left = points.value - points.value[near[:, 1:]].mean(axis=1)
    return max(float(1.4826 * np.median(np.abs(left)) / np.sqrt(1.0 + 1.0 / count)), FLOOR_M)
