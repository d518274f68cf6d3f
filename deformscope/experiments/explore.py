"""Thesis chapter 4: look, decide where to touch, touch, estimate, map, again; until the map tells what it can.

`Explorer` computes: what a robot saw and felt goes in, frozen results come out, the same every time. An
`ExploringRobot` looks and touches; `explore` does not know whether it is simulated. A stage that fails on one touch
costs that stage's result: the failure is a result like the others (`StageFailure`), and the robot goes on with the
touches that could be used, until too many in a row could not.
"""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeVar

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.robot.setup import Truth
from deformscope.stages.map.exploration import (
    ExplorationStop,
    MapEstimate,
    PhaseStart,
    PlannedTouch,
    StageFailure,
    SurfaceEstimate,
    TouchEstimate,
)
from deformscope.stages.map.field import BETA_PRIOR, fit_field
from deformscope.stages.map.map_score import boundary_distance, called_labels, match_regions
from deformscope.stages.map.plan import ALLOWED, FieldKernel, Planner, PlanOptions, plan_touch
from deformscope.stages.map.regions import RegionMap, RegionPosterior
from deformscope.stages.map.surface import HeightMap, HeightProcess, fit_surface
from deformscope.stages.map.touch_beta import BallContact, fit_touch, thesis_beta
from deformscope.stages.map.touches import MapGrid, StiffnessSample
from deformscope.stages.poke.contact import ArmCompliance, ContactFit, fit_approach, layer_modulus
from deformscope.stages.see.cloud import Box, Intrinsics, tactile_points
from deformscope_drivers.depth_camera import Intrinsics as CameraIntrinsics

BetaModel = Literal["volume", "thesis", "none"]
StageResult = TypeVar("StageResult")
SECOND_FORCE_N, SECOND_SHARE = 5.0, 5.0 / 3.0
SHALLOW_M = 0.002
NEAR_M = 0.08
"""Points within this of a touch are shown with it."""
FEWEST_FOR_FIELD = 2
BORDER_M = 0.02
"""No touch is made so near the surface's edge."""
VIEW_CELL_M = 0.004
"""Points of the surface before any touch are reduced to one in each cell of this size."""
PLAN_CELL_M = 0.02
"""Places that are considered for a touch are this far apart."""
BESIDE_M, SURE_SD = 0.02, 3.0
"""What the tip crosses is looked at this far beside its way, and taken for as high as it is with so many deviations."""
EDGE_M, ABOVE_M, LOW_SHARE = 0.005, 0.08, 0.5
LAW_STEPS = 400
"""Forces at which the fitted law is taken, from none to twice the largest."""
THESIS_ROI_M, TACTILE_NOISE_M = 0.08, 2e-4
MOST_FAILED = 3
"""After so many touches in a row that gave no map the exploration ends: whatever is wrong does not pass by itself."""
ESTIMATES_FAILED = "estimates failed"


@dataclass(frozen=True, slots=True)
class ExploreOptions:
    """How to explore.

    planner, budget, threshold: where to touch, how often at most, and Th of the thesis's rule
    set_force_n, max_depth_m: of a touch; tip_radius_m: of its ball; thickness_m: of the foam
    beta_model: layers below the surface, the thesis's single layer, or no beta; cell_m: of the maps; seed
    standoff_m: of the tip above the surface before and after a touch, and above all that it crosses
    go_on: touch until the budget is spent, even where the plan says enough (for studies)
    """

    planner: Planner = "regions"
    budget: int = 8
    threshold: float = 0.06
    set_force_n: float = 3.0
    max_depth_m: float = 0.015
    tip_radius_m: float = 0.01
    thickness_m: float = 0.05
    beta_model: BetaModel = "volume"
    cell_m: float = 0.005
    seed: int = 0
    standoff_m: float = 0.05
    go_on: bool = False

    def __post_init__(self) -> None:
        if self.budget < 1:
            raise InputError("a budget of one touch or more", f"{self.budget}")
        if not 0.0 < self.set_force_n <= SECOND_FORCE_N:
            raise InputError(f"a set force above 0 and up to {SECOND_FORCE_N:g} N", f"{self.set_force_n:g} N")

    @property
    def second_force_n(self) -> float:
        """Pressed with where the set force makes a small dent: 5 N after 3 N, and in proportion, 5 N at most."""
        return min(SECOND_FORCE_N, SECOND_SHARE * self.set_force_n)


