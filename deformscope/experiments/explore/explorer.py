"""Computation of an exploration: pure stages in their order, the same every time.

If a stage fails on one touch, only its result is missing. The failure is a result like the others (`StageFailure`), and
the exploration continues with the usable touches, until too many in a row fail.

A measured touch is fitted by its contact and its creep, which give its reported estimate. Before it is made there is a
forecast of it."""

import dataclasses
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.beta_fit import BetaEstimate, fit_beta
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import Geometry, Touch
from deformscope.experiments.explore.search import SurfaceSearch
from deformscope.experiments.explore.seen_surface import SeenSurface
from deformscope.processes import release_memory
from deformscope.robot.setup import Truth
from deformscope.robot.travel import NotThere
from deformscope.session import measuring
from deformscope.stages.map.exploration import (
    InclusionsResult,
    MapEstimate,
    PlannedTouch,
    StageFailure,
    SurfaceEstimate,
    TouchEstimate,
    TouchForecast,
)
from deformscope.stages.map.field import BETA_PRIOR, fit_field
from deformscope.stages.map.map_score import boundary_distance, called_labels, match_regions
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.map.perception import Perception, TouchPerception, TrainedField
from deformscope.stages.map.plan import ALLOWED
from deformscope.stages.poke.contact import EXPONENT, Z_90, ArmCompliance, ContactFit, fit_approach, fitted_law
from deformscope.stages.poke.creep import CreepFit, fit_creep
from deformscope.stages.poke.layer_seen import LayerModulus, modulus_of
from deformscope.stages.poke.local_shape import LocalShape, ShapeShift
from deformscope.stages.regions.posterior import RegionMap
from deformscope.stages.regions.touches import MapGrid, StiffnessSample, TouchErrorModel
from deformscope.stages.see.pixel_labels import SeenPixels

StageResult = TypeVar("StageResult")
Estimate = SurfaceEstimate | TouchEstimate | MapEstimate | InclusionsResult
Result = Estimate | PlannedTouch | TouchForecast | StageFailure | Perception
VETO_M = 0.03
"""A veto excludes places within this distance."""
SEEN_M = 0.01
"""A place counts as seen if a point of the surface was this near."""
BEFORE_A_MAP = ("contact", "creep", "regions", "maps")
"""Stages without which a touch gives no map."""
WAY = "way"
"""Stage of a failure that left a place out: there is no way to it within the workspace."""
FEWEST_FOR_FIELD = 2
"""Number of touches with a beta from which there is a field of beta."""
MOST_FAILED = 3
"""After this number of touches in a row without a map the exploration ends: the fault is then permanent."""
NEAR_M = 0.08
"""Points within this of a touch are shown with it."""
CLOCK_SD_S = 0.002
"""Standard deviation of the force's times relative to the arm's [s; assumed: a millisecond or two are left by
`calibrate time`]."""


@dataclass(frozen=True, slots=True)
class TouchContact:
    """fit; law_n: (n,) its force at each reading [N]; modulus: modulus of the layer, None where it is not known
    speed_m_s: speed of the tip's approach in contact, None if unknown
    level_n_per_mm: stiffness of a level layer of the stated thickness, None if the touched layer is level"""

    fit: ContactFit
    law_n: FloatArray
    modulus: LayerModulus | None
    speed_m_s: float | None
    level_n_per_mm: float | None = None


def fit_contact(
    touched: TouchMeasurement, surface: SeenSurface, search: SurfaceSearch, arm: ArmCompliance, error: TouchErrorModel
) -> TouchContact:
    """The contact of a touch. error: of its force; raises the errors of `fit_approach`"""
    options, along = surface.options, _along(touched)
    peak = int(np.argmax(_force_along(touched)))
    fit = fit_approach(
        touched.time_s,
        touched.position_m,
        touched.force_n,
        touched.normal,
        set_force_n=options.set_force_n,
        arm=arm,
        gain_sd=error.gain_sd,
        force_sd_n=error.noise_n or None,
        off_n=error.off_n,
        exponent_sd=search.exponent_sd,
        least_share=search.least_share,
    )
    law_n, modulus = fitted_law(fit, arm, along), None
    if not fit.rigid and fit.depth_m > 0.0:
        force = min(fit.at_force_n, fit.peak_force_n)
        dent_m, (low, high) = fit.dent_m(force), fit.interval_n_per_mm
        stiffness = 1e-3 * force / dent_m
        ends = stiffness * low / fit.stiffness_n_per_mm, stiffness * high / fit.stiffness_n_per_mm
        radius_m = options.tip_radius_m
        modulus = modulus_of(surface.layer, stiffness, ends, force_n=force, radius_m=radius_m, dent_m=dent_m)
    # speed of the tip from contact to the peak of the force
    began = min(int(np.searchsorted(np.maximum.accumulate(along), fit.contact_m)), max(peak - 1, 0))
    taken_s = float(touched.time_s[peak] - touched.time_s[began])
    speed_m_s = float(along[peak] - along[began]) / taken_s if taken_s > 0.0 else None
    return TouchContact(fit, law_n, modulus, speed_m_s)


