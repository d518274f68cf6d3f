"""The regions of equal stiffness of a surface, from a few touches: a posterior over maps (Bayes).

A map divides the surface into one to five regions (`partitions`), each with one level of log stiffness. A touch
averages the regions under its contact, whose forces add, plus its errors (`touches`). Given a map and the scatter
of touches the levels are integrated in closed form (a contact's stiffness is linear in them about their approximate
values), and summed over the scatter. The maps are particles that every touch reweights and that move under the prior
when few are left (iterated batch importance sampling, Chopin 2002). This also gives their evidence, which determines
the number of regions. Four are followed once three are the most likely, five once four have some probability; until
then they count as explaining the touches as well as the largest number that is followed. A map of more than three
regions counts by those that a touch lies in: a further one with hardly any effect would cost no evidence. A surface
whose stiffness changes smoothly is the rival hypothesis (`smooth`); where it wins, the verdict is "gradual"."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal, cast

import numpy as np
from scipy.special import logsumexp, ndtr
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.regions.hypotheses import RegionHypotheses, RelatedTouches, SmoothField, SmoothKernel
from deformscope.stages.regions.levels import (
    Readings,
    RegionPrior,
    labels_of,
    levels_of,
    log_likelihood_by_scatter,
    log_likelihood_of,
    readings_of,
    sorted_levels,
)
from deformscope.stages.regions.partitions import Partitions, draw, propose
from deformscope.stages.regions.touches import FIRST_REGIONS, LAW_SD, MapGrid, StiffnessSample

MOVES = 40
TEMPERS = (1.0, 4.0, 16.0, 64.0, 256.0)
"""Factors on the variance of the newest touch: the first that leaves enough maps is taken, then smaller ones."""
MOVE_BELOW = 0.3
"""Effective number of maps, as a share of their number, below which they are resampled and moved."""


@dataclass(frozen=True, slots=True)
class WeightedMaps:
    """Weighted maps of one number of regions. log_weight: (n,) normalised; log_likelihood: (n,) by all touches"""

    maps: Partitions
    log_weight: FloatArray
    log_likelihood: FloatArray
    log_evidence: float


@lru_cache(maxsize=8)
def prior_maps(
    seed: int, regions: int, size_m: tuple[float, float], count: int, family_shares: tuple[float, ...]
) -> Partitions:
    return draw(np.random.default_rng((seed, regions)), regions, size_m, count, family_shares)


def updated(
    rng: np.random.Generator, old: WeightedMaps, readings: Readings, prior: RegionPrior, keep: int
) -> WeightedMaps:
    """Reweight the maps by the newest touch; where few are left, its noise is first taken as larger and the maps move
    in between (tempering, in four steps at most). keep: maps that are left once they move"""
    maps, log_weight, before, log_evidence = old.maps, old.log_weight, old.log_likelihood, old.log_evidence
    least = MOVE_BELOW * min(len(maps), keep) / len(maps)
    left = list(TEMPERS)
    while left:
        shares = maps.shares(readings.xy_m, prior.blur_m)
        likelihoods = ((temper, log_likelihood_of(shares, readings, prior, temper)) for temper in left)
        # the first that leaves enough maps, or else the last
        temper, now = next(
            (one for one in likelihoods if _effective_share(log_weight + one[1] - before, maps) >= 0.25 * least),
            (left[-1], None),
        )
        if now is None:
            now = log_likelihood_of(shares, readings, prior, temper)
        left = [smaller for smaller in left if smaller < temper]
        joint = log_weight + now - before
        gained = float(logsumexp(joint))
        log_evidence += gained
        log_weight, before = joint - gained, now
        if left or _effective_share(joint, maps) < least:
            kept, log_weight = resampled(log_weight, maps.family[:, 0], min(len(maps), keep), float(rng.random()))
            maps, before = _moved(rng, maps.take(kept), now[kept], readings, prior, temper)
    return WeightedMaps(maps, log_weight, before, log_evidence)


def _effective_share(log_weight: FloatArray, maps: Partitions) -> float:
    """The effective number of independent maps of weighted ones (n,), as a share (Kong 1992): family by family of the
    first curve, as they are stored, in proportion to their weights."""
    weight, family = np.exp(log_weight - log_weight.max()), maps.family[:, 0]
    each, squares = (np.bincount(family, one) for one in (weight, weight**2))
    number = np.maximum(np.bincount(family) * squares, 1e-300)
    return float((each**3 / number).sum() / each.sum())


def resampled(log_weight: FloatArray, family: IntArray, count: int, start: float) -> tuple[IntArray, FloatArray]:
    """About `count` indices (n,), and the log weight of each then: of each family in proportion to the cube root of its
    weight, and in it to its maps' weights.

    Maps that are improbable now may explain later touches. From the few maps that their weight is worth they would
    return as copies of one, with an evidence that is wrong by factors."""
    weight = np.exp(log_weight)
    share = np.bincount(family, weight)
    number = np.ceil(count * np.cbrt(share) / np.cbrt(share).sum()).astype(int)
    indices, logs = [], []
    for kind in np.flatnonzero(share > 0.0):
        mine = np.flatnonzero(family == kind)
        indices.append(mine[systematic(weight[mine], number[kind], start)])
        logs.append(np.full(number[kind], np.log(share[kind] / number[kind])))
    return np.concatenate(indices), np.concatenate(logs)


def _moved(
    rng: np.random.Generator,
    maps: Partitions,
    log_likelihood: FloatArray,
    readings: Readings,
    prior: RegionPrior,
    last_noise: float,
) -> tuple[Partitions, FloatArray]:
    """Metropolis steps under the prior (`partitions.propose`), which do not change the posterior.

    Most proposals fail already under the one scatter that is most likely of all. The others are then judged under every
    scatter, by its addition (delayed acceptance, Christen and Fox 2005)."""
    scatters, share = prior.error.scatters()
    logs = log_likelihood_by_scatter(maps.shares(readings.xy_m, prior.blur_m), readings, prior, last_noise)
    likeliest = int(logsumexp(logs, axis=1).argmax())
    rough = logs[likeliest]
    for _ in range(MOVES):
        proposed = propose(rng, maps)
        shares = proposed.shares(readings.xy_m, prior.blur_m)
        roughly = levels_of(shares, readings, prior, scatters[likeliest], last_noise)[0] + np.log(share[likeliest])
        taken = np.log(rng.random(len(maps))) < roughly - rough
        taken[taken] = proposed.take(taken).admissible()
        now = np.where(taken, roughly, log_likelihood)
        now[taken] = log_likelihood_of(shares[taken], readings, prior, last_noise)
        taken &= np.log(rng.random(len(maps))) < now - log_likelihood - (roughly - rough)
        maps = maps.instead(taken, proposed)
        log_likelihood, rough = np.where(taken, now, log_likelihood), np.where(taken, roughly, rough)
    return maps, log_likelihood


def systematic(weight: FloatArray, count: int, start: float) -> IntArray:
    """(count,) indices, each as often as its weight says to within one."""
    found = np.searchsorted(np.cumsum(weight) / weight.sum(), (np.arange(count) + start) / count)
    return cast(IntArray, np.minimum(found, len(weight) - 1))


RegionMapKind = Literal["regions", "gradual"]
SurfaceKind = Literal["uniform", "materials", "gradual"]
"""The kinds of surface, with a separate name for one region."""
MOST_REGIONS = 5
"""Largest distinguished number: it means this number or more."""
MORE_SHARE = 0.5
"""Number of maps of four and more regions, as a share of the number of others: fewer maps save time."""
MORE_FROM = 0.2
"""Probability of four from which five are followed."""
TOUCHED_FROM = 0.5
"""Number of touches in a region from which it counts as touched."""
SMOOTH_LENGTHS_M = (0.2, 0.35, 0.6)
SMOOTH_SDS = (0.25, 0.6)
SLOPES_PER_M = (1.0, 3.0)
"""Slopes of log stiffness: how smooth fields may vary; each combination has the same prior probability."""
PRIOR_EXTENT_M, PRIOR_MARGIN_M = 0.5, 0.05
"""Distances of places, and from the border, are scaled to this size: that of the priors on shapes, 0.6 m."""
RIGID_SDS = 2.0
"""Levels within this many deviations below the bound of rigid touches count as rigid."""
MAPS_SHOWN = 240
SCATTER_MAPS = 100
"""Number of maps from which the scatter is computed."""
LEVELS_DRAWN = 4000
"""Number of drawn levels from which intervals are computed."""
LEAST_WEIGHT = 1e-3
"""Smallest weight among all smooth fields: one with less is left out."""


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
    wrong_share: share of the surface that is expected to have a wrong label, given k; nan without regions"""

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
    scatter: float = np.nan
    at_least: bool = False

    @property
    def more_possible(self) -> bool:
        """Whether there may be more regions: three and more are not distinguished reliably (`studies regions`)."""
        return self.region_count >= FIRST_REGIONS

    @property
    def claimed(self) -> float:
        """Probability of the verdict and `region_count`; of as many or more where that is possible."""
        return claimed_share(self.probability, self.region_count)


