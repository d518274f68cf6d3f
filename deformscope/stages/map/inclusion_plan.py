"""Next touches for inclusions, and the end of the search: `explore --goal inclusions`.

While no inclusion is detected: the place whose touch most lowers the miss probability per second. For every remaining
hypothesis, the plan compares the expected reading there with that of foam alone, in standard deviations given the other
touches. With a detected inclusion: the place with the most information about it. It stops when inclusions of the
smallest and of any larger size are missed with less than `PlanOptions.missed`."""

from dataclasses import replace
from typing import cast

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.map import plan
from deformscope.stages.map.exploration import DetectionLimit
from deformscope.stages.map.inclusion_posterior import DEPTHS_M, EXISTS, TIMES, InclusionPosterior
from deformscope.stages.regions.touches import MapGrid

DETECTED = 0.6
"""Probability of an inclusion from which the next touch is chosen to identify it."""
FEWEST = 3
"""Least number of touches before the search ends."""
AT_ONCE = 64
"""Number of places that are evaluated at once, with some 50 000 inclusions each: it bounds the memory."""
LEAST_VARIANCE = 2e-5
"""Smallest variance of a reading's log: 0.4 % deviation."""


def plan_inclusion_touch(
    posterior: InclusionPosterior,
    options: plan.PlanOptions,
    *,
    tip_m: FloatArray | None = None,
    left_out_m: FloatArray | None = None,
    reachable: BoolArray | None = None,
) -> plan.TouchChoice:
    """The next touch, on cells half as wide as those of the map of gains; arguments as in `plan.plan_touch`. tip_m:
    (2,), left_out_m: (k, 2) [m]; reachable: (rows, columns) mask of the posterior's grid"""
    detected = posterior.state.exists >= DETECTED and len(posterior.touches) >= FEWEST
    gain_of = information_gain if detected else detection_probability
    if tip_m is None and left_out_m is not None and len(left_out_m):
        tip_m = left_out_m[-1]
    planned = plan.PlannedPlaces(
        posterior, replace(options, apart_m=0.75 * options.cell_m), tip_m, left_out_m, reachable
    )
    circle = plan.largest_circle(posterior.grid, planned.made_m)
    radii, missed = np.array(posterior.radii_m), posterior.missed
    limit = DetectionLimit(*circle, radii, missed, contrast=TIMES[0], prior=EXISTS, deepest_m=max(DEPTHS_M))

    def gains(places: FloatArray, allowed: BoolArray) -> FloatArray:
        """(p,) gain of touches at places (p, 2); NaN where they are not allowed."""
        found = np.full(len(places), np.nan)
        if allowed.any():
            some = np.array_split(places[allowed], -(-int(allowed.sum()) // AT_ONCE))
            found[allowed] = np.concatenate([gain_of(posterior, one) for one in some])
        return found

    gain = gains(planned.grid.centres_m, planned.allowed)
    stop = planned.ended(options)
    if stop is None and len(posterior.touches) >= FEWEST and posterior.missed_smallest < options.missed:
        stop = "no lump missed"
    unit = "nat" if detected else "probability"
    choice = planned.choice(limit, gain, unit, gain / planned.cost_s, stop, lambda best: "")
    if choice.target_m is None or stop is not None:
        return choice
    finer = MapGrid(posterior.grid.size_m, 0.5 * options.cell_m)
    near = np.abs(finer.centres_m - choice.target_m).max(axis=1) < 0.8 * options.cell_m
    around = np.vstack([choice.target_m, finer.centres_m[near]])
    apart = replace(options, apart_m=0.75 * finer.cell_m)
    worth = gains(around, plan.exclusions(around, planned.made_m, posterior.grid, reachable, apart) == plan.ALLOWED)
    takes = plan.touch_seconds(around, planned.tip_m, options)
    best = int(np.nanargmax(worth / takes))
    reason = _why(posterior, detected, float(worth[best]), float(takes[best]))
    return replace(choice, target_m=around[best], reason=reason)


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
    here, left = posterior.hypotheses.shifts(places_m, posterior.contact_m), posterior.state.left
    apart = (here.log - weights @ posterior.shifts.log) / np.sqrt(variance + LEAST_VARIANCE)[:, None]
    earlier = posterior.shifts.exponent.mean(axis=0) if len(posterior.touches) else 0.0
    return apart, (here.exponent - earlier) / left.bent_sd


def _why(posterior: InclusionPosterior, detected: bool, gain: float, cost_s: float) -> str:
    """Why here, in words."""
    smallest = f"an inclusion of {100 * posterior.prior.smallest_m:g} cm radius or more"
    unseen = f"{smallest} is missed with a probability of {posterior.missed_smallest:.0%}"
    if detected:
        there = f"probability that there is one more: {posterior.state.exists:.0%}"
        return f"locates an inclusion best (by {gain:.2g} nat), takes {cost_s:.0f} s; {there}"
    return f"shows an inclusion with a probability of {gain:.1%}, takes {cost_s:.0f} s; {unseen}"
