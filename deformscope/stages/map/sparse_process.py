"""Sparse Gaussian process regression with inducing points on a lattice (SGPR; Titsias 2009).

The kernel is a product over x and y, and so are the functions of a lattice of inducing points: features of a place are
products of features of x and of y. Points of the lattice without new information (spaced closer than the kernel
resolves, within rounding) are left out by the eigenvalues of each axis's covariances."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.gaussian_process import Kernel, ProcessPrediction, correlation

SPACING = 0.45
"""Distance of inducing points in lengths of the kernel: between them the prior's variance is short by 1e-8."""

BEYOND = 2
"""Number of inducing points beyond the box on each side: the variance at the edge is then as accurate as inside."""

LEAST_EIGENVALUE = 1e-11
"""Directions of less prior variance than this share of the largest are left out."""

CHUNK = 2048
"""Number of places that are computed at once: it bounds the memory."""


class Axis:
    """Features of one coordinate: (n, r), whose products sum up to the kernel of deviation 1."""

    def __init__(self, low: float, high: float, length: float) -> None:
        spacing = SPACING * length
        steps = max(1, int(np.ceil((high - low) / spacing)))
        start = 0.5 * (low + high) - 0.5 * steps * spacing
        self.nodes = start + spacing * np.arange(-BEYOND, steps + BEYOND + 1)
        self.length = length
        eigenvalue, vector = np.linalg.eigh(self._kernel(self.nodes))
        kept = eigenvalue > LEAST_EIGENVALUE * eigenvalue[-1]
        self.eigenvalue: FloatArray = eigenvalue[kept][::-1]
        self._onto = vector[:, kept][:, ::-1] / np.sqrt(self.eigenvalue)

    def _kernel(self, x: FloatArray) -> FloatArray:
        """(n, nodes) correlation of coordinates (n,) with the inducing nodes of an axis [m]."""
        return correlation("gaussian", (x[:, None] - self.nodes) / self.length)

    def features(self, x: FloatArray) -> FloatArray:
        """(n, r) at coordinates (n,)."""
        return np.asarray(self._kernel(x) @ self._onto)

    def slopes(self, x: FloatArray) -> FloatArray:
        """(n, r) derivatives of the features by x [1/m]."""
        away = (self.nodes - x[:, None]) / self.length**2
        return np.asarray((away * self._kernel(x)) @ self._onto)


class SparseProcess:
    """A process conditioned on n points through inducing points.

    places: (n, 2) [m]; value: (n,) above the mean; noise: (n,) its deviation at each point
    low, high: (2,) the box [m] within which it will be evaluated; elbo: lower bound of the log marginal likelihood,
    equal to it where the inducing points suffice"""

    def __init__(
        self,
        kernel: Kernel,
        places: FloatArray,
        value: FloatArray,
        noise: FloatArray,
        low: FloatArray,
        high: FloatArray,
    ) -> None:
        self.kernel = kernel
        self.axes = [Axis(float(low[d]), float(high[d]), kernel.length_m) for d in range(2)]
        first, second = (axis.eigenvalue / axis.eigenvalue[0] for axis in self.axes)
        # (m, 2) the products of features whose variance counts
        self._pairs: IntArray = np.argwhere(np.outer(first, second) > LEAST_EIGENVALUE)
        size = len(self._pairs)
        inner, onto, missing = np.eye(size), np.zeros(size), 0.0
        for start in range(0, len(value), CHUNK):
            some = slice(start, start + CHUNK)
            feature = self._features(places[some])
            missing += float(np.sum((kernel.sigma_e**2 - np.sum(feature**2, axis=1)).clip(0.0) / noise[some] ** 2))
            feature /= noise[some, None]
            inner += feature.T @ feature
            onto += feature.T @ (value[some] / noise[some])
        self._factor = cholesky(inner, lower=True, overwrite_a=True, check_finite=False)
        self._weight = cho_solve((self._factor, True), onto, check_finite=False)
        square = float(np.sum((value / noise) ** 2)) - float(onto @ self._weight)
        logs = 2.0 * np.log(np.diag(self._factor)).sum() + 2.0 * np.log(noise).sum() + len(value) * np.log(2.0 * np.pi)
        self.elbo = float(-0.5 * (square + logs + missing))

    def at(self, places: FloatArray) -> ProcessPrediction:
        """Mean above the prior's and deviation at places (m, 2)."""
        mean, variance = self._believe(places, (False, False), self.kernel.sigma_e**2)
        return ProcessPrediction(mean, np.sqrt(variance))

    def slopes(self, places: FloatArray) -> ProcessPrediction:
        """Mean and deviation (m, 2) of the slopes along x and y at places (m, 2)."""
        prior = (self.kernel.sigma_e / self.kernel.length_m) ** 2
        found = [self._believe(places, along, prior) for along in ((True, False), (False, True))]
        return ProcessPrediction(
            np.column_stack([one[0] for one in found]), np.sqrt(np.column_stack([one[1] for one in found]))
        )

    def _believe(self, places: FloatArray, slope: tuple[bool, bool], prior: float) -> tuple[FloatArray, FloatArray]:
        """Mean and variance (m,) of the process, or of its slope along one axis."""
        mean, variance = np.empty(len(places)), np.empty(len(places))
        for start in range(0, len(places), CHUNK):
            some = slice(start, start + CHUNK)
            feature = self._features(places[some], slope)
            mean[some] = feature @ self._weight
            whitened = solve_triangular(self._factor, feature.T, lower=True, check_finite=False)
            variance[some] = (prior - np.sum(feature**2, axis=1)).clip(0.0) + np.sum(whitened**2, axis=0)
        return mean, variance

    def _features(self, places: FloatArray, slope: tuple[bool, bool] = (False, False)) -> FloatArray:
        """(n, features) features of places (n, 2) [m], or their slopes along the axes where `slope` is true [1/m]."""
        x, y = (
            axis.slopes(places[:, d]) if slope[d] else axis.features(places[:, d]) for d, axis in enumerate(self.axes)
        )
        return np.asarray(self.kernel.sigma_e * x[:, self._pairs[:, 0]] * y[:, self._pairs[:, 1]])
