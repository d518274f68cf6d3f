"""How likely residuals are: errors of measurement, of the prescribed positions, and of the model, each weighed.

The residual at a parameter's true value, observed - simulated at the free particles, is r = e - J e_held: J is the
effect of wrong prescribed positions on the simulation. The errors (e, e_held) of all particles are

    white noise, of the stated size times a scale that the residuals correct, and a smooth random field (the same in
    each coordinate). The field is either an error of measurement that neighbours share, as in optical flow, in free and
prescribed particles. Or it is misfit of the model, only in free particles.

Each combination of a field's roughness, length and size is one hypothesis with a Gaussian likelihood. Whether the
prescribed positions were measured too is another choice if unstated. The scale is integrated (Laplace) with a
log-normal prior about 1, or a flat one without a stated noise.

With G the covariance of (e, e_held), r has P G P^T, P = [I, -J]. P G P^T is never formed: it is the marginal over a
flat e_held, so chi2 = min over y of |(r + J y, y)|^2 in G^-1. The eigenvectors of the field make this diagonal, one
decomposition for all sizes of the field, all residuals and all coordinates.

In addition a tool or a camera may displace all positions together (`deformscope.stages.fit.systematic`): the effect of
such displacements on r is a few vectors, whose factors are integrated out. Which of them there are, and how large they
are, is another choice."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import eigh, lapack
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.systematic import camera_modes, tool_modes
from deformscope.stages.gaussian_process import Roughness, correlation

FIELDS: tuple[tuple[Roughness, tuple[float, ...]], ...] = (
    ("exponential", (1.0, 3.0, 9.0)),
    ("matern", (0.6, 1.0, 1.7, 3.0, 5.0, 8.0)),
    ("gaussian", (0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)),
)
"""Correlations of the smooth field, from rough to smooth, and their lengths in particle spacings."""

CORRELATIONS = tuple(rough for rough, _ in FIELDS)

FIELD_SIZES = tuple(float(size) for size in 10.0 ** np.concatenate([np.arange(-1.0, 2.1, 0.5), np.arange(3.0, 8.1)]))
"""Variances of the smooth field, in units of the white noise; coarser where there is hardly any white noise left."""

MISFIT_MOST = 1e5
"""Largest of these variances for misfit."""

SHARED_MOST = 1e8
"""Largest of these variances for an error of measurement that neighbours share. A smoother field appears less as a
difference between neighbours, and there may be almost no white noise besides."""

MISFIT_MOST_UNKNOWN = 100.0
"""Like `FIELD_SIZES`, if no noise was stated: beyond it, the smallest residuals would determine the white noise."""

MISFIT_ROUGH = 0.05
"""Share of a misfit's variance that no field describes: a model's errors are not as smooth as a random field, and if
they are large their finest part must not count as information."""

PRIOR_NO_FIELD = 0.5
PRIOR_HELD_EXACT = 0.15
"""Prior weight of exact prescribed positions, if it is not stated whether they were measured."""

EXACT = 1e-3
"""Noise of practically exact prescribed positions, as a share of the others'."""

LOOSE = 0.5
"""Deviation of a prescribed position that is no measurement [spacings]; only used with a stated noise."""

SCALE_SPREAD = 1.0
"""Log-normal deviation of the true noise about the stated one: a factor of 2.7 up or down is one deviation."""

SCALE_SETTLED = 1e-9
"""A step of the scale's logarithm shorter than this is the last."""

SCALE_ROUNDS = 4
"""Rounds of finding the noise's scale: the residuals without errors of tool and camera depend on it. Each leaves a
seventh of the error in its logarithm, these 0.002 at most."""

OFFS = tuple(
    ((scale, camera, shift, other), weight * share)
    for scale, camera, weight in ((0.0, 0.0, 0.4), (2.0, 0.0, 0.25), (4.0, 2.5, 0.35))
    for shift, other, share in ((1.0, 0.0, 0.3), (2.5, 0.0, 0.4), (2.5, 1.0, 0.3))
)
"""Possible standard deviations of a camera's scale, of its other displacements, of the tool's shift, and of other
errors of held positions, in units of `systematic`'s, and their prior: most cameras are right, few tools turned.
With one size for all of them, one that is off made each possible, and intervals with a right tool and camera were some
1.5 times as wide as an oracle's that allows for a tool's shift (`studies.independent.oracle`); they are 1.06 times as
wide now. Chosen on bodies of tuning seeds (`studies.seeds`)."""

