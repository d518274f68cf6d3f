"""Posterior of inclusions below a homogeneous surface, given touches: their places and sizes, and the miss probability.

A touch's log stiffness is one level, plus the effect of the inclusions (`stages.poke.inclusion_footprint`), plus the
variation of the foam. The latter is a Gaussian field with unknown deviation, length and share of each touch
(`Background`). Its exponent shows more: the wider the contact grows, the more it depends on deeper material
(`stages.poke.law_response`). Foam whose modulus varies from place to place has the same exponent everywhere. An
inclusion is one of a grid of
hypotheses: its middle, its radius, its depth and its contrast, each with equal probability before any touch; the level
has a flat prior, and backgrounds are summed over. An inclusion counts as found when the touches determine that there is
one, and its place. The next one is searched for in the remaining readings, with the uncertainty of the first.

Assumptions, reported with every result: before any touch an inclusion has probability .5. Inclusions are balls 4 times
as stiff or as soft as the foam, or more, whose uppermost point is at most 2 cm deep, entirely within the field. Weaker
or deeper ones may exist with any probability."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.distance import cdist
from scipy.special import expit, logsumexp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import gaussian_between
from deformscope.stages.map.exploration import InclusionsResult
from deformscope.stages.poke.contact import CONTACTS, EXPONENT, law_response
from deformscope.stages.poke.inclusion_footprint import contact_radius, contrast_share, footprint, inclusion_shift
from deformscope.stages.regions.posterior import RegionMap
from deformscope.stages.regions.touches import LAW_SD, MapGrid, StiffnessSample, TouchErrorModel

EXISTS = 0.5
"""Probability before any touch that there is an inclusion: as likely as not. Probability of one more inclusion after
one was found."""
RADII_M = (0.01, 0.015, 0.02, 0.025, 0.03, 0.04)
DEPTHS_M = (0.005, 0.01, 0.015, 0.02)
"""Depths of the uppermost points."""
DEEP_M = 0.0125
"""An inclusion is called deep if its uppermost point is farther down than this, else shallow."""
TIMES = (4.0, 20.0)
"""Ratio of stiffness, or its inverse."""
SCATTERS = (0.004, 0.008, 0.016, 0.032, 0.064, 0.12)
"""Deviations of log stiffness that are summed over, each as likely: from cast foam to 12 %."""
LENGTHS_M = (0.025, 0.04, 0.065, 0.1)
"""Lengths over which foam varies, equally probable: some centimetres. Variation over less than an inclusion's size is
one."""
APART = (0.0, 0.03, 0.3)
"""Shares of the scatter's variance that touches do not share, equally probable: from none, in foam that varies
smoothly."""
FOOTPRINT_DOUBT = 0.15
"""Relative error of an inclusion's effect on touches, common to all: the accuracy of the footprint."""
LEVEL_SD, LEAST_SD = 3.0, 0.002
HERTZ = EXPONENT["sphere"]
STIFFER, STIFFER_SD = 0.16, 0.03
"""Increase of a ball's exponent with the foam's log stiffness, because the ball sinks less, and its standard
deviation."""
BENT = 0.62
"""Increase of finite elements' exponents over an inclusion, relative to `law_response`: their foam is a layer."""
EXPONENT_LEAST_SD, EXPONENT_LEVEL_SD, EXPECTED_EXPONENT_SD, NOT_KNOWN = 0.005, 1.0, 0.025, 10.0
"""Standard deviations of exponents: of a touch with an exact fit, of the foam's, of a touch before any was made, and of
one that was not fitted."""
DRIFT_SD = 0.001
"""Deviation of log stiffness, from touch to touch, evenly, in the same direction: a force sensor's gain drifts by some
1 % in ten touches."""
CENTRE_CELL_M, MOST_CENTRES = 0.01, 700
ASIDE_M = np.append(np.arange(0.0, 0.08, 0.004), [0.08, 0.1, 0.12, 0.2, 2.0])
"""Distances at which the footprint is computed; between them it is interpolated."""
FOUND, LOCALISED = 0.95, 0.9
"""An inclusion counts as found where it is that likely, and its middle that likely within its radius of where it is
said to be."""
SURE_DEPTH = 0.9
MOST_FOUND = 5
Z_90 = 1.6449