def fit_touch_creep(
    touched: TouchMeasurement, surface: SeenSurface, arm: ArmCompliance, off_n: float = 0.0
) -> CreepFit | None:
    """Creep of a touch with a hold; None for any other. off_n: deviation of the force's offset [N]"""
    if touched.loading is None or touched.held is None:
        return None
    return fit_creep(
        touched.time_s,
        touched.position_m,
        touched.force_n,
        touched.normal,
        loading=touched.loading,
        held=touched.held,
        set_force_n=surface.options.set_force_n,
        arm=arm,
        radius_m=surface.options.tip_radius_m,
        clock_sd_s=CLOCK_SD_S,
        off_n=off_n,
    )


def touch_estimate(
    touched: TouchMeasurement,
    *,
    number: int,
    height_m: float | None,
    contact: TouchContact | None,
    creep: CreepFit | None,
    beta: BetaEstimate,
    shape: LocalShape | None,
    tip_radius_m: float,
) -> TouchEstimate:
    """The reported estimate of a touch. number: from 1; height_m: observed height of the surface there, None = not
    seen; known: the surface's height is known: it is the lowest place of the tip; contact: the fitted contact, None if
    it could not be fitted"""
    along, force_n, nan = _along(touched), _force_along(touched), float("nan")
    lowest_m = float(touched.position_m[:, 2].min()) - tip_radius_m
    near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < NEAR_M if len(touched.after_m) else []
    fit, modulus = (None, None) if contact is None else (contact.fit, contact.modulus)
    return TouchEstimate(
        number=number,
        xyz_m=np.append(touched.xy_m, lowest_m if height_m is None else height_m),
        normal=touched.normal / np.linalg.norm(touched.normal),
        approach_m=along - along[0],
        approach_n=force_n,
        fitted_n=np.full(len(along), nan) if contact is None else contact.law_n,
        contact_m=nan if fit is None else fit.contact_m - along[0],
        stiffness_n_per_mm=nan if fit is None else fit.stiffness_n_per_mm,
        stiffness_interval=(nan, nan) if fit is None else fit.interval_n_per_mm,
        rigid=False if fit is None else fit.rigid,
        modulus_pa=None if modulus is None else modulus.pa,
        modulus_interval_pa=None if modulus is None else modulus.interval_pa,
        depth_m=nan if fit is None else fit.dent_m(fit.peak_force_n),
        peak_force_n=float(force_n.max()) if fit is None else fit.peak_force_n,
        peak_rate_n_per_s=None if fit is None else fit.peak_rate_n_per_s,
        peak_rate_interval_n_per_s=None if fit is None else fit.peak_rate_interval_n_per_s,
        beta=beta.value,
        beta_interval=beta.interval,
        beta_verdict=beta.verdict,
        observed_m=touched.after_m[near],
        simulated_m=beta.simulated_m,
        creep=creep,
        thickness_m=None if shape is None else shape.thickness_m,
        level_n_per_mm=None if contact is None else contact.level_n_per_mm,
        speed_m_s=None if contact is None else contact.speed_m_s,
    )


def _along(touched: TouchMeasurement) -> FloatArray:
    """(n,) way of the tip into the surface [m]."""
    return np.asarray(-(touched.position_m @ touched.normal) / np.linalg.norm(touched.normal))


def _force_along(touched: TouchMeasurement) -> FloatArray:
    """(n,) force out of the surface [N]."""
    return np.asarray(touched.force_n @ touched.normal / np.linalg.norm(touched.normal))


FORCES = 25
"""Number of points of the depth forecast."""


