"""The next touch, and its reason: the expected information of each place, the cost of travel, and excluded places.

Touches fill the space first, where the mean variance of a field drops the most (active learning Cohn, 1996). Then those
follow that are expected to correct most of the map's labels per second. They show the course of borders, or an
inclusion that the map lacks (`detection_limit`), or repeat an uncertain touch. `inclusion_plan` has other rules.

An inclusion that the map lacks is a disc of some radius, twice as stiff or twice as soft as its surroundings. Its
centre may be anywhere with equal probability, if the whole inclusion is below the surface. The touches are taken to
read as the map explains them: the likelihood of an inclusion at a place follows from its effect on them (its share
under a contact, as with any region), in standard deviations of them. Therefore a touch inside excludes it, and a touch
at its rim does not. Rigid parts have none: twice as stiff or as soft is as rigid to the arm, and no touch there would
show one."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal, cast

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.special import ndtr, ndtri, xlogy
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import gaussian_between
from deformscope.stages.map.exploration import DetectionLimit
from deformscope.stages.map.inclusion_posterior import InclusionPosterior
from deformscope.stages.regions.hypotheses import Expected, RegionHypotheses, RelatedTouches
from deformscope.stages.regions.levels import labels_of
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid, TouchErrorModel

INCLUSION_PRIOR = 0.5
"""Probability before any touch that there is an inclusion: as likely as not."""

INCLUSION_CONTRAST = 2.0
"""Ratio of the apparent stiffness to that of the surroundings, or its inverse."""

INCLUSION_RADII_M = (0.03, 0.045, 0.06, 0.085, 0.12)
"""Radii of the reported detection limit."""

CENTRE_CELL_M = 0.02


class UnseenInclusions:
    """Undetected inclusions of one radius, after the touches.

    probability: probability that there is one; weight: (c,) probability of each centre, 1 in total"""

    def __init__(self, posterior: RegionPosterior, radius_m: float) -> None:
        self._radius_m, self._blur_m, self._noise_sd = radius_m, posterior.prior.blur_m, posterior.touch_sd
        size = np.asarray(posterior.grid.size_m)
        centres = MapGrid(posterior.grid.size_m, CENTRE_CELL_M).centres_m
        self._centres = centres[(np.minimum(centres, size - centres) >= radius_m).all(axis=1)]
        self.weight = np.full(len(self._centres), 1.0 / max(len(self._centres), 1))
        self.probability = INCLUSION_PRIOR if len(self._centres) else 0.0
        if not len(self._centres) or not posterior.touches:
            return
        places = np.array([touch.xy_m for touch in posterior.touches])
        own = [posterior.prior.rigid_sd if touch.rigid else touch.log_sd for touch in posterior.touches]
        ratio = np.prod(self._unseen(places, np.hypot(own, posterior.scatter)[:, None]), axis=0)
        soft = 1.0 - posterior.rigid_probability(self._centres)
        ratio *= soft
        unseen = float(ratio.sum() / max(soft.sum(), 1.0))  # less than one centre is no place
        self.weight = ratio / max(float(ratio.sum()), 1e-300)  # so many touches may leave nothing at all
        self.probability = INCLUSION_PRIOR * unseen / (INCLUSION_PRIOR * unseen + 1.0 - INCLUSION_PRIOR)

    def gain(self, places_m: FloatArray) -> FloatArray:
        """(p,) probability that a touch at places (p, 2) is the first to show an inclusion."""
        return cast(FloatArray, self.probability * (1.0 - self._unseen(places_m, self._noise_sd)) @ self.weight)

    def _unseen(self, places_m: FloatArray, sd: FloatArray | float) -> FloatArray:
        """(p, c) how likely touches at places (p, 2) are to read as without an inclusion at each centre, if it is
        there."""
        share = ndtr((self._radius_m - cdist(places_m, self._centres)) / self._blur_m)
        return cast(FloatArray, np.exp(-0.5 * (np.log(INCLUSION_CONTRAST) * share / sd) ** 2))


def detection_limit(
    posterior: RegionPosterior, made_m: FloatArray, radii_m: Iterable[float] = INCLUSION_RADII_M
) -> DetectionLimit:
    """Computes the detection limit. made_m: (n, 2) places of all touches, including those without a result [m]"""
    unseen = [(radius, UnseenInclusions(posterior, radius)) for radius in sorted(set(radii_m))]
    fitting = [(radius, one.probability) for radius, one in unseen if len(one.weight)]
    radii, probabilities = np.array(fitting).reshape(-1, 2).T
    circle = largest_circle(posterior.grid, made_m)
    return DetectionLimit(*circle, radii, probabilities, contrast=INCLUSION_CONTRAST, prior=INCLUSION_PRIOR)


def largest_circle(grid: MapGrid, made_m: FloatArray) -> tuple[float, FloatArray]:
    """Radius [m] and centre (2,) [m] of the largest circle on the surface without a touch at places (n, 2) [m]."""
    size, centres = np.asarray(grid.size_m), grid.centres_m
    radius = np.minimum(centres, size - centres).min(axis=1)
    if len(made_m):
        radius = np.minimum(radius, KDTree(made_m).query(centres)[0])
    at = int(radius.argmax())
    return float(radius[at]), centres[at]


StopReason = Literal["budget", "nothing above the threshold", "little left to learn", "nowhere to go", "no lump missed"]

ALLOWED, OUT_OF_REACH, AT_BORDER, TOUCHED_BEFORE = range(4)
"""Codes of `TouchChoice.excluded`."""

OUTCOMES = 16
"""Bins of a touch's possible readings, over which information is counted; half of them for labels."""

