"""Stiffness over a surface, from what a few pokes met, as a distribution: every surface that may have met them so.

The posterior over regions (`deformscope.stages.regions`), which maps an exploration, says what the surface may be: one
material, several whose borders may lie anywhere between pokes that differ, or a gradual change. The stiffness at a
place is what all of these say of it, each by its probability. So near a border it may be either material's. How much
stiffness scatters from poke to poke is not known beforehand; the pokes say that too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp, stdtr

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.poke.mixture import quantile
from deformscope.stages.regions.posterior import (
    PRIOR_EXTENT_M,
    PRIOR_MARGIN_M,
    RegionPosterior,
    RegionPrior,
    SmoothKernel,
    SurfaceKind,
)
from deformscope.stages.regions.touches import MapGrid, StiffnessSample

SCATTERS = {0.02: 0.3, 0.05: 0.45, 0.12: 0.25}
"""Deviation of log stiffness from poke to poke within a material, and the prior probability of each."""

CONTACT = 0.6
"""Deviation of the Gaussian that a poke feels the surface with, as a share of the tip's width: on finite element halves
a tip of 2 cm feels what lies within 1.1 to 1.2 cm."""

FEWEST_CONTACTS = 10.0
"""Pokes nearer than this many of these deviations are on a part of a surface; regions are not sought to be smaller."""

FREE_SHARE, FREE_SD, FREE_LENGTH_M = 0.03, 0.7, 0.08
"""Prior probability of a surface that is no map and nothing smooth: log stiffness wanders by this deviation over this
length, on a surface of 0.6 m."""

REPEATED = 0.2
"""Probability that a poke at the very place of an earlier one meets the same, whatever the maps say: above a tenth, so
that a 90 % interval holds it for certain."""

FREEDOM = 5.0
"""Of Student's t: errors have heavier tails than a Gaussian's."""

PARTICLES, MAPS, CELL_M = 300, 300, 0.02
SINGLE_POKE_SHARES = tuple(SCATTERS.values())


@dataclass(frozen=True, slots=True)
class _Mixture:
    """Log stiffness at n places: mean, variance: (c, n) of components; weight: (c, n), adding up to 1."""

    mean: FloatArray
    variance: FloatArray
    weight: FloatArray


@dataclass(frozen=True)
class StiffnessField:
    """Stiffness [N/m] over places (n, 2) [m].

    places: (p, 2); stiffness: (p,) [N/m], above 0, of the pokes; contact_m: deviation of what they feel [m]
    One poke alone is taken for the whole surface: it cannot say otherwise.
    """

    places: FloatArray
    stiffness: FloatArray
    contact_m: float

    def at(self, place: FloatArray, contact_m: float | None = None) -> FloatArray:
        """The median (n,) [N/m] at places (n, 2)."""
        return self._quantile(self._mixture(np.atleast_2d(place), contact_m), 0.5)

    def interval(
        self, place: FloatArray, level: float = 0.9, *, contact_m: float | None = None, extra: float = 0.0
    ) -> FloatArray:
        """Ends (n, 2) [N/m] between which a poke at places (n, 2) meets the stiffness with probability `level`.

        contact_m: deviation of what that poke feels, if its tip is another; extra: deviation of log stiffness for other
        reasons
        """
        mixture = self._mixture(np.atleast_2d(place), contact_m)
        ends = [self._quantile(mixture, 0.5 + 0.5 * sign * level, extra) for sign in (-1, 1)]
        return np.stack(ends, axis=-1)

    @cached_property
    def kind(self) -> SurfaceKind:
        """The most probable: gradual only if that is likelier than all regions."""
        return kind_of(self.probability)

    @cached_property
    def probability(self) -> dict[str, float]:
        """Of "1", "2", "3" regions, and "gradual": whatever is neither."""
        if len(self.stiffness) == 1:
            return {"1": 1.0, "2": 0.0, "3": 0.0, "gradual": 0.0}
        found = dict.fromkeys(("1", "2", "3", "gradual"), 0.0)
        for share, free, posterior, _ in self._posteriors:
            for name, value in posterior.probability.items():
                found[name] += share * (1.0 - free) * value
            found["gradual"] += share * free
        return found

    @cached_property
    def left_out(self) -> FloatArray:
        """(p,) relative error of each poke's stiffness predicted from the others; nan with one poke.

        Under each hypothesis the poke is taken out again in closed form, and hypotheses count the more, the less they
        expected it (importance sampling, Gelfand et al. 1992).
        """
        if len(self.stiffness) == 1:
            return np.full(1, np.nan)
        value = np.log(self.stiffness)
        parts = self._hypotheses(self.places, self.contact_m)
        means, variances, logs = [], [], []
        for mean, variance, noise2, weight in parts:
            own = np.maximum(1.0 / variance - 1.0 / noise2, 1e-9)  # precision without the poke
            others = (mean / variance - value / noise2) / own
            wide = 1.0 / own + noise2
            unexpected = 0.5 * ((value - others) ** 2 / wide + np.log(wide))
            means.append(others)
            variances.append(wide)
            logs.append(np.log(weight)[:, None] + unexpected)
        log_weight = np.concatenate(logs)
        shares = np.exp(log_weight - logsumexp(log_weight, axis=0))
        return self._quantile(_Mixture(np.concatenate(means), np.concatenate(variances), shares), 0.5) / self.stiffness - 1

    # The mixture -----------------------------------------------------------------------------------------------------

    @staticmethod
    def _quantile(mixture: _Mixture, share: float, extra: float = 0.0) -> FloatArray:
        wide = np.sqrt(mixture.variance + extra**2)
        below: Callable[[FloatArray], FloatArray] = partial(stdtr, FREEDOM)
        return np.exp(quantile(mixture.mean, wide, mixture.weight, share, below=below))

    def _mixture(self, place: FloatArray, contact_m: float | None) -> _Mixture:
        value = np.log(self.stiffness)
        if len(value) == 1:
            scatter, share = (np.array(list(one))[:, None] for one in (SCATTERS.keys(), SCATTERS.values()))
            ones = np.ones((1, len(place)))
            return _Mixture(value[0] * np.ones_like(scatter * ones), scatter**2 * ones, share * ones)
        contact = self.contact_m if contact_m is None else contact_m
        away = cdist(place, self.places)
        same = REPEATED * np.exp(-0.5 * (away / self.contact_m) ** 2)
        repeated = 1.0 - np.prod(1.0 - same, axis=1)
        means, variances, weights = [], [], []
        for mean, variance, noise2, weight in self._hypotheses(place, contact):
            means.append(mean)
            variances.append(variance + noise2)
            weights.append(weight[:, None] * (1.0 - repeated))
        for share, _, _, scatter in self._posteriors:
            means.append(np.repeat(value[:, None], len(place), axis=1))
            variances.append(np.full(away.T.shape, scatter**2))
            weights.append(share * (repeated[:, None] * same / np.maximum(same.sum(axis=1, keepdims=True), 1e-300)).T)
        return _Mixture(np.concatenate(means), np.concatenate(variances), np.concatenate(weights))

    def _hypotheses(
        self, place: FloatArray, contact_m: float
    ) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Of every hypothesis at n places: mean (c, n) and variance (c, n) of log stiffness, variance (c, n) of a poke
        about it, and probability (c,)."""
        at = self._scaled(place)
        spread = float(np.ptp(np.log(self.stiffness)))
        found = []
        for share, free, posterior, scatter in self._posteriors:
            hypotheses = posterior.hypotheses(MAPS)
            rest = share * (1.0 - free)
            for maps, level, cov, weight in hypotheses.maps:
                felt = np.ones((1, len(at), 1)) if maps is None else maps.shares(at, contact_m * self._scale)
                mixed = 2.0 * (1.0 - (felt**2).sum(axis=-1))
                mean = np.einsum("cnk,ck->cn", felt, level)
                variance = np.einsum("cnk,ckl,cnl->cn", felt, cov, felt)
                noise2 = scatter**2 + (posterior.prior.mixed_share * spread * mixed) ** 2
                found.append((mean, variance, noise2, rest * weight))
            fields = [(field, rest * weight) for field, weight in hypotheses.smooth]
            for field, weight in [*fields, (posterior.smooth_field(self._free), share * free)]:
                mean, variance = field.predict(at)
                noise2 = np.full((1, len(at)), scatter**2)
                found.append((mean[None], np.maximum(variance, 1e-9)[None], noise2, np.array([weight])))
        return found

    @cached_property
    def _posteriors(self) -> tuple[tuple[float, float, RegionPosterior, float], ...]:
        """For each scatter: its probability, that of the free surface under it, the posterior of maps, the scatter."""
        found = []
        for scatter, prior in SCATTERS.items():
            posterior = _posterior(self._scaled(self.places), np.log(self.stiffness), scatter, self._prior)
            maps = np.log1p(-FREE_SHARE) + posterior.log_evidence
            free = np.log(FREE_SHARE) + posterior.smooth_field(self._free).log_evidence
            every = float(np.logaddexp(maps, free))
            found.append((np.log(prior) + every, float(np.exp(free - every)), posterior, scatter))
        logs = np.array([one[0] for one in found])
        shares = np.exp(logs - logsumexp(logs))
        return tuple((float(share), *one[1:]) for share, one in zip(shares, found, strict=True))

    @property
    def _prior(self) -> RegionPrior:
        return RegionPrior(blur_m=self.contact_m * self._scale, within_sd=0.0)

    @property
    def _free(self) -> SmoothKernel:
        middle = 0.5 * PRIOR_EXTENT_M * np.ones(2)
        return SmoothKernel(self._prior.level_sd, middle, 0.0, FREE_SD, FREE_LENGTH_M)

    @property
    def _scale(self) -> float:
        """The priors on shapes are of a surface of about 0.6 m: this one is taken as if it were so large."""
        extent = float(np.ptp(self.places, axis=0).max())
        return PRIOR_EXTENT_M / max(extent, FEWEST_CONTACTS * self.contact_m)

    def _scaled(self, place: FloatArray) -> FloatArray:
        return np.asarray((place - self.places.min(axis=0)) * self._scale + PRIOR_MARGIN_M)


