"""`python -m studies regions`: how often a map's levels and its number of regions are right, on known surfaces.

python -m studies regions --objects 300 --jobs 8 --json -
python -m studies regions --objects 50 --scatter 0.08 --only "scatter 8 %"
python -m studies regions --objects 24 --touches 16 --only "4 materials"
python -m studies regions --objects 20 --touches 12 --only scenes

Do a map's probabilities and intervals hold? Explorations of known surfaces, touched in closed form.

A touch is the stiffness under its contact plus its errors (`LabErrors`, `touches`): no arm, no finite elements, so
that hundreds of explorations take minutes. Posterior, planner and stop rule are those of `explore`. Truths come from
the estimator's own prior (simulation-based calibration, Talts et al. 2018), and from scenes and errors that violate it.
"""

import dataclasses
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from scipy.stats import beta as beta_distribution
from threadpoolctl import threadpool_limits
from tyro.conf import arg

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import flags
from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_STIFFNESS_N_M
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors, SessionErrors
from deformscope.pictures.report import Table
from deformscope.stages.map.map_score import called_labels, match_regions
from deformscope.stages.map.plan import FieldKernel, PlanOptions, plan_touch
from deformscope.stages.regions.levels import RegionPrior
from deformscope.stages.regions.partitions import draw
from deformscope.stages.regions.posterior import SLOPES_PER_M, SMOOTH_LENGTHS_M, SMOOTH_SDS, RegionPosterior
from deformscope.stages.regions.touches import (
    LAW_SD,
    SCATTER_LENGTH_M,
    SCATTER_SHARED,
    MapGrid,
    StiffnessSample,
    TouchErrorModel,
)
from studies.independent.random_maps import random_surface
from studies.map_score import Z_90, TrueMap
from studies.quantities import Quantity, Rate, band, by, number, rows, share, table
from studies.reproduce.closed_form_table import FIT_SD, LOG_N_PER_MM_60
from studies.runner import Study, StudyOptions, StudyReport, Trials
from studies.seeds import INDEPENDENT, reported

SCENES = (
    *("homogeneous-60", "homogeneous-110", "two-60-150", "two-110-150", "three-60-110-200", "disc", "gradient"),
    *("wavy", "corner", "strip", "patches"),
)
"""Layouts of the laboratory, each as often; homogeneous ones as often as two regions, roughly."""

TOUCHES = 8
"""Number of touches that `explore` makes by default."""
CELL_M = 0.01
LOOKED_AT = (4, 8)
"""Touches after which layouts are counted too, besides the last."""
LAYOUTS = (
    *("homogeneous-60", "two-60-150", "three-60-110-200", "disc", "wavy", "zigzag"),
    *("gradient", "patches", "thin-thick", "ring", "strip", "corner"),
)
"""Scenes that are counted one by one."""
EXACT_SD = 0.01
"""Deviation of the touches of the oracle, which are exact otherwise."""
BLUR_M = (0.006, 0.009)
"""Blur of a contact; the estimator assumes 0.0075."""
BINS = 5
FIXED = 1.0

Truth = Literal["prior", "scenes", "maps"]


@dataclass(frozen=True, slots=True)
class RegionCondition:
    """Source of truths, and hidden errors of the session.

    errors: None draws scatter, gain and arm from the estimator's own prior; gain_at, arm_at: fixed at this number of
    their standard deviations, with the sign by the seed, instead of random; materials: on maps of an independent
    generator (`studies.independent.random_maps`), which has its own errors, 0 = a gradual change; scene: the only
    scene, for which an oracle touches the same places without errors"""

    name: str
    truth: Truth
    errors: LabErrors | None
    gain_at: float | None = None
    arm_at: float | None = None
    materials: int = 0
    scene: str = ""


def scattered(share: float) -> RegionCondition:
    """The laboratory with all its errors, and foam that scatters by this share."""
    return RegionCondition(f"scatter {100.0 * share:g} %", "scenes", LabErrors(scatter=(share, share)))


