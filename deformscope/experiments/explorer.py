"""What is computed of an exploration: pure stages in their order, the same every time.

A stage that fails on one touch costs that stage's result: the failure is a result like the others (`StageFailure`), and
the exploration goes on with the touches that could be used, until too many in a row could not.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.experiments.measured import Looked, SetupGeometry, Touched, off_the_border
from deformscope.experiments.options import BORDER_M, PLAN_CELL_M, ExploreOptions
from deformscope.robot.setup import Truth
from deformscope.robot.touch import TouchPlan
from deformscope.robot.travel import NotThere
from deformscope.stages.map.exploration import (
    LumpsFound,
    MapEstimate,
    PlannedTouch,
    StageFailure,
    SurfaceEstimate,
    TouchEstimate,
    TouchForecast,
)
from deformscope.stages.map.field import BETA_PRIOR, fit_field, levels_of
from deformscope.stages.map.loss import by_loss, loss_sample
from deformscope.stages.map.lump_plan import plan_lump_touch
from deformscope.stages.map.lump_posterior import LumpPosterior, LumpPrior
from deformscope.stages.map.map_score import boundary_distance, called_labels, match_regions
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.map.plan import ALLOWED, FieldKernel, PlanOptions, plan_touch
from deformscope.stages.map.surface import HeightMap, HeightProcess, fit_surface
from deformscope.stages.map.thesis_field import FIRST_SHARE, ThesisField, contoured
from deformscope.stages.map.touch_beta import BallContact, SeenDent, dent_of, fit_touch, thesis_beta
from deformscope.stages.poke.contact import (
    EXPONENT,
    EXPONENT_SD,
    LOADED,
    Z_90,
    ArmCompliance,
    ContactFit,
    fit_approach,
)
from deformscope.stages.poke.creep import REFERENCE_SPEED_M_S, CreepFit, fit_creep
from deformscope.stages.poke.law_response import LEAST_SHARE
from deformscope.stages.poke.layer_seen import KnownLayer, LayerModulus, known_layer, modulus_of
from deformscope.stages.poke.local_shape import LocalShape, ShapeShift, shape_of, shape_shift
from deformscope.stages.regions.posterior import RegionMap, RegionPosterior, RegionPrior
from deformscope.stages.regions.touch_error import LAW_SD, TouchErrorModel
from deformscope.stages.regions.touches import MapGrid, StiffnessSample
from deformscope.stages.see.cloud import tactile_points
from deformscope_drivers.arms import chain_of

StageResult = TypeVar("StageResult")
Result = SurfaceEstimate | TouchEstimate | MapEstimate | LumpsFound | PlannedTouch | TouchForecast | StageFailure
NEAR_M = 0.08
"""Points within this of a touch are shown with it."""
FEWEST_FOR_FIELD = 2
BESIDE_M, SURE_SD = 0.02, 3.0
"""What the tip crosses is looked at this far beside its path, at its height plus so many deviations."""
LAW_STEPS = 400
"""Forces at which the fitted law is taken, from none to twice the largest."""
THESIS_ROI_M, TACTILE_NOISE_M = 0.08, 2e-4
VETO_M = 0.03
"""A veto leaves out what is so near."""
SEEN_M = 0.01
"""A place counts as seen where a point of the surface was, so near."""
LEAST_THICKNESS = 0.1
"""Of the stated thickness: no foam is taken for thinner."""
CURVED_OVER_M = 0.01
"""Curvature is taken over so far to either side: a tip of 1 cm feels no finer."""
FORECAST_STEPS = 25
"""Forces at which a touch is foretold."""
COSTS = {"careful": (6.0, 0.1), "quick": (4.0, 0.15)}
"""What the planner takes a touch for [s], and the speed of the way to it [m/s], by pace. Chosen: near enough to
what they take, and such that both paces weigh a touch and its way alike, and touch the same places."""
FREE_EXPONENT_SD = 0.3
"""Of the contact's exponent where lumps are sought, which show in it: next to nothing is taken for granted."""
SPEED_SD = 0.03
"""Of log stiffness for each e-fold of the approach speed, where a touch's creep could not be fitted: a third of a
modulus that relaxes evenly over three decades of time changes a ball's stiffness so [assumed]."""
CLOCK_SD_S = 0.002
"""Of the force's times against the arm's [assumed: a millisecond or two are left by `calibrate time`]."""
BEFORE_A_MAP = ("contact", "creep", "loss", "regions", "maps")
"""Stages without which a touch gives no map."""
WAY = "way"
"""Stage of a failure that left a place out: there is no way to it within the workspace."""
MOST_FAILED = 3
"""After so many touches in a row that gave no map the exploration ends: whatever is wrong does not pass by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A command: touch a place (2,) [m] whose surface was seen at this height, along this normal (3,).

    over_m: how high the surface may be on the straight way from the touch before, None = not known
    plan: the same for a robot that has to be led there
    """

    xy_m: FloatArray
    height_m: float
    normal: FloatArray
    over_m: float | None
    plan: TouchPlan | None = None


class Geometry(Protocol):
    """What a robot can reach, and what its frames say."""

    size_m: tuple[float, float]

    def look(self, looked: Any) -> SurfaceMeasurement: ...

    def reachable(self, grid: MapGrid) -> BoolArray:
        """(rows, columns) cells that the tip can touch."""

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        """known_m: how far from this height the surface may be, None = not known"""

    def touch(self, touched: Any) -> TouchMeasurement: ...

    def dent(self, touched: Any) -> FloatArray:
        """(k, 3) points seen while it pressed, without the robot [m]."""