CONTENDERS = 100
"""Number of places, the most informative about the map per second, for which the gain in labels is computed."""

INCLUSION_M = 0.06
"""Default radius of the smallest inclusions that are sought."""

LARGER = (1.0, 1.4, 2.0)
"""Inclusions that are sought, in units of the smallest."""

INCLUSION_WORTH = 0.5
"""Share of the labels that are corrected when an inclusion is found: without it, the number of regions is wrong."""

LABEL_CELL_M = 0.025
LEVEL_WORTH = 0.02
"""Weight of a nat about the levels relative to the share of cells with the right label."""


@dataclass(frozen=True, slots=True)
class FieldKernel:
    """The field's Gaussian process: squared exponential of `sd` and `length_m`, noise of a touch, all in log
    stiffness."""

    sd: float = 0.5
    length_m: float = 0.12
    noise_sd: float = field(default_factory=lambda: TouchErrorModel().touch_sd)

    def covariance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Covariance (n, m) between places (n, 2) and (m, 2) [m]."""
        return np.asarray(self.sd**2 * gaussian_between(a, b, self.length_m))


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """fill: touches that fill the space before regions are planned; cell_m: cell size of the places considered
    border_m, apart_m: least distance from the border and from earlier touches, except of those that are repeated
    touch_s, speed_m_s: costs of touch and route
    threshold: threshold of variance, as a share of the field's variance before any touch (Th, thesis 4.2)
    least_gain: where less is to be gained it stops: of the share of cells with the right label; sure: the probability
    from which the number of regions is no longer in doubt; budget: most touches
    inclusion_m: radius of the smallest inclusions that are sought; unmet: probability of an undetected inclusion below
    which the search ends. `sure`, `unmet` and `least_gain` were chosen on tuning seeds (`studies.seeds`); missed: where
    inclusions alone are sought: probability of a missed one, below which enough is known (`inclusion_plan`)"""

    fill: int = 4
    cell_m: float = 0.02
    border_m: float = 0.02
    apart_m: float = 0.025
    touch_s: float = 6.0
    speed_m_s: float = 0.1
    threshold: float = 0.06
    least_gain: float = 0.007
    sure: float = 0.7
    budget: int = 8
    inclusion_m: float = INCLUSION_M
    unmet: float = 0.08
    missed: float = 0.05

    def __post_init__(self) -> None:
        if min(self.cell_m, self.touch_s, self.speed_m_s, self.inclusion_m) <= 0.0 or self.budget < 1:
            raise InputError("cells, times, speed, inclusions and budget above 0", f"{self}")


@dataclass(frozen=True, slots=True)
class TouchChoice:
    """The next touch. Maps are (rows, columns) of `grid`, whose cells are the places considered.

    target_m: (2,) the best place [m], None if there is none; stop: why no further touch is useful, None to continue
    gain: expected gain of each place, nan where excluded; unit: unit of gain ("label": share of cells that get the
    right label); missed: detection limit of the touches so far
    cost_s: time of the route and the touch; excluded: codes (ALLOWED, OUT_OF_REACH, AT_BORDER, TOUCHED_BEFORE)
    reason: reason in words"""

    grid: MapGrid
    target_m: FloatArray | None
    stop: StopReason | None
    gain: FloatArray
    unit: str
    cost_s: FloatArray
    excluded: IntArray
    reason: str
    missed: DetectionLimit


class PlannedPlaces:
    """The places that are considered for a touch: cells of `grid`.

    made_m: (n, 2) places of earlier touches, those without a result too [m]; excluded: (p,) codes, changed where a
    touch may be repeated; cost_s: (p,) time of the route and the touch"""

    def __init__(
        self,
        posterior: RegionPosterior | InclusionPosterior,
        options: PlanOptions,
        tip_m: FloatArray | None,
        left_out_m: FloatArray | None,
        reachable: BoolArray | None,
    ) -> None:
        """Arguments as in `plan_touch`."""
        self.grid = MapGrid(posterior.grid.size_m, options.cell_m)
        centres = self.grid.centres_m
        touched = np.array([touch.xy_m for touch in posterior.touches]).reshape(-1, 2)
        self.made_m = touched if left_out_m is None else np.concatenate([touched, left_out_m])
        self.tip_m = tip_m if tip_m is not None else touched[-1] if len(touched) else np.zeros(2)
        self.excluded = exclusions(centres, self.made_m, posterior.grid, reachable, options)
        self.cost_s = touch_seconds(centres, self.tip_m, options)

    @property
    def allowed(self) -> BoolArray:
        """(p,) where a touch is possible."""
        return np.asarray(self.excluded == ALLOWED)

    def ended(self, options: PlanOptions) -> StopReason | None:
        """Why no touch is possible, None while one is."""
        if len(self.made_m) >= options.budget:
            return "budget"
        return None if self.allowed.any() else "nowhere to go"

    def choice(
        self,
        limit: DetectionLimit,
        gain: FloatArray,
        unit: str,
        score: FloatArray,
        stop: StopReason | None,
        why: Callable[[int], str],
        at_m: FloatArray | None = None,
    ) -> TouchChoice:
        """The place of the largest score. gain, score: (p,) of each place; why: the reason for a place; at_m: (p, 2)
        where the touch of each place is made, default its middle [m]"""
        target, reason = None, f"stopped: {stop}"
        if self.allowed.any():
            best = int(np.nanargmax(np.where(self.allowed, score, -np.inf)))
            target = (self.grid.centres_m if at_m is None else at_m)[best]
            reason = why(best) if stop is None else reason
        shape = self.grid.shape
        gains, costs, excluded = gain.reshape(shape), self.cost_s.reshape(shape), self.excluded.reshape(shape)
        return TouchChoice(self.grid, target, stop, gains, unit, costs, excluded, reason, missed=limit)


def plan_touch(
    posterior: RegionPosterior,
    kernel: FieldKernel,
    options: PlanOptions,
    *,
    tip_m: FloatArray | None = None,
    left_out_m: FloatArray | None = None,
    reachable: BoolArray | None = None,
) -> TouchChoice:
    """The next touch.

    tip_m: (2,) present place of the tip, default the last touch, else the surface's corner [m]
    left_out_m: (n, 2) places of touches without a result: they count for the budget, and are not repeated
    reachable: (rows, columns) cells of `posterior.grid` that the tip reaches"""
    planned = PlannedPlaces(posterior, options, tip_m, left_out_m, reachable)
    places, excluded = planned.grid.centres_m, planned.excluded
    touched, left_out = np.split(planned.made_m, [len(posterior.touches)])
    at_m, again = posterior.repeated(places, 0.5 * options.cell_m)
    if len(touched) >= options.fill:
        failed = exclusions(places, left_out, posterior.grid, reachable, options) == TOUCHED_BEFORE
        excluded[again & (excluded == TOUCHED_BEFORE) & ~failed] = ALLOWED
    allowed = planned.allowed
    with threadpool_limits(1):
        gain, unit = _gain(posterior, kernel, options, places, allowed, touched, planned.cost_s)
        limit = detection_limit(posterior, planned.made_m, {*INCLUSION_RADII_M, options.inclusion_m})
    stop = planned.ended(options)
    if stop is None:
        explained = (_explained(kernel, touched, places[allowed]) ** 2).sum(axis=0)  # of the field's (Thesis eq. 4.4)
        variance = (kernel.sd**2 - explained) / kernel.sd**2
        stop = _enough(posterior, options, gain, unit, variance, limit)

    def why(best: int) -> str:
        text = _why(posterior, unit, float(gain[best]), float(planned.cost_s[best]))
        return "the same place again: " * bool(again[best]) + text

    return planned.choice(limit, gain, unit, gain / planned.cost_s, stop, why, at_m)


def information(expected: Expected) -> FloatArray:
    """(p,) mutual information of touches, of which this is expected (`RelatedTouches.expected`), and the surface [nat].
    It is the entropy of the reading over all hypotheses less that under each (Lindley 1956), computed in bins, which
    make it slightly smaller."""
    chance, weight = _outcomes(expected, OUTCOMES)
    together = np.tensordot(chance, weight, axes=(1, 0))
    entropy = -xlogy(together, together).sum(axis=0)
    return cast(FloatArray, np.maximum(entropy + weight @ xlogy(chance, chance).sum(axis=0), 0.0))


def label_gain(hypotheses: RegionHypotheses, touches: RelatedTouches, cells_m: FloatArray, blur_m: float) -> FloatArray:
    """(p,) expected increase, by each of some touches, of the share of cells (c, 2) with the right label.

    A label is right if the number of regions is, too; each region of a map counts the same, however small. The share
    is that of the best labels after the touch, over all its outcomes."""
    outcomes = OUTCOMES // 2
    chance, weight = _outcomes(touches.expected(hypotheses, blur_m), outcomes)
    joint = np.ascontiguousarray(np.swapaxes(chance * weight[:, None], 1, 2)).reshape(-1, len(weight))
    best, best_now = np.zeros((len(joint), len(cells_m))), np.zeros(len(cells_m))
    start = 0
    for maps, level, _, _ in hypotheses.maps:
        regions, here = level.shape[1], slice(start, start + len(level))
        start += len(level)
        labels = labels_of(maps, level, cells_m)
        for rank in range(regions):
            is_rank = labels == rank
            credit = is_rank / np.maximum(regions * is_rank.mean(axis=1, keepdims=True), 1e-9)
            np.maximum(best, joint[:, here] @ credit, out=best)
            np.maximum(best_now, weight[here] @ credit, out=best_now)
    smooth = np.full((1, len(cells_m)), 1.0)
    np.maximum(best, joint[:, start:].sum(axis=1, keepdims=True) @ smooth, out=best)
    np.maximum(best_now, weight[start:].sum() * smooth[0], out=best_now)
    after = best.reshape(outcomes, len(touches.at_m), -1).sum(axis=0).mean(axis=1)
    return cast(FloatArray, np.maximum(after - best_now.mean(), 0.0))


def _outcomes(expected: Expected, count: int) -> tuple[FloatArray, FloatArray]:
    """(count, h, p) probability of each outcome of a touch under each hypothesis, and the hypotheses' weights (h,)."""
    mean, _, sd, weight = expected
    # bins of about equal probability of a reading, under any hypothesis
    spread = ndtri((np.arange(8) + 0.5) / 8.0)
    reading = (mean[:, None] + sd[:, None] * spread[:, None]).reshape(-1, mean.shape[1])
    order = np.argsort(reading, axis=0)
    below = np.cumsum(np.repeat(weight / 8.0, 8)[order], axis=0)
    wanted = np.arange(1, count) / count
    at = [np.searchsorted(below[:, place], wanted) for place in range(reading.shape[1])]
    chosen = np.take_along_axis(order, np.minimum(np.stack(at, axis=1), len(reading) - 1), axis=0)
    edges = np.take_along_axis(reading, chosen, axis=0)
    return np.diff(ndtr((edges[:, None] - mean) / sd), axis=0, prepend=0.0, append=1.0), weight