SCALE_LEAST = 0.05
"""Ratio to the stated noise below which residuals are no sample of it (smoothed data): the stated value is used."""

NEIGHBOURS = 1.2
"""Distance within which particles are neighbours [spacings]."""

TELLS_APART = 1e-13
"""Share of the largest part of residuals below which a part is a rounding error."""


@dataclass(frozen=True, slots=True)
class Measured:
    """The particles of one observation, and the stated sizes of their errors.

    rest: (n, d) free observed particles; held_rest: (k, d) prescribed particles at rest, whose k d coordinates are the
    directions of a response; None if m random combinations, including noise, represent too many directions; noise,
    held_noise: (n,), (k,) deviation of a coordinate, None if unknown; held_measured: whether the prescribed positions
    carry noise, None = not known; spacing: spacing of the particles; floor: smallest deviation that numbers resolve
    loose: (k,) prescribed particles with an unmeasured position, None = none
    touched: (k,) prescribed particles that something moved, None if `held_rest` is None
    shift: deviation of the common offset of all held particles [unit]"""

    rest: FloatArray
    held_rest: FloatArray | None
    noise: FloatArray | None
    held_noise: FloatArray | None
    held_measured: bool | None
    spacing: float
    floor: float
    loose: BoolArray | None = None
    touched: BoolArray | None = None
    shift: float = 0.0

    def some(self, pick: IntArray) -> "Measured":
        """The measurement of only the free particles at indices (n,)."""
        noise = None if self.noise is None else self.noise[pick]
        return dataclasses.replace(self, rest=self.rest[pick], noise=noise)


@dataclass(frozen=True, slots=True)
class NoiseHypotheses:
    """Explanations of residuals, (h,) each.

    held: the prescribed positions carry noise; shared: the smooth field is an error of measurement, which prescribed
    positions have too if they have noise
    field: index in `CORRELATIONS`; length: its own [spacings]; size: its variance in units of the white noise, 0 = none
    off: (h, 4) levels of `OFFS`"""

    held: BoolArray
    shared: BoolArray
    field: IntArray
    length: FloatArray
    size: FloatArray
    off: FloatArray
    log_prior: FloatArray


@dataclass(frozen=True, slots=True)
class Evidence:
    """log_likelihood: (h, g) log likelihood of residuals g under hypothesis h, its prior and scale included; log_scale:
    (h, g) log scale of the white noise against the stated one (or 1), the most likely; log_scale_deviation: (h, g)"""

    log_likelihood: FloatArray
    log_scale: FloatArray
    log_scale_deviation: FloatArray


@dataclass(frozen=True, slots=True)
class Products:
    """chi2 of all sums of r residuals under hypotheses h: x'P x of the sum with shares x.

    rows: (h,) the hypotheses; product: (h, r, r) P; log_det: (h,) log determinant of the covariance; white: (r, r) P of
    the stated noise alone; count: numbers in a residual"""

    rows: IntArray
    product: FloatArray
    log_det: FloatArray
    white: FloatArray
    count: int


@dataclass(frozen=True, slots=True)
class _Basis:
    """Eigenvectors of one field in units of the noise: rotate (N, N) whitens e, or (e, e_held) if prescribed positions
    have the field too; moment (N,)."""

    rotate: FloatArray
    moment: FloatArray


Field = tuple[int, float, bool, bool]
"""A smooth field: its correlation and length, whether prescribed positions are noisy, and have the field."""


