"""The regions of equal stiffness of a surface, from a few touches: a posterior over maps (Bayes).

A map divides the surface into one to five regions (`partitions`), each with one level of log stiffness. A touch
averages the regions under its contact, whose forces add, plus its errors (`touch_error`). Given a map and the scatter
of touches the levels are integrated in closed form (a contact's stiffness is linear in them about their approximate
values), and summed over the scatter. The maps are particles that every touch reweights and that move under the prior
when few are left (iterated batch importance sampling, Chopin 2002). This also gives their evidence, which determines
the number of regions. Four are followed once three are the most likely, five once four have some probability; until
then they count as explaining the touches as well as the most that are followed. Beyond three, those of their regions
count that touches
met: a further one with hardly any effect would cost no evidence. A surface whose stiffness changes smoothly is the
rival hypothesis (Gaussian processes); where it wins, the verdict is "gradual".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal, cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp, ndtr
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.regions.partitions import FAMILY_SHARES, Partitions, draw, propose
from deformscope.stages.regions.touch_error import LAW_SD, TouchErrorModel
from deformscope.stages.regions.touches import FIRST_REGIONS, MapGrid, StiffnessSample

RegionMapKind = Literal["regions", "gradual"]
SurfaceKind = Literal["uniform", "materials", "gradual"]
"""The kinds of surface, with a separate name for one region."""

MOST_REGIONS = 5
"""Largest distinguished number: it means this number or more."""
MORE_SHARE = 0.5
"""Number of maps of four and more regions, as a share of the number of others: fewer maps save time."""
MORE_FROM = 0.2
"""Probability of four from which five are followed."""
MET = 0.5
"""Number of touches in a region from which it counts as touched."""
MOVES = 40
TEMPERS = (1.0, 4.0, 16.0, 64.0, 256.0)
"""Factors on the variance of the newest touch, where it comes as a surprise."""
FEW = 0.3
"""Share of the maps that they are worth, below which they move."""
SMOOTH_LENGTHS_M = (0.2, 0.35, 0.6)
SMOOTH_SDS = (0.25, 0.6)
SLOPES_PER_M = (1.0, 3.0)
"""Slopes of log stiffness: how smooth fields may vary; each combination has the same prior probability."""
PRIOR_EXTENT_M, PRIOR_MARGIN_M = 0.5, 0.05
"""Distances between places, and from the border, are scaled to this size: the priors on shapes are of a surface of
about 0.6 m."""
LINEARISED = 2
"""Number of estimates of the levels before a contact's stiffness is linearized about them."""
RIGID_SDS = 2.0
"""Levels within this many deviations below the bound of rigid touches count as rigid."""
SCATTER_MAPS = 100
"""Number of maps from which the scatter is computed."""
LEVELS_DRAWN = 4000
"""Number of drawn levels from which intervals are computed."""
FACTORS_BYTES = 32 << 20
"""Memory of the factors of maps that are computed at once: it would grow with the square of the touches."""
LEAST_WEIGHT = 1e-3
"""Smallest weight among all smooth fields: one with less is left out."""


@dataclass(frozen=True, slots=True)
class RegionPrior:
    """Assumptions of a map.

    one, two, three, four, five, gradual: prior probabilities; blur_m: standard deviation of a contact's Gaussian;
    error: error model of a touch; mixed_share: touches near a boundary are off by up to this share of all contrast;
    level_sd: deviation of the regions' log stiffness about their common level; `common_sd`: deviation of that level
    about the touches'; mean: deviation of the mean; large, so that the places of touches do not inform it;
    least_contrast: least difference of log stiffness between two regions (0.13: 14 %; with a sphere 20 % in modulus);
    rigid_sd: deviation of touches that are lower bounds; forces_add: under a contact on two regions, else their log
    stiffness has a mean; family_shares: family shares of borders, in each family of curves (`partitions.Family`)

    blur_m was fitted to finite elements of a ball of 1 cm at 3 N, 0 to 4 cm from a border. With forces that add, 0.0075
    gives the true stiffness within 3 % if one side is 1.8 times as stiff as the other, within 6 % at 3.6 times. Next to
    a rigid part it is within a factor of 1.5, except for the nearest 4 mm. A mean of logarithms needs 0.008 there and
    0.0045 here, and a border that is moved by 2 to 6 mm.
    """

    one: float = 0.47
    two: float = 0.33
    three: float = 0.10
    four: float = 0.03
    five: float = 0.01
    gradual: float = 0.06
    blur_m: float = 0.0075
    error: TouchErrorModel = field(default_factory=TouchErrorModel)
    mixed_share: float = 0.12
    level_sd: float = 1.0
    common_sd: float = 2.0
    least_contrast: float = 0.13
    rigid_sd: float = 0.3
    forces_add: bool = True
    family_shares: tuple[float, ...] = FAMILY_SHARES

    def __post_init__(self) -> None:
        shares = (*self.regions, self.gradual)
        if min(shares) < 0.0 or abs(sum(shares) - 1.0) > 1e-9:
            raise InputError("prior probabilities that add up to 1", f"{shares}")
        if min(self.blur_m, self.level_sd, self.common_sd, self.rigid_sd) <= 0.0:
            came = f"{self.blur_m}, {self.level_sd}, {self.common_sd}, {self.rigid_sd}"
            raise InputError("a blur and deviations above 0", came)

    @property
    def regions(self) -> tuple[float, ...]:
        """Probability of each number of regions, from one on."""
        return self.one, self.two, self.three, self.four, self.five

    @property
    def any_level_sd(self) -> float:
        """Standard deviation of the level of one region alone, in log stiffness."""
        return float(np.hypot(self.level_sd, self.common_sd))