def touch_seconds(places_m: FloatArray, tip_m: FloatArray, options: PlanOptions) -> FloatArray:
    """(p,) time of the route from the tip (2,) to places (p, 2) [m] and of the touch there [s]."""
    return np.asarray(options.touch_s + np.hypot(*(places_m - tip_m).T) / options.speed_m_s)


def exclusions(
    places: FloatArray, touched: FloatArray, cells: MapGrid, reachable: BoolArray | None, options: PlanOptions
) -> IntArray:
    """(p,) codes of places (p, 2): a touch is possible, or why it is not. touched: (n, 2) places of earlier
    touches; cells: grid of `reachable`"""
    excluded = np.full(len(places), ALLOWED)
    if len(touched):
        nearest = np.hypot(*(places[:, None] - touched).transpose(2, 0, 1)).min(axis=1)
        excluded[nearest < options.apart_m] = TOUCHED_BEFORE
    inside = ((places > options.border_m) & (places < np.asarray(cells.size_m) - options.border_m)).all(axis=1)
    excluded[~inside] = AT_BORDER
    if reachable is not None:
        if reachable.shape != cells.shape:
            raise InputError(f"a reachability mask of {cells.shape}", f"{reachable.shape}")
        last = np.asarray(cells.shape)[::-1] - 1
        column, row = np.minimum((places / cells.cell_m).astype(int), last).T
        excluded[~reachable[row, column]] = OUT_OF_REACH
    return excluded