class ErrorModel:
    """The hypotheses about one observation's errors."""

    def __init__(self, measured: Measured) -> None:
        self.measured = measured
        n, d = measured.rest.shape
        self.dim = d
        unknown = measured.noise is None
        noise = np.ones(n) if measured.noise is None else np.maximum(measured.noise, measured.floor)
        if measured.held_rest is None:
            held_noise = np.ones(0)
        elif measured.held_noise is None or unknown:
            held_noise = np.ones(len(measured.held_rest))
        else:
            held_noise = np.maximum(measured.held_noise, EXACT * noise.mean())
        if measured.loose is not None:
            if measured.held_measured is False:
                held_noise = np.full(len(held_noise), EXACT * noise.mean())
            held_noise = np.where(measured.loose, LOOSE * measured.spacing, held_noise)
        self.noise, self.held_noise = noise, held_noise
        self.held_variance = np.ones(1) if measured.held_rest is None else np.repeat(held_noise**2, d)
        """(m,) of each direction of a response by white noise, (1,) = the same for all."""
        self.log_noise = float(d * np.log(noise).sum())
        self.hypotheses = self._enumerate(unknown)
        self.log_scale: FloatArray = np.zeros(len(self.hypotheses.size))
        """(h,) of the white noise about where the parameter fits: errors of tool and camera are no multiple of it."""
        self._bases: dict[Field, _Basis] = {}

    def _enumerate(self, unknown: bool) -> NoiseHypotheses:
        stated = self.measured.held_measured if self.measured.loose is None else True
        either = {False: PRIOR_HELD_EXACT, True: 1.0 - PRIOR_HELD_EXACT}
        choices = {True: {True: 1.0}, False: {False: 1.0}, None: either}
        fields = [(CORRELATIONS.index(rough), length) for rough, lengths in FIELDS for length in lengths]
        rows: list[tuple[float, ...]] = []
        for held, prior in choices[stated].items():
            rows.append((held, False, 0, 1.0, 0.0, np.log(prior * PRIOR_NO_FIELD)))
            exact = self.measured.held_rest is None or self.measured.held_measured is False
            # what is exact was not seen by the camera
            seen_apart = self.measured.held_measured is False and not unknown
            kinds = (False, True) if (held and not exact) or (not held and seen_apart) else (False,)
            for shared, (field, length) in product(kinds, fields):
                most = MISFIT_MOST_UNKNOWN if unknown else SHARED_MOST if shared else MISFIT_MOST
                some = [size for size in FIELD_SIZES if size <= most]
                share = prior * (1.0 - PRIOR_NO_FIELD) / (len(kinds) * len(fields) * len(some))
                rows.extend((held, shared, field, length, size, np.log(share)) for size in some)
        offs = OFFS if self.measured.touched is not None else OFFS[:1]
        off = np.repeat([levels for levels, _ in offs], len(rows), axis=0)
        held_, shared_, field_, length_, size_, log_prior = np.tile(np.array(rows, dtype=np.float64), (len(offs), 1)).T
        log_prior = log_prior + np.repeat(np.log([weight / sum(w for _, w in offs) for _, weight in offs]), len(rows))
        index = field_.astype(np.int64)
        return NoiseHypotheses(held_ > 0.0, shared_ > 0.0, index, length_, size_, off, log_prior)

    def modes(self, response: FloatArray, *, held: bool) -> FloatArray:
        """Effect (n, d, q) on the residuals of errors of the tool and the camera, one deviation each, from a response
        (n, d, m); held: errors of the camera displace the prescribed positions too."""
        rest, at, touched = self.measured.rest, self.measured.held_rest, self.measured.touched
        n, d = rest.shape
        if at is None or touched is None:
            return np.zeros((n, d, 0))
        seen = camera_modes(np.concatenate([rest, at]))
        if not response.shape[2]:
            return seen[:n]

        def through(moved: FloatArray) -> FloatArray:
            return np.asarray(response @ moved.reshape(response.shape[2], -1))

        by_tool = through(tool_modes(at, touched) * self.measured.shift)
        by_camera = seen[:n] - through(seen[n:]) if held else seen[:n]
        return np.concatenate([by_camera, by_tool], axis=-1)

    def _groups(self, rows: IntArray) -> Iterator[tuple[Field, IntArray]]:
        """Each smooth field of the hypotheses at rows (h,), and the places of its own among them."""
        every = self.hypotheses
        parts = np.stack([every.field[rows], every.length[rows], every.held[rows], every.shared[rows]])
        kinds, kind = np.unique(parts, axis=1, return_inverse=True)
        for one, (field, length, held, shared) in enumerate(kinds.T):
            yield (int(field), float(length), bool(held), bool(shared)), np.flatnonzero(kind.reshape(-1) == one)

    def _basis(self, key: Field) -> _Basis:
        which, length, held, shared = key
        held = held and shared and self.measured.held_rest is not None
        key = (which, length, held, shared)
        if key in self._bases:
            return self._bases[key]
        place, noise = self.measured.rest, self.noise
        if held and self.measured.held_rest is not None:
            place = np.concatenate([place, self.measured.held_rest])
            noise = np.concatenate([noise, self.held_noise])
        field = correlation(CORRELATIONS[which], cdist(place, place) / (self.measured.spacing * length))
        if not shared:
            field = (1.0 - MISFIT_ROUGH) * field + MISFIT_ROUGH * np.eye(len(field))
        field *= float(np.mean(self.noise**2))
        moment, vectors = eigh(field / noise[:, None] / noise, check_finite=False, driver="evd")
        return self._bases.setdefault(key, _Basis(vectors.T / noise, np.maximum(moment, 0.0)))

    def evidence(
        self, residual: FloatArray, response: FloatArray, chosen: IntArray | None = None, mix: FloatArray | None = None
    ) -> Evidence:
        """How likely residuals are, where prescribed positions act by `response` (n, d, m). residual: (r, n, d); mix:
        (g, r) sums of residuals that are judged; default each alone; chosen: rows of the hypotheses; default all"""
        mix = np.eye(len(residual)) if mix is None else mix
        return self.judged(self.products(residual, response, chosen), mix)

    def products(
        self, residual: FloatArray, response: FloatArray, chosen: IntArray | None = None, *, settle: bool = False
    ) -> Products:
        """chi2 of all sums of some residuals (r, n, d); `few` reduces more residuals than coordinates. settle: each
        residual belongs to a value of the parameter, and the best of them determines `log_scale`"""
        every = self.hypotheses
        rows = np.arange(len(every.size)) if chosen is None else chosen
        product = np.empty((len(rows), len(residual), len(residual)))
        log_det = np.empty(len(rows))
        r = len(residual)
        white = (residual / self.noise[:, None]).reshape(len(residual), -1)
        modes = {held: np.moveaxis(self.modes(response, held=held), -1, 0) for held in (False, True)}
        count = residual.shape[1] * self.dim
        for key, places in self._groups(rows):
            both = np.concatenate([residual, modes[key[2]]])
            sizes, which = np.unique(every.size[rows[places]], return_inverse=True)
            found, log_det[places] = (one[which] for one in self._quadratic(both, response, key, sizes))
            off = self.deviations(every.off[rows[places]], len(both) - r)
            off = off.T  # hypotheses last: each step of `_by_modes` takes all of them at once
            across = np.ascontiguousarray(found[:, r:, :r].transpose(1, 2, 0)) * off[:, None]
            between = np.ascontiguousarray(found[:, r:, r:].transpose(1, 2, 0)) * off[:, None] * off
            if settle:
                exact = self._trusted(float(np.sum(white**2, axis=1).min()) / count)
                alone = np.einsum("hii->ih", found[:, :r, :r])
                self.log_scale[rows[places]] = 0.0 if exact else self._settled(alone, across, between, count)
            taken, log_modes = _by_modes(across, between, self.log_scale[rows[places]])
            taken = np.ascontiguousarray(taken.transpose(2, 0, 1))
            product[places] = found[:, :r, :r] - taken.transpose(0, 2, 1) @ taken
            log_det[places] += log_modes
        return Products(rows, product, log_det + 2.0 * self.log_noise, white @ white.T, count)

    def deviations(self, off: FloatArray, count: int) -> FloatArray:
        """(h, count) deviation of each of `modes` under hypotheses with levels (h, 4) of `OFFS`."""
        d = self.dim
        each = off * [np.sqrt(d), 1.0, 1.0, 1.0]  # a scale is that of every axis
        return np.asarray(each[:, np.repeat([0, 1, 2, 3], [1, d * d - 1, d, max(count - d * d - d, 0)])[:count]])

    def _settled(self, alone: FloatArray, across: FloatArray, between: FloatArray, count: int) -> FloatArray:
        """Logarithm (h,) of the noise's scale by the best of some residuals, of what tool and camera leave of it, which
        depends on the scale.

        alone: (r, h) chi2 without tool and camera; across, between: (q, r, h), (q, q, h) products with their effects"""
        left, log_scale = alone, np.zeros(alone.shape[1])
        for again in range(SCALE_ROUNDS):
            least = np.maximum(left.min(axis=0), 0.0)
            log_scale = 0.5 * np.log(least / count + self._least**2)
            if again < SCALE_ROUNDS - 1:
                left = alone - np.sum(_by_modes(across, between, log_scale)[0] ** 2, axis=0)
                if not again:  # the same residual stays the best
                    best = left.argmin(axis=0)[None]
                    alone, across = np.take_along_axis(alone, best, 0), np.take_along_axis(across, best[None], 1)
        return log_scale

    def judged(self, found: Products, mix: FloatArray) -> Evidence:
        """How likely sums of residuals are, mix (g, r)."""
        # x' A x as a sum over pairs, so that all hypotheses and residuals are one product of matrices
        i, j = np.triu_indices(mix.shape[1])
        pairs = np.where(i == j, 1.0, 2.0)[:, None] * mix.T[i] * mix.T[j]
        chi2 = np.maximum(found.product[:, i, j] @ pairs, 0.0)
        plain = float(np.min(found.white[i, j] @ pairs, initial=np.inf)) / found.count
        return self._scaled(chi2, found.log_det[:, None], found.count, found.rows, self._trusted(plain))

    def _trusted(self, square: float) -> bool:
        """Whether residuals of this mean square, in units of the stated noise, are no sample of it."""
        return self.measured.noise is not None and square < SCALE_LEAST**2

    def _quadratic(
        self, residual: FloatArray, response: FloatArray, key: Field, sizes: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """chi2 (f, r, r) and log determinant (f,), less that of the noise, for each size of one field."""
        basis = self._basis(key)
        held = key[2]
        n, d = residual.shape[1:]
        r, m = len(residual), response.shape[2]
        spread = 1.0 + sizes[:, None] * basis.moment
        log_det = d * np.log(spread).sum(axis=1)
        total = len(basis.moment)
        own = np.tensordot(basis.rotate[:, :n], residual, (1, 1)).transpose(0, 2, 1).reshape(total * d, r)
        weight = np.repeat(1.0 / spread, d, axis=1)
        if not held or not m:
            return (own.T * weight[:, None]) @ own, log_det
        act = np.tensordot(basis.rotate[:, :n], response, (1, 0))  # (N, d, m)
        white = np.zeros((m, m))
        if total == n:
            white = np.eye(m) / self.held_variance
        else:
            direct = act.reshape(total, d, total - n, d)
            for axis in range(d):
                direct[:, axis, :, axis] += basis.rotate[:, n:]
        log_held = 2.0 * d * float(np.log(self.held_noise).sum())
        both = np.concatenate([act.reshape(total * d, m), own], axis=1)
        found = np.empty((len(sizes), r, r))
        for at, each in enumerate(weight):
            square = (both.T * each) @ both  # (m + r, m + r)
            normal, right = square[:m, :m] + white, square[:m, m:]
            factor, by_held, failed = lapack.dposv(normal, right)
            size = np.abs(np.diag(factor))
            if failed:  # as good as singular
                by_held, size = np.linalg.lstsq(normal, right)[0], np.sqrt(np.abs(np.linalg.eigvalsh(normal)))
            found[at] = square[m:, m:] - right.T @ by_held
            log_det[at] += 2.0 * float(np.log(size).sum()) + log_held
        return found, log_det

    def projected(self, onto: FloatArray, response: FloatArray, chosen: IntArray, amplitude: FloatArray) -> FloatArray:
        """Covariance (h, q, q) of projections onto (n, d, q), at noise of scale 1. amplitude: (a, a), see `modes`"""
        every = self.hypotheses
        n, d, q = onto.shape
        m = response.shape[2]
        through = response.reshape(n * d, m).T @ onto.reshape(n * d, q)  # of each held direction
        flat, either = onto.reshape(n * d, q), (False, True)
        modes = {held: self.modes(response, held=held).reshape(n * d, -1).T @ flat for held in either}
        found = np.empty((len(chosen), q, q))
        for key, places in self._groups(chosen):
            basis, held = self._basis(key), key[2]
            parts = [onto * self.noise[:, None, None] ** 2]
            if len(basis.moment) > n:
                parts.append(-(through * self.held_variance[:, None]).reshape(-1, d, q))
            turned = np.tensordot(basis.rotate, np.concatenate(parts), 1)
            each = (turned.transpose(0, 2, 1) @ turned).reshape(-1, q * q)
            rows = chosen[places]
            found[places] = (each.sum(axis=0) + every.size[rows, None] * (basis.moment @ each)).reshape(-1, q, q)
            if held and len(basis.moment) == n:
                found[places] += (through.T * self.held_variance) @ through
            by_modes = modes[held].T @ amplitude @ modes[held]
            found[places] += by_modes * np.exp(-2.0 * self.log_scale[rows])[:, None, None]
        return found

    @property
    def _least(self) -> float:
        """Least scale of the noise that numbers resolve."""
        return self.measured.floor if self.measured.noise is None else 1e-9

    def _scaled(self, chi2: FloatArray, log_det: FloatArray, count: int, rows: IntArray, trusted: bool) -> Evidence:
        """Laplace's integral over t, the logarithm of the noise's scale; 0 where the statement is trusted.

        With a field, the stated size may be that of the white noise alone or of all of the noise: its prior is level
        from the one to the other."""
        log_prior = self.hypotheses.log_prior[rows][:, None]
        c = chi2 + count * self._least**2
        if trusted:
            t = np.zeros_like(c)
            return Evidence(log_prior - 0.5 * (log_det + c), t, t)
        pull = 0.0 if self.measured.noise is None else SCALE_SPREAD**-2
        level = -0.5 * np.log1p(self.hypotheses.size[rows])[:, None]
        t = 0.5 * np.log(c / count)
        for _ in range(12 if pull else 0):
            up = c * np.exp(-2.0 * t)
            away = t - np.clip(t, level, 0.0)
            step = np.clip((up - count - pull * away) / (2.0 * up + pull), -1.0, 1.0)
            t = t + step
            if np.abs(step).max(initial=0.0) < SCALE_SETTLED:
                break
        up = c * np.exp(-2.0 * t)
        away = t - np.clip(t, level, 0.0)
        bend = 2.0 * up + pull * (away != 0.0)
        value = -count * t - 0.5 * up - 0.5 * pull * away**2 - 0.5 * np.log(bend) - 0.5 * log_det
        if pull:
            value -= np.log1p(-level / (np.sqrt(2.0 * np.pi) * SCALE_SPREAD))
        return Evidence(value + log_prior, t, bend**-0.5)


def _by_modes(across: FloatArray, between: FloatArray, log_scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parts (q, r, h) whose squares sum to what tool and camera explain of r residuals, and the log determinant (h,) of
    1 + between, in units of the noise's scale; all hypotheses at once in each step of the factorisation.

    across, between: (q, r, h), (q, q, h) products with their effects; log_scale: (h,)"""
    parts, log_det = np.empty(across.shape), np.zeros(len(log_scale))
    inner = np.exp(-2.0 * log_scale) * between + np.eye(len(between))[..., None]
    left = np.exp(-log_scale) * across
    for at in range(len(between)):
        log_det += np.log(inner[0, 0])
        size = np.sqrt(inner[0, 0])
        column, parts[at] = inner[1:, 0] / size, left[0] / size
        inner, left = inner[1:, 1:] - column[:, None] * column, left[1:] - column[:, None] * parts[at]
    return parts, log_det


def few(residual: FloatArray, mix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sums (g, r) of residuals (r, n, d), expressed by the fewest residuals that the arithmetic distinguishes."""
    across, size, along = np.linalg.svd(residual.reshape(len(residual), -1), full_matrices=False)
    keep = max(1, int(np.count_nonzero(size > TELLS_APART * size[0])))
    return (size[:keep, None] * along[:keep]).reshape(keep, *residual.shape[1:]), mix @ across[:, :keep]


def independent(points: FloatArray, length: float) -> float:
    """How many independent values points (n, d) hold that share errors over a length (exponential correlation)."""
    return float(len(points) ** 2 / np.exp(-cdist(points, points) / length).sum())


def shared_over(points: FloatArray, residual: FloatArray, spacing: float) -> float:
    """Length over which residuals (n, d) of points share errors, from the correlation of neighbours; 0 if noise alone
    explains that correlation in 95 % of cases."""
    pairs = cKDTree(points).query_pairs(NEIGHBOURS * spacing, output_type="ndarray")
    square = float(np.mean(residual**2))
    if not len(pairs) or square <= 0.0:
        return 0.0
    near = float(np.mean(residual[pairs[:, 0]] * residual[pairs[:, 1]])) / square
    near -= 1.645 / np.sqrt(len(pairs) * residual.shape[1])
    apart = float(np.mean(np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)))
    return apart / -float(np.log(min(near, 0.95))) if near > 0.0 else 0.0