@dataclass(frozen=True, slots=True)
class SurfaceMeasurement:
    """What the camera saw. points_m: (n, 3) of the surface, robot and outliers taken away, surface frame [m]
    noise_m: (n,) deviation of each height [m]"""

    points_m: FloatArray
    noise_m: FloatArray


@dataclass(frozen=True, slots=True)
class TouchMeasurement:
    """What a touch gave.

    xy_m: (2,) where it was to be; normal: (3,) that it went along
    time_s: (n,) rising; position_m: (n, 3) middle of the ball as the arm says; force_n: (n, 3) on it; surface frame
    after_m: (k, 3) points seen while it pressed, without the robot; reached: the set force, rather than the depth
    seen_ns: until when they were seen, on the robot's clock; 0 = nobody looked
    unseen: where the points could not be taken from what the camera saw, the error's traceback
    """

    xy_m: FloatArray
    normal: FloatArray
    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    after_m: FloatArray
    reached: bool
    seen_ns: int = 0
    unseen: str = ""


class ExploringRobot(Protocol):
    """What looks and touches."""

    size_m: tuple[float, float]
    arm: ArmCompliance

    def reachable(self, grid: MapGrid) -> BoolArray:
        """(rows, columns) cells that the tip can touch."""

    def look(self) -> SurfaceMeasurement: ...

    def touch(self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None) -> TouchMeasurement:
        """Touch a place whose surface was seen at this height.

        over_m: how high the surface may be on the straight way from the touch before, None = not known. Raises
        ExplorationStopped where it came to nothing.
        """

    def now_ns(self) -> int:
        """The robot's clock."""