@dataclass(frozen=True, slots=True)
class Background:
    """Variation of foam without inclusions: a Gaussian field of log stiffness.

    scatter: its deviation; length_m: length over which it changes (squared exponential); apart: share of its variance
    that touches do not share"""

    scatter: float
    length_m: float
    apart: float

    @property
    def shape(self) -> tuple[float, float]:
        """The background without its scatter."""
        return self.length_m, self.apart

    def shared(self, first_m: FloatArray, second_m: FloatArray) -> FloatArray:
        """(n, m) correlation of touches at places (n, 2) and (m, 2), without the part that they do not share."""
        return np.asarray((1.0 - self.apart) * gaussian_between(first_m, second_m, self.length_m))

    def related(self, places_m: FloatArray) -> FloatArray:
        """(t, t) correlation of touches at places (t, 2)."""
        return np.asarray(self.shared(places_m, places_m) + self.apart * np.eye(len(places_m)))


BACKGROUNDS = tuple(
    Background(scatter, length_m, apart) for length_m in LENGTHS_M for apart in APART for scatter in SCATTERS
)


@dataclass(frozen=True, slots=True)
class InclusionPrior:
    """smallest_m: radius of the inclusions that must not be missed [m]; tip_radius_m, set_force_n: tip radius and set
    force of touches; error: error model of touches; the foam's scatter is that of `BACKGROUNDS`"""

    smallest_m: float = 0.02
    tip_radius_m: float = 0.01
    set_force_n: float = 3.0
    error: TouchErrorModel = field(default_factory=TouchErrorModel)

    def __post_init__(self) -> None:
        if not 0.005 <= self.smallest_m <= 0.1:
            raise InputError("inclusions of a radius from 0.5 to 10 cm", f"{100 * self.smallest_m:g} cm")

    def radii_m(self, size_m: tuple[float, float]) -> tuple[float, ...]:
        """(r,) rising radii of the considered inclusions: those that fit on the surface."""
        every = sorted({*RADII_M, self.smallest_m, 1.5 * self.smallest_m})
        fitting = tuple(one for one in every if 2.0 * one + CENTRE_CELL_M <= min(size_m))
        if self.smallest_m not in fitting:
            came = f"{100 * min(size_m):.3g} cm across"
            raise InputError("a surface on which the smallest inclusions fit", came, "a smaller --smallest-inclusion")
        return fitting


@dataclass(frozen=True, slots=True, eq=False)
class InclusionHypotheses:
    """All `j` inclusions that are considered, of every kind at every place.

    centre_m: (j, 2); radius_m, depth_m, share: (j,) (`inclusion_footprint.contrast_share`); weight: (j,) prior
    probability, 1 in total"""

    centre_m: FloatArray
    radius_m: FloatArray
    depth_m: FloatArray
    share: FloatArray
    weight: FloatArray

    @classmethod
    def on(cls, size_m: tuple[float, float], radii_m: Sequence[float]) -> "InclusionHypotheses":
        """Hypotheses on a surface: all radii are equally likely, and all places, depths and contrasts of a radius.
        Those of one place are adjacent."""
        cell_m = max(CENTRE_CELL_M, float(np.sqrt(size_m[0] * size_m[1] / MOST_CENTRES)))
        stiff = np.array([contrast_share(one) for one in TIMES])
        kinds = np.stack(np.meshgrid(DEPTHS_M, np.concatenate([stiff, -stiff]), indexing="ij"), axis=-1).reshape(-1, 2)
        parts = []
        for radius_m in radii_m:
            ends = [(radius_m, side - radius_m) for side in size_m]
            x, y = (np.linspace(a, b, max(2, round((b - a) / cell_m) + 1)) for a, b in ends)
            centre = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            count = len(centre) * len(kinds)
            each = [np.full((count, 1), one) for one in (radius_m, 1.0 / (count * len(radii_m)))]
            kind = np.tile(kinds, (len(centre), 1))
            parts.append(np.hstack([np.repeat(centre, len(kinds), axis=0), each[0], kind, each[1]]))
        every = np.concatenate(parts)
        radius_m, depth_m, share, weight = every[:, 2:].T
        return cls(centre_m=every[:, :2], radius_m=radius_m, depth_m=depth_m, share=share, weight=weight)

    def __len__(self) -> int:
        return len(self.weight)

    def shifts(self, places_m: FloatArray, contact_m: float) -> "InclusionShifts":
        """Effect of each inclusion on touches at places (p, 2)."""
        to_log, to_exponent = law_response()
        log, exponent = (np.empty((len(places_m), len(self))) for _ in range(2))
        for radius_m in np.unique(self.radius_m):
            mine = np.flatnonzero(self.radius_m == radius_m)
            centres = np.unique(self.centre_m[mine], axis=0, return_index=True)[1]
            kinds = len(mine) // len(centres)
            depth_m, share = self.depth_m[mine[:kinds]], self.share[mine[:kinds]]
            depths, of_depth = np.unique(depth_m, return_inverse=True)
            radius = np.array([radius_m])
            energies = [footprint(one * contact_m, radius, depths, ASIDE_M)[0][of_depth] for one in CONTACTS]
            by_contact = np.stack([inclusion_shift(share[:, None], one) for one in energies])
            away = cdist(places_m, self.centre_m[mine[::kinds]]).clip(max=ASIDE_M[-1])
            after = np.searchsorted(ASIDE_M, away, side="right").clip(1, len(ASIDE_M) - 1)
            part = (away - ASIDE_M[after - 1]) / (ASIDE_M[after] - ASIDE_M[after - 1])
            for out, weights in ((log, to_log), (exponent, to_exponent)):
                table = np.tensordot(weights, by_contact, axes=1).T  # (aside, kind)
                between = table[after - 1] * (1.0 - part[..., None]) + table[after] * part[..., None]
                out[:, mine] = between.reshape(len(places_m), len(mine))
        return InclusionShifts(log, BENT * exponent)