class AsMeasured:
    """Of robots that give measurements rather than frames, and reach what `reachable` says, all by default."""

    def __init__(self, size_m: tuple[float, float], reachable: Callable[[MapGrid], BoolArray] | None = None) -> None:
        self.size_m = size_m
        self.reachable = reachable or (lambda grid: np.ones(grid.shape, dtype=bool))

    def look(self, looked: SurfaceMeasurement) -> SurfaceMeasurement:
        return looked

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        return Touch(xy_m, height_m, normal, over_m)

    def touch(self, touched: TouchMeasurement) -> TouchMeasurement:
        return touched

    def dent(self, touched: TouchMeasurement) -> FloatArray:
        return touched.after_m


class FromFrames:
    """Of an arm, a force sensor and a camera: everything is computed from their frames."""

    def __init__(self, setup: SetupGeometry, options: ExploreOptions) -> None:
        self.size_m = setup.size_m
        self._setup, self._options = setup, options
        self._looked: Looked | None = None
        self._joints_deg: tuple[float, ...] = ()

    def look(self, looked: Looked) -> SurfaceMeasurement:
        self._looked, self._joints_deg = looked, looked.data.arm[looked.used.arm_ns].joints_deg
        return self._setup.surface(looked, self._options)

    def reachable(self, grid: MapGrid) -> BoolArray:
        assert self._looked is not None
        chain = chain_of(self._looked.used.arm_model)
        return self._setup.reachable(grid, self._options, chain, self._joints_deg)

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        assert self._looked is not None
        chain = chain_of(self._looked.used.arm_model)
        plan = self._setup.plan_led(xy_m, height_m, normal, over_m, self._options, chain, self._joints_deg, known_m)
        return Touch(xy_m, height_m, plan.normal, over_m, plan)

    def touch(self, touched: Touched) -> TouchMeasurement:
        self._joints_deg = touched.data.arm[touched.used.end_ns].joints_deg
        return self._setup.touch(touched)

    def dent(self, touched: Touched) -> FloatArray:
        assert self._looked is not None
        return self._setup.dent(touched, self._looked.used, self._options)


@dataclass(frozen=True, slots=True, eq=False)
class Computed:
    """What one computation of an exploration gave.

    results: in their order; touch: that comes next, None where there is none; given_up: why it makes no sense to touch
    on; region_probability: of each number of regions; seconds: that it took; refused: why a place cannot be touched
    """

    results: tuple[Result, ...]
    touch: Touch | None = None
    given_up: str = ""
    region_probability: dict[str, float] | None = None
    seconds: float = 0.0
    refused: str = ""


class ExplorationStages:
    """What `explore` has computed: an `Explorer`, and the geometry of its robot."""

    def __init__(self, explorer: Explorer, geometry: Geometry) -> None:
        self.explorer, self.geometry = explorer, geometry
        self._reachable: BoolArray | None = None
        self._vetoed: list[FloatArray] = []
        self._no_way: list[FloatArray] = []
        self._reported = 0

    def look(self, looked: Any) -> Computed:
        """The surface before any touch."""
        began = time.perf_counter()
        seen = self.explorer.look(lambda: self.geometry.look(looked))
        return self._computed(_made(seen), began)

    def plan(self) -> Computed:
        """Where to touch next, and how; nothing where enough is known, or nothing can be planned any more."""
        began = time.perf_counter()
        explorer = self.explorer
        plan, touch = None, None
        while not explorer.given_up:
            allowed = self._reached()
            for xy_m in (*self._vetoed, *self._no_way):
                allowed = allowed & ~_near(explorer.grid, xy_m)
            plan = explorer.next(allowed)
            if plan is None or plan.target_m is None:
                break
            try:
                touch = explorer.approach(plan.target_m, self.geometry)
                break
            except NotThere as error:  # left out, until the arm has moved
                self._no_way.append(plan.target_m)
                where = f"({100 * plan.target_m[0]:.0f}, {100 * plan.target_m[1]:.0f}) cm is left out: "
                explorer.failures.append(StageFailure(WAY, len(explorer.touches), f"{where}{error}", ""))
        return self._computed(_made(plan), began, touch)

    def veto(self, xy_m: FloatArray) -> Computed:
        """Plan anew, from now on without a place (2,) [m] and what is near it."""
        self._vetoed.append(xy_m)
        return self.plan()

    def aim(self, xy_m: FloatArray) -> Computed:
        """What a touch of a place (2,) [m] would be, and what it is expected to feel; or why it cannot be made."""
        began = time.perf_counter()
        touch, forecast = None, None
        try:
            refused = self._refusal(xy_m)
            if not refused:
                touch = self.explorer.approached(xy_m, self.geometry)
                forecast = self.explorer.forecast(touch)
        except InputError as error:
            refused = str(error)
        return dataclasses.replace(self._computed(_made(forecast), began, touch), refused=refused)

    def _refusal(self, xy_m: FloatArray) -> str:
        """Why a place (2,) [m] cannot be touched; empty where it can."""
        grid = self.explorer.grid
        x_cm, y_cm = (100.0 * value for value in grid.size_m)
        if not ((xy_m > 0.0) & (xy_m < grid.size_m)).all():
            return f"it is beside the surface, which has {x_cm:g} by {y_cm:g} cm"
        border_m = self.explorer.options.border_m
        if not ((xy_m > border_m) & (xy_m < np.asarray(grid.size_m) - border_m)).all():
            return f"it is within {100 * border_m:g} cm of the surface's edge"
        seen_m = self.explorer.seen_m
        if not len(seen_m) or float(np.hypot(*(seen_m[:, :2] - xy_m).T).min()) > SEEN_M:
            return f"the camera has not seen the surface there: no point within {1e3 * SEEN_M:g} mm"
        cell = tuple((xy_m[::-1] / grid.cell_m).astype(int))
        return "" if self._reached()[cell] else "the arm cannot be led there from above"

    def _reached(self) -> BoolArray:
        if self._reachable is None:
            self._reachable = self.geometry.reachable(self.explorer.grid)
        return self._reachable

    def touch(self, touched: Any) -> Computed:
        """What a touch says, and the maps after it."""
        began = time.perf_counter()
        made = self.geometry.touch(touched)
        self._no_way.clear()  # from here there may be one
        estimate = self.explorer.touch(made, lambda: self.geometry.dent(touched))
        return self._computed((estimate, *_made(self.explorer.maps()), *_made(self.explorer.lumps())), began)

    def _computed(self, results: tuple[Result, ...], began: float, touch: Touch | None = None) -> Computed:
        explorer = self.explorer
        failed = tuple(explorer.failures[self._reported :])
        self._reported = len(explorer.failures)
        seconds = time.perf_counter() - began
        return Computed((*results, *failed), touch, explorer.given_up, explorer.region_probability, seconds)


