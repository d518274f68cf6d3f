"""The *world* and *touch* surfaces: height over the table as a Gaussian process of all observed points (Thesis 4.1).

    surface = fit_surface(points_m)                      # (n, 3), any number: 12 000 take a second
    heights = surface.on(MapGrid((0.6, 0.4)))            # mean and deviation on cells of 0.5 cm
    normals = surface.normals(places_m)                  # (m, 3), with the slopes' deviation in surface.slopes

Every point counts: the hyper-parameters are those of the marginal likelihood of all points. The regression is sparse,
with inducing points on a lattice that resolve all that a map shows (SGPR; Titsias 2009). The kernel is a product over x
and y, and so are the lattice's functions: features of a place are products of features of x and of y. Points of the
lattice without new information (closer than the kernel resolves, within rounding) are left out by the eigenvalues of
each axis's covariances.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import Kernel, ProcessPrediction, correlation
from deformscope.stages.map.marginal_likelihood import Observations, learn
from deformscope.stages.map.perception import Hyperparameters
from deformscope.stages.regions.touches import MapGrid

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
        informed = eigenvalue > LEAST_EIGENVALUE * eigenvalue[-1]
        self.eigenvalue: FloatArray = eigenvalue[informed][::-1]
        self._onto = vector[:, informed][:, ::-1] / np.sqrt(self.eigenvalue)

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
        mean, variance = (np.column_stack(one) for one in zip(*found, strict=True))
        return ProcessPrediction(mean, np.sqrt(variance))

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


FEWEST = 3

UNIT_NOISE_M = 1e-3
"""The noise of points without given noise, before its factor is learned [m]."""

MOST_INDUCING = 6000
"""Lattices of inducing points with more are refused: their equations would take minutes."""

OUTLIER_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Heights on a grid. mean_m, deviation_m: (rows, columns) mean and deviation of the surface itself, without a
    point's noise [m]"""

    grid: MapGrid
    mean_m: FloatArray
    deviation_m: FloatArray