def claimed_share(probability: dict[str, float], regions: int) -> float:
    """Probability of this number of regions, or more where they are not distinguished; 0 = gradual"""
    if regions >= FIRST_REGIONS:
        return sum(share for number, share in probability.items() if number.isdigit() and int(number) >= regions)
    return probability[str(regions or "gradual")]


@dataclass(frozen=True)
class RegionPosterior:
    """The probability of every map after some touches; `with_touch` gives the next, repeatably.

    particles: number of particles of 2, 3 and more regions; most_regions: largest number that is distinguished"""

    grid: MapGrid
    prior: RegionPrior
    touches: tuple[StiffnessSample, ...]
    particles: tuple[WeightedMaps, ...]
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
    ) -> "RegionPosterior":
        """The posterior before any touch. particle_count: maps for each number of regions, four times as many first"""
        if particle_count < 50:
            raise InputError("50 particles or more", f"{particle_count}")
        nothing = cls(grid, prior or RegionPrior(), (), (), particle_count, seed, most_regions)
        return replace(nothing, particles=tuple(nothing._followed(k) for k in range(2, FIRST_REGIONS + 1)))

    def with_touch(self, touch: StiffnessSample) -> "RegionPosterior":
        """The posterior after one more touch."""
        touches = (*self.touches, touch)
        readings = readings_of(touches, self.prior)
        particles = []
        with threadpool_limits(1):  # thousands of tiny matrices: threads would only wait for each other
            for one in self.particles:
                rng = np.random.default_rng((self.seed, len(touches), one.maps.regions))
                particles.append(updated(rng, one, readings, self.prior, self._map_count(one.maps.regions)))
            found = replace(self, touches=touches, particles=tuple(particles))
            while found._more_follow:
                more = found._followed(len(found.particles) + 2)
                found = replace(found, particles=(*found.particles, more))
        return found

    @property
    def _more_follow(self) -> bool:
        """Maps of one more region are followed."""
        most, shares = len(self.particles) + 1, self._shares[:-1]
        enough = shares.argmax() + 1 == most or (most > FIRST_REGIONS and shares[-1] >= MORE_FROM)
        return bool(enough and most < self.most_regions)

    def _followed(self, regions: int) -> WeightedMaps:
        """Maps of `regions` regions after all touches."""
        count, shares = 4 * self._map_count(regions), self.prior.family_shares
        maps = prior_maps(self.seed, regions, self.grid.size_m, count, shares)
        found = WeightedMaps(maps, np.full(len(maps), -np.log(len(maps))), np.zeros(len(maps)), 0.0)
        for number in range(1, len(self.touches) + 1):
            rng = np.random.default_rng((self.seed, number, regions))
            readings = readings_of(self.touches[:number], self.prior)
            found = updated(rng, found, readings, self.prior, self._map_count(regions))
        return found

    @cached_property
    def _counted(self) -> tuple[WeightedMaps, ...]:
        """The maps of `particles` that count: with four regions and more, those whose every region was touched."""
        found = list(self.particles)
        for at, touched in self._touched_regions:
            weight = np.where(touched == found[at].maps.regions, np.exp(found[at].log_weight), 0.0)
            if weight.any():
                with np.errstate(divide="ignore"):
                    found[at] = replace(found[at], log_weight=np.log(weight / weight.sum()))
        return tuple(found)

    @property
    def _touched_regions(self) -> list[tuple[int, IntArray]]:
        """Indices of the `particles` of more than `FIRST_REGIONS`, and for each map (n,) the number of its regions that
        touches lie in, at least `FIRST_REGIONS`."""
        xy_m = np.array([touch.xy_m for touch in self.touches])
        more = list(enumerate(self.particles))[FIRST_REGIONS - 1 :]
        shares = [(at, one.maps.shares(xy_m, self.prior.blur_m).sum(axis=1)) for at, one in more]
        return [(at, np.maximum((one >= TOUCHED_FROM).sum(axis=1), FIRST_REGIONS)) for at, one in shares]

    def _map_count(self, regions: int) -> int:
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
        every = self.prior.regions
        rest = [*every[: self.most_regions - 1], sum(every[self.most_regions - 1 :])][len(shares) :]
        shares += [last * share / sum(rest) for share in rest]
        return {str(number): share for number, share in enumerate(shares, start=1)} | {"gradual": gradual}

    def with_smooth_field(self, kernel: SmoothKernel, share: float) -> tuple[tuple[SmoothField, float], ...]:
        """The fields of one more smooth hypothesis of this prior probability, and each one's probability among all."""
        fields = self._fields(kernel)
        logs = np.log(share) + np.array([one.log_evidence for one in fields])
        every = np.logaddexp(logsumexp(logs), np.log1p(-share) + logsumexp(self._joint_logs))
        return tuple(zip(fields, np.exp(logs - every).tolist(), strict=True))

    @property
    def _joint_logs(self) -> FloatArray:
        """Logarithm of prior probability times evidence of 1, 2 and more regions, as many as are followed or more, and
        of a smooth field. In maps of four regions and more, those that were touched count."""
        kernels = len(SLOPES_PER_M) + len(SMOOTH_SDS) * len(SMOOTH_LENGTHS_M)
        evidence = [
            logsumexp(self._one_region[0]),
            *(one.log_evidence for one in self.particles),
            float(logsumexp([one.log_evidence for one in self._smooth]) - np.log(kernels)),
        ]
        every = self.prior.regions
        prior = np.array([*every[: len(self.particles)], sum(every[len(self.particles) :]), self.prior.gradual])
        with np.errstate(divide="ignore"):
            logs = np.log(prior) + np.array(evidence)
            for at, touched in self._touched_regions:
                some = np.bincount(touched, np.exp(self.particles[at].log_weight))
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
        """ "gradual" where that is likelier than the most probable number of regions, as it would be reported."""
        regions = claimed_share(self.probability, self.region_count)
        return "gradual" if self.probability["gradual"] > regions else "regions"

    @property
    def kind(self) -> SurfaceKind:
        """The verdict, with a separate name for one region."""
        if self.verdict == "gradual":
            return "gradual"
        return "uniform" if self.region_count == 1 else "materials"

    def hypotheses(self, count: int = 300) -> RegionHypotheses:
        """About `count` maps, in proportion to the probability of their number of regions."""
        readings = readings_of(self.touches, self.prior)
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

    def region_map(self) -> RegionMap:
        """The map of this posterior; `MAPS_SHOWN` maps are drawn for it."""
        centres, k = self.grid.centres_m, self.region_count
        hypotheses = self.hypotheses(MAPS_SHOWN)
        mean, square = np.zeros(len(centres)), np.zeros(len(centres))
        probability, (_, level, cov, shared) = np.ones((1, len(centres))), hypotheses.maps[0]
        for maps, levels, covs, weight in hypotheses.maps:
            labels = labels_of(maps, levels, centres)
            levels, covs = sorted_levels(levels, covs)
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
            scatter=self.scatter,
        )
        if self.verdict == "gradual":
            return found
        rng = np.random.default_rng((self.seed, len(self.touches)))
        one = systematic(shared, LEVELS_DRAWN, 0.5)
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2) + gain_variance)
        drawn = level[one] + sd[one] * rng.standard_normal((LEVELS_DRAWN, k))
        labels = probability.argmax(axis=0).reshape(self.grid.shape)
        mean_level = drawn.mean(axis=0)
        # with a rigid touch and a level at its bound: a boundary explains softer touches in them
        rigid = np.zeros(k, dtype=bool)
        for touch in self.touches:
            if touch.rigid:
                column, row = np.clip((touch.xy_m / self.grid.cell_m).astype(int), 0, np.array(labels.shape)[::-1] - 1)
                rigid[labels[row, column]] = True
        rigid &= mean_level > self._rigid_bound - RIGID_SDS * self.prior.rigid_sd
        interval = np.quantile(drawn, [0.05, 0.95], axis=0).T
        mean_level[rigid], interval[rigid] = self._rigid_bound, (self._rigid_bound, np.inf)
        right = np.minimum(probability.max(axis=0), 1.0)  # weights add up to 1 but for rounding
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
            wrong_share=float(1.0 - right.mean()),
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

    def _draw(
        self, one: WeightedMaps, count: int, readings: Readings
    ) -> tuple[Partitions, FloatArray, FloatArray, FloatArray]:
        """`count` maps in proportion to their weights, their levels (count, r) and covariances (count, r, r) under one
        scatter (count,) each, which is drawn in proportion to its probability given the map."""
        maps = one.maps.take(systematic(np.exp(one.log_weight), count, 0.5))
        shares = maps.shares(readings.xy_m, self.prior.blur_m)
        logs = log_likelihood_by_scatter(shares, readings, self.prior)
        up_to = np.cumsum(np.exp(logs - logsumexp(logs, axis=0)), axis=0)
        # evenly spaced chances in an order that has nothing to do with that of the maps
        chance = (np.random.default_rng((self.seed, count)).permutation(count) + 0.5) / count
        scatter = self.prior.error.scatters()[0][np.minimum((up_to < chance).sum(axis=0), len(logs) - 1)]
        _, level, cov = levels_of(shares, readings, self.prior, scatter)
        return maps, level + readings.centre, cov, scatter

    @cached_property
    def _one_region(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Under each scatter (s,): log evidence with its prior (s,), levels (s, 1), covariances (s, 1, 1)."""
        readings = readings_of(self.touches, self.prior)
        scatter, prior = self.prior.error.scatters()
        shares = np.ones((len(scatter), len(self.touches), 1))
        log_likelihood, level, cov = levels_of(shares, readings, self.prior, scatter)
        return log_likelihood + np.log(prior), level, cov

    @cached_property
    def scatter(self) -> float:
        """Root mean square of the scatter of touches over the posterior, for all maps of regions and for one region."""
        readings = readings_of(self.touches, self.prior)
        one_region = self._one_region[0]
        shares = [self._shares[0] * np.exp(one_region - logsumexp(one_region))]
        for one, share in zip(self._counted, self._shares[1:], strict=False):
            if share > LEAST_WEIGHT:
                maps = one.maps.take(systematic(np.exp(one.log_weight), SCATTER_MAPS, 0.5))
                logs = log_likelihood_by_scatter(maps.shares(readings.xy_m, self.prior.blur_m), readings, self.prior)
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
        own_sd = float(np.median(known)) if known else LAW_SD
        return RelatedTouches(places_m, readings_of(self.touches, self.prior), self.prior, own_sd)

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
        readings, scatters = readings_of(self.touches, self.prior), zip(*self.prior.error.scatters(), strict=True)
        return [SmoothField(readings, kernel, float(scatter), float(np.log(share))) for scatter, share in scatters]