def _made(result: StageResult | None) -> tuple[StageResult, ...]:
    return () if result is None else (result,)


def _near(grid: MapGrid, xy_m: FloatArray) -> BoolArray:
    """(rows, columns) within VETO_M of a place (2,) [m]."""
    return np.asarray(np.hypot(*(grid.centres_m - xy_m).T) < VETO_M).reshape(grid.shape)


class Explorer:
    """The estimates after each touch; pure, but for what it was given so far.

    touches: every one made; seen_m: (n, 3) points of the surface before any; known: the newest maps, None before the
    first; failures: every stage that failed
    thesis: its field of beta, where that planner is; dents: of its touches, None of what is rigid
    """

    def __init__(
        self,
        size_m: tuple[float, float],
        options: ExploreOptions,
        arm: ArmCompliance,
        truth: Truth | None = None,
        failed: Collection[StageFailure] = (),
        error: TouchErrorModel | None = None,
    ) -> None:
        """failed: what failed when this was recorded: it is not computed again, and fails as it did; error: of touches,
        default as of a rig that is not calibrated"""
        self.options = options
        self.grid = MapGrid(size_m, options.cell_m)
        self.world: HeightProcess | None = None
        error = error or TouchErrorModel()
        self._gain_sd = error.gain_sd
        self.posterior: RegionPosterior | LumpPosterior
        if options.goal == "inclusions":
            of_touches = options.inclusion_m, options.tip_radius_m, options.set_force_n
            self.posterior = LumpPosterior(self.grid, LumpPrior(*of_touches, error))
        else:
            # the force that goes in and the one that comes back are off by the same gain
            prior = RegionPrior(error=dataclasses.replace(error, gain_sd=0.0) if options.feel == "loss" else error)
            self.posterior = RegionPosterior.before_touches(self.grid, prior, seed=options.seed)
        self.touches: list[TouchEstimate] = []
        self.seen_m: FloatArray = np.zeros((0, 3))
        self._exponents: list[float] = []
        self._felt: list[StiffnessSample] = []
        self.known: MapEstimate | None = None
        self.region_probability: dict[str, float] | None = None
        self.failures: list[StageFailure] = []
        self.travel_m = 0.0
        self.stop_reason = ""
        self._arm = arm
        self._truth = truth
        self._regions: RegionMap | None = None
        self._beta_sd: list[float] = []
        self.dents: list[SeenDent | None] = []
        self.thesis = ThesisField()
        self._heights: HeightMap | None = None
        self._layer = KnownLayer(options.thickness_m if options.thickness_stated else None)
        self._failed_before = {(one.touch, one.stage): one for one in failed}
        self._touch = 0
        self._left_out: list[FloatArray] = []
        self._usable = False
        self._without_map = 0
        self._beside_m = 0.0

    # Each step --------------------------------------------------------------------------------------------------------

    def look(self, looked: Callable[[], SurfaceMeasurement]) -> SurfaceEstimate | None:
        """Take the surface before any touch in; None where it could not be seen or fitted."""
        return self._stage("surface", lambda: self._surface(looked()))

    def next(self, reachable: BoolArray | None = None) -> PlannedTouch | None:
        """Where to touch next, and why; None where that could not be planned."""
        return self._stage("plan", lambda: self._plan(reachable))

    def _surface(self, looked: SurfaceMeasurement) -> SurfaceEstimate:
        size_m = self.grid.size_m
        self.world = fit_surface(looked.points_m, noise_m=looked.noise_m, within_m=((0.0, 0.0), size_m), outlier_sd=5.0)
        heights = self.world.on(self.grid)
        self._heights, self.seen_m = heights, looked.points_m
        options = self.options
        self._layer = layer = known_layer(
            heights.mean_m[off_the_border(self.grid, options.border_m)],
            looked.table,
            stated_m=options.thickness_m if options.thickness_stated else None,
            relief=options.relief == "seen",
        )
        return SurfaceEstimate(
            looked.points_m, heights.mean_m, heights.deviation_m, self.grid.cell_m, layer.thickness_m, layer.sd_m
        )

    def _plan(self, reachable: BoolArray | None) -> PlannedTouch:
        options = self.options
        touch_s, speed_m_s = COSTS[options.pace]
        planning = PlanOptions(
            planner=options.planner,
            budget=options.budget,
            threshold=options.threshold,
            cell_m=PLAN_CELL_M,
            inclusion_m=options.inclusion_m,
            touch_s=touch_s,
            speed_m_s=speed_m_s,
        )
        tip_m = self.touches[-1].xyz_m[:2] if self.touches else None
        left_out_m = np.reshape(self._left_out, (-1, 2))
        if isinstance(self.posterior, LumpPosterior):
            plan = plan_lump_touch(self.posterior, planning, tip_m=tip_m, left_out_m=left_out_m, reachable=reachable)
        else:
            plan = plan_touch(
                self.posterior,
                FieldKernel(),
                planning,
                tip_m=tip_m,
                left_out_m=left_out_m,
                reachable=reachable,
                thesis=self.thesis,
                seed=options.seed + len(self.touches),
            )
        first, reason = options.first_m, "as asked for"
        if first is None and options.planner == "thesis":
            first, reason = tuple(np.multiply(FIRST_SHARE, self.grid.size_m)), "the preset place"
        if first is not None and not self.touches and not self._left_out:
            first_m = self._first_m(np.array(first), reachable)
            plan = dataclasses.replace(plan, target_m=first_m, reason=reason, stop=None)
        enough = plan.stop is not None and not (options.go_on and len(self.touches) < options.budget)
        target = None if enough else plan.target_m
        self.stop_reason = plan.stop or ""
        return PlannedTouch(
            target,
            plan.gain,
            plan.cost_s,
            plan.excluded != ALLOWED,
            plan.reason,
            plan.stop or "",
            plan.missed,
            plan.unit,
        )

    def _first_m(self, xy_m: FloatArray, reachable: BoolArray | None) -> FloatArray:
        """Raises InputError where the arm does not reach it."""
        cell = int(np.argmin(np.linalg.norm(self.grid.centres_m - xy_m, axis=1)))
        if reachable is not None and not reachable.ravel()[cell]:
            raise InputError("--first at a place that the tip can be led to", f"{xy_m[0]:g},{xy_m[1]:g}", "another one")
        return xy_m

    def approach(self, xy_m: FloatArray, geometry: Geometry) -> Touch | None:
        """The touch of a place (2,) [m]; None where it could not be planned."""
        return self._stage("plan", lambda: self.approached(xy_m, geometry))

    def approached(self, xy_m: FloatArray, geometry: Geometry) -> Touch:
        """The touch of a place (2,) [m]. Raises InputError where it cannot be made."""
        return geometry.approach(xy_m, *self.aim(xy_m), self.over_m(xy_m), self.known_m(xy_m))

    def aim(self, xy_m: FloatArray) -> tuple[float, FloatArray]:
        """Height of the surface at a place (2,) [m], and its unit normal (3,), as the camera saw them."""
        assert self.world is not None
        return float(self.world.at(xy_m[None]).mean[0]), self.world.normals(xy_m[None])[0]

    def forecast(self, touch: Touch) -> TouchForecast:
        """What a touch is expected to feel: the map's stiffness there, of the law that touches had so far."""
        options = self.options
        row, column = (touch.xy_m[::-1] / self.grid.cell_m).astype(int)
        if options.feel == "loss" and self.known is not None:
            field, field_sd = np.log(self.known.stiffness_n_per_mm), self.known.stiffness_log_sd
        else:
            field, field_sd = self.region_map().field, self.region_map().field_sd
        log_stiffness = float(field[row, column])
        if (shift := self._shift(touch.xy_m, float(np.exp(log_stiffness)))) is not None:
            log_stiffness -= shift.log
        log_sd = float(np.hypot(field_sd[row, column], self.posterior.prior.error.touch_sd))
        exponent = float(np.mean(self._exponents)) if self._exponents else EXPONENT["sphere"]
        forces = np.linspace(0.0, options.set_force_n, FORECAST_STEPS)
        share = (forces / options.set_force_n) ** (1.0 / exponent)
        stiffness, low, high = (float(np.exp(log_stiffness + sds * log_sd)) for sds in (0.0, -Z_90, Z_90))
        depth_m, deepest_m, least_m = (1e-3 * options.set_force_n / one * share for one in (stiffness, low, high))
        at = np.append(touch.xy_m, touch.height_m)
        above_m = at + (options if touch.plan is None else touch.plan).standoff_m * touch.normal
        crossing_m = above_m[2] if touch.plan is None else touch.plan.travel_height_m - options.tip_radius_m
        over_m = np.append(above_m[:2], max(above_m[2], crossing_m))
        return TouchForecast(
            at,
            touch.normal,
            np.array([over_m, above_m, at]),
            options.set_force_n,
            stiffness,
            (low, high),
            forces,
            depth_m,
            least_m,
            deepest_m,
            len(self.touches),
        )

    def over_m(self, xy_m: FloatArray) -> float | None:
        """How high the surface may be on the straight way from the last touch to a place (2,) [m]; None before the
        first touch."""
        if not self.touches:
            return None
        assert self._heights is not None
        start = self.touches[-1].xyz_m[:2]
        way = xy_m - start
        along = ((self.grid.centres_m - start) @ way / max(float(way @ way), 1e-12)).clip(0.0, 1.0)
        beside_m = np.linalg.norm(self.grid.centres_m - start - along[..., None] * way, axis=-1)
        crossed = beside_m.reshape(self.grid.shape) <= self.options.tip_radius_m + BESIDE_M
        return float((self._heights.mean_m + SURE_SD * self._heights.deviation_m)[crossed].max())

    def known_m(self, xy_m: FloatArray) -> float | None:
        """How far the surface at a place (2,) [m] may be from where it was seen: as far as any touch felt it from
        there, and what its process doubts; None before the first touch, of a place that was seen."""
        assert self._heights is not None
        row, column = (xy_m[::-1] / self.grid.cell_m).astype(int)
        doubt_m = SURE_SD * float(self._heights.deviation_m[row, column])
        return None if not self.touches and doubt_m <= SEEN_M else self._beside_m + doubt_m

    def touch(self, touched: TouchMeasurement, dent: Callable[[], FloatArray] | None = None) -> TouchEstimate:
        """Take a touch in. dent: computes its `after_m`, where that is not known yet"""
        self._touch = len(self.touches) + 1
        if dent is not None and (after_m := self._stage("dent", dent)) is not None:
            touched = dataclasses.replace(touched, after_m=after_m)
        before = self.touches[-1].xyz_m[:2] if self.touches else np.zeros(2)
        self.travel_m += float(np.hypot(*(touched.xy_m - before)))
        contact = self._stage("contact", lambda: self._contact(touched))
        creep = None if contact is None or contact.fit.rigid else self._stage("creep", lambda: self._creep(touched))
        posterior = None
        if contact is not None:
            fit = contact.fit
            sample = StiffnessSample(touched.xy_m, fit.log_stiffness, fit.own_log_sd, fit.rigid, fit.arm_log_sd)
            if self.options.goal == "inclusions" and not fit.rigid:
                sample = dataclasses.replace(
                    sample,
                    exponent=fit.exponent,
                    exponent_sd=fit.exponent_sd,
                    exponent_related=fit.exponent_related,
                )
            seen = _as_mapped(sample, creep, self.options, contact.speed_m_s)
            shift = None if fit.rigid or seen is None else self._shift(touched.xy_m, float(np.exp(seen.log_stiffness)))
            if seen is not None and shift is not None:
                seen = _levelled(seen, shift)
                log_level, log_sd = fit.log_stiffness + shift.log, float(np.hypot(fit.own_log_sd, shift.sd))
                level, low, high = (float(np.exp(log_level + sds * log_sd)) for sds in (0.0, -Z_90, Z_90))
                contact = dataclasses.replace(contact, level_n_per_mm=level, modulus=self._modulus(level, (low, high)))
            if seen is not None and self.options.feel == "loss":
                self._felt.append(seen)
                seen = self._stage("loss", lambda: loss_sample(touched.xy_m, creep, rigid=fit.rigid))
            if seen is not None:
                posterior = self._stage("regions", partial(_after, self.posterior, seen))
            if not fit.rigid:
                self._exponents.append(fit.exponent)
        self._usable = posterior is not None
        if posterior is None:
            self._left_out.append(touched.xy_m)
        else:
            self.posterior, self._regions = posterior, None
        estimate = self._estimate(touched, contact, creep)
        self._beside_m = max(self._beside_m, _beside_m(touched, estimate, self.options.tip_radius_m))
        self.touches.append(estimate)
        return estimate

    def maps(self) -> MapEstimate | None:
        """The maps after the newest touch; None where it gave none."""
        maps = self._stage("maps", self._maps) if self._usable else None
        self._without_map = self._without_map + 1 if maps is None else 0
        if maps is not None:
            self.known, self.region_probability = maps, self.region_map().probability
        return maps

    @property
    def given_up(self) -> str:
        """Why it makes no sense to touch on; empty where it does."""
        if self._without_map < MOST_FAILED:
            return ""
        last = next((one for one in reversed(self.failures) if one.stage in BEFORE_A_MAP), None)
        why = "none was held for long enough" if last is None else f"the last for {last.stage}: {last.reason}"
        return f"{self._without_map} touches in a row gave no map, {why}"

    def lumps(self) -> LumpsFound | None:
        """What was found after the newest touch, where lumps are sought; None where they are not, or it gave none."""
        posterior = self.posterior
        if not isinstance(posterior, LumpPosterior) or not self._usable:
            return None
        truth_m = None if self._truth is None else self._truth.lumps_m
        return self._stage("lumps", lambda: posterior.lumps(truth_m))

    def _maps(self) -> MapEstimate:
        found = self.region_map()
        beta, beta_sd = self._stage("beta field", self._beta_field) or (None, None)
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
            verdict=found.verdict,
            probability=found.probability[str(found.region_count or "gradual")],
            level_n_per_mm=np.exp(found.level),
            level_interval_n_per_mm=np.exp(found.level_interval),
            level_rigid=found.rigid,
            contacts_m=np.array([one.xyz_m[:2] for one in self.touches]),
            tip_radius_m=self.options.tip_radius_m,
            travel_m=self.travel_m,
            levelled_m=self._layer.thickness_m if self._levels else None,
            truth_labels=truth,
            iou=None if truth is None else match_regions(called_labels(found), truth)[0],
            boundary_m=None if truth is None else boundary_distance(called_labels(found), truth, self.grid.cell_m),
        )
        if self.options.planner == "thesis":
            maps = self._contoured(maps)
        elif self.options.feel == "loss":
            maps = by_loss(maps, self._felt)
        return self._with_moduli(maps)

    def _contoured(self, maps: MapEstimate) -> MapEstimate:
        """The maps with the thesis's regions, between isopleths of its field of beta, in place of those by stiffness,
        softest first. Levels are means of the field of stiffness; the number of regions is as probable as by stiffness:
        the thesis has no probability of it."""
        found = self.thesis.on(self.grid)
        cut = contoured(found, self.thesis.isopleths)
        field = np.log(maps.stiffness_n_per_mm)
        every = [cut.labels == label for label in range(int(cut.labels.max()) + 1)]
        every.sort(key=lambda cells: float(field[cells].mean()))
        labels = np.select(every, range(len(every)))
        level, interval = levels_of(field, maps.stiffness_log_sd, labels, len(every))
        truth = maps.truth_labels
        return dataclasses.replace(
            maps,
            labels=labels,
            label_probability=cut.probability,
            region_count=len(every),
            verdict="regions",
            probability=self.region_map().probability.get(str(len(every)), 0.0),
            level_n_per_mm=np.exp(level),
            level_interval_n_per_mm=np.exp(interval),
            level_rigid=np.zeros(len(every), dtype=bool),
            isopleths=self.thesis.isopleths,
            iou=None if truth is None else match_regions(labels, truth)[0],
            boundary_m=None if truth is None else boundary_distance(labels, truth, maps.cell_m),
        )

    def region_map(self) -> RegionMap:
        """Regions with their levels and intervals, computed once for each touch."""
        if self._regions is None:
            self._regions = self.posterior.region_map()
        return self._regions

    # Within -----------------------------------------------------------------------------------------------------------

    @property
    def _levels(self) -> bool:
        """Whether touches compare as on a level, wide layer: the foam is uneven, or an edge is near, or matters."""
        options = self.options
        return self._layer.uneven or options.border_m < BORDER_M or options.goal == "inclusions"

    def _shape(self, xy_m: FloatArray) -> LocalShape | None:
        """Of the foam at a place (2,) [m] as it was seen; None where it counts as level, and nothing asks how wide."""
        layer, edge_m = self._layer, float(np.min([xy_m, self.grid.size_m - xy_m]))
        if layer.thickness_m is None:
            return None
        if not layer.uneven:
            return LocalShape(layer.thickness_m, edge_m=edge_m) if self._levels else None
        assert self.world is not None
        step = CURVED_OVER_M
        found = self.world.at(xy_m + step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]))
        above_m = found.mean - layer.table_m
        return shape_of(above_m, found.deviation, step, edge_m, LEAST_THICKNESS * self.options.thickness_m)

    def _shift(self, xy_m: FloatArray, n_per_mm: float) -> ShapeShift | None:
        """What the level layer would add to a log stiffness [N/mm]; None where it is one."""
        shape, options, thickness_m = self._shape(xy_m), self.options, self._layer.thickness_m
        if shape is None or thickness_m is None:
            return None
        depth_m = 1e-3 * options.set_force_n / n_per_mm
        return shape_shift(shape, depth_m, reference_m=thickness_m, radius_m=options.tip_radius_m)

    def _modulus(self, n_per_mm: float, interval: tuple[float, float]) -> LayerModulus | None:
        """Of the level layer, by its stiffness at the set force; None where its thickness is not known."""
        options = self.options
        return modulus_of(self._layer, n_per_mm, interval, force_n=options.set_force_n, radius_m=options.tip_radius_m)

    def _with_moduli(self, maps: MapEstimate) -> MapEstimate:
        """With the modulus of each level; without where the thickness is not known."""
        if self._layer.thickness_m is None:
            return maps
        level, interval = maps.level_n_per_mm, maps.level_interval_n_per_mm
        ends = np.where(maps.level_rigid[:, None] | ~np.isfinite(interval), level[:, None], interval)  # open above
        found = [
            self._modulus(float(one), (float(low), float(high))) for one, (low, high) in zip(level, ends, strict=True)
        ]
        return dataclasses.replace(
            maps,
            level_modulus_pa=np.array([one.pa for one in found if one is not None]),
            level_modulus_interval_pa=np.reshape([one.interval_pa for one in found if one is not None], (-1, 2)),
        )

    def _stage(self, name: str, compute: Callable[[], StageResult]) -> StageResult | None:
        """What a stage computes; None where it fails, which `failures` then says. Raises NotThere for a place without a
        way."""
        if (failed := self._failed_before.get((self._touch, name))) is not None:
            self.failures.append(failed)
            return None
        try:
            return compute()
        except NotThere:
            raise
        except Exception as error:  # whatever it is, the arm is over a table and the touches made are worth something
            self.failures.append(StageFailure.of(name, self._touch, error))
            return None

    def _contact(self, touched: TouchMeasurement) -> _Contact:
        options, lumps = self.options, self.options.goal == "inclusions"
        fit = fit_approach(
            touched.time_s,
            touched.position_m,
            touched.force_n,
            touched.normal,
            set_force_n=options.set_force_n,
            arm=self._arm,
            gain_sd=self._gain_sd,
            exponent_sd=FREE_EXPONENT_SD if lumps else EXPONENT_SD,
            least_share=LEAST_SHARE if lumps else LOADED,
        )
        law = fitted_law(fit, self._arm, _along(touched))
        modulus = None
        if not fit.rigid and fit.depth_m > 0.0:
            force = min(fit.at_force_n, fit.peak_force_n)
            dent_m, (low, high) = fit.dent_m(force), fit.interval_n_per_mm
            stiffness = 1e-3 * force / dent_m
            ends = stiffness * low / fit.stiffness_n_per_mm, stiffness * high / fit.stiffness_n_per_mm
            radius_m = options.tip_radius_m
            modulus = modulus_of(self._layer, stiffness, ends, force_n=force, radius_m=radius_m, dent_m=dent_m)
        return _Contact(fit, law, modulus, _speed_m_s(touched, fit))

    def _creep(self, touched: TouchMeasurement) -> CreepFit | None:
        whole = touched.whole
        if whole is None:
            return None
        return fit_creep(
            whole.time_s,
            whole.position_m,
            whole.force_n,
            touched.normal,
            loading=whole.loading,
            held=whole.held,
            set_force_n=self.options.set_force_n,
            arm=self._arm,
            radius_m=self.options.tip_radius_m,
            clock_sd_s=CLOCK_SD_S,
        )

    def _estimate(self, touched: TouchMeasurement, contact: _Contact | None, creep: CreepFit | None) -> TouchEstimate:
        along = _along(touched)
        nan = float("nan")
        aimed = self._stage("surface", lambda: self.aim(touched.xy_m))
        lowest_m = float(touched.position_m[:, 2].min()) - self.options.tip_radius_m
        xyz = np.append(touched.xy_m, lowest_m if aimed is None else aimed[0])
        beta = _Beta("not fitted: no contact")
        if contact is not None:
            fitted = self._stage("beta", lambda: self._beta(touched, contact.fit))
            beta = fitted or _Beta(f"not fitted: {self.failures[-1].reason}")
        self._beta_sd.append(beta.sd)
        if self.options.planner == "thesis" and beta.value is not None:
            self.thesis = self.thesis.with_touch(beta.dented_m, beta.value)
            self.dents.append(beta.dent)
        level = None if contact is None else contact.level_n_per_mm
        modulus = None if contact is None else contact.modulus
        shape = self._stage("surface", lambda: self._shape(touched.xy_m))
        near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < NEAR_M if len(touched.after_m) else []
        fit = None if contact is None else contact.fit
        return TouchEstimate(
            number=len(self.touches),
            xyz_m=xyz,
            normal=touched.normal / np.linalg.norm(touched.normal),
            approach_m=along - along[0],
            approach_n=_force_along(touched),
            fitted_n=np.full(len(along), nan) if contact is None else contact.law_n,
            contact_m=nan if fit is None else fit.contact_m - along[0],
            stiffness_n_per_mm=nan if fit is None else fit.stiffness_n_per_mm,
            stiffness_interval=(nan, nan) if fit is None else fit.interval_n_per_mm,
            rigid=False if fit is None else fit.rigid,
            modulus_pa=None if modulus is None else modulus.pa,
            modulus_interval_pa=None if modulus is None else modulus.interval_pa,
            depth_m=nan if fit is None else fit.dent_m(fit.peak_force_n),
            peak_force_n=float(_force_along(touched).max()) if fit is None else fit.peak_force_n,
            beta=beta.value,
            beta_interval=beta.interval,
            beta_verdict=beta.verdict,
            observed_m=touched.after_m[near],
            simulated_m=beta.simulated_m,
            creep=creep,
            thickness_m=None if shape is None else shape.thickness_m,
            level_n_per_mm=level,
            speed_m_s=None if contact is None else contact.speed_m_s,
        )

    def _beta(self, touched: TouchMeasurement, fit: ContactFit) -> _Beta:
        options = self.options
        if options.beta_model == "none":
            return _Beta("not asked for")
        as_thesis = options.planner == "thesis"
        if fit.rigid and not as_thesis:
            return _Beta("rigid: no dent to fit")
        assert self.world is not None
        radius = options.tip_radius_m
        if fit.rigid:  # nothing moved, so every beta fits: the first of the sweep, where the tip was
            grid = MapGrid((4.0 * radius, 4.0 * radius), options.cell_m)
            under = np.linalg.norm(grid.centres_m - 2.0 * radius, axis=1) <= radius
            return _Beta("rigid: nothing was dented", 0.0, dented_m=touched.xy_m - 2.0 * radius + grid.centres_m[under])
        deepest = int(np.argmax(-(touched.position_m @ touched.normal)))
        gives_m = self._arm.compliance_m_per_n * fit.peak_force_n  # the arm says that it is that much deeper
        lowest = touched.position_m[deepest] - (radius - gives_m) * touched.normal
        ball = BallContact(lowest, radius, fit.dent_m(fit.peak_force_n), fit.peak_force_n)
        thickness_m = self._layer.thickness_m
        if options.beta_model != "thesis" and thickness_m is None:
            return _Beta("not fitted: the foam's thickness is not known")
        if options.beta_model in ("thesis", "layers"):
            below_m = thickness_m if options.beta_model == "layers" else None
            swept = thesis_beta(self._dent(touched, ball), thickness_m=below_m)
            made = _Beta(f"thesis: {swept.note}", swept.beta, simulated_m=swept.simulated_m)
            return dataclasses.replace(made, dented_m=swept.dent.dented_m, dent=swept.dent)
        assert thickness_m is not None
        found = fit_touch(self.world, touched.after_m, ball, thickness_m=thickness_m)
        estimate = found.estimate
        made = _Beta(estimate.verdict, estimate.value, estimate.interval, found.sd, found.simulated_m)
        dent = self._dent(touched, ball) if as_thesis else None
        return made if dent is None else dataclasses.replace(made, dented_m=dent.dented_m, dent=dent)

    def _dent(self, touched: TouchMeasurement, ball: BallContact) -> SeenDent:
        """The dent as the thesis has it: the touch surface's own process, with virtual points where the ball is."""
        assert self.world is not None
        tactile = tactile_points(ball.lowest_m, ball.radius_m, ball.depth_m, normal=touched.normal)
        near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < THESIS_ROI_M
        surface = fit_surface(
            touched.after_m[near], known_m=tactile, known_noise_m=np.full(len(tactile), TACTILE_NOISE_M)
        )
        return dent_of(self.world, surface, touched.xy_m)

    def _beta_field(self) -> tuple[FloatArray | None, FloatArray | None]:
        if self.options.planner == "thesis":
            contour = self.thesis.on(self.grid)
            return contour.mean.clip(0.0, 1.0), contour.deviation
        known = [
            (one.xyz_m[:2], one.beta, sd)
            for one, sd in zip(self.touches, self._beta_sd, strict=True)
            if one.beta is not None
        ]
        if len(known) < FEWEST_FOR_FIELD:
            return None, None
        places, values, sds = (np.array(part, dtype=np.float64) for part in zip(*known, strict=True))
        sds = np.where(np.isfinite(sds), sds, BETA_PRIOR.nugget)
        field = fit_field(places, values, sds, prior=BETA_PRIOR)
        found = field.on(self.grid)
        return found.mean.clip(0.0, 1.0), found.deviation