def fit_field(places: FloatArray, stiffness: FloatArray, tip_width: float) -> StiffnessField:
    """The field that pokes (p, 2) with a tip of this width [m] say. Raises InputError for stiffness that is not above
    0."""
    if not (np.isfinite(stiffness).all() and (stiffness > 0.0).all()):
        raise InputError("stiffness above 0 at every poke", f"{float(np.min(stiffness)):g} N/m")
    return StiffnessField(places, stiffness, CONTACT * tip_width)


def kind_of(probability: dict[str, float]) -> SurfaceKind:
    """The most probable kind: gradual only if that is likelier than all numbers of regions together."""
    if probability["gradual"] > 0.5:
        return "gradual"
    return "uniform" if probability["1"] >= max(probability["2"], probability["3"]) else "materials"


def _posterior(at: FloatArray, value: FloatArray, scatter: float, prior: RegionPrior) -> RegionPosterior:
    size = np.maximum(at.max(axis=0) + PRIOR_MARGIN_M, 4.0 * PRIOR_MARGIN_M)
    grid = MapGrid((float(size[0]), float(size[1])), CELL_M)
    posterior = RegionPosterior.before_touches(grid, prior, particle_count=PARTICLES)
    for xy_m, one in zip(at, value, strict=True):
        posterior = posterior.with_touch(StiffnessSample(xy_m, float(one), scatter))
    return posterior
