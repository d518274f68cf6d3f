"""The *world* and *touch* surfaces: height over the table as a Gaussian process of all observed points (Thesis 4.1).

    surface = fit_surface(points_m)                      # (n, 3), any number: 12 000 take a second
    heights = surface.on(MapGrid((0.6, 0.4)))            # mean and deviation on cells of 0.5 cm
    normals = surface.normals(places_m)                  # (m, 3), with the slopes' deviation in surface.slopes

Every point counts: the hyper-parameters are those of the marginal likelihood of all points. The regression is sparse,
with inducing points on a lattice that resolve all that a map shows (SGPR; Titsias 2009). The kernel is a product over x
and y, and so are the lattice's functions: features of a place are products of features of x and of y. Points of the
lattice without new information (closer than the kernel resolves, within rounding) are left out by the eigenvalues of
each axis's covariances.

Hyper-parameters of a surface's Gaussian process by the marginal likelihood of all its points.

The start is the best of a few lengths, from long to short. L-BFGS-B then maximizes, in a basis of sines that is renewed
when the length leaves its range (Solin and Särkkä 2020). The priors are so wide (a factor of 4.5 up or down) that a
hundred points overrule them; they bound the estimates of a handful of points.

On a box around the data the kernel is nearly a sum over sines, each weighed by the kernel's spectral density at its
frequency. Only these weights depend on the kernel. Therefore sums over points are computed once, and a trial of
hyper-parameters costs the same for a thousand and for a million points. For products of sines even that sum is cheap:
sin a sin b = (cos(a - b) - cos(a + b)) / 2. Therefore sums of cosines over points give all products of two sines.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import Kernel, ProcessPrediction, correlation
from deformscope.stages.map.perception import Hyperparameters
from deformscope.stages.regions.touches import MapGrid

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

    def trial(self, points: WeightedBasis, sigma_e: float, length: float, scale: float) -> LogLikelihood:
        """The log marginal likelihood; the noise of the points is multiplied by `scale`."""
        density = 2.0 * np.pi * (sigma_e * length) ** 2 * np.exp(-0.5 * length**2 * self.frequency2)
        root = np.sqrt(density)
        by = scale**-2.0
        inner = points.gram * (by * root[:, None])
        inner *= root
        inner.flat[:: len(root) + 1] += 1.0
        onto = by * root * points.onto
        factor, failed = dpotrf(inner, lower=1, clean=1, overwrite_a=1)
        if failed:
            return LogLikelihood(-np.inf, np.zeros(3))
        weight = cho_solve((factor, True), onto, check_finite=False)
        logs = points.log_noise - points.count * np.log(by) + 2.0 * np.log(np.diag(factor)).sum()
        square = by * points.square - float(onto @ weight)
        value = -0.5 * (square + logs + points.count * np.log(2.0 * np.pi))
        inverse, _ = dtrtri(factor, lower=1, overwrite_c=1)
        spread = np.einsum("ij,ij->j", inverse, inverse)  # the weights' posterior variances
        by_density = 0.5 * (weight**2 + spread - 1.0)
        expected = root * weight
        left = points.square - 2.0 * expected @ points.onto + expected @ (points.gram @ expected)
        uncertain = len(root) - float(spread.sum())
        by_length = by_density @ (2.0 - length**2 * self.frequency2)
        slope = np.array([2.0 * by_density.sum(), by_length, by * left + uncertain - points.count])
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


class _Search:
    """The likeliest hyper-parameters of points whose noise is known up to one factor."""

    def __init__(self, points: Observations) -> None:
        self.points = points
        low, high = points.places.min(axis=0), points.places.max(axis=0)
        self.middle, self.half = 0.5 * (low + high), 0.5 * (high - low)
        half = self.half
        self.trials = 0
        longest = LONGEST * max(2.0 * float(half.max()), FLOOR_M)
        shortest = longest * 1e-4
        while HilbertBasis.size(half, shortest / RANGE[0], shortest * RANGE[1]) > MOST_SINES:
            shortest *= 1.05
        self.limits = (shortest, longest)
        noise = roughness(points)
        scale = noise / float(np.median(points.noise))
        self.scales = np.log([max(float(points.value.std()), noise, FLOOR_M), 0.25 * longest / LONGEST, scale])

    def run(self, before: Hyperparameters | None) -> Hyperparameters:
        """before: estimates from nearly the same points; None: a few lengths are tried first"""
        low, high = self.scales - FREEDOM, self.scales + FREEDOM
        low[1], high[1] = np.log(self.limits)
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
            for less in (0.0, LESS_NOISE):
                here = np.array([start[0], np.log(length), start[2] - less])
                value = basis.trial(weighed, *(float(x) for x in np.exp(here))).value
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
        count = len(self.points.value)

        def cost(x: FloatArray) -> tuple[float, FloatArray]:
            """Negative log posterior at x (3,) and its slopes (3,), each divided by the number of points."""
            self.trials += 1
            sigma_e, length, scale = np.exp(x)
            found = basis.trial(weighed, sigma_e, length, scale)
            away = np.where(free, (x - self.scales) / PRIOR_SPREAD, 0.0)
            value = found.value if np.isfinite(found.value) else -HOPELESS
            return (0.5 * float(away @ away) - value) / count, (away / PRIOR_SPREAD - found.slope) / count

        first = np.clip(start, bounds[:, 0], bounds[:, 1])
        options = {"ftol": SETTLED / count, "gtol": 1e-2 * SETTLED, "maxiter": 60}
        found = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        x = np.asarray(found.x)
        away = np.where(free, (x - self.scales) / PRIOR_SPREAD, 0.0)
        return x, float(0.5 * away @ away - found.fun * count)

    def _weighed(self, basis: HilbertBasis) -> WeightedBasis:
        return basis.weigh(self.points.places, self.points.value, self.points.noise)


def roughness(points: Observations) -> float:
    """A robust deviation of the noise [m]: of each height from the mean of its nearest neighbours' [m]."""
    count = min(NEIGHBOURS, len(points.value) - 1)
    if count < 2:
        return FLOOR_M
    _, near = cKDTree(points.places).query(points.places, k=count + 1)
    left = points.value - points.value[near[:, 1:]].mean(axis=1)
    return max(float(1.4826 * np.median(np.abs(left)) / np.sqrt(1.0 + 1.0 / count)), FLOOR_M)


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
    within_m: tuple[tuple[float, float], tuple[float, float]] | None = None,
    outlier_sd: float | None = None,
) -> HeightProcess:
    """The surface through points (n, 3) [m], z up.

    noise_m: (n,) deviation of each height [m] up to one factor, which is learned: default the same at all points
    within_m: the (low, high) places at which the surface will be evaluated, default the points' own box; beyond it the
    process falls back to its prior within about a length
    outlier_sd: points farther from the surface than this many deviations are left out, and the surface is fitted again.
    Raises InputError for too few points, values that are not finite, and a kernel too short for the box."""
    given = _checked(points_m, noise_m)
    if len(given.value) < FEWEST:
        raise InputError(f"{FEWEST} surface points at least", f"{len(given.value)}")
    level = float(given.value.mean())
    points = Observations(given.places, given.value - level, given.noise)
    low, high = points.places.min(axis=0), points.places.max(axis=0)
    if within_m is not None:
        low, high = np.minimum(low, within_m[0]), np.maximum(high, within_m[1])
    used = np.ones(len(points.value), dtype=bool)
    with threadpool_limits(1):  # the same digits whatever the machine's cores
        learned, process = _learned(points, low, high)
        for _ in range(OUTLIER_ROUNDS if outlier_sd is not None else 0):
            found = process.at(points.places)
            away = np.abs(points.value - found.mean)
            inside = away <= outlier_sd * np.hypot(learned.noise_scale * points.noise, found.deviation)
            if (inside == used).all() or inside.sum() < FEWEST:
                break
            used = inside
            some = Observations(points.places[used], points.value[used], points.noise[used])
            learned, process = _learned(some, low, high, learned)
    return HeightProcess(
        learned=learned,
        level_m=level,
        noise_m=learned.noise_scale * points.noise,
        used=used,
        box_m=((float(low[0]), float(low[1])), (float(high[0]), float(high[1]))),
        evidence=process.elbo,
        process=process,
    )