REGION_CONDITIONS = (
    RegionCondition("stated prior", "prior", None),
    *(scattered(share) for share in (0.03, 0.06, 0.10)),
    RegionCondition("gain off by 3 %", "scenes", LabErrors(), gain_at=FIXED),
    RegionCondition("arm off by a deviation", "scenes", LabErrors(), arm_at=FIXED),
    RegionCondition("scatter over 12 cm", "scenes", LabErrors(scatter_length_m=0.12)),
    RegionCondition("clean", "scenes", LabErrors.none()),
)
"""The first is the stated prior; then the laboratory with all its errors, one of them at a different value. The last
two violate the model on either side: a scatter that neighbours share, and none."""

INDEPENDENT_CONDITIONS = tuple(
    RegionCondition(f"{number} materials" if number else "gradual maps", "maps", LabErrors.none(), materials=number)
    for number in range(6)
)
"""Where nothing is shared with the estimator: maps, contacts and errors of their own."""

LAYOUT_CONDITIONS = tuple(RegionCondition(f"scene {name}", "scenes", LabErrors(), scene=name) for name in LAYOUTS)
"""Layouts of one scene, with all errors."""


@dataclass(frozen=True, slots=True)
class RegionCase:
    """One exploration: the condition, the seed, and touches at most."""

    condition: RegionCondition
    seed: int
    touches: int = TOUCHES


@dataclass(frozen=True, slots=True)
class RegionOutcome:
    """Outcome of one exploration.

    true_count: true number of regions, 0 where stiffness is gradual; count: as reported; claimed: probability of that
    levels, levels_covered: levels and levels covered of the true regions, where their number is right, and those in
    their 90 % intervals; level_z: (levels,) what is reported less the truth, in reported deviations;
    width: mean of the intervals of log stiffness; wrong_claimed, wrong: share of the surface with a wrong label, where
    the number is right and above 1; scatter: as learned; touches: made
    cells_held: share of the surface whose true log stiffness lies in the 90 % interval; at_least: reported as `count`
    or more
    met: true regions in which a touch was made: no other can be counted; places_m: places of
    touches; iou: mean overlap of regions, nan where stiffness is gradual; oracle: outcome of exact touches at the same
    places, None without one"""

    condition: str
    seed: int
    true_count: int
    count: int
    claimed: float
    probability: dict[str, float]
    levels: int
    levels_covered: int
    level_z: tuple[float, ...]
    width: float
    wrong_claimed: float
    wrong: float
    scatter_true: float
    scatter: float
    touches: int
    cells_held: float = np.nan
    at_least: bool = False
    met: int = 0
    places_m: tuple[tuple[float, float], ...] = ()
    iou: float = np.nan
    oracle: "RegionOutcome | None" = None

    @property
    def right(self) -> bool:
        """Whether the surface has as many as reported, or more if it reports "or more"."""
        return self.holds(self.true_count)

    def holds(self, count: int) -> bool:
        """Whether the report agrees with this number of regions."""
        return self.count == count or (self.at_least and count > self.count)


@dataclass(frozen=True)
class KnownSurface:
    """A surface and the session it is touched in.

    true: labels and levels; places_m: (p, 2) that can be touched; felt: (p,) log stiffness [N/mm] of a contact there,
    scatter in it; exact: (p,) without; gain: log of the force's; arm: deviations by which its compliance is off;
    own_sd: deviation of each touch alone"""

    true: TrueMap
    places_m: FloatArray
    felt: FloatArray
    exact: FloatArray
    gain: float
    arm: float
    scatter_sd: float
    seed: int

    @cached_property
    def _random(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, 77])

    def touch(self, xy_m: FloatArray, arm_doubt: float) -> StiffnessSample:
        """A touch at the nearest place (2,) [m]. arm_doubt: deviation of the compliance that its calibration states, as
        a share of it"""
        felt = float(self.felt[np.argmin(((self.places_m - xy_m) ** 2).sum(axis=1))])
        own_sd = float(np.hypot(LAW_SD, FIT_SD))
        bent = arm_doubt * 1e3 * np.exp(felt) / ARM_STIFFNESS_N_M  # k dC, for a deviation
        value = felt + self.gain + self.arm * bent + own_sd * float(self._random.standard_normal())
        return StiffnessSample(xy_m, float(value), own_sd, arm_sd=float(bent))

    def touch_exactly(self, xy_m: FloatArray) -> StiffnessSample:
        """A touch without errors at the nearest place (2,) [m]."""
        value = float(self.exact[np.argmin(((self.places_m - xy_m) ** 2).sum(axis=1))])
        return StiffnessSample(xy_m, value, EXACT_SD)