@dataclass(frozen=True)
class HeightProcess:
    """A surface as a Gaussian process: `level_m` plus its kernel's prediction from the points.

    learned: the hyper-parameters; level_m: mean of the process [m]
    noise_m: (n,) deviation of each point given, as it was used [m]; used: (n,) points that were not taken as outliers
    box_m: (low, high) places (x, y) that contain the inducing points [m]; evidence: lower bound of the log marginal
    likelihood by the inducing points; where it is as high as `learned.log_likelihood` both approximations hold"""

    learned: Hyperparameters
    level_m: float
    noise_m: FloatArray
    used: BoolArray
    box_m: tuple[tuple[float, float], tuple[float, float]]
    evidence: float
    process: SparseProcess

    @property
    def kernel(self) -> Kernel:
        return self.learned.kernel

    def at(self, places_m: FloatArray) -> ProcessPrediction:
        """Height (m,) and its deviation at places (m, 2) [m] (Thesis eq. 4.3 and 4.4)."""
        with threadpool_limits(1):
            found = self.process.at(np.atleast_2d(np.asarray(places_m, dtype=np.float64)))
        return ProcessPrediction(found.mean + self.level_m, found.deviation)

    def on(self, grid: MapGrid) -> HeightMap:
        """Heights at the centres of a grid's cells."""
        found = self.at(grid.centres_m)
        return HeightMap(grid, found.mean.reshape(grid.shape), found.deviation.reshape(grid.shape))

    def slopes(self, places_m: FloatArray) -> ProcessPrediction:
        """Slopes (m, 2) along x and y and their deviation at places (m, 2) [m/m]."""
        with threadpool_limits(1):
            return self.process.slopes(np.atleast_2d(np.asarray(places_m, dtype=np.float64)))

    def normals(self, places_m: FloatArray) -> FloatArray:
        """Unit normals (m, 3) that point up, of the mean surface at places (m, 2) [m]."""
        slope = self.slopes(places_m).mean
        normal = np.column_stack([-slope, np.ones(len(slope))])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def fit_surface(
    points_m: FloatArray,
    *,
    noise_m: FloatArray | None = None,
    known_m: FloatArray | None = None,
    known_noise_m: FloatArray | None = None,
    within_m: tuple[tuple[float, float], tuple[float, float]] | None = None,
    outlier_sd: float | None = None,
) -> HeightProcess:
    """The surface through points (n, 3) [m], z up.

    noise_m: (n,) deviation of each height [m] up to one factor, which is learned: default the same at all points
    known_m, known_noise_m: (k, 3) and (k,) further points with known noise, such as tactile ones [m]
    within_m: the (low, high) places at which the surface will be evaluated, default the points' own box; beyond it the
    process falls back to its prior within about a length
    outlier_sd: points farther from the surface than this many deviations are left out, and the surface is fitted again.
    Raises InputError for too few points, values that are not finite, and a kernel too short for the box."""
    free, known = _checked(points_m, noise_m, UNIT_NOISE_M), _checked(known_m, known_noise_m, None)
    if len(free.value) + len(known.value) < FEWEST:
        raise InputError(f"{FEWEST} surface points at least", f"{len(free.value) + len(known.value)}")
    level = float(free.value.mean() if len(free.value) else known.value.mean())
    free, known = (Observations(one.places, one.value - level, one.noise) for one in (free, known))
    places = np.concatenate([free.places, known.places])
    low, high = places.min(axis=0), places.max(axis=0)
    if within_m is not None:
        low, high = np.minimum(low, within_m[0]), np.maximum(high, within_m[1])
    used = np.ones(len(free.value), dtype=bool)
    with threadpool_limits(1):  # the same digits whatever the machine's cores
        learned, process = _learned(free, known, low, high)
        for _ in range(OUTLIER_ROUNDS if outlier_sd is not None else 0):
            found = process.at(free.places)
            away = np.abs(free.value - found.mean)
            inside = away <= outlier_sd * np.hypot(learned.noise_scale * free.noise, found.deviation)
            if (inside == used).all() or inside.sum() + len(known.value) < FEWEST:
                break
            used = inside
            some = Observations(free.places[used], free.value[used], free.noise[used])
            learned, process = _learned(some, known, low, high, learned)
    return HeightProcess(
        learned=learned,
        level_m=level,
        noise_m=learned.noise_scale * free.noise,
        used=used,
        box_m=((float(low[0]), float(low[1])), (float(high[0]), float(high[1]))),
        evidence=process.elbo,
        process=process,
    )


def _learned(
    free: Observations, known: Observations, low: FloatArray, high: FloatArray, start: Hyperparameters | None = None
) -> tuple[Hyperparameters, SparseProcess]:
    """Hyper-parameters, and the process with them. low, high: (2,) corners of the box that holds the points [m]"""
    learned = learn(free, known, start)
    length_m = learned.kernel.length_m
    if float(np.prod((high - low) / (SPACING * length_m) + 1.0)) > MOST_INDUCING:
        raise InputError(
            f"a surface for at most {MOST_INDUCING} inducing points",
            f"length {length_m:.3g} m on {high[0] - low[0]:.3g} x {high[1] - low[1]:.3g} m",
            "a smaller box",
        )
    process = SparseProcess(
        learned.kernel,
        np.concatenate([free.places, known.places]),
        np.concatenate([free.value, known.value]),
        np.concatenate([learned.noise_scale * free.noise, known.noise]),
        low,
        high,
    )
    return learned, process


def _checked(points: FloatArray | None, noise: FloatArray | None, default: float | None) -> Observations:
    """Places, heights and noise of points (n, 3); none: no points."""
    if points is None:
        return Observations(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError("points (n, 3) [m]", f"shape {points.shape}")
    if noise is None:
        if default is None:
            raise InputError("known_noise_m, a deviation of each known point", "none")
        noise = np.full(len(points), default)
    noise = np.asarray(noise, dtype=np.float64)
    if noise.shape != (len(points),):
        raise InputError(f"a noise for each of {len(points)} points", f"shape {noise.shape}")
    if not np.isfinite(points).all():
        raise InputError("finite points", "NaN or infinity", "drop those points")
    if not (np.isfinite(noise).all() and (noise > 0.0).all()):
        raise InputError("noise above 0 [m]", f"{noise.min():g}")
    return Observations(points[:, :2], points[:, 2], noise)