def _explained(kernel: FieldKernel, touched: FloatArray, places: FloatArray) -> FloatArray:
    """(t, p) whitened covariances of touches and places."""
    if not len(touched):
        return np.zeros((0, len(places)))
    own = kernel.covariance(touched, touched) + kernel.noise_sd**2 * np.eye(len(touched))
    return cast(FloatArray, np.linalg.solve(np.linalg.cholesky(own), kernel.covariance(touched, places)))


def _gain(
    posterior: RegionPosterior,
    kernel: FieldKernel,
    options: PlanOptions,
    places: FloatArray,
    allowed: BoolArray,
    touched: FloatArray,
    cost: FloatArray,
) -> tuple[FloatArray, str]:
    """Gain (p,), nan where not `allowed`, and its unit."""
    if len(touched) < options.fill:
        explained = _explained(kernel, touched, places)
        covariance = kernel.covariance(places, places) - explained.T @ explained
        drop = (covariance**2).mean(axis=0) / (np.diagonal(covariance) + kernel.noise_sd**2)
        return np.where(allowed, drop, np.nan), "mean variance"
    gain = np.full(len(places), np.nan)
    if allowed.any():
        inclusions = [UnseenInclusions(posterior, times * options.inclusion_m) for times in LARGER]
        gain[allowed] = INCLUSION_WORTH * np.mean([one.gain(places[allowed]) for one in inclusions], axis=0)
        # a search for the boundaries of what nothing speaks for would only stall
        if posterior.probability["1"] <= 0.5:
            at_m, _ = posterior.repeated(places[allowed], 0.5 * options.cell_m)
            gain[allowed] += _region_gain(posterior, posterior.related(at_m), cost[allowed])
    return gain, "label"