@dataclass(frozen=True, slots=True, eq=False)
class InclusionShifts:
    """Effect of inclusions on touches: log, exponent: (p, j) the change of a touch's log stiffness by each, and of its
    exponent relative to foam of the same stiffness"""

    log: FloatArray
    exponent: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FoundInclusion:
    """An inclusion that the touches make probable.

    centre_m: (2,) its middle; within_m: distance from it within which it lies in 90 %; radius_m, radius_interval_m: its
    radius and the 90 % interval [m]; stiff: it is stiffer than the foam, not softer; probability: probability that
    there is one; deep: probability that it is deep (DEEP_M)
    posterior: (j,) probability of each hypothesis"""

    centre_m: FloatArray
    within_m: float
    radius_m: float
    radius_interval_m: tuple[float, float]
    stiff: bool
    probability: float
    deep: float
    posterior: FloatArray

    @property
    def depth(self) -> str:
        """The depth in a word; empty if it is not identified."""
        return "deep" if self.deep >= SURE_DEPTH else "shallow" if self.deep <= 1.0 - SURE_DEPTH else ""


@dataclass(frozen=True, slots=True, eq=False)
class LeftOver:
    """Residuals of t touches after the found inclusions.

    places_m: (t, 2); read: (t,) log stiffness, without the found ones; noise: (t, t) its covariance, without scatter
    and level; bent: (t,) exponents, without the found ones and the part due to stiffness; bent_noise: (t, t) covariance
    of exponents, without the level"""

    places_m: FloatArray
    read: FloatArray
    noise: FloatArray
    bent: FloatArray
    bent_noise: FloatArray

    @classmethod
    def of(cls, touches: Sequence[StiffnessSample]) -> "LeftOver":
        """Residuals of the touches while no inclusion is assumed."""
        bent = np.array([HERTZ if touch.exponent is None else touch.exponent for touch in touches])
        bent_sd = np.array([NOT_KNOWN if touch.exponent is None else touch.exponent_sd for touch in touches])
        # a stiffness as of the same exponent in every touch is off by nothing that its exponent is off by
        goes_with = np.array([touch.exponent_related for touch in touches]) / bent_sd**2
        read = np.array([touch.log_stiffness for touch in touches]) - goes_with * (bent - HERTZ)
        # what the law is off by is alike in touches of one foam: it is a part of the level
        own2 = np.array([touch.log_sd for touch in touches]) ** 2 - LAW_SD**2 - (goes_with * bent_sd) ** 2
        order = np.arange(len(read)) - 0.5 * (len(read) - 1)
        noise = np.diag(np.maximum(own2, LEAST_SD**2)) + DRIFT_SD**2 * np.outer(order, order)
        about = read - (np.median(read) if len(read) else 0.0)
        bent_noise = np.diag(np.hypot(bent_sd, EXPONENT_LEAST_SD) ** 2) + STIFFER_SD**2 * np.outer(about, about)
        places = np.array([touch.xy_m for touch in touches]).reshape(-1, 2)
        return cls(places_m=places, read=read, noise=noise, bent=bent - STIFFER * about, bent_noise=bent_noise)

    def without(self, shifts: InclusionShifts, weight: FloatArray) -> "LeftOver":
        """Residuals without an inclusion of the posterior (j,), with its uncertainty."""

        def less(each: FloatArray) -> tuple[FloatArray, FloatArray]:
            """(t,) mean of the shifts (t, j), and (t, t) the doubt about them."""
            mean = each @ weight
            return mean, (each * weight) @ each.T + (FOOTPRINT_DOUBT**2 - 1.0) * np.outer(mean, mean)

        (log, log_doubt), (exponent, exponent_doubt) = less(shifts.log), less(shifts.exponent)
        return LeftOver(
            places_m=self.places_m,
            read=self.read - log,
            noise=self.noise + log_doubt,
            bent=self.bent - exponent,
            bent_noise=self.bent_noise + exponent_doubt,
        )

    @property
    def bent_sd(self) -> float:
        """Standard deviation of one more touch's exponent [-]."""
        return float(np.sqrt(np.median(np.diag(self.bent_noise)))) if len(self.read) else EXPECTED_EXPONENT_SD