def known_surface(condition: RegionCondition, seed: int, prior: RegionPrior) -> KnownSurface:
    """The explored scene: the same for each seed."""
    if condition.truth == "maps":
        return _from_maps(condition.materials, seed)
    stream = zlib.crc32(condition.name.encode())  # sessions of two conditions have nothing in common
    rng = np.random.default_rng([seed, stream])
    grid, places_m = MapGrid(cell_m=CELL_M), MapGrid(cell_m=PlanOptions().cell_m).centres_m
    error = prior.error
    if condition.errors is None:
        scatter_sd = error.scatter_median * float(np.exp(error.scatter_spread * rng.standard_normal()))
        errors = replace(LabErrors(), scatter=(scatter_sd, scatter_sd), scatter_length_m=SCATTER_LENGTH_M)
        gain, arm = error.gain_sd * float(rng.standard_normal()), float(rng.standard_normal())
    else:
        errors = condition.errors
        sign = 1.0 if rng.random() < 0.5 else -1.0
        gain = errors.gain * (float(rng.standard_normal()) if condition.gain_at is None else sign * condition.gain_at)
        arm = float(rng.standard_normal()) if condition.arm_at is None else sign * condition.arm_at
        arm = arm if errors.arm > 0.0 else 0.0
    session = errors.draw([seed, stream])
    if condition.truth == "prior":
        true, felt = _from_prior(rng, prior, grid, places_m)
    else:
        name = condition.scene or SCENES[seed % len(SCENES)]
        true, felt = _from_scene(name, seed, grid, places_m, float(rng.uniform(*BLUR_M)))
    field = session.scatter(places_m)
    if condition.errors is None:  # as `TouchErrorModel` has it: neighbours share a part
        own = session.scatter_sd * rng.standard_normal(len(places_m))
        field = np.sqrt(SCATTER_SHARED) * field + np.sqrt(1.0 - SCATTER_SHARED) * own
    return KnownSurface(true, places_m, felt + field, felt, gain, arm, session.scatter_sd, seed)


def _from_maps(materials: int, seed: int) -> KnownSurface:
    """A surface of the independent generator."""
    grid, places_m = MapGrid(cell_m=CELL_M), MapGrid(cell_m=PlanOptions().cell_m).centres_m
    surface = random_surface(materials, INDEPENDENT.start + seed)
    felt = surface.felt(places_m)
    log_stiffness = surface.log_stiffness(grid.centres_m).reshape(grid.shape)
    true = TrueMap(None, np.zeros(0), np.zeros(0, dtype=bool), log_stiffness)
    if materials:
        true = _true(surface.labels(grid.centres_m).reshape(grid.shape), surface.level)
    return KnownSurface(
        true=true,
        places_m=places_m,
        felt=felt,
        exact=felt,
        gain=0.0,
        arm=0.0,
        scatter_sd=surface.scatter_sd,
        seed=INDEPENDENT.start + seed,
    )


