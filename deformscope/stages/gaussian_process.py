"""Kernels of all Gaussian processes: over a surface, between touches, between particles.

The thesis's is `sigma_e^2 exp(-|u - u'|^2 / sigma_w^2)` (eq. 4.5), without the usual half: its length scale, in the
field's common sense `exp(-|u - u'|^2 / (2 l^2))`, is `l = sigma_w / sqrt(2)`."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError

Roughness = Literal["exponential", "matern", "gaussian"]


def correlation(rough: Roughness, scaled_distance: FloatArray) -> FloatArray:
    """Correlation at distances (...,) in units of its length; "matern": of Matern with 3/2."""
    if rough == "exponential":
        return np.asarray(np.exp(-scaled_distance))
    if rough == "gaussian":
        return np.asarray(np.exp(-0.5 * scaled_distance**2))
    root = np.sqrt(3.0) * scaled_distance
    return np.asarray((1.0 + root) * np.exp(-root))


def gaussian_between(one: FloatArray, other: FloatArray, length: float) -> FloatArray:
    """The squared exponential correlation (n, m) between places (n, d) and (m, d). length: [the places' unit]"""
    square = ((one[:, None] - other) ** 2).sum(axis=-1)
    return np.asarray(np.exp(-0.5 * square / length**2))


@dataclass(frozen=True, slots=True)
class Kernel:
    """The squared exponential kernel (Thesis eq. 4.5). sigma_e: deviation of the process [its unit]; sigma_w: width,
    sqrt(2) times the length scale [m]. Raises InputError for values that are not above 0."""

    sigma_e: float
    sigma_w: float

    def __post_init__(self) -> None:
        for name in ("sigma_e", "sigma_w"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"a kernel's {name} above 0", f"{value:g}")

    @classmethod
    def of_length(cls, sigma_e: float, length_m: float) -> "Kernel":
        """The kernel of a length scale l [m]."""
        return cls(sigma_e, float(np.sqrt(2.0)) * length_m)

    @property
    def length_m(self) -> float:
        """The length scale l = sigma_w / sqrt(2) [m]."""
        return self.sigma_w / float(np.sqrt(2.0))

    def between(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Covariances (n, m) between places (n, d) and (m, d) [m]."""
        square = np.zeros((len(one), len(other)))
        for a, b in zip(one.T, other.T, strict=True):
            square += (a[:, None] - b) ** 2
        return np.asarray(self.sigma_e**2 * np.exp(-square / self.sigma_w**2))


@dataclass(frozen=True, slots=True)
class ProcessPrediction:
    """Values at places, as a process predicts them. mean, deviation: (n,), mean and deviation of the process itself,
    without noise"""

    mean: FloatArray
    deviation: FloatArray
