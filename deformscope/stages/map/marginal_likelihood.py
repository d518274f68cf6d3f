"""Hyper-parameters of a surface's Gaussian process by the marginal likelihood of all its points.

The start is the best of a few lengths, from long to short. L-BFGS-B then maximizes, in a basis of sines that is renewed
when the length leaves its range (Solin and Särkkä 2020). The priors are so wide (a factor of 4.5 up or down) that a
hundred points overrule them; they bound the estimates of a handful of points.

On a box around the data the kernel is nearly a sum over sines, each weighed by the kernel's spectral density at its
frequency. Only these weights depend on the kernel. Therefore sums over points are computed once, and a trial of
hyper-parameters costs the same for a thousand and for a million points. For products of sines even that sum is cheap:
sin a sin b = (cos(a - b) - cos(a + b)) / 2. Therefore sums of cosines over points give all products of two sines."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from deformscope.arrays import FloatArray
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.map.perception import Hyperparameters

EDGE = 2.5
"""Number of lengths by which the box extends beyond the data on each side (for data 2.5 to 5 lengths wide, the c = 2 to
3 of the literature). The mirror images at its walls, five lengths away, then have a weight of 4e-6."""

HIGHEST = 4.0
"""The largest frequency, as a multiple of one over the shortest length, where the spectral density is 3e-4 of its
highest."""

MOST_SINES = 1600
"""Products of sines at most: one trial then takes 0.2 s. Largest number of sines: it bounds the length from below."""


@dataclass(frozen=True, slots=True)
class WeightedBasis:
    """Information of points whose noise is known up to one factor. gram: (m, m), onto: (m,), square: sums over points
    of basis products, of value times basis, and of squared values, each by 1 / noise^2; log_noise: sum of log noise^2;
    count: points"""

    gram: FloatArray
    onto: FloatArray
    square: float
    log_noise: float
    count: int


@dataclass(frozen=True, slots=True)
class ListedPoints:
    """A few points whose noise is known. basis: (k, m), value: (k,), both multiplied by 1 / noise; log_noise: as
    above"""

    basis: FloatArray
    value: FloatArray
    log_noise: float


@dataclass(frozen=True, slots=True)
class LogLikelihood:
    """Log marginal likelihood and its slopes by log sigma_e, log length and log of the noise's scale."""

    value: float
    slope: FloatArray


class HilbertBasis:
    """Sines over a box, good for kernels of lengths from `shortest` to `longest` [m].

    middle, half: (2,) middle and half of the box that holds the data [m]"""

    def __init__(self, middle: FloatArray, half: FloatArray, shortest: float, longest: float) -> None:
        self.middle = middle
        self.wall = half + EDGE * longest
        most = np.maximum(1, np.floor(HIGHEST / shortest * 2.0 * self.wall / np.pi)).astype(np.int64)
        every = np.stack(np.meshgrid(*(np.arange(1, n + 1) for n in most), indexing="ij"), axis=-1).reshape(-1, 2)
        frequency2 = np.sum((0.5 * np.pi * every / self.wall) ** 2, axis=1)
        inside = frequency2 <= (HIGHEST / shortest) ** 2
        inside[0] = True
        # (m, 2) how often each sine swings along each axis, up to the highest frequency
        self.number, self.frequency2 = every[inside], frequency2[inside]

    @staticmethod
    def size(half: FloatArray, shortest: float, longest: float) -> float:
        """Approximate number of sines of a basis. half: (2,) half sizes of the region; shortest, longest: correlation
        lengths [m]"""
        return float(np.pi / 4.0 * np.prod(2.0 * (half + EDGE * longest) / np.pi * HIGHEST / shortest))

    def weigh(self, places: FloatArray, value: FloatArray, noise: FloatArray) -> WeightedBasis:
        """Sums over points (n, 2) with values (n,) and deviations of the noise (n,)."""
        weight = 1.0 / noise**2
        angle = 0.5 * np.pi * (places - self.middle + self.wall) / self.wall
        most = self.number.max(axis=0)
        cosine = [np.cos(angle[:, d, None] * np.arange(2 * most[d] + 1)) for d in range(2)]
        sine = [np.sin(angle[:, d, None] * np.arange(most[d] + 1)) for d in range(2)]
        sums = cosine[0].T @ (weight[:, None] * cosine[1])
        first, second = self.number.T
        less, more = ([np.abs(n[:, None] - n) for n in (first, second)], [n[:, None] + n for n in (first, second)])
        gram = sums[less[0], less[1]] - sums[more[0], less[1]] - sums[less[0], more[1]] + sums[more[0], more[1]]
        gram /= 4.0 * np.prod(self.wall)
        onto = (sine[0].T @ ((weight * value)[:, None] * sine[1]))[first, second] / np.sqrt(np.prod(self.wall))
        return WeightedBasis(gram, onto, float(weight @ value**2), float(2.0 * np.log(noise).sum()), len(value))

    def list(self, places: FloatArray, value: FloatArray, noise: FloatArray) -> ListedPoints:
        """Points (k, 2), with values (k,) and noise (k,)."""
        angle = 0.5 * np.pi * (places - self.middle + self.wall) / self.wall
        sine = np.prod(np.sin(angle[:, None] * self.number), axis=2) / np.sqrt(np.prod(self.wall))
        return ListedPoints(sine / noise[:, None], value / noise, float(2.0 * np.log(noise).sum()))

    def trial(
        self, free: WeightedBasis, known: ListedPoints, sigma_e: float, length: float, scale: float
    ) -> LogLikelihood:
        """The log marginal likelihood; the noise of the free points is multiplied by `scale`, of the known ones not."""
        density = 2.0 * np.pi * (sigma_e * length) ** 2 * np.exp(-0.5 * length**2 * self.frequency2)
        root = np.sqrt(density)
        by = scale**-2.0
        listed = known.basis * root
        inner = free.gram * (by * root[:, None])
        inner *= root
        if len(listed):
            inner += listed.T @ listed
        inner.flat[:: len(root) + 1] += 1.0
        onto = by * root * free.onto + listed.T @ known.value
        factor, failed = dpotrf(inner, lower=1, clean=1, overwrite_a=1)
        if failed:
            return LogLikelihood(-np.inf, np.zeros(3))
        weight = cho_solve((factor, True), onto, check_finite=False)
        logs = free.log_noise + known.log_noise - free.count * np.log(by) + 2.0 * np.log(np.diag(factor)).sum()
        count = free.count + len(known.value)
        square = by * free.square + float(known.value @ known.value) - float(onto @ weight)
        value = -0.5 * (square + logs + count * np.log(2.0 * np.pi))
        inverse, _ = dtrtri(factor, lower=1, overwrite_c=1)
        spread = np.einsum("ij,ij->j", inverse, inverse)  # the weights' posterior variances
        by_density = 0.5 * (weight**2 + spread - 1.0)
        expected = root * weight
        left = free.square - 2.0 * expected @ free.onto + expected @ (free.gram @ expected)
        uncertain = len(root) - float(spread.sum()) - float(np.sum((inverse @ listed.T) ** 2))
        by_length = by_density @ (2.0 - length**2 * self.frequency2)
        slope = np.array([2.0 * by_density.sum(), by_length, by * left + uncertain - free.count])
        return LogLikelihood(float(value), slope)


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
        sigma_e, length, scale = (float(x) for x in np.exp(at))
        return Hyperparameters(
            kernel=Kernel.of_length(sigma_e, length), noise_scale=scale, log_likelihood=value, trials=self.trials
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