def _learned(
    points: Observations, low: FloatArray, high: FloatArray, start: Hyperparameters | None = None
) -> tuple[Hyperparameters, SparseProcess]:
    """Hyper-parameters, and the process with them. low, high: (2,) corners of the box that holds the points [m]"""
    learned = _Search(points).run(start)
    length_m = learned.kernel.length_m
    if float(np.prod((high - low) / (SPACING * length_m) + 1.0)) > MOST_INDUCING:
        raise InputError(
            f"a surface for at most {MOST_INDUCING} inducing points",
            f"length {length_m:.3g} m on {high[0] - low[0]:.3g} x {high[1] - low[1]:.3g} m",
            "a smaller box",
        )
    noise = learned.noise_scale * points.noise
    return learned, SparseProcess(learned.kernel, points.places, points.value, noise, low, high)


def _checked(points: FloatArray, noise: FloatArray | None) -> Observations:
    """Places, heights and noise of points (n, 3)."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError("points (n, 3) [m]", f"shape {points.shape}")
    noise = np.full(len(points), UNIT_NOISE_M) if noise is None else np.asarray(noise, dtype=np.float64)
    if noise.shape != (len(points),):
        raise InputError(f"a noise for each of {len(points)} points", f"shape {noise.shape}")
    if not np.isfinite(points).all():
        raise InputError("finite points", "NaN or infinity", "drop those points")
    if not (np.isfinite(noise).all() and (noise > 0.0).all()):
        raise InputError("noise above 0 [m]", f"{noise.min():g}")
    return Observations(points[:, :2], points[:, 2], noise)
