"""An interval for one parameter, from its error curve and from what noise and misfit do to that curve.

The interval holds every value whose error exceeds the lowest one by no more than it would in `level` of all repeats,
were that value true (Feldman and Cousins 1998, with the average Euclidean error as the statistic). So it always holds
the estimate, needs no flat-top or Gaussian shape, and stays right where the parameter reaches a bound.

Repeats differ by three things, weighed by how well they explain the residuals that were seen:

- white noise of each observed particle, of known or unknown size;
- the same noise in the prescribed positions, which moves every simulated particle (taken as exact, 90 % intervals
  cover about half the time); where it is not known whether they are exact, the residuals weigh in;
- a smooth random field (Matern 3/2) as large as the residuals ask for: misfit of the model, or errors of measurement
  that neighbours share. The latter is in measured prescribed positions too, so that one common to all tells nothing.

Far below the noise the error curve is taken as quadratic (a pseudo-Huber distance), so that residuals smaller than
the noise that was stated cannot tell more than that noise allows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import eigh, solve_triangular
from scipy.spatial.distance import cdist

from deformscope.arrays import BoolArray, FloatArray, IntArray

MISFIT_LENGTHS = (1.0, 2.5, 6.0)
"""Correlation lengths tried for the misfit, in particle spacings."""

MISFIT_SHARES = (0.1, 0.3, 1.0, 3.0)
"""Misfit variances tried, in units of the residuals' mean square (known noise)."""

MISFIT_RATIOS = (0.3, 1.0, 3.0, 10.0, 100.0)
"""Misfit variances tried, in units of the white noise (unknown noise)."""

SPECTRAL_WAVES = 100
"""Waves that one draw of a smooth field is made of."""

HELD_SHARES: dict[bool | None, dict[float, float]] = {True: {1.0: 1.0}, False: {0.0: 1.0}, None: {0.0: 0.25, 1.0: 0.75}}
"""Variances of the prescribed positions' noise tried, in units of the other particles', and their prior weights."""

SHARED_MOST = 25.0
"""A smooth field of more than this variance, in units of the white noise, is misfit: measuring is not that wrong."""

PRIOR_NO_MISFIT = 0.5
MOST_FOR_EVIDENCE = 120
"""Particles that the evidence for noise and misfit is taken from; more add cost, not insight."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """What is left unexplained at the estimate, for the free observed particles of one observation.

    rest: (n, d) their rest positions; value: (n, d) observed - simulated; noise: (n,) one standard deviation per
    coordinate, or None if unknown; spacing: of the particles; floor: smallest deviation that the numbers can resolve
    held_response: (n, d, m) displacement of each for a unit step along each of m directions of the prescribed positions
    held_deviation: (m,) noise along these directions (times the noise if that is known)
    held_rest: (k, d) rest positions of the prescribed particles, whose k d coordinates are the directions; None where
    random combinations stand for too many of them
    held_measured: whether the prescribed positions carry noise; None = not known
    """

    rest: FloatArray
    value: FloatArray
    noise: FloatArray | None
    spacing: float
    floor: float
    held_response: FloatArray
    held_deviation: FloatArray
    held_rest: FloatArray | None
    held_measured: bool | None

    def deviation(self) -> FloatArray:
        """(n,) stated noise, or 1 where it is a scale that is still to be found."""
        if self.noise is None:
            return np.ones(len(self.value))
        return np.maximum(self.noise, self.floor)


@dataclass(frozen=True, slots=True)
class Repeats:
    """What may happen to an observation, r times over.

    own: (r, n, d) errors of the free observed particles; held: (r, m) steps of the prescribed positions along their
    directions, which move the simulation
    """

    own: FloatArray
    held: FloatArray


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Weighed explanations of the residuals: each a white-noise scale, a share of held noise, a misfit and its length.

    weight: (h,) summing to 1; scale, held_share, misfit, length: (h,); scale multiplies `noise` (1 if that was known)
    shared: (h,) whether the prescribed particles have the smooth field too: an error of measurement, not a misfit
    """

    weight: FloatArray
    scale: FloatArray
    held_share: FloatArray
    misfit: FloatArray
    length: FloatArray
    shared: BoolArray