class InclusionState:
    """Posterior after the found inclusions: whether there is one more.

    odds_log: (j,) logarithm of each hypothesis's likelihood over that without an inclusion; open: (j,) hypotheses that
    do not overlap the found inclusions; posterior: (j,) posterior of kind and place of one more inclusion, 1 in total;
    exists: probability that there is one more, of any radius; backgrounds: (b,) posterior of `BACKGROUNDS`"""

    def __init__(
        self, hypotheses: InclusionHypotheses, shifts: InclusionShifts, left: LeftOver, open_: BoolArray
    ) -> None:
        """shifts: effect on the touches"""
        self.left, self.open = left, open_
        self._hypotheses = hypotheses
        sure = FOOTPRINT_DOUBT**-2
        none, one = np.zeros(len(BACKGROUNDS)), np.zeros((len(BACKGROUNDS), len(hypotheses)))
        # exponents, and the effects of inclusions on them, in units of independent deviations
        root = np.linalg.cholesky(left.bent_noise + EXPONENT_LEVEL_SD**2)
        whitened = solve_triangular(root, np.column_stack([left.bent, shifts.exponent]), lower=True)
        bare, effects = whitened[:, 0], whitened[:, 1:]
        bent, bent_own = bare @ effects, (effects**2).sum(axis=0)
        root = np.linalg.cholesky(left.noise + LEVEL_SD**2)
        constant = float(np.log(np.diag(root)).sum())
        for _, many in groupby(range(len(BACKGROUNDS)), key=lambda b: BACKGROUNDS[b].shape):
            some = list(many)
            # of one shape all scatters have the same axes, and what remains is as quick as a sum
            half = solve_triangular(root, BACKGROUNDS[some[0]].related(left.places_m), lower=True)
            spread, axes = np.linalg.eigh(solve_triangular(root, half.T, lower=True))
            whitened = axes.T @ solve_triangular(root, np.column_stack([left.read, shifts.log]), lower=True)
            weight = 1.0 / (1.0 + np.outer([BACKGROUNDS[b].scatter ** 2 for b in some], np.maximum(spread, 0.0)))
            bare, effects = whitened[:, 0], whitened[:, 1:]
            none[some] = 0.5 * (np.log(weight).sum(axis=1) - weight @ bare**2) - constant
            # the factor of an inclusion's effect has the standard deviation FOOTPRINT_DOUBT about 1
            with_read, own = (weight * bare) @ effects + bent, weight @ effects**2 + bent_own
            one[some] = 0.5 * ((with_read + sure) ** 2 / (own + sure) - sure - np.log1p(own / sure))
        self.odds_log = logsumexp(one + none[:, None], axis=0) - logsumexp(none)
        weight = np.where(open_, hypotheses.weight, 0.0)
        self.posterior, log_odds = _normalised(weight, self.odds_log)
        self.exists = float(expit(log_odds + np.log(EXISTS / (1.0 - EXISTS))))
        with_one = one + none[:, None]
        shares = np.exp(with_one - logsumexp(with_one, axis=0)) @ self.posterior
        joint = self.exists * shares + (1.0 - self.exists) * np.exp(none - logsumexp(none))
        self.backgrounds = joint / joint.sum()

    @property
    def background(self) -> Background:
        """The most probable background."""
        return BACKGROUNDS[int(self.backgrounds.argmax())]

    def missed(self, some: BoolArray) -> float:
        """Probability that there is one more inclusion among some of the hypotheses (j,), if only these are
        possible."""
        weight = np.where(self.open & some, self._hypotheses.weight, 0.0)
        if not weight.sum() > 0.0:
            return 0.0
        whole = self._hypotheses.weight[some].sum()
        log_odds = np.log(max(weight.sum() / whole, 1e-300)) + _normalised(weight, self.odds_log)[1]
        return float(expit(log_odds + np.log(EXISTS / (1.0 - EXISTS))))


