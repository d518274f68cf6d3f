"""Next touches for inclusions, and the end of the search: `explore --goal inclusions`.

While no inclusion is detected: the place whose touch most lowers the miss probability per second. For every remaining
hypothesis, the plan compares the expected reading there with that of foam alone, in standard deviations given the other
touches. With a detected inclusion: the place with the most information about it. It stops when inclusions of the
smallest and of any larger size are missed with less than `PlanOptions.missed`."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from scipy.spatial import KDTree

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.map.exploration import DetectionLimit
from deformscope.stages.map.inclusion_posterior import DEPTHS_M, EXISTS, TIMES, InclusionPosterior
from deformscope.stages.map.plan import ALLOWED, PlanOptions, StopReason, TouchChoice, exclusions
from deformscope.stages.regions.touches import MapGrid

FELT = 0.6
"""Probability of an inclusion from which the next touch is chosen to identify it."""
FEWEST = 3
"""Least number of touches before the search ends."""
AT_ONCE = 64
"""Number of places that are evaluated at once, with some 50 000 inclusions each: it bounds the memory."""
LEAST_VARIANCE = 2e-5
"""Smallest variance of a reading's log: 0.4 % deviation."""


def plan_inclusion_touch(
    posterior: InclusionPosterior,
    options: PlanOptions,
    *,
    tip_m: FloatArray | None = None,
    left_out_m: FloatArray | None = None,
    reachable: BoolArray | None = None,
) -> TouchChoice:
    """The next touch, on cells half as wide as those of the map of gains; arguments as in `plan.plan_touch`. tip_m:
    (2,), left_out_m: (k, 2) [m]; reachable: (rows, columns) mask of the posterior's grid"""
    grid = MapGrid(posterior.grid.size_m, options.cell_m)
    places = grid.centres_m
    made = posterior.places_m if left_out_m is None else np.concatenate([posterior.places_m, left_out_m])
    tip = tip_m if tip_m is not None else made[-1] if len(made) else np.zeros(2)
    felt = posterior.state.exists >= FELT and len(posterior.touches) >= FEWEST

    def weighed(places: FloatArray, cell_m: float) -> tuple[IntArray, FloatArray, FloatArray]:
        excluded = exclusions(places, made, posterior.grid, reachable, replace(options, apart_m=0.75 * cell_m))
        allowed, gain = excluded == ALLOWED, np.full(len(places), np.nan)
        if allowed.any():
            some = np.array_split(places[allowed], -(-int(allowed.sum()) // AT_ONCE))
            gain[allowed] = np.concatenate(
                [(information_gain if felt else detection_probability)(posterior, one) for one in some]
            )
        return excluded, gain, options.touch_s + np.hypot(*(places - tip).T) / options.speed_m_s

    missed = _detection_limit(posterior, made)
    excluded, gain, cost = weighed(places, options.cell_m)
    allowed = excluded == ALLOWED
    stop = _stop(posterior, options, len(made), allowed)
    target, reason = None, f"stopped: {stop}"
    if allowed.any():
        target = places[int(np.nanargmax(gain / cost))]
    if target is not None and stop is None:
        finer = MapGrid(posterior.grid.size_m, 0.5 * options.cell_m)
        near = np.abs(finer.centres_m - target).max(axis=1) < 0.8 * options.cell_m
        around = np.vstack([target, finer.centres_m[near]])
        _, worth, takes = weighed(around, finer.cell_m)
        best = int(np.nanargmax(worth / takes))
        target, reason = around[best], _why(posterior, felt, float(worth[best]), float(takes[best]))
    shape = grid.shape
    return TouchChoice(
        grid=grid,
        target_m=target,
        stop=stop,
        gain=gain.reshape(shape),
        unit="nat" if felt else "probability",
        cost_s=cost.reshape(shape),
        excluded=excluded.reshape(shape),
        reason=reason,
        missed=missed,
    )


def detection_probability(posterior: InclusionPosterior, places_m: FloatArray) -> FloatArray:
    """(p,) probability that touches at places (p, 2) are the first to show an inclusion of the size that is most likely
    missed."""
    radii = np.array(posterior.radii_m)
    worst = radii[int(np.where(radii >= posterior.prior.smallest_m, posterior.missed, -1.0).argmax())]
    weight = np.where(posterior.hypotheses.radius_m == worst, posterior.state.posterior, 0.0)
    weight = posterior.missed_smallest * weight / max(float(weight.sum()), 1e-300)
    apart2 = sum(one**2 for one in _readings(posterior, places_m))
    return cast(FloatArray, -np.expm1(-0.5 * apart2) @ weight)


def information_gain(posterior: InclusionPosterior, places_m: FloatArray) -> FloatArray:
    """(p,) approximate information [nats] of touches at places (p, 2) about which inclusion there is, if any."""
    state = posterior.state
    weight = state.exists * state.posterior
    spread = sum(one**2 @ weight - (one @ weight) ** 2 for one in _readings(posterior, places_m))
    return cast(FloatArray, 0.5 * np.log1p(np.maximum(spread, 0.0)))


def _readings(posterior: InclusionPosterior, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(p, j), (p, j) expected change of stiffness and exponent of a touch at places (p, 2) by each inclusion, beyond
    its effect on the earlier ones, in standard deviations."""
    weights, variance = posterior.kriging(places_m)
    felt, left = posterior.hypotheses.shifts(places_m, posterior.contact_m), posterior.state.left
    apart = (felt.log - weights @ posterior.felt.log) / np.sqrt(variance + LEAST_VARIANCE)[:, None]
    earlier = posterior.felt.exponent.mean(axis=0) if len(posterior.touches) else 0.0
    return apart, (felt.exponent - earlier) / left.bent_sd


def _stop(posterior: InclusionPosterior, options: PlanOptions, made: int, allowed: BoolArray) -> StopReason | None:
    if made >= options.budget:
        return "budget"
    if not allowed.any():
        return "nowhere to go"
    if len(posterior.touches) >= FEWEST and posterior.missed_smallest < options.missed:
        return "no lump missed"
    return None


def _detection_limit(posterior: InclusionPosterior, made_m: FloatArray) -> DetectionLimit:
    size, centres = np.asarray(posterior.grid.size_m), posterior.grid.centres_m
    circle = np.minimum(centres, size - centres).min(axis=1)
    if len(made_m):
        circle = np.minimum(circle, KDTree(made_m).query(centres)[0])
    at = int(circle.argmax())
    radii = np.array(posterior.radii_m)
    return DetectionLimit(
        untouched_m=float(circle[at]),
        untouched_at_m=centres[at],
        lump_radius_m=radii,
        lump_probability=posterior.missed,
        contrast=TIMES[0],
        prior=EXISTS,
        deepest_m=max(DEPTHS_M),
    )


def _why(posterior: InclusionPosterior, felt: bool, gain: float, cost_s: float) -> str:
    """Why here, in words."""
    smallest = f"an inclusion of {100 * posterior.prior.smallest_m:g} cm radius or more"
    unseen = f"{smallest} is missed with a probability of {posterior.missed_smallest:.0%}"
    if felt:
        there = f"probability that there is one more: {posterior.state.exists:.0%}"
        return f"locates an inclusion best (by {gain:.2g} nat), takes {cost_s:.0f} s; {there}"
    return f"shows an inclusion with a probability of {gain:.1%}, takes {cost_s:.0f} s; {unseen}"