def _region_gain(posterior: RegionPosterior, touches: RelatedTouches, cost: FloatArray) -> FloatArray:
    """(p,) expected gain of a touch in labels, and in uncertain levels; the labels' part only at the places that
    are most informative of levels."""
    hypotheses, blur = posterior.hypotheses(), posterior.prior.blur_m
    # (p,) information of touches about the levels, if the map is known [nat]; beyond `rigid_sd` precision adds little
    _, variance, _, weight = expected = touches.expected(hypotheses, blur)
    gain = LEVEL_WORTH * cast(FloatArray, 0.5 * weight @ np.log1p(variance / posterior.prior.rigid_sd**2))
    learned = LEVEL_WORTH * information(expected)
    best = np.argsort(-(gain + learned) / cost, kind="stable")[:CONTENDERS]
    cells = MapGrid(posterior.grid.size_m, LABEL_CELL_M).centres_m
    gain[best] += label_gain(hypotheses, touches.take(best), cells, blur)
    return gain


def _enough(
    posterior: RegionPosterior,
    options: PlanOptions,
    gain: FloatArray,
    unit: str,
    variance: FloatArray,
    limit: DetectionLimit,
) -> StopReason | None:
    """Why no further touch is needed, None while one is. While the number of regions is in doubt, or inclusions may be
    there unseen, only the budget and the reach end it. gain: (n,) gain of each place, NaN where no touch is allowed"""
    if len(posterior.touches) < 3 or max(posterior.probability.values()) < options.sure:
        return None
    if limit.probability(options.inclusion_m) > options.unmet:
        return None
    if variance.max() < options.threshold:
        return "nothing above the threshold"
    if unit == "label" and np.nanmax(gain) < options.least_gain:
        return "little left to learn"
    return None


def _why(posterior: RegionPosterior, unit: str, gain: float, cost_s: float) -> str:
    """Why here, in words."""
    if unit == "mean variance":
        return f"spreads the touches over the surface, where the map is least certain; takes {cost_s:.0f} s"
    if posterior.probability["1"] > 0.5:
        found = "one material so far: seeks a spot of another"
        return f"{found}; expected to correct {gain:.1%} of the map, takes {cost_s:.0f} s"
    shares = ", ".join(f"{name} ({share:.0%})" for name, share in posterior.probability.items() if share >= 0.05)
    return f"expected to correct {gain:.1%} of the map, takes {cost_s:.0f} s; regions so far: {shares}"