@dataclass(frozen=True, slots=True)
class RegionMap:
    """Posterior of the whole surface, arrays (rows, columns) of the grid.

    verdict: "gradual" where a smooth field explains the touches better than regions
    region_count: k, the most probable number of regions, 0 where the verdict is "gradual"
    at_least: there may be more regions than `region_count`, the largest number that is distinguished
    probability: probability of each number of regions and "gradual"
    labels: 0 (softest) to k - 1; -1 everywhere without regions
    label_probability: probability that verdict, number of regions and the cell's label are all right
    level, level_sd: (k,) log stiffness of each region; level_interval: (k, 2) 90 % interval; rigid: (k,) regions for
    which the level is a lower bound, the highest of their touches', at which the interval begins; it is open above
    field, field_sd: log stiffness at every cell, over all hypotheses
    scatter: deviation of touches' log stiffness within one material, root mean square over the posterior
    wrong_share: share of the surface that is expected to have a wrong label, given k; nan without regions
    boundary_sd_m: the same as a distance from the boundary; nan without one
    """

    grid: MapGrid
    verdict: RegionMapKind
    region_count: int
    probability: dict[str, float]
    labels: IntArray
    label_probability: FloatArray
    level: FloatArray
    level_sd: FloatArray
    level_interval: FloatArray
    rigid: BoolArray
    field: FloatArray
    field_sd: FloatArray
    wrong_share: float
    boundary_sd_m: float
    scatter: float = np.nan
    at_least: bool = False

    @property
    def more_possible(self) -> bool:
        """Whether there may be more regions: three and more are not distinguished reliably (`studies regions`)."""
        return self.region_count >= FIRST_REGIONS

    @property
    def claimed(self) -> float:
        """Probability of the verdict and `region_count`; of as many or more where that is possible."""
        k = self.region_count
        if self.more_possible:
            return sum(share for number, share in self.probability.items() if number.isdigit() and int(number) >= k)
        return self.probability[str(k or "gradual")]


