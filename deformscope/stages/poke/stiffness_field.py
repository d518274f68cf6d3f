"""Stiffness over a surface, from a few pokes, as a distribution over all surfaces that may have caused them.

The posterior over regions (`deformscope.stages.regions`), which maps an exploration, has these hypotheses: one
material, several with any borders between pokes that differ, or a gradual change. The stiffness at a place is the
mixture of all of these, each by its probability. Near a border the stiffness may therefore be that of either material.
The scatter of stiffness from poke to poke is unknown; the pokes determine it too."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp, ndtr, stdtr

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import correlation
from deformscope.stages.regions.hypotheses import SmoothField, SmoothKernel
from deformscope.stages.regions.levels import RegionPrior
from deformscope.stages.regions.posterior import PRIOR_EXTENT_M, PRIOR_MARGIN_M, RegionPosterior, SurfaceKind
from deformscope.stages.regions.touches import MapGrid, StiffnessSample, TouchErrorModel

OWN_SD = 0.01
"""Deviation of log stiffness: error of lattice and contact solutions in each poke, in addition to the estimated
scatter."""

CONTACT = 0.6
"""Standard deviation of the Gaussian weight of a poke over the surface, as a share of the tip's width. On finite
element halves a tip of 2 cm averages log stiffness within 1.1 to 1.2 cm."""

USUAL_TIP_M = 0.02

FEWEST_CONTACTS = 10.0
"""Pokes nearer than this many of these deviations are on a part of a surface; regions are not sought to be smaller."""

FREE_SHARE, FREE_SD, FREE_LENGTH_M = 0.03, 0.7, 0.08
"""Prior probability of a surface that is neither a map nor smooth: log stiffness wanders by this deviation over this
length, on a surface of 0.6 m."""

REPEATED = 0.25
"""Probability that a poke at the place of an earlier one has the same stiffness, under any map. Each side of that value
then has a probability above the 0.05 that a 90 % interval leaves out, so the interval contains that poke."""

TILT = 0.25
"""The expected value of |f - F| / F^TILT is least at the median of the possible true forces F, each weighted by 1 /
F^TILT. Chosen on tuning seeds (`studies.seeds`): between two possible materials, the stiffer is expected only if it is
more likely by the fourth root of their ratio. A wrong choice of it has a far larger error than that of the softer
one."""

TAILS = 10
"""Possible shares of the left-out probability that lie below an interval."""

FREEDOM = 8.0
"""Degrees of freedom of Student's t: errors have heavier tails than a Gaussian's. Chosen on tuning seeds, of 5, 8 and
12."""

OWN_SCALE = float(np.sqrt((FREEDOM - 2.0) / FREEDOM))
"""Scale of Student's t whose standard deviation is 1: learned and stated values are standard deviations."""

EXCLUDED = 1e-6
"""Probability below which a hypothesis is taken as excluded by the pokes together."""

MOST_REGIONS = 3
"""Largest number of regions: it means this number or more. Pokes are fewer than touches of an exploration, and their
number is not fixed."""

PARTICLES, MAPS, CELL_M = 1000, 300, 0.02
"""With 300 particles few were left for pokes that scatter by 3 % or less. On tuning seeds force errors on stiff discs
were 29 % instead of 20 %, in one material 7 % instead of 3.5 %."""
ERROR = TouchErrorModel(gain_sd=0.0)
"""Error model of a poke: all pokes are of one session, and share errors with the forces predicted for it."""


@dataclass(frozen=True, slots=True)
class _Mixture:
    """Log stiffness at n places: mean, variance: (c, n) of components; weight: (c, n), adding up to 1."""

    mean: FloatArray
    variance: FloatArray
    weight: FloatArray


