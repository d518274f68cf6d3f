"""Weighted maps that touches reweight, and that move when few are left (iterated importance sampling, Chopin 2002)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from scipy.special import logsumexp

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.regions import levels
from deformscope.stages.regions.levels import Readings, RegionPrior
from deformscope.stages.regions.partitions import Partitions, draw, propose

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
        likelihoods = ((temper, levels.log_likelihood_of(shares, readings, prior, temper)) for temper in left)
        # the first that leaves enough maps, or else the last
        temper, now = next(
            (one for one in likelihoods if _effective_share(log_weight + one[1] - before, maps) >= 0.25 * least),
            (left[-1], None),
        )
        if now is None:
            now = levels.log_likelihood_of(shares, readings, prior, temper)
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
    logs = levels.log_likelihood_by_scatter(maps.shares(readings.xy_m, prior.blur_m), readings, prior, last_noise)
    likeliest = int(logsumexp(logs, axis=1).argmax())
    rough = logs[likeliest]
    for _ in range(MOVES):
        proposed = propose(rng, maps)
        shares = proposed.shares(readings.xy_m, prior.blur_m)
        roughly = levels.levels_of(shares, readings, prior, scatters[likeliest], last_noise)[0] + np.log(
            share[likeliest]
        )
        taken = np.log(rng.random(len(maps))) < roughly - rough
        taken[taken] = proposed.take(taken).admissible()
        now = np.where(taken, roughly, log_likelihood)
        now[taken] = levels.log_likelihood_of(shares[taken], readings, prior, last_noise)
        taken &= np.log(rng.random(len(maps))) < now - log_likelihood - (roughly - rough)
        maps = maps.instead(taken, proposed)
        log_likelihood, rough = np.where(taken, now, log_likelihood), np.where(taken, roughly, rough)
    return maps, log_likelihood


def systematic(weight: FloatArray, count: int, start: float) -> IntArray:
    """(count,) indices, each as often as its weight says to within one."""
    found = np.searchsorted(np.cumsum(weight) / weight.sum(), (np.arange(count) + start) / count)
    return cast(IntArray, np.minimum(found, len(weight) - 1))