@dataclass(frozen=True, slots=True)
class _Contact:
    """fit; law_n: (n,) its force at each reading [N]; modulus: of the layer, None where it is not known
    speed_m_s: at which the tip came down in it, None where that is not known
    level_n_per_mm: stiffness of a level layer as thick as stated, None where that is what was touched"""

    fit: ContactFit
    law_n: FloatArray
    modulus: LayerModulus | None
    speed_m_s: float | None
    level_n_per_mm: float | None = None


@dataclass(frozen=True, slots=True)
class _Beta:
    """verdict: or why there is no value; value, interval: of beta, None where there is none; sd: nan where not known
    simulated_m: (p, 3) particles of the fitted model
    dented_m: (m, 2) places that the touch dented, and dent: the square around it, for the thesis
    """

    verdict: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    sd: float = float("nan")
    simulated_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    dented_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    dent: SeenDent | None = None


def _after(posterior: RegionPosterior | LumpPosterior, touch: StiffnessSample) -> RegionPosterior | LumpPosterior:
    return posterior.with_touch(touch)


def _levelled(seen: StiffnessSample, shift: ShapeShift) -> StiffnessSample:
    """The same touch on a level, wide layer as thick as stated."""
    return dataclasses.replace(
        seen,
        log_stiffness=seen.log_stiffness + shift.log,
        log_sd=float(np.hypot(seen.log_sd, shift.sd)),
        exponent=None if seen.exponent is None else seen.exponent + shift.exponent,
    )