@dataclass(frozen=True)
class StiffnessField:
    """Stiffness [N/m] over places (n, 2) [m].

    places: (p, 2); stiffness: (p,) [N/m], above 0, of the pokes; contact_m: deviation of their contact weight [m]. One
    poke alone gives the whole surface its value."""

    places: FloatArray
    stiffness: FloatArray
    contact_m: float

    def at(self, place: FloatArray, contact_m: float | None = None) -> FloatArray:
        """The most central estimate (n,) [N/m] at places (n, 2). The predicted force is a compromise, weighted by
        `TILT`, between the least expected error in newtons (the median) and the least error relative to the true
        force."""
        mixture = self._mixture(np.atleast_2d(place), contact_m)
        tilted = mixture.weight * np.exp(-TILT * (mixture.mean - mixture.mean.mean()))
        return self._quantile(_Mixture(mixture.mean, mixture.variance, tilted / tilted.sum(axis=0)), 0.5)

    def interval(
        self, place: FloatArray, level: float = 0.9, *, contact_m: float | None = None, extra: float = 0.0
    ) -> FloatArray:
        """Ends (n, 2) [N/m] of the interval of the stiffness of a poke at places (n, 2), with probability `level`.
        The ends with the smallest ratio are chosen, so that an improbable material is left out.

        contact_m: deviation of that poke's contact weight, for another tip; extra: deviation of log stiffness for other
        reasons"""
        mixture = self._mixture(np.atleast_2d(place), contact_m)
        below = (1.0 - level) * (np.arange(TAILS) + 0.5) / TAILS
        low, high = (np.array([self._quantile(mixture, one, extra) for one in ends]) for ends in (below, below + level))
        best = np.argmin(high / low, axis=0)[None]
        return np.stack([np.take_along_axis(end, best, axis=0)[0] for end in (low, high)], axis=-1)

    @cached_property
    def kind(self) -> SurfaceKind:
        """The most probable: gradual only if that is likelier than all regions."""
        return kind_of(self.probability)

    @cached_property
    def probability(self) -> dict[str, float]:
        """Probability of "1", "2", "3" regions, and "gradual": whatever is neither."""
        if len(self.stiffness) == 1:
            return {"1": 1.0, "2": 0.0, "3": 0.0, "gradual": 0.0}
        free = sum(share for _, share in self._free)
        found = {name: (1.0 - free) * share for name, share in self._posterior.probability.items()}
        return found | {"gradual": found["gradual"] + free}

    @cached_property
    def scatter(self) -> float:
        """Root mean square deviation of log stiffness from poke to poke about what the surface may be."""
        fields = [*self._posterior.hypotheses(MAPS).smooth, *self._free]
        smooth = sum(share for _, share in fields)
        square = (1.0 - smooth) * self._posterior.scatter**2 + sum(share * field.scatter**2 for field, share in fields)
        return float(np.sqrt(OWN_SD**2 + square))

    @cached_property
    def left_out(self) -> FloatArray:
        """(p,) relative error of each poke's stiffness predicted from the others; nan with one poke.

        Under each hypothesis the poke is removed in closed form. Hypotheses have the more weight, the less they
        expected it (importance sampling, Gelfand et al. 1992)."""
        if len(self.stiffness) == 1:
            return np.full(1, np.nan)
        value = np.log(self.stiffness)
        centre = value.mean()
        means, variances, logs = [], [], []
        for mean, variance, noise2, weight in self._hypotheses(self.places, self.contact_m):
            if weight.sum() < EXCLUDED:
                continue  # one poke less would not bring it back
            own = np.maximum(1.0 / variance - 1.0 / noise2, 1.0)  # precision without the poke; the prior's is 1
            others = centre + ((mean - centre) / variance - (value - centre) / noise2) / own
            others = np.clip(others, value.min(), value.max())
            wide = 1.0 / own + noise2
            unexpected = 0.5 * ((value - others) ** 2 / wide + np.log(wide))
            means.append(others)
            variances.append(wide)
            logs.append(np.log(np.maximum(weight, 1e-300))[:, None] + unexpected)
        log_weight = np.concatenate(logs)
        shares = np.exp(log_weight - logsumexp(log_weight, axis=0))
        mixture = _Mixture(np.concatenate(means), np.concatenate(variances), shares)
        return self._quantile(mixture, 0.5) / self.stiffness - 1

    # The mixture -----------------------------------------------------------------------------------------------------

    @staticmethod
    def _quantile(mixture: _Mixture, share: float, extra: float = 0.0) -> FloatArray:
        """(n,) stiffness at a share of the probability, of mixtures of log stiffness."""
        wide = OWN_SCALE * np.sqrt(mixture.variance + extra**2)
        below: Callable[[FloatArray], FloatArray] = partial(stdtr, FREEDOM)
        return np.exp(quantile(mixture.mean, wide, mixture.weight, share, below=below))

    def _mixture(self, place: FloatArray, contact_m: float | None) -> _Mixture:
        """The mixture that log stiffness is at places (n, 2). contact_m: radius of the contact that asks [m]"""
        value = np.log(self.stiffness)
        if len(value) == 1:
            flat = np.full((1, len(place)), value[0])
            return _Mixture(flat, np.full_like(flat, OWN_SD**2 + ERROR.touch_sd**2), np.ones_like(flat))
        near = REPEATED * correlation("gaussian", cdist(self.places, place) / self.contact_m)  # (p, n)
        repeated = 1.0 - np.prod(1.0 - near, axis=0)
        parts = self._hypotheses(place, self.contact_m if contact_m is None else contact_m)
        means = [mean for mean, _, _, _ in parts] + [np.repeat(value[:, None], len(place), axis=1)]
        variances = [variance + noise2 for _, variance, noise2, _ in parts]
        variances.append(np.full(near.shape, self.scatter**2))
        weights = [weight[:, None] * (1.0 - repeated) for _, _, _, weight in parts]
        weights.append(repeated * near / np.maximum(near.sum(axis=0), 1e-300))
        return _Mixture(np.concatenate(means), np.concatenate(variances), np.concatenate(weights))

    def _hypotheses(
        self, place: FloatArray, contact_m: float
    ) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """For every hypothesis, at n places: mean (c, n) and variance (c, n) of log stiffness, variance (c, n) of a
        poke about it, and probability (c,)."""
        at, posterior, free = self._scaled(place), self._posterior, sum(share for _, share in self._free)
        spread = float(np.ptp(np.log(self.stiffness)))
        hypotheses = posterior.hypotheses(MAPS)
        scatter2, found = OWN_SD**2 + posterior.scatter**2, []
        for maps, level, cov, weight in hypotheses.maps:
            shares = np.ones((len(level), len(at), 1)) if maps is None else maps.shares(at, contact_m * self._scale)
            mixed = 2.0 * (1.0 - (shares**2).sum(axis=-1))
            mean = np.einsum("cnk,ck->cn", shares, level)
            variance = np.einsum("cnk,ckl,cnl->cn", shares, cov, shares)
            noise2 = scatter2 + (posterior.prior.mixed_share * spread * mixed) ** 2
            found.append((mean, variance, noise2, (1.0 - free) * weight))
        for field, share in [*((field, (1.0 - free) * share) for field, share in hypotheses.smooth), *self._free]:
            mean, variance = field.predict(at)
            noise2 = np.full((1, len(at)), OWN_SD**2 + field.scatter**2)
            found.append((mean[None], variance[None], noise2, np.array([share])))
        return [part for part in found if part[3].sum() > 0.0]

    @cached_property
    def _posterior(self) -> RegionPosterior:
        at = self._scaled(self.places)
        size = np.maximum(at.max(axis=0) + PRIOR_MARGIN_M, 4.0 * PRIOR_MARGIN_M)
        grid = MapGrid((float(size[0]), float(size[1])), CELL_M)
        prior = RegionPrior(blur_m=self.contact_m * self._scale, error=ERROR, forces_add=False)
        posterior = RegionPosterior.before_touches(grid, prior, particle_count=PARTICLES, most_regions=MOST_REGIONS)
        for xy_m, value in zip(at, np.log(self.stiffness), strict=True):
            posterior = posterior.with_touch(StiffnessSample(xy_m, float(value), OWN_SD))
        return posterior

    @cached_property
    def _free(self) -> tuple[tuple[SmoothField, float], ...]:
        middle = 0.5 * np.asarray(self._posterior.grid.size_m)
        kernel = SmoothKernel(self._posterior.prior.any_level_sd, middle, 0.0, FREE_SD, FREE_LENGTH_M)
        return self._posterior.with_smooth_field(kernel, FREE_SHARE)

    @property
    def _scale(self) -> float:
        """The priors on shapes are of a surface of about 0.6 m: this one is scaled to it."""
        extent = float(np.ptp(self.places, axis=0).max())
        return PRIOR_EXTENT_M / max(extent, FEWEST_CONTACTS * self.contact_m)

    def _scaled(self, place: FloatArray) -> FloatArray:
        return np.asarray((place - self.places.min(axis=0)) * self._scale + PRIOR_MARGIN_M)