class InclusionPosterior:
    """Posterior of inclusions given touches of a surface; each touch makes a new posterior. touches; found: inclusions,
    in the order in which they explain most; state: state of the remaining part"""

    def __init__(self, grid: MapGrid, prior: InclusionPrior, touches: tuple[StiffnessSample, ...] = ()) -> None:
        self.grid, self.prior, self.touches = grid, prior, touches
        self.radii_m = prior.radii_m(grid.size_m)

    def with_touch(self, touch: StiffnessSample) -> "InclusionPosterior":
        """The posterior after one more touch."""
        return InclusionPosterior(self.grid, self.prior, (*self.touches, touch))

    @cached_property
    def hypotheses(self) -> InclusionHypotheses:
        return InclusionHypotheses.on(self.grid.size_m, self.radii_m)

    @property
    def places_m(self) -> FloatArray:
        """Places (t, 2) of the touches."""
        return np.array([touch.xy_m for touch in self.touches]).reshape(-1, 2)

    @cached_property
    def contact_m(self) -> float:
        """Radius of the contact on foam like that of most touches."""
        if not self.touches:
            return 0.8 * self.prior.tip_radius_m
        level = float(np.median([touch.log_stiffness for touch in self.touches]))
        dent_m = 1e-3 * self.prior.set_force_n / float(np.exp(level))
        return contact_radius(min(dent_m, self.prior.tip_radius_m), self.prior.tip_radius_m)

    @cached_property
    def shifts(self) -> InclusionShifts:
        """Effect of each hypothesis on the touches."""
        return self.hypotheses.shifts(self.places_m, self.contact_m)

    @cached_property
    def _search(self) -> tuple[tuple[FoundInclusion, ...], InclusionState]:
        hypotheses, shifts, left = self.hypotheses, self.shifts, LeftOver.of(self.touches)
        found: list[FoundInclusion] = []
        open_ = np.ones(len(hypotheses), dtype=bool)
        while True:
            state = InclusionState(hypotheses, shifts, left, open_)
            one = self._found(state)
            if one is None or len(found) == MOST_FOUND:
                return tuple(found), state
            found.append(one)
            left = left.without(shifts, one.posterior)
            away = np.linalg.norm(hypotheses.centre_m - one.centre_m, axis=1)
            open_ = open_ & (away > hypotheses.radius_m + one.radius_m)

    @property
    def found(self) -> tuple[FoundInclusion, ...]:
        return self._search[0]

    @property
    def state(self) -> InclusionState:
        return self._search[1]

    def _found(self, state: InclusionState) -> FoundInclusion | None:
        """The inclusion that is left, where there is one, and its place is known."""
        hypotheses, weight = self.hypotheses, state.posterior
        if state.exists < FOUND:
            return None
        centre = weight @ hypotheses.centre_m
        away = np.linalg.norm(hypotheses.centre_m - centre, axis=1)
        radius_m = float(weight @ hypotheses.radius_m)
        if weight[away <= radius_m].sum() < LOCALISED:
            return None
        order = np.argsort(away, kind="stable")
        within_m = float(away[order][np.searchsorted(np.cumsum(weight[order]), 0.9)])
        shares = np.array([weight[hypotheses.radius_m == one].sum() for one in self.radii_m])
        return FoundInclusion(
            centre_m=centre,
            within_m=max(within_m, 0.5 * CENTRE_CELL_M),
            radius_m=radius_m,
            radius_interval_m=_interval(np.array(self.radii_m), shares),
            stiff=bool(weight[hypotheses.share > 0.0].sum() > 0.5),
            probability=state.exists,
            deep=float(weight[hypotheses.depth_m > DEEP_M].sum()),
            posterior=weight,
        )

    # What is missed ---------------------------------------------------------------------------------------------------

    @cached_property
    def missed_smallest(self) -> float:
        """The largest probability of `missed`, of the smallest radius that must not be missed and of larger ones."""
        return float(self.missed[np.array(self.radii_m) >= self.prior.smallest_m].max())

    @cached_property
    def missed(self) -> FloatArray:
        """(r,) probability that there is a further inclusion of each of `radii_m`, were inclusions of this radius alone
        there."""
        return np.array([self.state.missed(self.hypotheses.radius_m == one) for one in self.radii_m])

    @cached_property
    def covered(self) -> FloatArray:
        """(rows, columns) probability that a cell lies above an inclusion, found or not."""
        centres, clear = self.grid.centres_m, np.ones(len(self.grid.centres_m))
        each = [*((one.posterior, one.probability) for one in self.found), (self.state.posterior, self.state.exists)]
        for weight in (posterior * probability for posterior, probability in each):
            clear *= 1.0 - np.minimum(self._above(weight, centres), 1.0)
        return (1.0 - clear).reshape(self.grid.shape)

    def _above(self, weight: FloatArray, cells_m: FloatArray) -> FloatArray:
        """(c,) weight (j,) of the guesses that cells (c, 2) lie above."""
        hypotheses, found = self.hypotheses, np.zeros(len(cells_m))
        for radius_m in self.radii_m:
            mine = hypotheses.radius_m == radius_m
            centre, of_centre = np.unique(hypotheses.centre_m[mine], axis=0, return_inverse=True)
            found += (cdist(cells_m, centre) < radius_m) @ np.bincount(of_centre.ravel(), weight[mine])
        return found

    def inclusions(self, truth_m: FloatArray | None = None) -> InclusionsResult:
        """The reported result. truth_m: (m, 4) x, y, radius, depth of each [m], where these are known"""
        found = self.found
        return InclusionsResult(
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
        """Standard deviation of the foam's log stiffness from place to place."""
        return float(np.sqrt(self.state.backgrounds @ [one.scatter**2 for one in BACKGROUNDS]))

    # As maps ----------------------------------------------------------------------------------------------------------

    @property
    def probability(self) -> dict[str, float]:
        """Probability of the number of regions: the foam and the inclusions that were found, or one more."""
        count, more = len(self.found) + 1, self.state.exists
        return {str(count): 1.0 - more, str(count + 1): more}

    def region_map(self) -> RegionMap:
        """Foam and found inclusions as regions, softest first; the field is the foam's with the effect of found
        inclusions."""
        found, cells = self.found, self.grid.centres_m
        weights, variance = self.kriging(cells)
        field_log = weights @ self.state.left.read
        level, sd = [float(field_log.mean())], [float(np.sqrt(variance.mean()))]
        labels, sure = np.zeros(len(cells), dtype=np.int64), 1.0 - self.covered.ravel()
        for number, one in enumerate(found, start=1):
            shift = self.hypotheses.shifts(np.vstack([cells[::4], one.centre_m]), self.contact_m).log
            mean = shift @ one.posterior
            doubt = np.maximum(shift**2 @ one.posterior - mean**2, 0.0) + (FOOTPRINT_DOUBT * mean) ** 2
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
            scatter=self.scatter,
        )

    def kriging(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(p, t) weights of touches for one at places (p, 2), and (p,) remaining variance: of a scatter with known
        parameters."""
        background, places = self.state.background, self.places_m
        scatter2 = background.scatter**2
        if not len(places):
            return np.zeros((len(places_m), 0)), np.full(len(places_m), scatter2)
        across = scatter2 * background.shared(places_m, places) + LEVEL_SD**2
        mixed = self.state.left.noise + scatter2 * background.related(places) + LEVEL_SD**2
        weights = cho_solve(cho_factor(mixed), across.T).T
        spare = scatter2 + LEVEL_SD**2 - (weights * across).sum(axis=1)
        return weights, np.maximum(spare, LEAST_SD**2)


def _normalised(weight: FloatArray, log: FloatArray) -> tuple[FloatArray, float]:
    """weight times exp(log) (j,), 1 in all, and the logarithm of its mean over `weight`."""
    if not weight.sum() > 0.0:
        return np.zeros(len(weight)), -np.inf
    with np.errstate(divide="ignore"):
        every = np.log(weight / weight.sum()) + log
    total = float(logsumexp(every))
    return np.exp(every - total), total


def _interval(values: FloatArray, share: FloatArray) -> tuple[float, float]:
    """The 90 % interval of values (n,) on a grid, each as broad as the distance to its neighbours."""
    edges = np.concatenate([[1.5 * values[0] - 0.5 * values[1]], 0.5 * (values[1:] + values[:-1])])
    edges = np.append(edges, 1.5 * values[-1] - 0.5 * values[-2])
    low, high = np.interp([0.05, 0.95], np.append(0.0, np.cumsum(share)), edges)
    return float(low), float(high)