def _from_prior(
    rng: np.random.Generator, prior: RegionPrior, grid: MapGrid, places_m: FloatArray
) -> tuple[TrueMap, FloatArray]:
    """A map of the prior, and the stiffness of contacts at places (p, 2): mixed where a contact covers two regions."""
    count = int(rng.choice(len(prior.regions) + 1, p=[*prior.regions, prior.gradual])) + 1
    if count > len(prior.regions):
        return _smooth(rng, prior, grid, places_m)
    level = prior.level_sd * rng.standard_normal(count)
    while count > 1 and np.diff(np.sort(level)).min() < prior.least_contrast:
        level = prior.level_sd * rng.standard_normal(count)
    level += LOG_N_PER_MM_60
    if count == 1:
        return _true(np.zeros(grid.shape, dtype=np.int64), level), np.full(len(places_m), level[0])
    maps = draw(rng, count, grid.size_m, 1)
    labels = maps.labels(grid.centres_m)[0].reshape(grid.shape).astype(np.int64)
    shares = maps.shares(places_m, prior.blur_m)[0]
    mixed = 2.0 * (1.0 - (shares**2).sum(axis=-1))
    off = prior.mixed_share * float(np.ptp(level)) * mixed * rng.standard_normal(len(places_m))
    return _true(labels, level), np.log(shares @ np.exp(level)) + off


def _smooth(
    rng: np.random.Generator, prior: RegionPrior, grid: MapGrid, places_m: FloatArray
) -> tuple[TrueMap, FloatArray]:
    """A plane, or a smooth random field, as the rival hypothesis has them."""
    kernels = [(slope, 0.0, 1.0) for slope in SLOPES_PER_M]
    kernels += [(0.0, sd, length) for sd in SMOOTH_SDS for length in SMOOTH_LENGTHS_M]
    slope, sd, length = kernels[rng.integers(len(kernels))]
    across = slope * rng.standard_normal(2)
    waves = replace(LabErrors.none(), scatter=(sd, sd), scatter_length_m=length) if sd else LabErrors.none()
    bend: SessionErrors = waves.draw(int(rng.integers(1 << 30)))
    level = LOG_N_PER_MM_60 + prior.level_sd * float(rng.standard_normal())
    middle = 0.5 * np.asarray(grid.size_m)

    def field(xy_m: FloatArray) -> FloatArray:
        return np.asarray(level + (xy_m - middle) @ across + bend.scatter(xy_m))

    log_stiffness = field(grid.centres_m).reshape(grid.shape)
    return TrueMap(None, np.zeros(0), np.zeros(0, dtype=bool), log_stiffness), field(places_m)


def _from_scene(name: str, seed: int, grid: MapGrid, places_m: FloatArray, blur_m: float) -> tuple[TrueMap, FloatArray]:
    """A layout of the laboratory; a contact averages stiffness over a Gaussian of `blur_m`."""
    scene = built_in(name, seed)
    node, weight = np.polynomial.hermite_e.hermegauss(7)
    around = np.stack(np.meshgrid(node, node), axis=-1).reshape(-1, 2) * blur_m
    share = np.outer(weight, weight).ravel() / weight.sum() ** 2
    reference = built_in("homogeneous-60").pieces[0].modulus_pa

    def field(xy_m: FloatArray) -> FloatArray:
        return np.asarray(LOG_N_PER_MM_60 + 2.0 / 3.0 * np.log(scene.modulus_pa(xy_m) / reference))

    felt = np.log(np.exp(field(places_m[:, None] + around)) @ share)
    if not scene.pieces:
        return TrueMap(None, np.zeros(0), np.zeros(0, dtype=bool), field(grid.centres_m).reshape(grid.shape)), felt
    moduli = np.array([piece.modulus_pa for piece in scene.pieces])
    level = LOG_N_PER_MM_60 + 2.0 / 3.0 * np.log(moduli / reference)
    return _true(scene.label(grid.centres_m).reshape(grid.shape), level), felt


def _true(labels: IntArray, level: FloatArray) -> TrueMap:
    return TrueMap(labels, level, np.zeros(len(level), dtype=bool), level[labels])