class Explorer:
    """The estimates after each touch; pure, but for what it has been told so far.

    told: every touch made; known: the newest maps, None before the first; failures: every stage that failed
    """

    def __init__(
        self,
        size_m: tuple[float, float],
        options: ExploreOptions,
        arm: ArmCompliance,
        truth: Truth | None = None,
        failed: Collection[StageFailure] = (),
    ) -> None:
        """failed: what failed when this was recorded: it is not computed again, and fails as it did"""
        self.options = options
        self.grid = MapGrid(size_m, options.cell_m)
        self.world: HeightProcess | None = None
        self.posterior = RegionPosterior.before_touches(self.grid, seed=options.seed)
        self.told: list[TouchEstimate] = []
        self.known: MapEstimate | None = None
        self.failures: list[StageFailure] = []
        self.travel_m = 0.0
        self.stop_reason = ""
        self.plan_cell_m = PLAN_CELL_M
        self._arm = arm
        self._truth = truth
        self._regions: RegionMap | None = None
        self._beta_sd: list[float] = []
        self._inputs: list[tuple[str, bytes]] = []
        self._heights: HeightMap | None = None
        self._failed_before = {(one.touch, one.stage): one for one in failed}
        self._touch = 0
        self._left_out: list[FloatArray] = []
        self._usable = False
        self._without_map = 0

    # Each step --------------------------------------------------------------------------------------------------------

    def look(self, looked: SurfaceMeasurement) -> SurfaceEstimate | None:
        """Take the surface before any touch in; None where it could not be fitted."""
        self._inputs.append(("explored/looked", pack(looked)))
        return self._stage("surface", lambda: self._surface(looked))

    def next(self, reachable: BoolArray | None = None) -> PlannedTouch | None:
        """Where to touch next, and why; None where that could not be planned."""
        return self._stage("plan", lambda: self._plan(reachable))

    def _surface(self, looked: SurfaceMeasurement) -> SurfaceEstimate:
        size_m = self.grid.size_m
        self.world = fit_surface(looked.points_m, noise_m=looked.noise_m, within_m=((0.0, 0.0), size_m), outlier_sd=5.0)
        heights = self.world.on(self.grid)
        self._heights = heights
        return SurfaceEstimate(looked.points_m, heights.mean_m, heights.deviation_m, self.grid.cell_m)

    def _plan(self, reachable: BoolArray | None) -> PlannedTouch:
        options = self.options
        plan = plan_touch(
            self.posterior,
            FieldKernel(),
            PlanOptions(
                planner=options.planner, budget=options.budget, threshold=options.threshold, cell_m=self.plan_cell_m
            ),
            tip_m=self.told[-1].xyz_m[:2] if self.told else None,
            left_out_m=np.reshape(self._left_out, (-1, 2)),
            reachable=reachable,
            seed=options.seed + len(self.told),
        )
        enough = plan.stop is not None and not (options.go_on and len(self.told) < options.budget)
        target = None if enough else plan.target_m
        self.stop_reason = plan.stop or ""
        return PlannedTouch(target, plan.gain, plan.cost_s, plan.excluded != ALLOWED, plan.reason, plan.stop or "")

    def approach(self, xy_m: FloatArray) -> tuple[float, FloatArray, float | None] | None:
        """What a robot is told of a touch at a place (2,) [m]: `aim` and `over_m`; None where that failed."""
        return self._stage("plan", lambda: (*self.aim(xy_m), self.over_m(xy_m)))

    def aim(self, xy_m: FloatArray) -> tuple[float, FloatArray]:
        """Height of the surface at a place (2,) [m], and its unit normal (3,), as the camera saw them."""
        assert self.world is not None
        return float(self.world.at(xy_m[None]).mean[0]), self.world.normals(xy_m[None])[0]

    def over_m(self, xy_m: FloatArray) -> float | None:
        """How high the surface may be on the straight way from the last touch to a place (2,) [m]; None before the
        first touch."""
        if not self.told:
            return None
        assert self._heights is not None
        start = self.told[-1].xyz_m[:2]
        way = xy_m - start
        along = ((self.grid.centres_m - start) @ way / max(float(way @ way), 1e-12)).clip(0.0, 1.0)
        beside_m = np.linalg.norm(self.grid.centres_m - start - along[..., None] * way, axis=-1)
        crossed = beside_m.reshape(self.grid.shape) <= self.options.tip_radius_m + BESIDE_M
        return float((self._heights.mean_m + SURE_SD * self._heights.deviation_m)[crossed].max())

    def touch(self, touched: TouchMeasurement) -> TouchEstimate:
        """Take a touch in."""
        self._inputs.append((f"explored/touched-{len(self.told):03d}", pack(touched)))
        self._touch = len(self.told) + 1
        before = self.told[-1].xyz_m[:2] if self.told else np.zeros(2)
        self.travel_m += float(np.hypot(*(touched.xy_m - before)))
        if touched.unseen:
            reason = touched.unseen.strip().splitlines()[-1]
            self.failures.append(StageFailure("dent", self._touch, reason, touched.unseen))
        contact = self._stage("contact", lambda: self._contact(touched))
        posterior = None
        if contact is not None:
            fit = contact.fit
            seen = StiffnessSample(touched.xy_m, fit.log_stiffness, fit.log_sd, fit.rigid)
            posterior = self._stage("regions", lambda: self.posterior.with_touch(seen))
        self._usable = posterior is not None
        if posterior is None:
            self._left_out.append(touched.xy_m)
        else:
            self.posterior, self._regions = posterior, None
        told = self._told(touched, contact)
        self.told.append(told)
        return told

    def maps(self) -> MapEstimate | None:
        """The maps after the newest touch; None where it gave none."""
        maps = self._stage("maps", self._maps) if self._usable else None
        self._without_map = self._without_map + 1 if maps is None else 0
        self.known = self.known if maps is None else maps
        return maps

    @property
    def given_up(self) -> str:
        """Why it makes no sense to touch on; empty where it does."""
        if self._without_map < MOST_FAILED:
            return ""
        last = next(one for one in reversed(self.failures) if one.stage in ("contact", "regions", "maps"))
        return f"{self._without_map} touches in a row gave no map, the last for {last.stage}: {last.reason}"

    def failed(self, touch: int) -> list[str]:
        """What failed on a touch, from 1, in words."""
        return [f"{one.stage}: {one.reason}" for one in self.failures if one.touch == touch]

    def _maps(self) -> MapEstimate:
        found = self.region_map()
        beta, beta_sd = self._stage("beta field", self._beta_field) or (None, None)
        truth = None if self._truth is None else self._truth.labels
        return MapEstimate(
            touches=len(self.told),
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
            contacts_m=np.array([told.xyz_m[:2] for told in self.told]),
            tip_radius_m=self.options.tip_radius_m,
            travel_m=self.travel_m,
            truth_labels=truth,
            iou=None if truth is None else match_regions(called_labels(found), truth)[0],
            boundary_m=None if truth is None else boundary_distance(called_labels(found), truth, self.grid.cell_m),
        )

    def region_map(self) -> RegionMap:
        """Regions with their levels and intervals, computed once for each touch."""
        if self._regions is None:
            self._regions = self.posterior.region_map()
        return self._regions

    def new_inputs(self) -> list[tuple[str, bytes]]:
        """What was taken in since the last call: names and files of arrays (.npz), from which all can be computed
        again."""
        taken, self._inputs = self._inputs, []
        return taken

    # Within -----------------------------------------------------------------------------------------------------------

    def _stage(self, name: str, compute: Callable[[], StageResult]) -> StageResult | None:
        """What a stage computes; None where it fails, which `failures` then says."""
        if (failed := self._failed_before.get((self._touch, name))) is not None:
            self.failures.append(failed)
            return None
        try:
            return compute()
        except Exception as error:  # whatever it is, the arm is over a table and the touches made are worth something
            self.failures.append(StageFailure.of(name, self._touch, error))
            return None

    def _contact(self, touched: TouchMeasurement) -> _Contact:
        options = self.options
        fit = fit_approach(
            touched.time_s,
            touched.position_m,
            touched.force_n,
            touched.normal,
            set_force_n=options.set_force_n,
            arm=self._arm,
        )
        forces = np.linspace(0.0, 2.0 * max(fit.peak_force_n, fit.at_force_n), LAW_STEPS)
        dent = max(fit.depth_m, 1e-9) * (forces / fit.at_force_n) ** (1.0 / fit.exponent)
        along = fit.contact_m + dent + self._arm.compliance_m_per_n * forces
        law = np.interp(_along(touched), along, forces)
        modulus = None
        if not fit.rigid and fit.depth_m > 0.0:
            modulus = layer_modulus(
                fit.depth_m, fit.at_force_n, radius_m=options.tip_radius_m, thickness_m=options.thickness_m
            )
        return _Contact(fit, law, modulus)

    def _told(self, touched: TouchMeasurement, contact: _Contact | None) -> TouchEstimate:
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
        near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < NEAR_M if len(touched.after_m) else []
        fit = None if contact is None else contact.fit
        return TouchEstimate(
            number=len(self.told),
            xyz_m=xyz,
            normal=touched.normal / np.linalg.norm(touched.normal),
            approach_m=along - along[0],
            approach_n=_force_along(touched),
            fitted_n=np.full(len(along), nan) if contact is None else contact.law_n,
            contact_m=nan if fit is None else fit.contact_m - along[0],
            stiffness_n_per_mm=nan if fit is None else fit.stiffness_n_per_mm,
            stiffness_interval=(nan, nan) if fit is None else fit.interval_n_per_mm,
            rigid=False if fit is None else fit.rigid,
            modulus_pa=None if contact is None else contact.modulus_pa,
            depth_m=nan if fit is None else _dent_m(fit),
            peak_force_n=float(_force_along(touched).max()) if fit is None else fit.peak_force_n,
            beta=beta.value,
            beta_interval=beta.interval,
            beta_verdict=beta.verdict,
            observed_m=touched.after_m[near],
            simulated_m=beta.simulated_m,
        )

    def _beta(self, touched: TouchMeasurement, fit: ContactFit) -> _Beta:
        if self.options.beta_model == "none":
            return _Beta("not asked for")
        if fit.rigid:
            return _Beta("rigid: no dent to fit")
        assert self.world is not None
        radius = self.options.tip_radius_m
        deepest = int(np.argmax(-(touched.position_m @ touched.normal)))
        gives_m = self._arm.compliance_m_per_n * fit.peak_force_n  # the arm says that it is that much deeper
        lowest = touched.position_m[deepest] - (radius - gives_m) * touched.normal
        ball = BallContact(lowest, radius, _dent_m(fit), fit.peak_force_n)
        if self.options.beta_model == "thesis":
            return self._thesis(touched, ball)
        found = fit_touch(self.world, touched.after_m, ball, thickness_m=self.options.thickness_m)
        estimate = found.estimate
        return _Beta(estimate.verdict, estimate.value, estimate.interval, found.sd, found.simulated_m)

    def _thesis(self, touched: TouchMeasurement, ball: BallContact) -> _Beta:
        """The thesis's way: the touch surface's own process, with virtual points where the ball is."""
        assert self.world is not None
        tactile = tactile_points(ball.lowest_m, ball.radius_m, ball.depth_m, normal=touched.normal)
        near = np.abs(touched.after_m[:, :2] - touched.xy_m).max(axis=1) < THESIS_ROI_M
        surface = fit_surface(
            touched.after_m[near], known_m=tactile, known_noise_m=np.full(len(tactile), TACTILE_NOISE_M)
        )
        found = thesis_beta(self.world, surface, touched.xy_m)
        return _Beta(f"thesis: {found.note}", found.beta, simulated_m=found.simulated_m)

    def _beta_field(self) -> tuple[FloatArray | None, FloatArray | None]:
        known = [
            (told.xyz_m[:2], told.beta, sd)
            for told, sd in zip(self.told, self._beta_sd, strict=True)
            if told.beta is not None
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
    """fit; law_n: (n,) its force at each reading [N]; modulus_pa: of the layer, None where it cannot be told"""

    fit: ContactFit
    law_n: FloatArray
    modulus_pa: float | None


@dataclass(frozen=True, slots=True)
class _Beta:
    """verdict: or why there is no value; value, interval: of beta, None where there is none; sd: nan where not known
    simulated_m: (p, 3) particles of the fitted model"""

    verdict: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    sd: float = float("nan")
    simulated_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def _along(touched: TouchMeasurement) -> FloatArray:
    """(n,) way of the tip into the surface [m]."""
    return np.asarray(-(touched.position_m @ touched.normal) / np.linalg.norm(touched.normal))


def _force_along(touched: TouchMeasurement) -> FloatArray:
    """(n,) force out of the surface [N]."""
    return np.asarray(touched.force_n @ touched.normal / np.linalg.norm(touched.normal))


def _dent_m(fit: ContactFit) -> float:
    """How deep the dent was at the peak of the force, at which the camera saw it: deeper than at the set force where
    that made too shallow a dent and more was pressed [m]."""
    return float(fit.depth_m * (fit.peak_force_n / fit.at_force_n) ** (1.0 / fit.exponent))


def pack(taken: SurfaceMeasurement | TouchMeasurement) -> bytes:
    """What a robot gave as a file of arrays; the same bytes for the same values."""
    file = io.BytesIO()
    told = {field.name: np.asarray(getattr(taken, field.name)) for field in dataclasses.fields(taken)}
    np.savez(file, allow_pickle=False, **told)
    return file.getvalue()


def unpack_looked(content: bytes) -> SurfaceMeasurement:
    """The reverse of `pack`."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return SurfaceMeasurement(file["points_m"], file["noise_m"])


def unpack_touched(content: bytes) -> TouchMeasurement:
    """The reverse of `pack`."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    scalars = {"reached": bool(arrays["reached"]), "seen_ns": int(arrays.get("seen_ns", 0))}
    return TouchMeasurement(**arrays | scalars | {"unseen": str(arrays.get("unseen", ""))})


def pinhole(told: CameraIntrinsics) -> Intrinsics:
    """What a depth camera tells of its projection, as the stages take it."""
    return Intrinsics((told.fx_px, told.fy_px), (told.cx_px, told.cy_px))


def sample_box(size_m: tuple[float, float], thickness_m: float) -> Box:
    """What belongs to the sample's surface: its edges are left out, where the camera sees its sides."""
    low = (EDGE_M, EDGE_M, LOW_SHARE * thickness_m)
    return Box(low, (size_m[0] - EDGE_M, size_m[1] - EDGE_M, thickness_m + ABOVE_M))


class ExplorationStopped(InputError):
    """The robot must not go on, or what it was to do came to nothing. stop: why, and when on the robot's clock"""

    def __init__(self, stop: ExplorationStop, time_ns: int) -> None:
        super().__init__("an exploration that comes to its end", f"{stop.kind}: {stop.reason}", stop.advice)
        self.stop, self.time_ns = stop, time_ns


Result = SurfaceEstimate | TouchEstimate | MapEstimate | PlannedTouch | StageFailure | PhaseStart | ExplorationStop


@dataclass(frozen=True, slots=True)
class Moment:
    """Results, and when they were there on the robot's clock [ns].

    compute_s: what computing them took; touch: 0 before the first, then the number of the one they belong to, from 1
    seen_ns: when the dent was last seen that they are of, None where they are of none
    """

    now_ns: int
    results: tuple[Result, ...]
    compute_s: float = 0.0
    touch: int = 0
    seen_ns: int | None = None


def explore(robot: ExploringRobot, explorer: Explorer) -> Iterator[Moment]:
    """Look, then touch until the plan says enough; gives results as they come. `explorer` holds what was found.

    Raises ExplorationStopped when the robot must not go on, or it makes no sense: what was found until then stands.
    """
    yield Moment(robot.now_ns(), (PhaseStart("look", 0),))
    looked = robot.look()
    began = time.perf_counter()
    seen = explorer.look(looked)
    failed = _NewFailures(explorer)
    yield Moment(robot.now_ns(), (*_made(seen), *failed()), time.perf_counter() - began)
    if seen is None:
        raise _given_up(robot, explorer)
    reachable = robot.reachable(explorer.grid)
    spent_s = 0.0
    while True:
        began = time.perf_counter()
        plan = None if explorer.given_up else explorer.next(reachable)
        aimed = None if plan is None or plan.target_m is None else explorer.approach(plan.target_m)
        spent_s += time.perf_counter() - began
        yield Moment(robot.now_ns(), (*_made(plan), *failed()), spent_s, len(explorer.told))
        if plan is not None and plan.target_m is None:
            return
        if plan is None or plan.target_m is None or aimed is None:
            raise _given_up(robot, explorer)
        number = len(explorer.told)
        touched = robot.touch(plan.target_m, *aimed)
        began = time.perf_counter()
        told = explorer.touch(touched)
        maps = explorer.maps()
        spent_s = time.perf_counter() - began
        yield Moment(robot.now_ns(), (PhaseStart("plan", number),), touch=number + 1)
        results: tuple[Result, ...] = (told, *_made(maps), *failed())
        yield Moment(robot.now_ns(), results, touch=number + 1, seen_ns=touched.seen_ns or None)


class _NewFailures:
    """Those that came since the last call."""

    def __init__(self, explorer: Explorer) -> None:
        self._explorer, self._count = explorer, 0

    def __call__(self) -> tuple[StageFailure, ...]:
        fresh = tuple(self._explorer.failures[self._count :])
        self._count = len(self._explorer.failures)
        return fresh


def _made(result: StageResult | None) -> tuple[StageResult, ...]:
    return () if result is None else (result,)


def _given_up(robot: ExploringRobot, explorer: Explorer) -> ExplorationStopped:
    last = explorer.failures[-1]
    reason = explorer.given_up or f"{last.stage}: {last.reason}"
    stop = ExplorationStop(ESTIMATES_FAILED, reason, "what failed, in the recording", "stop", len(explorer.told))
    return ExplorationStopped(stop, robot.now_ns())


def explore_again(inputs: dict[str, bytes], explorer: Explorer) -> Iterator[tuple[Result, ...]]:
    """The same computations on recorded inputs (`Explorer.new_inputs`), in their order."""
    if "looked" not in inputs:  # it was stopped before it had looked
        return
    yield _made(explorer.look(unpack_looked(inputs["looked"])))
    for name in sorted(name for name in inputs if name.startswith("touched-")):
        told = explorer.touch(unpack_touched(inputs[name]))
        yield told, *_made(explorer.maps())
