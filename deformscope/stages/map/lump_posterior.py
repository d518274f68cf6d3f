"""What touches say of lumps below a surface that shows nothing: where they are, how large, and what may be missed.

A touch's log stiffness is one level, plus what the lumps add to it (`stages.poke.lump_footprint`), plus scatter of an
unknown deviation, which neighbours share (`stages.regions.touch_error`). A lump is one of a grid of hypotheses: its
middle, its radius, its depth and its contrast, each as likely as another before any touch; the level is flat, the
scatter summed over. Where the touches say that there is one, and where, it counts as found; the next is sought in what
is left, with the doubt about the first.

What is taken for granted, and stated with every result: before any touch a lump is as likely as not; lumps are balls
4 times as stiff or as soft as the foam, or more, whose uppermost point is at most 2 cm deep, all of each within the
field. What is weaker or deeper may be there at any probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.distance import cdist
from scipy.special import expit, logsumexp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.map.exploration import LumpsFound
from deformscope.stages.poke.lump_footprint import contact_radius, contrast_share, footprint, lump_shift
from deformscope.stages.regions.posterior import RegionMap
from deformscope.stages.regions.touch_error import LAW_SD, TouchErrorModel
from deformscope.stages.regions.touches import MapGrid, StiffnessSample

EXISTS = 0.5
"""Probability before any touch that there is a lump: as likely as not. The same of a further one."""
RADII_M = (0.01, 0.015, 0.02, 0.025, 0.03, 0.04)
DEPTHS_M = (0.005, 0.01, 0.015, 0.02)
"""Of the uppermost points."""
DEEP_M = 0.0125
"""A lump is called deep where its uppermost point is farther down, shallow where it is not."""
TIMES = (4.0, 10.0, 100.0)
"""How many times as stiff, or as soft."""
SCATTERS = (0.004, 0.008, 0.016, 0.032, 0.064, 0.12)
"""Deviations of log stiffness that are summed over, each as likely: from cast foam to 12 %."""
FOOTPRINT_DOUBT = 0.15
"""Of what a lump does to a touch, as a share of it: the footprint is no better."""
LEVEL_SD, LEAST_SD = 3.0, 0.002
CENTRE_CELL_M, MOST_CENTRES = 0.01, 700
ASIDE_M = np.append(np.arange(0.0, 0.08, 0.004), [0.08, 0.1, 0.12, 0.2, 2.0])
"""Distances at which the footprint is computed; between them it is interpolated."""
FOUND, LOCALISED = 0.95, 0.9
"""A lump counts as found where it is that likely, and its middle that likely within its radius of where it is said to
be."""
SURE_DEPTH = 0.9
MOST_FOUND = 5
Z_90 = 1.6449


@dataclass(frozen=True, slots=True)
class LumpPrior:
    """smallest_m: radius of the lumps that must not be missed [m]; tip_radius_m, set_force_n: of touches;
    error: of touches; what scatters is taken from `SCATTERS`"""

    smallest_m: float = 0.02
    tip_radius_m: float = 0.01
    set_force_n: float = 3.0
    error: TouchErrorModel = field(default_factory=TouchErrorModel)

    def __post_init__(self) -> None:
        if not 0.005 <= self.smallest_m <= 0.1:
            raise InputError("lumps of a radius from 0.5 to 10 cm", f"{100 * self.smallest_m:g} cm")

    def radii_m(self, size_m: tuple[float, float]) -> tuple[float, ...]:
        """(r,) of lumps that are thought of, rising: those that fit on the surface."""
        every = sorted({*RADII_M, self.smallest_m, 1.5 * self.smallest_m})
        fitting = tuple(one for one in every if 2.0 * one + CENTRE_CELL_M <= min(size_m))
        if self.smallest_m not in fitting:
            came = f"{100 * min(size_m):.3g} cm across"
            raise InputError("a surface on which the smallest lumps fit", came, "a smaller --smallest-lump-cm")
        return fitting


@dataclass(frozen=True, slots=True, eq=False)
class LumpGuesses:
    """Lumps that there may be, of every kind at every place: `j` of them.

    centre_m: (j, 2); radius_m, depth_m, share: (j,) (`lump_footprint.contrast_share`); weight: (j,) prior, 1 in all
    """

    centre_m: FloatArray
    radius_m: FloatArray
    depth_m: FloatArray
    share: FloatArray
    weight: FloatArray

    @classmethod
    def on(cls, size_m: tuple[float, float], radii_m: Sequence[float]) -> LumpGuesses:
        """On a surface: each radius as likely, and of each radius every place, depth and contrast."""
        cell_m = max(CENTRE_CELL_M, float(np.sqrt(size_m[0] * size_m[1] / MOST_CENTRES)))
        stiff = np.array([contrast_share(one) for one in TIMES])
        kinds = np.stack(np.meshgrid(DEPTHS_M, np.concatenate([stiff, -stiff]), indexing="ij"), axis=-1).reshape(-1, 2)
        parts = []
        for radius_m in radii_m:
            x, y = (_spaced(radius_m, side - radius_m, cell_m) for side in size_m)
            centre = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            count = len(centre) * len(kinds)
            row = [
                np.repeat(centre, len(kinds), axis=0),
                np.full((count, 1), radius_m),
                np.tile(kinds, (len(centre), 1)),
            ]
            parts.append(np.hstack([*row, np.full((count, 1), 1.0 / (count * len(radii_m)))]))
        every = np.concatenate(parts)
        return cls(every[:, :2], *every[:, 2:].T)

    def __len__(self) -> int:
        return len(self.weight)

    def shifts(self, places_m: FloatArray, contact_m: float) -> FloatArray:
        """(p, j) what each adds to the log stiffness of touches at places (p, 2)."""
        radii, of_radius = np.unique(self.radius_m, return_inverse=True)
        depths, of_depth = np.unique(self.depth_m, return_inverse=True)
        table = footprint(contact_m, radii, depths, ASIDE_M)
        centres, of_centre = np.unique(self.centre_m, axis=0, return_inverse=True)
        away = cdist(places_m, centres)
        each = np.empty((len(radii), len(depths), *away.shape))
        for r in range(len(radii)):
            for d in range(len(depths)):
                each[r, d] = np.interp(away, ASIDE_M, table[r, d])
        at = each.transpose(2, 3, 0, 1)[:, of_centre.ravel(), of_radius, of_depth]
        return lump_shift(self.share, at)


@dataclass(frozen=True, slots=True, eq=False)
class FoundLump:
    """A lump that the touches speak for.

    centre_m: (2,) its middle; within_m: distance from it within which it lies in 90 %; radius_m, radius_interval_m: of
    90 % [m]; stiff: rather than soft; probability: that there is one
    deep: that it is (DEEP_M); log_shift: what it adds to log stiffness right above it
    posterior: (j,) over the guesses
    """

    centre_m: FloatArray
    within_m: float
    radius_m: float
    radius_interval_m: tuple[float, float]
    stiff: bool
    probability: float
    deep: float
    log_shift: float
    posterior: FloatArray

    @property
    def depth(self) -> str:
        """In a word; empty where it cannot be told."""
        return "deep" if self.deep >= SURE_DEPTH else "shallow" if self.deep <= 1.0 - SURE_DEPTH else ""


class LumpState:
    """What is known after the lumps that were found: whether there is one more.

    odds_log: (j,) logarithm of each guess's likelihood over that of none; open: (j,) guesses that stay apart from all
    that were found; posterior: (j,) of one more, its kinds and places, 1 in all; exists: that there is one more, of
    all radii
    scatter: (s,) posterior of SCATTERS
    """

    def __init__(
        self,
        guesses: LumpGuesses,
        read: FloatArray,
        own_sd: FloatArray,
        felt: FloatArray,
        related: FloatArray,
        open_: BoolArray,
    ) -> None:
        """read: (t,) log stiffness, less what was found; own_sd: (t,); felt: (t, j) shifts of the guesses; related:
        (t, t) correlation of the scatter"""
        self.open = open_
        self._guesses = guesses
        self.covariances = [scatter**2 * related + np.diag(own_sd**2) + LEVEL_SD**2 for scatter in SCATTERS]
        none, one = np.zeros(len(SCATTERS)), np.zeros((len(SCATTERS), len(guesses)))
        for s, covariance in enumerate(self.covariances):
            root = np.linalg.cholesky(covariance)
            bare = solve_triangular(root, read, lower=True)
            lumps = solve_triangular(root, felt, lower=True)
            none[s] = -0.5 * float(bare @ bare) - float(np.log(np.diag(root)).sum())
            one[s] = bare @ lumps - 0.5 * (lumps**2).sum(axis=0)
        self.odds_log = logsumexp(one + none[:, None], axis=0) - logsumexp(none)
        self.read = read
        weight = np.where(open_, guesses.weight, 0.0)
        self.posterior, log_odds = _normalised(weight, self.odds_log)
        self.exists = float(expit(log_odds + np.log(EXISTS / (1.0 - EXISTS))))
        joint = self.exists * _shares(one + none[:, None], self.posterior) + (1.0 - self.exists) * np.exp(
            none - logsumexp(none)
        )
        self.scatter = joint / joint.sum()

    def missed(self, some: BoolArray) -> float:
        """Probability that there is one more of some of the guesses (j,), were these all that there can be."""
        weight = np.where(self.open & some, self._guesses.weight, 0.0)
        if not weight.sum() > 0.0:
            return 0.0
        whole = self._guesses.weight[some].sum()
        log_odds = np.log(max(weight.sum() / whole, 1e-300)) + _normalised(weight, self.odds_log)[1]
        return float(expit(log_odds + np.log(EXISTS / (1.0 - EXISTS))))


class LumpPosterior:
    """What touches of a surface say of lumps in it; each touch makes another one.

    touches; found: lumps, in the order in which they explain most; state: of what is left
    """

    def __init__(self, grid: MapGrid, prior: LumpPrior, touches: tuple[StiffnessSample, ...] = ()) -> None:
        self.grid, self.prior, self.touches = grid, prior, touches
        self.radii_m = prior.radii_m(grid.size_m)

    def with_touch(self, touch: StiffnessSample) -> LumpPosterior:
        """After one more touch."""
        return LumpPosterior(self.grid, self.prior, (*self.touches, touch))

    @cached_property
    def guesses(self) -> LumpGuesses:
        return LumpGuesses.on(self.grid.size_m, self.radii_m)

    @property
    def places_m(self) -> FloatArray:
        """(t, 2) of the touches."""
        return np.array([touch.xy_m for touch in self.touches]).reshape(-1, 2)

    @cached_property
    def contact_m(self) -> float:
        """Radius of the contact, of foam like that of most touches; of none before any."""
        if not self.touches:
            return 0.8 * self.prior.tip_radius_m
        level = float(np.median([touch.log_stiffness for touch in self.touches]))
        dent_m = 1e-3 * self.prior.set_force_n / float(np.exp(level))
        return contact_radius(min(dent_m, self.prior.tip_radius_m), self.prior.tip_radius_m)

    @cached_property
    def felt(self) -> FloatArray:
        """(t, j) what each guess adds to the log stiffness of the touches."""
        return self.guesses.shifts(self.places_m, self.contact_m)

    @cached_property
    def _search(self) -> tuple[tuple[FoundLump, ...], LumpState]:
        guesses, places = self.guesses, self.places_m
        read = np.array([touch.log_stiffness for touch in self.touches])
        own = np.array([touch.log_sd for touch in self.touches])
        # what the law is off by is alike in touches of one foam: it is a part of the level
        own = np.sqrt(np.maximum(own**2 - LAW_SD**2, LEAST_SD**2))
        if len(read):
            own = np.hypot(own, FOOTPRINT_DOUBT * (read - np.median(read)))
        felt, related = self.felt, self.prior.error.related(places)
        found: list[FoundLump] = []
        open_ = np.ones(len(guesses), dtype=bool)
        while True:
            state = LumpState(guesses, read, own, felt, related, open_)
            one = self._found(state)
            if one is None or len(found) == MOST_FOUND:
                return tuple(found), state
            found.append(one)
            mean = felt @ one.posterior
            read = read - mean
            own = np.sqrt(own**2 + np.maximum(felt**2 @ one.posterior - mean**2, 0.0))
            open_ = open_ & (np.linalg.norm(guesses.centre_m - one.centre_m, axis=1) > guesses.radius_m + one.radius_m)

    @property
    def found(self) -> tuple[FoundLump, ...]:
        return self._search[0]

    @property
    def state(self) -> LumpState:
        return self._search[1]

    def _found(self, state: LumpState) -> FoundLump | None:
        """The lump that is left, where there is one, and its place is known."""
        guesses, weight = self.guesses, state.posterior
        if state.exists < FOUND:
            return None
        centre = weight @ guesses.centre_m
        away = np.linalg.norm(guesses.centre_m - centre, axis=1)
        radius_m = float(weight @ guesses.radius_m)
        if weight[away <= radius_m].sum() < LOCALISED:
            return None
        order = np.argsort(away, kind="stable")
        within_m = float(away[order][np.searchsorted(np.cumsum(weight[order]), 0.9)])
        shares = np.array([weight[guesses.radius_m == one].sum() for one in self.radii_m])
        above = guesses.shifts(centre[None], self.contact_m)[0]
        return FoundLump(
            centre,
            max(within_m, 0.5 * CENTRE_CELL_M),
            radius_m,
            _interval(np.array(self.radii_m), shares),
            bool(weight[guesses.share > 0.0].sum() > 0.5),
            state.exists,
            float(weight[guesses.depth_m > DEEP_M].sum()),
            float(weight @ above),
            weight,
        )

    # What is missed ---------------------------------------------------------------------------------------------------

    @cached_property
    def missed_smallest(self) -> float:
        """The largest probability of `missed`, of the smallest radius that must not be missed and of larger ones."""
        return float(self.missed[np.array(self.radii_m) >= self.prior.smallest_m].max())

    @cached_property
    def missed(self) -> FloatArray:
        """(r,) probability that there is a further lump of each of `radii_m`, were lumps of this radius alone there."""
        return np.array([self.state.missed(self.guesses.radius_m == one) for one in self.radii_m])

    @cached_property
    def covered(self) -> FloatArray:
        """(rows, columns) probability that a cell lies above a lump, found or not."""
        centres, clear = self.grid.centres_m, np.ones(len(self.grid.centres_m))
        for weight in (
            *(one.posterior * one.probability for one in self.found),
            self.state.exists * self.state.posterior,
        ):
            clear *= 1.0 - np.minimum(self._above(weight, centres), 1.0)
        return (1.0 - clear).reshape(self.grid.shape)

    def _above(self, weight: FloatArray, cells_m: FloatArray) -> FloatArray:
        """(c,) weight (j,) of the guesses that cells (c, 2) lie above."""
        guesses, found = self.guesses, np.zeros(len(cells_m))
        for radius_m in self.radii_m:
            mine = guesses.radius_m == radius_m
            centre, of_centre = np.unique(guesses.centre_m[mine], axis=0, return_inverse=True)
            found += (cdist(cells_m, centre) < radius_m) @ np.bincount(of_centre.ravel(), weight[mine])
        return found

    def lumps(self, truth_m: FloatArray | None = None) -> LumpsFound:
        """What is reported. truth_m: where it is known"""
        found = self.found
        return LumpsFound(
            centre_m=np.array([one.centre_m for one in found]).reshape(-1, 2),
            within_m=np.array([one.within_m for one in found]),
            radius_m=np.array([one.radius_m for one in found]),
            radius_interval_m=np.array([one.radius_interval_m for one in found]).reshape(-1, 2),
            stiff=np.array([one.stiff for one in found], dtype=bool),
            probability=np.array([one.probability for one in found]),
            depth=tuple(one.depth for one in found),
            covered=self.covered,
            cell_m=self.grid.cell_m,
            size_m=np.array(self.radii_m),
            missed=self.missed,
            smallest_m=self.prior.smallest_m,
            missed_smallest=self.missed_smallest,
            prior=EXISTS,
            contrast=TIMES[0],
            deepest_m=max(DEPTHS_M),
            deep_m=DEEP_M,
            scatter=self.scatter,
            contacts_m=self.places_m,
            truth_m=truth_m,
        )

    @property
    def scatter(self) -> float:
        """Of the foam's log stiffness, a deviation."""
        return float(np.sqrt(self.state.scatter @ np.square(SCATTERS)))

    # As maps ----------------------------------------------------------------------------------------------------------

    @property
    def probability(self) -> dict[str, float]:
        """Of the number of regions: the foam and the lumps, those that were found or one more."""
        count, more = len(self.found) + 1, self.state.exists
        return {str(count): 1.0 - more, str(count + 1): more}

    def region_map(self) -> RegionMap:
        """Foam and found lumps as regions, softest first; the field is the foam's with what found lumps add to it."""
        found, cells = self.found, self.grid.centres_m
        field_log, variance = self._foam(cells)
        level, sd = [float(field_log.mean())], [float(np.sqrt(variance.mean()))]
        labels, sure = np.zeros(len(cells), dtype=np.int64), 1.0 - self.covered.ravel()
        for number, one in enumerate(found, start=1):
            felt = self.guesses.shifts(np.vstack([cells[::4], one.centre_m]), self.contact_m)
            mean = felt @ one.posterior
            doubt = np.maximum(felt**2 @ one.posterior - mean**2, 0.0) + (FOOTPRINT_DOUBT * mean) ** 2
            at = np.linalg.norm(cells - one.centre_m, axis=1)
            order = np.argsort(at[::4])
            field_log = field_log + np.interp(at, at[::4][order], mean[:-1][order])
            variance = variance + np.interp(at, at[::4][order], doubt[:-1][order])
            labels[at < one.radius_m] = number
            inside = np.minimum(self._above(one.posterior, cells), 1.0)
            sure = np.where(labels == number, one.probability * inside, sure)
            level.append(level[0] + float(mean[-1]))
            sd.append(float(np.hypot(sd[0], np.sqrt(doubt[-1]))))
        order, shape = np.argsort(level), self.grid.shape
        rank: IntArray = np.argsort(order)
        levels, sds = np.array(level)[order], np.hypot(np.array(sd)[order], self.prior.error.gain_sd)
        return RegionMap(
            grid=self.grid,
            verdict="regions",
            region_count=len(levels),
            probability=self.probability,
            labels=rank[labels].reshape(shape),
            label_probability=sure.clip(0.0, 1.0).reshape(shape),
            level=levels,
            level_sd=sds,
            level_interval=levels[:, None] + Z_90 * sds[:, None] * [-1.0, 1.0],
            rigid=np.zeros(len(levels), dtype=bool),
            field=field_log.reshape(shape),
            field_sd=np.sqrt(variance + self.prior.error.gain_sd**2).reshape(shape),
            wrong_share=float(1.0 - sure.mean()),
            boundary_sd_m=np.nan,
            scatter=self.scatter,
        )

    def _foam(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(p,), (p,) mean and variance of the foam's log stiffness at places (p, 2), lumps left out."""
        weights, spare = self.kriging(places_m)
        return weights @ self.state.read, spare

    def kriging(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(p, t) weights that touches have for one at places (p, 2), and (p,) variance of what is left: of a scatter
        as it is known."""
        scatter2, places = self.scatter**2, self.places_m
        if not len(places):
            return np.zeros((len(places_m), 0)), np.full(len(places_m), scatter2)
        error = self.prior.error
        beside = scatter2 * error.shared(places_m, places) + LEVEL_SD**2
        related = error.related(places)
        mixed = self.state.covariances[0] - SCATTERS[0] ** 2 * related + scatter2 * related
        weights = cho_solve(cho_factor(mixed), beside.T).T
        spare = scatter2 + LEVEL_SD**2 - (weights * beside).sum(axis=1)
        return weights, np.maximum(spare, LEAST_SD**2)


def _spaced(low: float, high: float, cell: float) -> FloatArray:
    """From end to end, about a cell apart."""
    return np.linspace(low, high, max(2, round((high - low) / cell) + 1))


def _normalised(weight: FloatArray, log: FloatArray) -> tuple[FloatArray, float]:
    """weight times exp(log) (j,), 1 in all, and the logarithm of its mean over `weight`."""
    if not weight.sum() > 0.0:
        return np.zeros(len(weight)), -np.inf
    with np.errstate(divide="ignore"):
        every = np.log(weight / weight.sum()) + log
    total = float(logsumexp(every))
    return np.exp(every - total), total


def _shares(joint: FloatArray, posterior: FloatArray) -> FloatArray:
    """(s,) of scatters under some guesses: joint (s, j) logarithms."""
    return np.asarray(np.exp(joint - logsumexp(joint, axis=0)) @ posterior)


def _interval(values: FloatArray, share: FloatArray) -> tuple[float, float]:
    """Of 90 %, of values (n,) on a grid, each as broad as the way to its neighbours."""
    edges = np.concatenate([[1.5 * values[0] - 0.5 * values[1]], 0.5 * (values[1:] + values[:-1])])
    edges = np.append(edges, 1.5 * values[-1] - 0.5 * values[-2])
    low, high = np.interp([0.05, 0.95], np.append(0.0, np.cumsum(share)), edges)
    return float(low), float(high)