@dataclass(frozen=True, slots=True)
class RegionHypotheses:
    """A sample of possible surfaces: weighted maps, with levels from soft to stiff, and smooth fields.

    maps: for each number of regions its maps (none for one region), their levels (n, k) and covariances (n, k, k), and
    weights (n,); smooth: kernels with their weights; all weights add up to 1; forces_add: as in `RegionPrior`
    scatter: for each number of regions the scatter of its maps (n,)
    """

    maps: tuple[tuple[Partitions | None, FloatArray, FloatArray, FloatArray], ...]
    smooth: tuple[tuple[SmoothField, float], ...]
    forces_add: bool
    scatter: tuple[FloatArray, ...] = ()

    def predict(self, places_m: FloatArray, blur_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean and variance (h, p) of contacts at places (p, 2) under each hypothesis, and its probability (h,)."""
        means: list[FloatArray] = []
        variances: list[FloatArray] = []
        weights: list[FloatArray] = []
        for maps, level, cov, weight in self.maps:
            shares = np.ones((1, len(places_m), 1)) if maps is None else maps.shares(places_m, blur_m)
            if self.forces_add:
                mean, shares = _felt(shares, level)
            else:
                mean = (shares @ level[..., None])[..., 0]
            means.append(mean)
            variances.append(((shares @ cov) * shares).sum(axis=-1))
            weights.append(weight)
        for smooth, share in self.smooth:
            mean, variance = smooth.predict(places_m)
            means.append(mean[None])
            variances.append(variance[None])
            weights.append(np.array([share]))
        weight = np.concatenate(weights)
        return np.concatenate(means), np.concatenate(variances), weight / weight.sum()


@dataclass(frozen=True, slots=True)
class RelatedTouches:
    """Touches at places `at_m` (p, 2), which share scatter with those made so far, at `readings`, the more the nearer
    they are. The deviation of a neighbour is expected again, so that a touch next to it adds little information.
    own_sd: deviation of a touch alone"""

    at_m: FloatArray
    readings: _Readings
    prior: RegionPrior
    own_sd: float

    def take(self, index: IntArray) -> RelatedTouches:
        """The touches at the places of these indices."""
        return replace(self, at_m=self.at_m[index])

    def expected(
        self, hypotheses: RegionHypotheses, blur_m: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Under each hypothesis mean, variance due to the levels and total deviation (h, p) of the readings, and its
        weight (h,): the predictive distribution given the map and its scatter (universal kriging, Cressie 1993,
        3.4.2)."""
        made, places = self.readings, np.concatenate([self.at_m, self.readings.xy_m])
        new, measured, shared = len(self.at_m), made.value + made.centre, self.prior.error.shared(self.at_m, made.xy_m)
        parts: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []
        for (maps, level, cov, weight), scatter in zip(hypotheses.maps, hypotheses.scatter, strict=True):
            shares = np.ones((1, len(places), 1)) if maps is None else maps.shares(places, blur_m)
            off2 = (self.prior.mixed_share * made.spread * 2.0 * (1.0 - (shares**2).sum(axis=-1))) ** 2
            slope = shares
            if hypotheses.forces_add:
                mean, slope = _felt(shares, level)
            else:
                mean = (shares @ level[..., None])[..., 0]
            square = scatter[:, None, None] ** 2
            errors = square * made.related + np.eye(len(measured)) * (made.variance + off2[:, None, new:])
            again = (square * shared) @ np.linalg.inv(errors)
            lever = slope[:, :new] - again @ slope[:, new:]
            variance = ((lever @ cov) * lever).sum(axis=-1)
            left = scatter[:, None] ** 2 * (1.0 - (again * shared).sum(axis=-1)) + off2[:, :new] + self.own_sd**2
            mean = mean[:, :new] + (again @ (measured - mean[:, new:])[..., None])[..., 0]
            parts.append((mean, variance, np.sqrt(variance + left), weight))
        for smooth, share in hypotheses.smooth:
            _, variance = smooth.predict(self.at_m)
            mean, both = smooth.predict(self.at_m, smooth.scatter**2 * shared)
            sd = np.sqrt(both + smooth.scatter**2 + self.own_sd**2)
            parts.append((mean[None], variance[None], sd[None], np.array([share])))
        mean, variance, sd, weight = (np.concatenate(one) for one in zip(*parts, strict=True))
        return mean, variance, sd, weight / weight.sum()


@dataclass(frozen=True, slots=True)
class _Readings:
    """xy_m: (t, 2); value: (t,) log stiffness over `centre`; variance: (t,) variance of each alone, without the
    scatter; arm: (t,) shift of each if the arm's compliance is off by a deviation; related: (t, t) correlation of their
    scatter; spread: spread of all values."""

    xy_m: FloatArray
    value: FloatArray
    variance: FloatArray
    arm: FloatArray
    related: FloatArray
    centre: float
    spread: float


@dataclass(frozen=True, slots=True)
class _Particles:
    """Weighted maps of one number of regions. log_weight: (n,) normalised; log_likelihood: (n,) log likelihood of all
    touches"""

    maps: Partitions
    log_weight: FloatArray
    log_likelihood: FloatArray
    log_evidence: float


@dataclass(frozen=True)
class RegionPosterior:
    """The probability of every map after some touches; `with_touch` gives the next one. The same touches give the same
    result.

    particles: number of particles of 2, 3 and more regions; most_regions: largest number that is distinguished
    """

    grid: MapGrid
    prior: RegionPrior
    touches: tuple[StiffnessSample, ...]
    particles: tuple[_Particles, ...]
    particle_count: int
    seed: int
    most_regions: int = MOST_REGIONS

    @classmethod
    def before_touches(
        cls,
        grid: MapGrid,
        prior: RegionPrior | None = None,
        *,
        particle_count: int = 2000,
        seed: int = 0,
        most_regions: int = MOST_REGIONS,
    ) -> RegionPosterior:
        """The posterior before any touch. particle_count: maps stored for each number of regions; four times as many at
        first"""
        if particle_count < 50:
            raise InputError("50 particles or more", f"{particle_count}")
        nothing = cls(grid, prior or RegionPrior(), (), (), particle_count, seed, most_regions)
        return replace(nothing, particles=tuple(nothing._followed(k) for k in range(2, FIRST_REGIONS + 1)))

    def with_touch(self, touch: StiffnessSample) -> RegionPosterior:
        """The posterior after one more touch."""
        touches = (*self.touches, touch)
        readings = _readings(touches, self.prior)
        particles = []
        with threadpool_limits(1):  # thousands of tiny matrices: threads would only wait for each other
            for one in self.particles:
                rng = np.random.default_rng((self.seed, len(touches), one.maps.regions))
                particles.append(_update(rng, one, readings, self.prior, self._kept_of(one.maps.regions)))
            found = replace(self, touches=touches, particles=tuple(particles))
            while found._more_follow:
                more = found._followed(found._most_followed + 1)
                found = replace(found, particles=(*found.particles, more))
        return found

    @property
    def _most_followed(self) -> int:
        return len(self.particles) + 1

    @property
    def _more_follow(self) -> bool:
        """Maps of one more region are followed."""
        most, shares = self._most_followed, self._shares[:-1]
        enough = shares.argmax() + 1 == most or (most > FIRST_REGIONS and shares[-1] >= MORE_FROM)
        return bool(enough and most < self.most_regions)

    def _followed(self, regions: int) -> _Particles:
        """Maps of `regions` regions after all touches."""
        count, shares = 4 * self._kept_of(regions), self.prior.family_shares
        maps = _prior_maps(self.seed, regions, self.grid.size_m, count, shares)
        found = _Particles(maps, np.full(len(maps), -np.log(len(maps))), np.zeros(len(maps)), 0.0)
        for number in range(1, len(self.touches) + 1):
            rng = np.random.default_rng((self.seed, number, regions))
            readings = _readings(self.touches[:number], self.prior)
            found = _update(rng, found, readings, self.prior, self._kept_of(regions))
        return found

    @cached_property
    def _counted(self) -> tuple[_Particles, ...]:
        """The maps of `particles` that count: with four regions and more, those whose every region was touched."""
        found = list(self.particles)
        for at, met in self._met:
            weight = np.where(met == found[at].maps.regions, np.exp(found[at].log_weight), 0.0)
            if weight.any():
                with np.errstate(divide="ignore"):
                    found[at] = replace(found[at], log_weight=np.log(weight / weight.sum()))
        return tuple(found)

    @property
    def _met(self) -> list[tuple[int, IntArray]]:
        """Which of `particles` are of more than `FIRST_REGIONS`, and how many regions of each map (n,) the touches met,
        or so many."""
        xy_m = np.array([touch.xy_m for touch in self.touches])
        more = list(enumerate(self.particles))[FIRST_REGIONS - 1 :]
        felt = [(at, one.maps.shares(xy_m, self.prior.blur_m).sum(axis=1)) for at, one in more]
        return [(at, np.maximum((shares >= MET).sum(axis=1), FIRST_REGIONS)) for at, shares in felt]

    def _kept_of(self, regions: int) -> int:
        """Number of stored maps with this number of regions."""
        return self.particle_count if regions <= FIRST_REGIONS else int(MORE_SHARE * self.particle_count)

    @cached_property
    def _shares(self) -> FloatArray:
        """Probability of 1, 2 and more regions, as many as are followed or more, and of a smooth field."""
        logs = self._joint_logs
        return cast(FloatArray, np.maximum(np.exp(logs - logsumexp(logs)), 1e-9))  # nothing is certain

    @cached_property
    def probability(self) -> dict[str, float]:
        """Probability of "1", "2" and more regions and of "gradual"."""
        *shares, last, gradual = self._shares.tolist()
        rest = self._prior_shares[len(shares) :]
        shares += [last * share / sum(rest) for share in rest]
        return {str(number): share for number, share in enumerate(shares, start=1)} | {"gradual": gradual}

    @property
    def _prior_shares(self) -> list[float]:
        """Prior probability of each distinguished number of regions, the last or more."""
        every = self.prior.regions
        return [*every[: self.most_regions - 1], sum(every[self.most_regions - 1 :])]

    def with_smooth_field(self, kernel: SmoothKernel, share: float) -> tuple[tuple[SmoothField, float], ...]:
        """The fields of one more smooth hypothesis with this prior probability, and the probability of each among all
        hypotheses."""
        fields = self._fields(kernel)
        logs = np.log(share) + np.array([one.log_evidence for one in fields])
        every = np.logaddexp(logsumexp(logs), np.log1p(-share) + logsumexp(self._joint_logs))
        return tuple(zip(fields, np.exp(logs - every).tolist(), strict=True))

    @property
    def _joint_logs(self) -> FloatArray:
        """Logarithm of prior probability times evidence of 1, 2 and more regions, as many as are followed or more, and
        of a smooth field. In maps of four regions and more, those that were touched count."""
        evidence = [
            logsumexp(self._one_region[0]),
            *(one.log_evidence for one in self.particles),
            self._smooth_log_evidence,
        ]
        every = self.prior.regions
        prior = np.array([*every[: len(self.particles)], sum(every[len(self.particles) :]), self.prior.gradual])
        with np.errstate(divide="ignore"):
            logs = np.log(prior) + np.array(evidence)
            for at, met in self._met:
                some = np.bincount(met, np.exp(self.particles[at].log_weight))
                parts = logs[at + 1] + np.log(some[FIRST_REGIONS:])
                logs[at + 1] = -np.inf
                logs[FIRST_REGIONS - 1 :][: len(parts)] = np.logaddexp(logs[FIRST_REGIONS - 1 :][: len(parts)], parts)
            return cast(FloatArray, logs)

    @property
    def region_count(self) -> int:
        """The most probable number of regions, were it regions."""
        return int(np.argmax([self.probability[str(k)] for k in range(1, self.most_regions + 1)])) + 1

    @property
    def verdict(self) -> RegionMapKind:
        return "gradual" if self.probability["gradual"] > 0.5 else "regions"

    @property
    def kind(self) -> SurfaceKind:
        """The verdict, with a separate name for one region."""
        if self.verdict == "gradual":
            return "gradual"
        return "uniform" if self.region_count == 1 else "materials"

    def hypotheses(self, count: int = 300) -> RegionHypotheses:
        """About `count` maps, in proportion to the probability of their number of regions."""
        readings = _readings(self.touches, self.prior)
        one_region, level, cov = self._one_region
        share = np.exp(one_region - logsumexp(one_region))
        found: list[tuple[Partitions | None, FloatArray, FloatArray, FloatArray]] = [
            (None, level + readings.centre, cov, self.probability["1"] * share)
        ]
        scatters = [self.prior.error.scatters()[0]]
        for one, share in zip(self._counted, self._shares[1:], strict=False):
            number = int(np.ceil(count * share / max(1.0 - self.probability["gradual"], 1e-12)))
            if number > 0.01 * count or one.maps.regions == self.region_count:
                number = max(number, 20)
                maps, level, cov, scatter = self._draw(one, number, readings)
                found.append((maps, level, cov, np.full(number, share / number)))
                scatters.append(scatter)
        logs = np.array([one.log_evidence for one in self._smooth])
        weights = np.exp(logs - logs.max())
        kept = np.flatnonzero(weights > LEAST_WEIGHT * weights.sum())
        weights *= self.probability["gradual"] / weights[kept].sum()
        smooth = tuple((self._smooth[i], float(weights[i])) for i in kept)
        return RegionHypotheses(tuple(found), smooth, self.prior.forces_add, tuple(scatters))

    def region_map(self, count: int = 240) -> RegionMap:
        """The map of this posterior; `count` maps are drawn for it."""
        centres, k = self.grid.centres_m, self.region_count
        hypotheses = self.hypotheses(count)
        mean, square = np.zeros(len(centres)), np.zeros(len(centres))
        probability, (_, level, cov, shared) = np.ones((1, len(centres))), hypotheses.maps[0]
        for maps, levels, covs, weight in hypotheses.maps:
            labels = labels_of(maps, levels, centres)
            levels, covs = _sorted(levels, covs)
            variance = np.diagonal(covs, axis1=1, axis2=2)
            shares = np.stack([weight @ (labels == rank) for rank in range(levels.shape[1])])
            for rank in range(levels.shape[1]):
                here = labels == rank
                mean += (weight * levels[:, rank]) @ here
                square += (weight * (levels[:, rank] ** 2 + variance[:, rank])) @ here
            if levels.shape[1] == k:
                probability, level, cov, shared = shares / weight.sum(), levels, covs, weight
        for smooth, share in hypotheses.smooth:
            here, variance = smooth.predict(centres)
            mean += share * here
            square += share * (here**2 + variance)

        log_stiffness = mean.reshape(self.grid.shape)
        gain_variance = self.prior.error.gain_sd**2  # touches of one session cannot see it
        log_stiffness_sd = np.sqrt(np.maximum(square - mean**2, 0.0) + gain_variance).reshape(self.grid.shape)
        none = np.zeros(0)
        found = RegionMap(
            grid=self.grid,
            verdict=self.verdict,
            region_count=0,
            probability=self.probability,
            labels=np.full(self.grid.shape, -1),
            label_probability=np.full(self.grid.shape, self.probability["gradual"]),
            level=none,
            level_sd=none,
            level_interval=np.zeros((0, 2)),
            rigid=np.zeros(0, dtype=bool),
            field=log_stiffness,
            field_sd=log_stiffness_sd,
            wrong_share=np.nan,
            boundary_sd_m=np.nan,
            scatter=self.scatter,
        )
        if self.verdict == "gradual":
            return found
        rng = np.random.default_rng((self.seed, len(self.touches)))
        one = _systematic(shared, LEVELS_DRAWN, 0.5)
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2) + gain_variance)
        drawn = level[one] + sd[one] * rng.standard_normal((LEVELS_DRAWN, k))
        labels = probability.argmax(axis=0).reshape(self.grid.shape)
        mean_level = drawn.mean(axis=0)
        rigid = self._rigid_regions(labels, mean_level)
        interval = np.quantile(drawn, [0.05, 0.95], axis=0).T
        mean_level[rigid], interval[rigid] = self._rigid_bound, (self._rigid_bound, np.inf)
        right = np.minimum(probability.max(axis=0), 1.0)  # weights add up to 1 but for rounding
        wrong = float(1.0 - right.mean())
        edge_m = self.grid.cell_m * _edges(labels)
        area = self.grid.size_m[0] * self.grid.size_m[1]
        return replace(
            found,
            region_count=k,
            at_least=k == self.most_regions,
            labels=labels,
            label_probability=self.probability[str(k)] * right.reshape(self.grid.shape),
            level=mean_level,
            level_sd=drawn.std(axis=0),
            level_interval=interval,
            rigid=rigid,
            wrong_share=wrong,
            boundary_sd_m=wrong * area / edge_m if edge_m else np.nan,
        )

    @property
    def _rigid_bound(self) -> float:
        """The highest lower bound of log stiffness that rigid touches give; inf without one."""
        return max((touch.log_stiffness for touch in self.touches if touch.rigid), default=np.inf)

    def rigid_probability(self, places_m: FloatArray) -> FloatArray:
        """(p,) that places (p, 2) are as stiff as the rigid touches, whose level is at the bound."""
        if not np.isfinite(self._rigid_bound):
            return np.zeros(len(places_m))
        mean, variance, weight = self._some_hypotheses.predict(places_m, self.prior.blur_m)
        least = self._rigid_bound - RIGID_SDS * self.prior.rigid_sd
        return cast(FloatArray, weight @ ndtr((mean - least) / np.sqrt(variance)))

    @cached_property
    def _some_hypotheses(self) -> RegionHypotheses:
        return self.hypotheses()

    def _rigid_regions(self, labels: IntArray, level: FloatArray) -> BoolArray:
        """(k,) regions with a rigid touch whose level is at its bound: softer touches in them are those that a boundary
        explains."""
        rows, columns = self.grid.shape
        rigid = np.zeros(len(level), dtype=bool)
        for touch in self.touches:
            if touch.rigid:
                column, row = np.clip((touch.xy_m / self.grid.cell_m).astype(int), 0, [columns - 1, rows - 1])
                rigid[labels[row, column]] = True
        return rigid & (level > self._rigid_bound - RIGID_SDS * self.prior.rigid_sd)

    def _draw(
        self, one: _Particles, count: int, readings: _Readings
    ) -> tuple[Partitions, FloatArray, FloatArray, FloatArray]:
        """`count` maps in proportion to their weights, their levels (count, r) and covariances (count, r, r) under one
        scatter (count,) each, which is drawn in proportion to its probability given the map."""
        maps = one.maps.take(_systematic(np.exp(one.log_weight), count, 0.5))
        shares = maps.shares(readings.xy_m, self.prior.blur_m)
        logs = _by_scatter(shares, readings, self.prior)
        up_to = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
        # evenly spaced chances in an order that has nothing to do with that of the maps
        chance = (np.random.default_rng((self.seed, count)).permutation(count) + 0.5) / count
        scatter = self.prior.error.scatters()[0][np.minimum((up_to < chance).sum(axis=0), len(logs) - 1)]
        _, level, cov = _levels(shares, readings, self.prior, scatter)
        return maps, level + readings.centre, cov, scatter

    @cached_property
    def _one_region(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Under each scatter (s,): log evidence with its prior (s,), levels (s, 1), covariances (s, 1, 1)."""
        readings = _readings(self.touches, self.prior)
        scatter, prior = self.prior.error.scatters()
        log_likelihood, level, cov = _levels(
            np.ones((len(scatter), len(self.touches), 1)), readings, self.prior, scatter
        )
        return log_likelihood + np.log(prior), level, cov

    @cached_property
    def scatter(self) -> float:
        """Root mean square of the scatter of touches over the posterior, for all maps of regions and for one region."""
        readings = _readings(self.touches, self.prior)
        one_region = self._one_region[0]
        shares = [self._shares[0] * np.exp(one_region - logsumexp(one_region))]
        for one, share in zip(self._counted, self._shares[1:], strict=False):
            if share > LEAST_WEIGHT:
                maps = one.maps.take(_systematic(np.exp(one.log_weight), SCATTER_MAPS, 0.5))
                logs = _by_scatter(maps.shares(readings.xy_m, self.prior.blur_m), readings, self.prior)
                shares.append(share * np.exp(logs - logsumexp(logs, axis=0)).mean(axis=1))
        weight = np.sum(shares, axis=0)
        return float(np.sqrt(weight @ self.prior.error.scatters()[0] ** 2 / weight.sum()))

    @property
    def touch_sd(self) -> float:
        """Expected deviation of the next touch, with the noise of the touches so far."""
        known = [touch.log_sd for touch in self.touches if not touch.rigid]
        return float(np.hypot(self.scatter, np.median(known))) if known else self.prior.error.touch_sd

    def repeated(self, places_m: FloatArray, within_m: float) -> tuple[FloatArray, BoolArray]:
        """Places (p, 2) [m] of touches at places (p, 2), and which (p,) repeat an earlier touch: one that is this near
        along x and along y, and did not touch something rigid."""
        at, again = np.array(places_m, np.float64), np.zeros(len(places_m), dtype=bool)
        for touch in self.touches:
            if not touch.rigid:
                here = (np.abs(places_m - touch.xy_m) <= within_m).all(axis=1)
                at[here], again[here] = touch.xy_m, True
        return at, again

    def related(self, places_m: FloatArray) -> RelatedTouches:
        """Touches at places (p, 2) [m], given those made so far."""
        known = [touch.log_sd for touch in self.touches if not touch.rigid]
        return RelatedTouches(
            at_m=places_m,
            readings=_readings(self.touches, self.prior),
            prior=self.prior,
            own_sd=float(np.median(known)) if known else LAW_SD,
        )

    @cached_property
    def _smooth(self) -> tuple[SmoothField, ...]:
        """Smooth fields of each kernel and each scatter; their evidence includes the scatter's prior."""
        middle = 0.5 * np.asarray(self.grid.size_m)
        kernels = [(slope, 0.0, 1.0) for slope in SLOPES_PER_M]
        kernels += [(0.0, sd, length) for sd in SMOOTH_SDS for length in SMOOTH_LENGTHS_M]
        level_sd = self.prior.any_level_sd
        return tuple(field for kernel in kernels for field in self._fields(SmoothKernel(level_sd, middle, *kernel)))

    def _fields(self, kernel: SmoothKernel) -> list[SmoothField]:
        """Under each scatter."""
        readings, scatters = _readings(self.touches, self.prior), zip(*self.prior.error.scatters(), strict=True)
        return [SmoothField(readings, kernel, float(scatter), float(np.log(share))) for scatter, share in scatters]

    @property
    def _smooth_log_evidence(self) -> float:
        kernels = len(SLOPES_PER_M) + len(SMOOTH_SDS) * len(SMOOTH_LENGTHS_M)
        return float(logsumexp([one.log_evidence for one in self._smooth]) - np.log(kernels))


@dataclass(frozen=True, slots=True)
class SmoothKernel:
    """Kernel of log stiffness: a constant of deviation `level_sd`, a plane of random slope about `middle_m` (2,) [m],
    and a squared exponential part of `sd` and `length_m`."""

    level_sd: float
    middle_m: FloatArray
    slope_per_m: float
    sd: float
    length_m: float

    def covariance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(n, m) prior covariance between places (n, 2) and (m, 2)."""
        apart = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
        plane = self.slope_per_m**2 * (a - self.middle_m) @ (b - self.middle_m).T
        return cast(FloatArray, self.level_sd**2 + plane + self.sd**2 * np.exp(-0.5 * apart / self.length_m**2))


class SmoothField:
    """A Gaussian process through the touches, which scatter. log_evidence: log evidence of these hyper-parameters,
    including `log_prior`"""

    def __init__(self, readings: _Readings, kernel: SmoothKernel, scatter: float, log_prior: float) -> None:
        self.kernel, self._readings, self.scatter, self.log_evidence = kernel, readings, scatter, log_prior
        if count := len(readings.value):
            own = kernel.covariance(readings.xy_m, readings.xy_m) + np.outer(readings.arm, readings.arm)
            own += scatter**2 * readings.related + np.diag(readings.variance)
            self._factor, _ = cho_factor(own, lower=True)
            self._weight = cho_solve((self._factor, True), readings.value)
            square, logs = readings.value @ self._weight, 2.0 * np.log(np.diag(self._factor)).sum()
            self.log_evidence += float(-0.5 * (square + logs + count * np.log(2.0 * np.pi)))

    def predict(self, xy_m: FloatArray, shared: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Mean (p,) and variance (p,) of log stiffness at places (p, 2) [m]. shared: (p, t) covariance of their scatter
        with that of the touches, if the prediction includes scatter; the variance of the scatter is not included"""
        k, readings = self.kernel, self._readings
        prior = k.level_sd**2 + k.sd**2 + k.slope_per_m**2 * ((xy_m - k.middle_m) ** 2).sum(axis=1)
        if not len(readings.xy_m):
            return np.full(len(xy_m), readings.centre), prior
        cross = k.covariance(xy_m, readings.xy_m) + shared
        explained = (cross.T * cho_solve((self._factor, True), cross.T)).sum(axis=0)
        return cross @ self._weight + readings.centre, np.maximum(prior - explained, 0.0)


@lru_cache(maxsize=8)
def _prior_maps(
    seed: int, regions: int, size_m: tuple[float, float], count: int, family_shares: tuple[float, ...]
) -> Partitions:
    return draw(np.random.default_rng((seed, regions)), regions, size_m, count, family_shares)


def _readings(touches: Sequence[StiffnessSample], prior: RegionPrior) -> _Readings:
    """Rigid touches are all at the highest of their bounds: one material, as stiff as can be measured."""
    value = np.array([touch.log_stiffness for touch in touches])
    sd = np.array([touch.log_sd for touch in touches])
    arm = np.array([touch.arm_sd for touch in touches])
    rigid = np.array([touch.rigid for touch in touches], dtype=bool)
    if rigid.any():
        value = np.where(rigid, value[rigid].max(), value)
        sd, arm = np.where(rigid, prior.rigid_sd, sd), np.where(rigid, 0.0, arm)
    centre = float(value.mean()) if len(value) else 0.0
    spread = float(np.ptp(value)) if len(value) else 0.0
    xy_m = np.array([touch.xy_m for touch in touches]).reshape(-1, 2)
    return _Readings(xy_m, value - centre, sd**2, arm, prior.error.related(xy_m), centre, spread)


def _levels(
    shares: FloatArray,
    readings: _Readings,
    prior: RegionPrior,
    scatter: FloatArray | float = 0.0,
    last_noise: float = 1.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For maps with contact shares (n, t, k): log likelihood (n,), levels (n, k) over the centre, their covariance (n,
    k, k). scatter: (n,) scatter of touches, or of all maps; with one axis more, (s, n) or (s, 1), so have the results

    The touches are a linear model in the levels, whose prior is Gaussian (Bishop 2006, 3.49 and 3.86), their errors
    correlated by scatter that neighbours share and by the arm. The remaining part of the prior, for levels that differ
    enough, is counted afterwards, pair by pair.
    last_noise: factor on the variance of the last touch
    """
    count, touches, _ = shares.shape
    scatter = np.broadcast_to(scatter, np.broadcast_shapes(np.shape(scatter), (count,)))
    at_once = max(1, FACTORS_BYTES // max(1, 8 * touches**2 * math.prod(scatter.shape[:-1])))
    blocks = (slice(at, at + at_once) for at in range(0, count or 1, at_once))
    found = [_levels_of(shares[one], readings, prior, scatter[..., one], last_noise) for one in blocks]
    log_likelihood, level, cov = zip(*found, strict=True)
    return np.concatenate(log_likelihood, axis=-1), np.concatenate(level, axis=-2), np.concatenate(cov, axis=-3)


def _levels_of(
    shares: FloatArray, readings: _Readings, prior: RegionPrior, scatter: FloatArray, last_noise: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`_levels` of maps whose factors fit into memory. scatter: (n,) or (s, n)"""
    _, touches, k = shares.shape
    mixed = 2.0 * (1.0 - (shares**2).sum(axis=-1))  # 1 midway between two regions
    own = (readings.variance + (prior.mixed_share * readings.spread * mixed) ** 2).T
    square = scatter**2
    value = readings.value[:, None]
    if k > 1 and prior.forces_add:
        shares, value = _linear(shares, readings, prior, own)
    # the touches' errors made white, column by column of the Cholesky factor of their covariance; by hand, since a
    # library would solve each of thousands of small matrices by itself
    lower = np.empty((touches, touches, *square.shape))
    white = np.empty((touches, k + 1, *square.shape))
    white[:, :k] = np.expand_dims(np.moveaxis(shares, 0, -1), tuple(range(2, square.ndim + 1)))
    white[:, k] = np.expand_dims(value, tuple(range(1, square.ndim)))
    log_det = np.zeros(square.shape)
    for j in range(touches):
        shared = np.expand_dims(readings.related[j:, j], tuple(range(1, square.ndim + 1))) * square
        shared += np.expand_dims(readings.arm[j:] * readings.arm[j], tuple(range(1, square.ndim + 1)))
        shared[0] = (shared[0] + own[j]) * (last_noise if j == touches - 1 else 1.0)
        left = shared - (lower[j:, :j] * lower[j, :j]).sum(axis=1)
        lower[j:, j] = left / np.sqrt(left[0])
        log_det += np.log(left[0])
        white[j] = (white[j] - (lower[j, :j, None] * white[:j]).sum(axis=0)) / lower[j, j]
    products = [(white[:, i] * white[:, j]).sum(axis=0) for i in range(k) for j in range(i + 1)]
    pull = [(white[:, i] * white[:, k]).sum(axis=0) for i in range(k)]
    before = prior.level_sd**2 * np.eye(k) + prior.common_sd**2
    level, cov, log_det_cov = _solved(products, pull, np.linalg.inv(before))
    log_likelihood = 0.5 * (
        (np.stack(pull, axis=-1) * level).sum(axis=-1)
        + log_det_cov
        - np.linalg.slogdet(before)[1]
        - log_det
        - touches * np.log(2.0 * np.pi)
        - (white[:, k] ** 2).sum(axis=0)
    )
    at_first = 2.0 * ndtr(-prior.least_contrast / (np.sqrt(2.0) * prior.level_sd))
    for i in range(k):
        for j in range(i):
            apart = level[..., i] - level[..., j]
            sd = np.sqrt(np.maximum(cov[..., i, i] + cov[..., j, j] - 2.0 * cov[..., i, j], 1e-12))
            left = ndtr((apart - prior.least_contrast) / sd) + ndtr((-apart - prior.least_contrast) / sd)
            log_likelihood += np.log(np.maximum(left, 1e-300) / at_first)
    return log_likelihood, level, cov


def _felt(shares: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log stiffness (n, t) of contacts with shares (n, t, k) of levels (n, k): their forces add; and its derivative by
    each level (n, t, k)."""
    most = level.max(axis=1, keepdims=True)
    force = shares * np.exp(level - most)[:, None]
    total = force.sum(axis=-1)
    return np.log(total) + most, force / total[..., None]


def _linear(
    shares: FloatArray, readings: _Readings, prior: RegionPrior, own: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A contact's stiffness, linear in the levels about their approximate values: its slopes (n, t, k) and the readings
    (t, n) less its value at levels of 0. own: (t, n) variance of the touches"""
    k = shares.shape[-1]
    precision = 1.0 / (own.T + prior.error.scatter_median**2)
    before = np.linalg.inv(prior.level_sd**2 * np.eye(k) + prior.common_sd**2)
    slope, value = shares, np.broadcast_to(readings.value, shares.shape[:2])
    for _ in range(LINEARISED):
        weighted = slope * precision[..., None]
        products = [(weighted[..., i] * slope[..., j]).sum(axis=1) for i in range(k) for j in range(i + 1)]
        pull = [(weighted[..., i] * value).sum(axis=1) for i in range(k)]
        level, _, _ = _solved(products, pull, before)
        felt, slope = _felt(shares, level)
        value = readings.value - felt + (slope * level[:, None]).sum(axis=-1)
    return slope, value.T


def _solved(
    products: Sequence[FloatArray], pull: Sequence[FloatArray], prior_precision: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (..., c), covariance (..., c, c) and its log determinant (...,) of c levels. products: lower triangle of
    their precision, row by row; prior_precision: (c, c) added to it; pull: (c) their pull"""
    size = len(pull)
    lower: dict[tuple[int, int], FloatArray] = {}
    inverse: dict[tuple[int, int], FloatArray] = {}
    entry, nothing = iter(products), np.zeros(pull[0].shape)
    for i in range(size):
        for j in range(i + 1):
            rest = next(entry) + prior_precision[i, j] - sum((lower[i, m] * lower[j, m] for m in range(j)), nothing)
            lower[i, j] = np.sqrt(rest) if i == j else rest / lower[j, j]
    for j in range(size):
        inverse[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, size):
            inverse[i, j] = -sum((lower[i, m] * inverse[m, j] for m in range(j, i)), nothing) / lower[i, i]
    cov = np.empty((*nothing.shape, size, size))
    for i in range(size):
        for j in range(i + 1):
            both = sum((inverse[m, i] * inverse[m, j] for m in range(i, size)), nothing)
            cov[..., i, j] = cov[..., j, i] = both
    mean = (cov * np.stack(pull, axis=-1)[..., None, :]).sum(axis=-1)
    return mean, cov, 2.0 * sum((np.log(inverse[i, i]) for i in range(size)), nothing)


def _by_scatter(shares: FloatArray, readings: _Readings, prior: RegionPrior, last_noise: float = 1.0) -> FloatArray:
    """(s, n) log likelihood of maps under each scatter, with its prior."""
    scatter, share = prior.error.scatters()
    return _levels(shares, readings, prior, scatter[:, None], last_noise)[0] + np.log(share)[:, None]


def _log_likelihood(shares: FloatArray, readings: _Readings, prior: RegionPrior, last_noise: float = 1.0) -> FloatArray:
    """(n,) of maps, whatever the scatter."""
    logs = _by_scatter(shares, readings, prior, last_noise)
    most = logs.max(axis=0)
    return cast(FloatArray, most + np.log(np.exp(logs - most).sum(axis=0)))


def _update(
    rng: np.random.Generator, old: _Particles, readings: _Readings, prior: RegionPrior, keep: int
) -> _Particles:
    """Reweight the maps by the newest touch; where few are left, its noise is first taken as larger and the maps move
    in between (tempering, in four steps at most). keep: maps that are left once they move"""
    maps, log_weight, before, log_evidence = old.maps, old.log_weight, old.log_likelihood, old.log_evidence
    least = FEW * min(len(maps), keep) / len(maps)
    left = list(TEMPERS)
    while left:
        shares = maps.shares(readings.xy_m, prior.blur_m)
        likelihoods = ((temper, _log_likelihood(shares, readings, prior, temper)) for temper in left)
        # the first that leaves enough maps, or else the last
        temper, now = next(
            (one for one in likelihoods if _effective(log_weight + one[1] - before, maps) >= 0.25 * least),
            (left[-1], None),
        )
        if now is None:
            now = _log_likelihood(shares, readings, prior, temper)
        left = [smaller for smaller in left if smaller < temper]
        joint = log_weight + now - before
        gained = float(logsumexp(joint))
        log_evidence += gained
        log_weight, before = joint - gained, now
        if left or _effective(joint, maps) < least:
            kept, log_weight = _kept(log_weight, maps.family[:, 0], min(len(maps), keep), float(rng.random()))
            maps, before = _move(rng, maps.take(kept), now[kept], readings, prior, temper)
    return _Particles(maps, log_weight, before, log_evidence)


def _effective(log_weight: FloatArray, maps: Partitions) -> float:
    """The effective number of independent maps of weighted ones (n,), as a share (Kong 1992): family by family of the
    first curve, as they are stored, in proportion to their weights."""
    weight, family = np.exp(log_weight - log_weight.max()), maps.family[:, 0]
    each, squares = (np.bincount(family, one) for one in (weight, weight**2))
    number = np.maximum(np.bincount(family) * squares, 1e-300)
    return float((each**3 / number).sum() / each.sum())


def _kept(log_weight: FloatArray, family: IntArray, count: int, start: float) -> tuple[IntArray, FloatArray]:
    """About `count` indices (n,), and the log weight of each then: of each family in proportion to the cube root of its
    weight, and in it to its maps' weights.

    Maps that are improbable now may explain later touches. From the few maps that their weight is worth they would
    return as copies of one, with an evidence that is wrong by factors.
    """
    weight = np.exp(log_weight)
    share = np.bincount(family, weight)
    number = np.ceil(count * np.cbrt(share) / np.cbrt(share).sum()).astype(int)
    indices, logs = [], []
    for kind in np.flatnonzero(share > 0.0):
        mine = np.flatnonzero(family == kind)
        indices.append(mine[_systematic(weight[mine], number[kind], start)])
        logs.append(np.full(number[kind], np.log(share[kind] / number[kind])))
    return np.concatenate(indices), np.concatenate(logs)


def _move(
    rng: np.random.Generator,
    maps: Partitions,
    log_likelihood: FloatArray,
    readings: _Readings,
    prior: RegionPrior,
    last_noise: float,
) -> tuple[Partitions, FloatArray]:
    """Metropolis steps under the prior (`partitions.propose`), which do not change the posterior.

    Most proposals fail already under the one scatter that is most likely of all. The others are then judged under every
    scatter, by its addition (delayed acceptance, Christen and Fox 2005).
    """
    scatters, share = prior.error.scatters()
    logs = _by_scatter(maps.shares(readings.xy_m, prior.blur_m), readings, prior, last_noise)
    likeliest = int(logsumexp(logs, axis=1).argmax())
    rough = logs[likeliest]
    for _ in range(MOVES):
        proposed = propose(rng, maps)
        shares = proposed.shares(readings.xy_m, prior.blur_m)
        roughly = _levels(shares, readings, prior, scatters[likeliest], last_noise)[0] + np.log(share[likeliest])
        taken = np.log(rng.random(len(maps))) < roughly - rough
        taken[taken] = proposed.take(taken).admissible()
        now = np.where(taken, roughly, log_likelihood)
        now[taken] = _log_likelihood(shares[taken], readings, prior, last_noise)
        taken &= np.log(rng.random(len(maps))) < now - log_likelihood - (roughly - rough)
        maps = maps.instead(taken, proposed)
        log_likelihood, rough = np.where(taken, now, log_likelihood), np.where(taken, roughly, rough)
    return maps, log_likelihood


def _systematic(weight: FloatArray, count: int, start: float) -> IntArray:
    """(count,) indices, each as often as its weight says to within one."""
    return cast(
        IntArray,
        np.minimum(
            np.searchsorted(np.cumsum(weight) / weight.sum(), (np.arange(count) + start) / count), len(weight) - 1
        ),
    )


def labels_of(maps: Partitions | None, level: FloatArray, xy_m: FloatArray) -> IntArray:
    """(n, p) labels by level, of one region too, which has no maps."""
    return np.zeros((len(level), len(xy_m)), dtype=np.int8) if maps is None else ranked_labels(maps, level, xy_m)


def ranked_labels(maps: Partitions, level: FloatArray, xy_m: FloatArray) -> IntArray:
    """(n, p) labels by level: 0 is the softest."""
    rank = np.argsort(np.argsort(level, axis=1), axis=1)
    return cast(IntArray, np.take_along_axis(rank, maps.labels(xy_m).astype(np.intp), axis=1).astype(np.int8))


def _sorted(level: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Levels (n, k) from soft to stiff, covariances (n, k, k) alike."""
    order = np.argsort(level, axis=1)
    cov = np.take_along_axis(np.take_along_axis(cov, order[:, :, None], axis=1), order[:, None, :], axis=2)
    return np.take_along_axis(level, order, axis=1), cov


def _edges(labels: IntArray) -> float:
    """Number of cell sides between two labels; a slanted boundary has sqrt(2) more than its length at most, 4/pi on
    average, which is divided out."""
    sides = (labels[1:] != labels[:-1]).sum() + (labels[:, 1:] != labels[:, :-1]).sum()
    return float(sides) * np.pi / 4.0