def forecast_touch(
    touch: Touch,
    options: ExploreOptions,
    *,
    log_stiffness: float,
    log_sd: float,
    exponent: float,
    shift: ShapeShift | None,
    touches: int,
) -> TouchForecast:
    """Forecast of a touch where the map has this log stiffness [N/mm], with the deviation of one touch's measurement.
    exponent: exponent of the law of force over depth; shift: as in `SeenSurface.shift`; touches: touches made so far"""
    if shift is not None:
        log_stiffness -= shift.log
    forces = np.linspace(0.0, options.set_force_n, FORCES)
    share = (forces / options.set_force_n) ** (1.0 / exponent)
    stiffness, low, high = (float(np.exp(log_stiffness + sds * log_sd)) for sds in (0.0, -Z_90, Z_90))
    depth_m, deepest_m, least_m = (1e-3 * options.set_force_n / one * share for one in (stiffness, low, high))
    at = np.append(touch.xy_m, touch.height_m)
    above_m = at + (options if touch.plan is None else touch.plan).standoff_m * touch.normal
    crossing_m = above_m[2] if touch.plan is None else touch.plan.travel_height_m - options.tip_radius_m
    over_m = np.append(above_m[:2], max(above_m[2], crossing_m))
    return TouchForecast(
        xyz_m=at,
        normal=touch.normal,
        way_m=np.array([over_m, above_m, at]),
        set_force_n=options.set_force_n,
        stiffness_n_per_mm=stiffness,
        stiffness_interval=(low, high),
        force_n=forces,
        depth_m=depth_m,
        depth_low_m=least_m,
        depth_high_m=deepest_m,
        touches=touches,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Computed:
    """Results of one computation of an exploration.

    results: results in their order; touch: the next touch, None if there is none; given_up: why further touches are
    useless; region_probability: probability of each number of regions; seconds: computing time; refused: why a place
    cannot be touched"""

    results: tuple[Result, ...]
    touch: Touch | None = None
    given_up: str = ""
    region_probability: dict[str, float] | None = None
    seconds: float = 0.0
    refused: str = ""


class ExplorationStages:
    """The computations of `explore`, from the look on, with the geometry of its robot."""

    def __init__(self, unseen: "UnseenSurface", geometry: Geometry) -> None:
        self.geometry, self.unseen = geometry, unseen
        self._explorer: Explorer | None = None
        self._reachable: BoolArray | None = None
        self._vetoed: list[FloatArray] = []
        self._no_way: list[FloatArray] = []
        self._reported = 0

    @property
    def explorer(self) -> "Explorer":
        """The explorer of the surface that the look measured. The explorer of the surface. Raises InputError before a
        look."""
        if self._explorer is None:
            raise InputError("a look at the surface first", "none")
        return self._explorer

    def look(self, looked: Any) -> Computed:
        """The surface before any touch."""
        began, unseen = time.perf_counter(), self.unseen
        seen = _guarded("surface", 0, lambda: unseen.look(self.geometry.look(looked)), unseen.failed)
        if isinstance(seen, StageFailure):
            return Computed((seen,), seconds=time.perf_counter() - began)
        self._explorer = seen
        return self._computed((seen.surface.estimate, *_present(seen.surface.perception)), began)

    def plan(self) -> Computed:
        """The next touch, and its path; none if the goal is reached, or nothing can be planned any more."""
        began = time.perf_counter()
        explorer = self.explorer
        plan, touch = None, None
        while not explorer.given_up:
            allowed = self._reached()
            for xy_m in (*self._vetoed, *self._no_way):
                away_m = np.hypot(*(explorer.grid.centres_m - xy_m).T)
                allowed = allowed & (away_m >= VETO_M).reshape(explorer.grid.shape)
            plan = explorer.next(allowed)
            if plan is None or plan.target_m is None:
                break
            try:
                touch = explorer.approach(plan.target_m, self.geometry)
                break
            except NotThere as error:  # left out, until the arm has moved
                self._no_way.append(plan.target_m)
                where = f"({100 * plan.target_m[0]:.0f}, {100 * plan.target_m[1]:.0f}) cm is left out: "
                explorer.failures.append(
                    StageFailure(stage=WAY, touch=len(explorer.touches), reason=f"{where}{error}", trace="")
                )
        return self._computed(_present(plan), began, touch)

    def veto(self, xy_m: FloatArray) -> Computed:
        """Plan again; from now on a place (2,) [m] and its surroundings are excluded."""
        self._vetoed.append(xy_m)
        return self.plan()

    def aim(self, xy_m: FloatArray) -> Computed:
        """The plan of a touch at a place (2,) [m], and its forecast; or the reason why it is impossible."""
        began = time.perf_counter()
        touch, forecast = None, None
        try:
            refused = self._refusal(xy_m)
            if not refused:
                touch = self.explorer.approached(xy_m, self.geometry)
                forecast = self.explorer.forecast(touch)
        except InputError as error:
            refused = str(error)
        return dataclasses.replace(self._computed(_present(forecast), began, touch), refused=refused)

    def _refusal(self, xy_m: FloatArray) -> str:
        """Why a place (2,) [m] cannot be touched; empty where it can."""
        grid = self.explorer.grid
        x_cm, y_cm = (100.0 * value for value in grid.size_m)
        if not ((xy_m > 0.0) & (xy_m < grid.size_m)).all():
            return f"it is outside the surface, which has {x_cm:g} by {y_cm:g} cm"
        border_m = self.explorer.options.border_m
        if not ((xy_m > border_m) & (xy_m < np.asarray(grid.size_m) - border_m)).all():
            return f"it is within {100 * border_m:g} cm of the surface's edge"
        seen_m = self.explorer.surface.points_m
        if not len(seen_m) or float(np.hypot(*(seen_m[:, :2] - xy_m).T).min()) > SEEN_M:
            return f"the camera measured no surface there: no point within {1e3 * SEEN_M:g} mm"
        cell = tuple((xy_m[::-1] / grid.cell_m).astype(int))
        return "" if self._reached()[cell] else "the arm cannot reach it from above"

    def _reached(self) -> BoolArray:
        if self._reachable is None:
            self._reachable = self.geometry.reachable(self.explorer.grid)
        return self._reachable

    def touch(self, touched: Any) -> Computed:
        """The result of a touch, and the maps after it."""
        began = time.perf_counter()
        made = self.geometry.touch(touched)
        self._no_way.clear()  # from here there may be one
        estimate, perception, maps, inclusions = self.explorer.touch(made, lambda: self.geometry.dent(touched))
        every = (estimate, perception, made.force_pose, maps, inclusions)
        release_memory()  # of a process of its own, or on a simulated clock: nothing waits for it
        return self._computed(tuple(one for one in every if one is not None), began)

    def _computed(self, results: tuple[Result, ...], began: float, touch: Touch | None = None) -> Computed:
        explorer = self.explorer
        failed = tuple(explorer.failures[self._reported :])
        self._reported = len(explorer.failures)
        seconds = time.perf_counter() - began
        return Computed(
            results=(*results, *failed),
            touch=touch,
            given_up=explorer.given_up,
            region_probability=explorer.region_probability,
            seconds=seconds,
        )


def _present(result: StageResult | None) -> tuple[StageResult, ...]:
    return () if result is None else (result,)


class UnseenSurface:
    """An exploration before its look at the surface: only the `Explorer` that a look returns accepts touches.

    failed: recorded failures by touch and stage"""

    def __init__(
        self,
        size_m: tuple[float, float],
        options: ExploreOptions,
        arm: ArmCompliance,
        truth: Truth | None = None,
        failed: Collection[StageFailure] = (),
        error: TouchErrorModel | None = None,
    ) -> None:
        """failed: is not computed again, and fails as recorded; error: error model of touches, default that of a rig
        that is not calibrated"""
        error = error or TouchErrorModel()
        self.options, self.arm, self.error, self.truth = options, arm, error, truth
        self.grid = MapGrid(size_m, options.cell_m)
        self.search: SurfaceSearch = options.search(self.grid, error)
        self.failed = {(one.touch, one.stage): one for one in failed}

    def look(self, looked: SurfaceMeasurement) -> "Explorer":
        """Add the surface before any touch. Raises InputError if it cannot be fitted."""
        return Explorer(
            self, SeenSurface.of(looked, self.grid, self.options, on_level_layer=self.search.on_level_layer)
        )


class Explorer:
    """The estimates after each touch of a measured surface; its only state is the input so far.

    surface: the surface that the look measured; search: the goal, and its posterior by the usable touches
    touches, betas: estimates and betas of all touches made
    maps: the newest maps, None before the first touch; region_probability: probability of each number of regions
    failures: every stage that failed; travel_m: travel over the surface from its corner (0, 0), from place to place"""

    def __init__(self, unseen: UnseenSurface, surface: SeenSurface) -> None:
        self.options, self.grid, self.search = unseen.options, unseen.grid, unseen.search
        self.surface = surface
        self.touches: list[TouchEstimate] = []
        self.betas: list[BetaEstimate] = []
        self.maps: MapEstimate | None = None
        self.region_probability: dict[str, float] | None = None
        self.failures: list[StageFailure] = []
        self.travel_m = 0.0
        self._arm, self._error, self._truth = unseen.arm, unseen.error, unseen.truth
        self._quantity = unseen.options.quantity
        self._exponents: list[float] = []
        self._failed_before = unseen.failed
        self._touch = 0
        self._left_out: list[FloatArray] = []
        self._without_map = 0
        self._off_seen_m = 0.0
        self._trained: TrainedField | None = None

    @property
    def given_up(self) -> str:
        """Why further touches are useless; empty if they are useful."""
        if self._without_map < MOST_FAILED:
            return ""
        last = next((one for one in reversed(self.failures) if one.stage in BEFORE_A_MAP), None)
        why = "no touch held its force long enough" if last is None else f"the last for {last.stage}: {last.reason}"
        return f"{self._without_map} touches in a row gave no map, {why}"

    # The next touch ---------------------------------------------------------------------------------------------------

    def next(self, reachable: BoolArray | None = None) -> PlannedTouch | None:
        """The next touch, and its reason; None if it could not be planned. reachable: (rows, columns) mask"""
        return self._stage("plan", lambda: self._plan(reachable))

    def _plan(self, reachable: BoolArray | None) -> PlannedTouch:
        options, touches = self.options, len(self.touches)
        plan = self.search.planner()(
            options=options.planning,
            tip_m=self.touches[-1].xyz_m[:2] if self.touches else None,
            left_out_m=np.reshape(self._left_out, (-1, 2)),
            reachable=reachable,
        )
        if options.first_m is not None and not self.touches and not self._left_out:
            xy_m = np.array(options.first_m)
            cell = int(np.argmin(np.linalg.norm(self.grid.centres_m - xy_m, axis=1)))
            if reachable is not None and not reachable.ravel()[cell]:
                raise InputError("--first at a place that the tip can reach", f"{xy_m[0]:g},{xy_m[1]:g}", "another one")
            plan = dataclasses.replace(plan, target_m=xy_m, reason="as asked for", stop=None)
        enough = plan.stop is not None and not (options.go_on and touches < options.budget)
        return PlannedTouch(
            target_m=None if enough else plan.target_m,
            gain=plan.gain,
            cost_s=plan.cost_s,
            excluded=plan.excluded != ALLOWED,
            reason=plan.reason,
            stop_reason=plan.stop or "",
            missed=plan.missed,
            gain_unit=plan.unit,
        )

    def approach(self, xy_m: FloatArray, geometry: Geometry) -> Touch | None:
        """The planned touch of a place (2,) [m]; None if it cannot be planned."""
        return self._stage("plan", lambda: self.approached(xy_m, geometry))

    def approached(self, xy_m: FloatArray, geometry: Geometry) -> Touch:
        """The touch of a place (2,) [m]. Raises InputError if it cannot be made."""
        return geometry.approach(xy_m, *self.surface.aim(xy_m), self.over_m(xy_m), self.known_m(xy_m))

    def over_m(self, xy_m: FloatArray) -> float | None:
        """Greatest height of the surface on the straight path from the last touch to a place (2,) [m]; None before the
        first touch."""
        return self.surface.highest_m(self.touches[-1].xyz_m[:2], xy_m) if self.touches else None

    def known_m(self, xy_m: FloatArray) -> float | None:
        """Uncertainty of the surface's height at a place (2,) [m]: the largest deviation of a contact from the observed
        height, and the process's deviation. How well the height of an observed place is known; None before the first
        touch."""
        doubt_m = self.surface.doubt_m(xy_m)
        return None if not self.touches and doubt_m <= SEEN_M else self._off_seen_m + doubt_m

    def forecast(self, touch: Touch) -> TouchForecast:
        """The forecast of a touch: the map's stiffness there, with the exponent of the touches so far."""
        options = self.options
        row, column = (touch.xy_m[::-1] / self.grid.cell_m).astype(int)
        field, field_sd = self.region_map.field, self.region_map.field_sd
        return forecast_touch(
            touch,
            options,
            log_stiffness=float(field[row, column]),
            log_sd=float(np.hypot(field_sd[row, column], self.search.posterior.prior.error.touch_sd)),
            exponent=float(np.mean(self._exponents)) if self._exponents else EXPONENT["sphere"],
            shift=self.surface.shift(touch.xy_m, float(np.exp(field[row, column]))),
            touches=len(self.touches),
        )

    # A touch ----------------------------------------------------------------------------------------------------------

    def touch(
        self, touched: TouchMeasurement, dent: Callable[[], tuple[FloatArray, SeenPixels | None]] | None = None
    ) -> tuple[TouchEstimate, TouchPerception | None, MapEstimate | None, InclusionsResult | None]:
        """Add a touch, and update the map; returns its estimate, its perception, and the maps and inclusions after it.

        dent: computes its `after_m` and `pixels`, if they are not known yet"""
        self._touch = len(self.touches) + 1
        if dent is not None and (seen := self._stage("dent", dent)) is not None:
            touched = dataclasses.replace(touched, after_m=seen[0], pixels=seen[1])
        approach = touched.approach
        before = self.touches[-1].xyz_m[:2] if self.touches else np.zeros(2)
        self.travel_m += float(np.hypot(*(touched.xy_m - before)))
        contact = self._stage(
            "contact", lambda: fit_contact(approach, self.surface, self.search, self._arm, self._error)
        )
        creep, search, sample, self._trained = None, None, None, None
        if contact is not None:
            if not contact.fit.rigid:
                creep = self._stage(
                    "creep", lambda: fit_touch_creep(touched, self.surface, self._arm, self._error.off_n)
                )
            contact, sample = self._sample(approach, contact, creep)
            if sample is not None:
                search = self._stage("regions", partial(self.search.with_touch, sample))
            if not contact.fit.rigid:
                self._exponents.append(contact.fit.exponent)
        if search is None:
            self._left_out.append(touched.xy_m)
        else:
            self.search = search
        estimate = self._estimate(approach, contact, creep)
        began_m = float((approach.position_m[0] - estimate.xyz_m) @ estimate.normal)
        off_m = abs(began_m - estimate.contact_m - self.options.tip_radius_m)  # NaN without a contact
        self._off_seen_m = max(self._off_seen_m, off_m if np.isfinite(off_m) else float("inf"))
        self.touches.append(estimate)
        maps = None if search is None else self._stage("maps", self._maps)
        self._without_map = self._without_map + 1 if maps is None else 0
        if maps is not None:
            self.maps, self.region_probability = maps, self.region_map.probability
        truth_m = None if self._truth is None else self._truth.inclusions_m
        found = None if search is None else self._stage("lumps", lambda: self.search.inclusions(truth_m))
        return estimate, self._perception(touched, sample), maps, found

    def _perception(self, touched: TouchMeasurement, sample: StiffnessSample | None) -> TouchPerception | None:
        """Perception of the newest touch, with the training data of its maps; None unless requested."""
        if not self.options.perception:
            return None
        beta = self.betas[-1]
        return TouchPerception(
            number=len(self.touches),
            masks=None if touched.pixels is None else touched.pixels.masks(),
            error=beta.curve,
            estimate=beta.value,
            stiffness=sample,
            beta=self._trained,
        )

    def _sample(
        self, touched: TouchMeasurement, contact: TouchContact, creep: CreepFit | None
    ) -> tuple[TouchContact, StiffnessSample | None]:
        """A touch's sample for the map, None without the mapped quantity; and its contact, on the level layer."""
        measured = self.search.sample(touched.xy_m, contact.fit)
        stiffness = self._stage("creep", lambda: self._quantity.stiffness(measured, creep, contact.speed_m_s))
        if stiffness is None:
            return contact, None
        shift = None
        if not contact.fit.rigid:
            shift = self.surface.shift(touched.xy_m, float(np.exp(stiffness.log_stiffness)))
        if shift is not None:
            stiffness, level, modulus = self.surface.levelled(stiffness, contact.fit, shift)
            contact = dataclasses.replace(contact, level_n_per_mm=level, modulus=modulus)
        return contact, stiffness

    def _estimate(
        self, touched: TouchMeasurement, contact: TouchContact | None, creep: CreepFit | None
    ) -> TouchEstimate:
        aimed = self._stage("surface", lambda: self.surface.aim(touched.xy_m))
        beta = BetaEstimate("not fitted: no contact")
        if contact is not None:
            fit = contact.fit
            fitted = self._stage("beta", lambda: fit_beta(touched, fit, self.surface, self._arm, self.options))
            beta = fitted or BetaEstimate(f"not fitted: {self.failures[-1].reason}")
        self.betas.append(beta)
        return touch_estimate(
            touched,
            number=len(self.touches) + 1,
            height_m=None if aimed is None else aimed[0],
            contact=contact,
            creep=creep,
            beta=beta,
            shape=self._stage("surface", lambda: self.surface.shape(touched.xy_m)),
            tip_radius_m=self.options.tip_radius_m,
        )

    # The maps ---------------------------------------------------------------------------------------------------------

    @property
    def region_map(self) -> RegionMap:
        """Regions with their levels and intervals, computed once for each touch."""
        return self.search.region_map

    def _maps(self) -> MapEstimate:
        found, surface = self.region_map, self.surface
        beta, beta_sd, self._trained = self._stage("beta field", self._beta_field) or (None, None, None)
        truth = None if self._truth is None else self._truth.labels
        maps = MapEstimate(
            touches=len(self.touches),
            cell_m=self.grid.cell_m,
            stiffness_n_per_mm=np.exp(found.field),
            stiffness_log_sd=found.field_sd,
            beta=beta,
            beta_sd=beta_sd,
            labels=found.labels,
            label_probability=found.label_probability,
            region_count=found.region_count,
            at_least=found.at_least,
            verdict=found.verdict,
            probability=found.claimed,
            level_n_per_mm=np.exp(found.level),
            level_interval_n_per_mm=np.exp(found.level_interval),
            level_rigid=found.rigid,
            contacts_m=np.array([one.xyz_m[:2] for one in self.touches]),
            tip_radius_m=self.options.tip_radius_m,
            travel_m=self.travel_m,
            levelled_m=surface.layer.thickness_m if surface.levels else None,
            truth_labels=truth,
            iou=None if truth is None else match_regions(called_labels(found), truth)[0],
            boundary_m=None if truth is None else boundary_distance(called_labels(found), truth, self.grid.cell_m),
        )
        return surface.with_moduli(maps)

    def _beta_field(self) -> tuple[FloatArray, FloatArray, TrainedField] | None:
        """Mean and deviation (rows, columns) of the field of beta, and its training data; None with too few touches."""
        known = [
            (one.xyz_m[:2], beta.value, beta.sd)
            for one, beta in zip(self.touches, self.betas, strict=True)
            if beta.value is not None
        ]
        if len(known) < FEWEST_FOR_FIELD:
            return None
        places, values, sds = (np.array([one[part] for one in known], dtype=np.float64) for part in range(3))
        field = fit_field(places, values, np.where(np.isfinite(sds), sds, BETA_PRIOR.nugget), BETA_PRIOR)
        found = field.on(self.grid)
        trained = TrainedField(
            kernel=field.kernel,
            noise=field.nugget,
            place_m=field.places_m,
            value=field.value,
            weight=1.0 / (field.sd**2 + field.nugget**2),
        )
        return found.mean.clip(0.0, 1.0), found.deviation, trained

    def _stage(self, name: str, compute: Callable[[], StageResult]) -> StageResult | None:
        """Result of a stage; None after a failure, which `failures` then has. Raises NotThere for a place without a
        way."""
        result = _guarded(name, self._touch, compute, self._failed_before)
        if not isinstance(result, StageFailure):
            return result
        self.failures.append(result)
        return None


def _guarded(
    name: str, touch: int, compute: Callable[[], StageResult], failed: Mapping[tuple[int, str], StageFailure]
) -> StageResult | StageFailure:
    """Result of a stage, or its failure: the recorded one if there is one. Raises NotThere for a place without a
    way."""
    if (before := failed.get((touch, name))) is not None:
        return before
    try:
        with measuring(name):
            return compute()
    except NotThere:
        raise
    except Exception as error:  # whatever it is, the arm is over a table and the touches made are worth something
        return StageFailure.of(name, touch, error)