def explain(residuals: Residuals, seed: int = 0) -> NoiseModel:
    """Weigh the explanations by how likely they make the residuals (Gaussian evidence, flat over the grid)."""
    rng = np.random.default_rng(seed)
    d = residuals.value.shape[1]
    pick = np.sort(rng.permutation(len(residuals.value))[:MOST_FOR_EVIDENCE])
    value = residuals.value[pick].ravel()
    size = value.size
    known = residuals.noise is not None
    mean_square = max(float(np.mean(value**2)), residuals.floor**2)
    white = np.maximum(np.repeat(residuals.deviation()[pick] ** 2, d), 1e-12 * mean_square)
    effect = (residuals.held_response[pick] * residuals.held_deviation).reshape(size, -1)
    rows: list[tuple[float, ...]] = []
    for held_share, held_prior in HELD_SHARES[residuals.held_measured].items():
        base = np.diag(white) + held_share * effect @ effect.T
        lower = np.linalg.cholesky(base)
        log_det_base = 2.0 * float(np.log(np.diag(lower)).sum())
        kinds = (False, True) if held_share > 0.0 and residuals.held_rest is not None else (False,)
        for length, shared in product(MISFIT_LENGTHS, kinds):
            field = _field_covariance(residuals, pick, length, shared=shared)
            half = solve_triangular(lower, field, lower=True)
            moments, axes = eigh(solve_triangular(lower, half.T, lower=True))
            z2 = (axes.T @ solve_triangular(lower, value, lower=True)) ** 2
            moments = np.maximum(moments, 0.0)
            misfits = [m * mean_square for m in MISFIT_SHARES] if known else list(MISFIT_RATIOS)
            for misfit in [0.0, *misfits]:
                if shared and misfit > SHARED_MOST * (float(white.mean()) if known else 1.0):
                    continue
                spread = 1.0 + misfit * moments
                chi2 = float(np.sum(z2 / spread))
                log_det = log_det_base + float(np.log(spread).sum())
                if known:
                    scale2, log_like = 1.0, -0.5 * (chi2 + log_det)
                else:
                    scale2 = max(chi2 / size, residuals.floor**2)
                    log_like = -0.5 * (chi2 / scale2 + size * np.log(scale2) + log_det)
                prior = PRIOR_NO_MISFIT if misfit == 0.0 else (1.0 - PRIOR_NO_MISFIT) / len(misfits)
                weight_of = log_like + float(np.log(prior * held_prior / len(kinds)))
                rows.append((weight_of, np.sqrt(scale2), held_share, misfit * scale2, length, float(shared)))
    table = np.array(rows)
    weight = np.exp(table[:, 0] - table[:, 0].max())
    keep = weight > 1e-3 * weight.max()
    weight, table = weight[keep] / weight[keep].sum(), table[keep]
    return NoiseModel(weight, table[:, 1], table[:, 2], table[:, 3], table[:, 4], table[:, 5] > 0.0)


def draw(residuals: Residuals, model: NoiseModel, count: int, rng: np.random.Generator) -> Repeats:
    """Repeats of noise, held noise and smooth fields."""
    n, d = residuals.value.shape
    which = rng.choice(len(model.weight), size=count, p=model.weight)
    scale = model.scale[which]
    own = rng.standard_normal((count, n, d)) * residuals.deviation()[:, None] * scale[:, None, None]
    held = rng.standard_normal((count, len(residuals.held_deviation))) * residuals.held_deviation
    held *= (scale * np.sqrt(model.held_share[which]))[:, None]
    places = residuals.rest
    if residuals.held_rest is not None:
        places = np.concatenate([places, residuals.held_rest])
    for row in np.flatnonzero(model.misfit[which] > 0.0):
        one = which[row]
        field = _smooth_field(places / (residuals.spacing * model.length[one]), rng) * np.sqrt(model.misfit[one])
        own[row] += field[:n]
        if model.shared[one]:
            held[row] += field[n:].ravel()
    return Repeats(own, held)