def explore_known(case: RegionCase) -> tuple[RegionOutcome, ...]:
    """One exploration, until the end of the plan; of a scene alone also what was found before."""
    condition, prior = case.condition, RegionPrior()
    surface = known_surface(condition, case.seed, prior)
    doubt = LabErrors().arm if condition.errors is None else condition.errors.arm or LabErrors().arm
    options = PlanOptions(budget=case.touches)
    posterior = RegionPosterior.before_touches(MapGrid(cell_m=CELL_M), prior, seed=case.seed)
    looked_at = (
        (*(one for one in LOOKED_AT if one < case.touches), case.touches) if condition.scene else (case.touches,)
    )
    error = TouchErrorModel(scatter_median=EXACT_SD, scatter_spread=0.0)
    exact = RegionPosterior.before_touches(posterior.grid, replace(prior, error=error), seed=case.seed)
    found: list[RegionOutcome] = []
    with threadpool_limits(1):
        while len(found) < len(looked_at):
            plan = plan_touch(posterior, FieldKernel(), options)
            ended = plan.stop is not None or plan.target_m is None
            while len(found) < len(looked_at) and (ended or len(posterior.touches) == looked_at[len(found)]):
                one = _outcome(case, surface, posterior)
                if condition.scene:
                    name = f"{condition.name}, {looked_at[len(found)]} touches"
                    one = replace(one, condition=name, oracle=_outcome(case, surface, exact))
                found.append(one)
            if plan.target_m is not None and not ended:
                posterior = posterior.with_touch(surface.touch(plan.target_m, doubt))
                if condition.scene:
                    exact = exact.with_touch(surface.touch_exactly(plan.target_m))
    return tuple(found)


def _outcome(case: RegionCase, surface: KnownSurface, posterior: RegionPosterior) -> RegionOutcome:
    """Of the map after all touches."""
    shown, truth = posterior.region_map(), surface.true
    same = shown.region_count == truth.region_count
    met = 0
    if truth.labels is not None:
        at = [np.argmin(((posterior.grid.centres_m - one.xy_m) ** 2).sum(axis=1)) for one in posterior.touches]
        met = len(np.unique(truth.labels.ravel()[at]))
    levels = covered = 0
    width = wrong = np.nan
    z: tuple[float, ...] = ()
    if same and truth.labels is not None:
        _, pairs = match_regions(shown.labels, truth.labels)
        inside = [
            shown.level_interval[one, 0] <= truth.level[true] <= shown.level_interval[one, 1] for one, true in pairs
        ]
        levels, covered = truth.region_count, int(np.sum(inside))
        z = tuple(float((shown.level[one] - truth.level[true]) / shown.level_sd[one]) for one, true in pairs)
        width = float(np.mean(np.diff(shown.level_interval, axis=1)))
        as_true = np.full(truth.region_count, -1)
        for one, true in pairs:
            as_true[one] = true
        wrong = float((as_true[shown.labels] != truth.labels).mean()) if truth.region_count > 1 else np.nan
    return RegionOutcome(
        condition=case.condition.name,
        seed=case.seed,
        true_count=truth.region_count,
        count=shown.region_count,
        claimed=shown.claimed,
        probability=dict(shown.probability),
        levels=levels,
        levels_covered=covered,
        level_z=z,
        width=width,
        wrong_claimed=shown.wrong_share if np.isfinite(wrong) else np.nan,
        wrong=wrong,
        scatter_true=surface.scatter_sd,
        scatter=shown.scatter,
        touches=len(posterior.touches),
        cells_held=float((np.abs(shown.field - truth.log_stiffness) <= Z_90 * shown.field_sd).mean()),
        at_least=shown.more_possible,
        met=met,
        places_m=tuple((float(x), float(y)) for x, y in (one.xy_m for one in posterior.touches)),
        iou=np.nan if truth.labels is None else match_regions(called_labels(shown), truth.labels)[0],
    )


