"""The marginal likelihood of a Gaussian process by all of its points, in a basis of sines (Solin and Särkkä 2020).

On a box around the data the kernel is nearly a sum over sines, each weighed by the kernel's spectral density at its
frequency. Only these weights depend on the kernel. Therefore sums over points are computed once, and a trial of
hyper-parameters costs the same for a thousand and for a million points. For products of sines even that sum is cheap:
sin a sin b = (cos(a - b) - cos(a + b)) / 2. Therefore sums of cosines over points give all products of two sines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dpotrf, dtrtri

from deformscope.arrays import BoolArray, FloatArray, IntArray

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
        self.number = _numbers(self.wall, HIGHEST / shortest)
        self.frequency2: FloatArray = np.sum((0.5 * np.pi * self.number / self.wall) ** 2, axis=1)

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


def _numbers(wall: FloatArray, highest: float) -> IntArray:
    """(m, 2) how often each sine swings along each axis, up to a frequency."""
    most = np.maximum(1, np.floor(highest * 2.0 * wall / np.pi)).astype(np.int64)
    first, second = np.meshgrid(np.arange(1, most[0] + 1), np.arange(1, most[1] + 1), indexing="ij")
    every = np.column_stack([first.ravel(), second.ravel()])
    inside: BoolArray = np.sum((0.5 * np.pi * every / wall) ** 2, axis=1) <= highest**2
    inside[0] = True
    return every[inside]