def _field_covariance(residuals: Residuals, pick: IntArray, length: float, *, shared: bool) -> FloatArray:
    """Covariance (s, s) at the picked particles of a smooth field of unit variance; `shared` by the prescribed ones."""
    d = residuals.value.shape[1]
    rest = residuals.rest[pick]
    scale = residuals.spacing * length
    own = np.kron(_matern(cdist(rest, rest) / scale), np.eye(d))
    if not shared or residuals.held_rest is None:
        return np.asarray(own)
    response = residuals.held_response[pick].reshape(len(own), -1)
    cross = np.kron(_matern(cdist(rest, residuals.held_rest) / scale), np.eye(d)) @ response.T
    held = np.kron(_matern(cdist(residuals.held_rest, residuals.held_rest) / scale), np.eye(d))
    return np.asarray(own - cross - cross.T + response @ held @ response.T)


def _smooth_field(place: FloatArray, rng: np.random.Generator) -> FloatArray:
    """One draw of `_matern` fields of unit variance, one for each coordinate, at (n, d) places in units of its length.

    Waves drawn from its spectrum (Rahimi and Recht 2007), a multivariate t with 3 degrees of freedom: cost linear in n.
    """
    stretch = np.sqrt(3.0 / rng.chisquare(3.0, (SPECTRAL_WAVES, 1)))
    waves = rng.standard_normal((SPECTRAL_WAVES, place.shape[1])) * stretch
    angle = place @ waves.T
    sine, cosine = rng.standard_normal((2, SPECTRAL_WAVES, place.shape[1])) / np.sqrt(SPECTRAL_WAVES)
    return np.asarray(np.sin(angle) @ sine + np.cos(angle) @ cosine)


def accepted(
    parameter: FloatArray,
    simulated: FloatArray,
    observed: FloatArray,
    repeats: Callable[[int], FloatArray],
    level: float,
    soft: FloatArray,
) -> tuple[float, float]:
    """The set of values that the error curve does not rule out, as the ends of its hull.

    parameter: (g,) rising; simulated: (g, n, d) free observed particles at each; observed: (n, d);
    repeats: called with a place in `parameter`, gives (r, n, d): what each repeat adds to observed - simulated there
    soft: (n,) length below which the error of a particle counts by its square: its noise
    """
    error = np.sqrt(np.sum((simulated - observed) ** 2, axis=-1) + soft**2).mean(axis=-1)
    excess = error - error.min()
    tested = np.unique(np.linspace(0, len(parameter) - 1, 13).round().astype(int))
    curves = np.stack([_errors(repeats(g), simulated[tested] - simulated[g], soft) for g in range(len(parameter))])
    own = np.stack([curves[truth, row] for row, truth in enumerate(tested)])
    limit = np.quantile(own - curves.min(axis=0), level, axis=1)
    margin = np.interp(parameter, parameter[tested], limit) - excess
    inside = np.flatnonzero(margin >= 0.0)
    low, high = int(inside[0]), int(inside[-1])
    return _cross(parameter, margin, low, low - 1), _cross(parameter, margin, high, high + 1)


def _errors(added: FloatArray, offsets: FloatArray, soft: FloatArray) -> FloatArray:
    """Mean soft distance of repeats (r, n, d) plus each offset (t, n, d), (t, r)."""
    every = np.empty((len(offsets), len(added)))
    for row, offset in enumerate(offsets):
        left = added + offset
        every[row] = np.sqrt(np.einsum("rnd,rnd->rn", left, left) + soft**2).mean(axis=1)
    return every


def _cross(parameter: FloatArray, margin: FloatArray, inside: int, outside: int) -> float:
    """Where the margin crosses 0 between two neighbouring values; the value itself at the end of the range."""
    if not 0 <= outside < len(parameter):
        return float(parameter[inside])
    share = margin[inside] / (margin[inside] - margin[outside])
    return float(parameter[inside] + share * (parameter[outside] - parameter[inside]))


def _matern(scaled_distance: FloatArray) -> FloatArray:
    """Matern 3/2 correlation at distances in units of its length."""
    s = np.sqrt(3.0) * scaled_distance
    return np.asarray((1.0 + s) * np.exp(-s))