# Figures of many -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Explorations whose claims are next to each other. claimed: mean probability of the number of regions; right: how
    many are right; band: 90 % binomial interval of the frequency (Clopper and Pearson 1934)"""

    cases: int
    claimed: float
    right: int
    band: tuple[float, float]

    @property
    def holds(self) -> bool:
        return self.band[0] <= self.claimed <= self.band[1]


def reliability(outcomes: Sequence[RegionOutcome], bins: int = BINS) -> list[ReliabilityBin]:
    """Claims against frequency, in bins of as many explorations each."""
    ordered = sorted(outcomes, key=lambda one: (one.claimed, one.seed))
    found = []
    for part in np.array_split(np.arange(len(ordered)), bins):
        some = [ordered[i] for i in part]
        if some:
            right = sum(one.right for one in some)
            found.append(
                ReliabilityBin(
                    len(some), float(np.mean([one.claimed for one in some])), right, clopper_pearson(right, len(some))
                )
            )
    return found


def clopper_pearson(hits: int, cases: int, level: float = 0.9) -> tuple[float, float]:
    """The binomial interval that is never too short."""
    tail = 0.5 * (1.0 - level)
    low = 0.0 if hits == 0 else float(beta_distribution.ppf(tail, hits, cases - hits + 1))
    high = 1.0 if hits == cases else float(beta_distribution.ppf(1.0 - tail, hits + 1, cases - hits))
    return low, high


# The study -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RegionCoverageConfig(StudyOptions):
    """Count how often a map's levels lie in their intervals, and its number of regions is right. Surfaces of known
    truth are drawn from the stated prior and from violations of it, touched in closed form and explored as `explore`
    does."""

    objects: Annotated[int, flags.least(5)] = 300
    """Explorations of each condition; each takes some 5 s of a core."""
    scatter: Annotated[float | None, arg(metavar="SHARE")] = None
    """One more condition: foam whose log stiffness scatters by this, such as 0.08."""
    only: Annotated[str, arg(metavar="NAME,NAME...")] = ""
    """These conditions alone, such as "stated prior,scatter 6 %"; also "gradual maps" and "1 materials" to
    "5 materials", which share nothing with the estimator, and "scenes": layouts of each scene, for claims and maps."""
    touches: flags.ManyFlag = 8
    """Touches of each exploration at most."""

    def check(self) -> None:
        if self.scatter is not None and not 0.0 < self.scatter < 1.0:
            raise InputError("a share above 0 and below 1 after --scatter", f"{self.scatter:g}", "0.08")


def _or_nan(figure: Callable[[list[float]], np.floating], values: Sequence[float]) -> float:
    """`figure` of the values that are known; nan without any."""
    known = [one for one in values if np.isfinite(one)]
    return float(figure(known)) if known else float("nan")


QUANTITIES: tuple[Quantity[Sequence[RegionOutcome]], ...] = (
    Quantity("condition", lambda some: some[0].condition, {"truths": str}),
    Quantity("objects", len, {"explored": int}),
    Quantity(
        "levels",
        lambda some: Rate(sum(one.levels for one in some), sum(one.levels_covered for one in some)),
        {"levels": lambda rate: rate.cases, "held": lambda rate: f"{rate.rate:.3f}", "95 % band": band(3)},
    ),
    Quantity("level_width", lambda some: _or_nan(np.median, [one.width for one in some]), {"width": number(3)}),
    Quantity("number_right", lambda some: Rate.of(one.right for one in some), {"number right": share(2)}),
    Quantity("same", lambda some: Rate.of(one.count == one.true_count for one in some), {"exactly": share(2)}),
    Quantity("met_right", lambda some: Rate.of(one.holds(one.met) for one in some), {"right of those met": share(2)}),
    Quantity("number_claimed", lambda some: float(np.mean([one.claimed for one in some])), {"claimed": number(2)}),
    Quantity(
        "true_number_probability",
        lambda some: float(np.mean([one.probability[str(one.true_count or "gradual")] for one in some])),
        {"P(true number)": number(2)},
    ),
    # of the surface with a wrong label, where the number is right and above 1
    Quantity("wrong_share", lambda some: _or_nan(np.mean, [one.wrong for one in some]), {"wrong share": number(3)}),
    Quantity(
        "wrong_share_claimed",
        lambda some: _or_nan(np.mean, [one.wrong_claimed for one in some]),
        {"claimed share": number(3)},
    ),
    Quantity("cells_held", lambda some: float(np.mean([one.cells_held for one in some])), {"cells held": number(2)}),
    Quantity("scatter_learned", lambda some: float(np.median([one.scatter for one in some]))),
    Quantity("touches", lambda some: float(np.mean([one.touches for one in some])), {"touches": number(1)}),
    Quantity("iou", lambda some: _or_nan(np.median, [one.iou for one in some]), {"IoU": number(2)}),
    Quantity(
        "oracle_right",
        lambda some: Rate.of(one.oracle.right for one in some if one.oracle),
        {"exact touches: number right": share(2)},
    ),
    Quantity(
        "oracle_claimed",
        lambda some: _or_nan(np.mean, [one.oracle.claimed for one in some if one.oracle]),
        {"claimed by these": number(2)},
    ),
    Quantity(
        "oracle_iou",
        lambda some: _or_nan(np.median, [one.oracle.iou for one in some if one.oracle]),
        {"IoU of these": number(2)},
    ),
)


def _conditions(options: RegionCoverageConfig) -> list[RegionCondition]:
    every = [*REGION_CONDITIONS, *INDEPENDENT_CONDITIONS, *LAYOUT_CONDITIONS]
    if options.scatter is not None and scattered(options.scatter) not in every:
        every.append(scattered(options.scatter))
    named = [name.strip() for name in options.only.split(",") if name.strip()]
    if "scenes" in named:
        named += [one.name for one in LAYOUT_CONDITIONS]
        named.remove("scenes")
    known = [one.name for one in every]
    if unknown := [name for name in named if name not in known]:
        raise InputError(f"conditions out of {', '.join(known)}", ", ".join(map(repr, unknown)), "leave --only out")
    return (
        [one for one in every if one.name in named]
        if named
        else [one for one in every if one.truth != "maps" and not one.scene]
    )


def trials(options: RegionCoverageConfig) -> list[Trials[RegionCase, tuple[RegionOutcome, ...]]]:
    """Every condition, seed by seed."""
    conditions = _conditions(options)
    seeds = reported(options.objects, options.output.seed)
    cases = [RegionCase(condition, seed, options.touches) for seed in seeds for condition in conditions]
    return [Trials("explorations", explore_known, cases)]


def report(options: RegionCoverageConfig, seconds: float, explored: Sequence[tuple[RegionOutcome, ...]]) -> StudyReport:
    """A line of each condition, and bins of what was claimed."""
    seeds, tried = reported(options.objects, options.output.seed), [one for outcomes in explored for one in outcomes]
    some = list(by(sorted(tried, key=_touches), lambda one: one.condition).values())
    truth = {one.name: one.truth for one in _conditions(options)}
    lines = rows(some, QUANTITIES)
    claims = {name: reliability(those) for name, those in by(tried, lambda one: one.condition.split(", ")[-1]).items()}
    title = "Levels in 90 % intervals where the number is right, and that number"
    tables = [table(lines, QUANTITIES, title), _bins_table(claims)]
    tables.append(Table([("all", f"{seconds:.0f} s")], caption="Time"))
    found = {
        "seeds": [seeds.start, seeds.stop - 1],
        "touches": options.touches,
        "conditions": [
            row
            | {
                "truth": truth[row["condition"].split(", ")[0]],
                "reliability": [dataclasses.asdict(one) | {"holds": one.holds} for one in reliability(those)],
            }
            for row, those in zip(lines, some, strict=True)
        ],
        "explorations": tried,
        "seconds": seconds,
    }
    return StudyReport(tables, found)


def _touches(one: RegionOutcome) -> int:
    """Touches in the name of its condition; 0 without."""
    return int(one.condition.split(", ")[1].split()[0]) if ", " in one.condition else 0


def _bins_table(claims: Mapping[str, Sequence[ReliabilityBin]]) -> Table:
    lines = [
        (
            *(name, one.cases, f"{one.claimed:.3f}", f"{one.right / one.cases:.3f}"),
            *(f"{one.band[0]:.3f} to {one.band[1]:.3f}", "yes" if one.holds else "no"),
        )
        for name, some in claims.items()
        for one in some
    ]
    names = ("truths", "explored", "claimed", "right", "90 % band", "holds the claim")
    return Table(lines, names, "Probability of the number of regions, in bins of as many explorations")


STUDY = Study(RegionCoverageConfig, trials, report)