def fit_field(places: FloatArray, stiffness: FloatArray, tip_width: float | None) -> StiffnessField:
    """The field that pokes (p, 2) with a tip of this width [m], `USUAL_TIP_M` if not known, say. Raises InputError for
    stiffness that is not above 0."""
    if not (np.isfinite(stiffness).all() and (stiffness > 0.0).all()):
        raise InputError("stiffness above 0 at every poke", f"{float(np.min(stiffness)):g} N/m")
    return StiffnessField(places, stiffness, CONTACT * (USUAL_TIP_M if tip_width is None else tip_width))


def kind_of(probability: dict[str, float]) -> SurfaceKind:
    """The most probable kind: gradual only if that is likelier than all numbers of regions together."""
    if probability["gradual"] > 0.5:
        return "gradual"
    return "uniform" if probability["1"] >= max(probability["2"], probability["3"]) else "materials"


BISECTIONS = 30
FARTHEST = 9.0
"""Deviations from a component's mean within which its quantiles are sought."""


def quantile(
    mean: FloatArray,
    deviation: FloatArray,
    weight: FloatArray,
    share: float,
    *,
    below: Callable[[FloatArray], FloatArray] = ndtr,
) -> FloatArray:
    """The value (...) that a `share` of a mixture lies below, by bisection.

    mean, deviation: (c, ...) mean and deviation of the components; weight: (c,) or (c, ...), adding up to 1 over them;
    below: distribution function of a component of mean 0 and deviation 1"""
    own = weight.reshape(*weight.shape, *(1,) * (mean.ndim - weight.ndim))
    low, high = (mean - FARTHEST * deviation).min(axis=0), (mean + FARTHEST * deviation).max(axis=0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        less = (own * below((middle - mean) / deviation)).sum(axis=0) < share
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return np.asarray(0.5 * (low + high))