def _as_mapped(
    seen: StiffnessSample, creep: CreepFit | None, options: ExploreOptions, speed_m_s: float | None
) -> StiffnessSample | None:
    """What the map takes of a touch; None where it has not what is to be mapped."""
    if seen.rigid or not options.hold_s:
        return seen
    if options.feel == "relaxed":
        return None if creep is None else _relaxed(seen, creep)
    if creep is None:  # how much it would creep is not known
        speed_m_s = REFERENCE_SPEED_M_S if speed_m_s is None else max(speed_m_s, 1e-4)
        away = SPEED_SD * abs(float(np.log(speed_m_s / REFERENCE_SPEED_M_S)))
        return dataclasses.replace(seen, log_sd=float(np.hypot(seen.log_sd, away)))
    log_stiffness = seen.log_stiffness + creep.log_at_reference
    log_sd = float(np.hypot(seen.log_sd, creep.log_at_reference_sd))
    return dataclasses.replace(seen, log_stiffness=log_stiffness, log_sd=log_sd)


def _speed_m_s(touched: TouchMeasurement, fit: ContactFit) -> float | None:
    """Of the tip from contact to the peak of the force."""
    along, force = _along(touched), _force_along(touched)
    until = int(np.argmax(force))
    since = min(int(np.searchsorted(np.maximum.accumulate(along), fit.contact_m)), max(until - 1, 0))
    taken_s = float(touched.time_s[until] - touched.time_s[since])
    return float(along[until] - along[since]) / taken_s if taken_s > 0.0 else None


def _relaxed(seen: StiffnessSample, creep: CreepFit) -> StiffnessSample:
    """The same touch by its stiffness when all has relaxed."""
    return dataclasses.replace(
        seen, log_stiffness=float(np.log(creep.relaxed_n_per_mm)), log_sd=float(np.hypot(creep.relaxed_log_sd, LAW_SD))
    )


def fitted_law(fit: ContactFit, arm: ArmCompliance, along_m: FloatArray) -> FloatArray:
    """(n,) force of the fitted law where the arm says that the tip is, along its way into the surface (n,) [N]."""
    forces = np.linspace(0.0, 2.0 * max(fit.peak_force_n, fit.at_force_n), LAW_STEPS)
    dent = max(fit.depth_m, 1e-9) * (forces / fit.at_force_n) ** (1.0 / fit.exponent)
    return np.asarray(np.interp(along_m, fit.contact_m + dent + arm.compliance_m_per_n * forces, forces))


def _along(touched: TouchMeasurement) -> FloatArray:
    """(n,) way of the tip into the surface [m]."""
    return np.asarray(-(touched.position_m @ touched.normal) / np.linalg.norm(touched.normal))


def _force_along(touched: TouchMeasurement) -> FloatArray:
    """(n,) force out of the surface [N]."""
    return np.asarray(touched.force_n @ touched.normal / np.linalg.norm(touched.normal))


def _beside_m(touched: TouchMeasurement, estimate: TouchEstimate, tip_radius_m: float) -> float:
    """How far along the normal a touch met the surface from where it was seen [m]; infinite where it met none."""
    if not np.isfinite(estimate.contact_m):
        return float("inf")
    began_m = float((touched.position_m[0] - estimate.xyz_m) @ estimate.normal)
    return abs(began_m - estimate.contact_m - tip_radius_m)
