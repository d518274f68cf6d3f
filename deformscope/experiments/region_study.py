"""How many touches, and how far to travel, until the map of regions is right: planners on scenes, over seeds.

A world answers touches: any function from a place to (log stiffness, its deviation, rigid). The synthetic ones here are
label maps whose log stiffness is blurred by a contact of 1.2 cm, with noise; other shapes and a world of finite
elements fit the same harness.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.optimize import linear_sum_assignment
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.plan import FieldKernel, Planner, PlanOptions, plan_touch
from deformscope.stages.regions import RegionMap, RegionPosterior
from deformscope.stages.touches import MapGrid, Touch

World = Callable[[FloatArray], tuple[float, float, bool]]
"""From a place (2,) [m] to (log stiffness, its deviation, rigid)."""

GOOD_IOU = 0.85
BLUR_M = 0.012
NOISE = 0.08
RIGID_TIMES = 20.0
"""As stiff as this many times the foam of 60 N; above 12 times a touch counts as rigid, a lower bound."""

MODULUS = {60: 60.0, 110: 110.0, 150: 150.0, 20: 20.0, 120: 120.0, 0: 60.0 * RIGID_TIMES}
"""Relative stiffness of foams by hardness [N]; 0: rigid."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What a scene is. labels: (rows, columns), None where stiffness changes gradually; log_stiffness: the same shape,
    not blurred; level: (k,) of each label"""

    labels: IntArray | None
    log_stiffness: FloatArray
    level: FloatArray

    @property
    def region_count(self) -> int:
        return 1 if self.labels is None else int(self.labels.max()) + 1


@dataclass(frozen=True, slots=True)
class After:
    """The map after some touches. iou, boundary_m: nan where the truth has no regions (no boundary); covered: share of
    the true levels in their 90 % intervals, nan where k is wrong; field_rms: of log stiffness; ordered: levels of the
    matched regions stand in the right order; rigid_found: None where nothing is rigid; seconds: computing"""

    touches: int
    travel_m: float
    region_count: int
    verdict: str
    iou: float
    boundary_m: float
    covered: float
    field_rms: float
    ordered: bool
    rigid_found: bool | None
    probability: dict[str, float]
    seconds: float
    xy_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Run:
    """One scene and seed with one planner. stop_after: touches at which the planner itself would have stopped"""

    scene: str
    seed: int
    planner: Planner
    stop_after: int | None
    after: tuple[After, ...]


@dataclass(frozen=True, slots=True)
class Job:
    """What to run."""

    scene: str
    seed: int
    planner: Planner
    touches: int = 12
    noise: float = NOISE
    cell_m: float = 0.005


def scene_truth(scene: str, seed: int, grid: MapGrid | None = None) -> Truth:
    """A synthetic scene; places, tilts and sizes are drawn from the seed."""
    grid = grid or MapGrid()
    rng = np.random.default_rng((seed, 7))
    x, y = grid.centres_m.T.reshape(2, *grid.shape)
    width, height = grid.size_m
    tilt = np.tan(np.radians(rng.uniform(-15.0, 15.0)))
    across = x + tilt * (y - height / 2.0)
    kinds: dict[str, tuple[int, ...]] = {
        "homogeneous-60": (60,),
        "homogeneous-110": (110,),
        "two-60-150": (60, 150),
        "two-110-150": (110, 150),
        "two-150-rigid": (150, 0),
        "three-60-110-rigid": (60, 110, 0),
        "disc": (20, 120),
        "wavy": (60, 150),
        "soft-spot": (60, 20),
        "corner": (60, 150),
        "strip": (150, 60),
        "two-patches": (60, 150),
    }
    labels = np.zeros(grid.shape, dtype=int)
    if scene == "gradient":
        direction = rng.uniform(0.0, 2.0 * np.pi)
        along = np.cos(direction) * (x - width / 2) + np.sin(direction) * (y - height / 2)
        share = (along - along.min()) / np.ptp(along)
        log_stiffness = np.log(60.0) + share * np.log(150.0 / 60.0)
        return Truth(None, log_stiffness, np.zeros(0))
    if scene not in kinds:
        raise InputError(f"a scene of {', '.join((*kinds, 'gradient'))}", scene)
    if scene.startswith("two-1") or scene == "two-60-150":
        labels[across > width * rng.uniform(0.35, 0.65)] = 1
    elif scene == "wavy":
        wave = 0.03 * np.sin(2.0 * np.pi * y / rng.uniform(0.15, 0.3) + rng.uniform(0.0, 2.0 * np.pi))
        labels[across + wave > width * rng.uniform(0.4, 0.6)] = 1
    elif scene == "three-60-110-rigid":
        if rng.random() < 0.5:
            cuts = rng.uniform(0.25, 0.4), rng.uniform(0.6, 0.75)
            labels = (across > width * cuts[0]).astype(int) + (across > width * cuts[1])
        else:
            second = rng.uniform(0.35, 0.65) * height
            labels = np.where(across < width * rng.uniform(0.4, 0.6), 0, np.where(y < second, 1, 2))
        labels = rng.permutation(3)[labels]
    elif scene in ("disc", "soft-spot"):
        radius = rng.uniform(0.08, 0.10) if scene == "disc" else rng.uniform(0.05, 0.06)
        centre = [rng.uniform(radius + 0.02, side - radius - 0.02) for side in grid.size_m]
        labels[np.hypot(x - centre[0], y - centre[1]) < radius] = 1
    elif scene == "corner":
        labels[(x > width * rng.uniform(0.35, 0.6)) & (y > height * rng.uniform(0.3, 0.5))] = 1
    elif scene == "strip":
        middle, half = width * rng.uniform(0.4, 0.6), rng.uniform(0.06, 0.09)
        labels[np.abs(across - middle) < half] = 1
    elif scene == "two-patches":
        for share in (0.25, 0.75):
            centre = [width * (share + rng.uniform(-0.05, 0.05)), height * rng.uniform(0.35, 0.65)]
            labels[np.hypot(x - centre[0], y - centre[1]) < rng.uniform(0.07, 0.09)] = 1
    level = np.log([MODULUS[hardness] for hardness in kinds[scene]])
    return Truth(labels, level[labels], level)


def synthetic_world(truth: Truth, seed: int, grid: MapGrid | None = None, noise: float = NOISE) -> World:
    """Answers touches of a scene: log stiffness blurred by the contact, with noise that it tells."""
    grid = grid or MapGrid()
    felt = gaussian_filter(truth.log_stiffness, BLUR_M / grid.cell_m, mode="nearest")
    rng = np.random.default_rng((seed, 11))
    bound = float(np.log(12.0 * MODULUS[60]))

    def answer(xy_m: FloatArray) -> tuple[float, float, bool]:
        column, row = np.minimum((xy_m / grid.cell_m).astype(int), [grid.shape[1] - 1, grid.shape[0] - 1])
        value = float(felt[row, column] + noise * rng.standard_normal())
        return (bound, 0.3, True) if value > bound else (value, noise, False)

    return answer


def explore(
    world: World,
    truth: Truth,
    planner: Planner,
    touches: int,
    *,
    grid: MapGrid | None = None,
    seed: int = 0,
    kernel: FieldKernel | None = None,
) -> tuple[tuple[After, ...], int | None]:
    """Touch `touches` times where the planner says, whether or not it would stop; the map after each, and where it
    would have stopped."""
    posterior = RegionPosterior.before_touches(grid or MapGrid(), seed=seed)
    kernel = kernel or FieldKernel()
    options = PlanOptions(planner=planner, budget=touches + 1)
    rng = np.random.default_rng((seed, 13))
    tip = np.array([rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.35)]) * np.asarray(posterior.grid.size_m) / [0.6, 0.4]
    travel, found, stop_after = 0.0, [], None
    target: FloatArray | None = tip
    for count in range(1, touches + 1):
        if target is None:
            break
        travel += float(np.hypot(*(target - tip)))
        tip = target
        value, sd, rigid = world(tip)
        start = time.process_time()
        posterior = posterior.with_touch(Touch(tip, value, sd, rigid))
        shown = posterior.region_map()
        plan = plan_touch(posterior, kernel, options, seed=seed)
        seconds = time.process_time() - start
        found.append(score(shown, truth, count, travel, seconds, (float(tip[0]), float(tip[1]))))
        if stop_after is None and plan.stop is not None:
            stop_after = count
        target = plan.target_m
    return tuple(found), stop_after


def run_job(job: Job) -> Run:
    """One synthetic scene and seed; for processes side by side."""
    with threadpool_limits(1):
        grid = MapGrid(cell_m=job.cell_m)
        truth = scene_truth(job.scene, job.seed, grid)
        world = synthetic_world(truth, job.seed, grid, noise=job.noise)
        kernel = FieldKernel(noise_sd=job.noise)
        after, stop = explore(world, truth, job.planner, job.touches, grid=grid, seed=job.seed, kernel=kernel)
    return Run(job.scene, job.seed, job.planner, stop, after)


def score(
    shown: RegionMap, truth: Truth, touches: int, travel_m: float, seconds: float, xy_m: tuple[float, float]
) -> After:
    """A map against the truth."""
    rms = float(np.sqrt(np.mean((shown.field - truth.log_stiffness) ** 2)))
    if truth.labels is None:
        nothing = (np.nan, np.nan, np.nan)
        return After(
            touches,
            travel_m,
            shown.region_count,
            shown.verdict,
            *nothing,
            rms,
            True,
            None,
            shown.probability,
            seconds,
            xy_m,
        )
    # a verdict "gradual" calls no regions
    labels = shown.labels if shown.verdict == "regions" else np.zeros_like(shown.labels)
    iou, pairs = match_regions(labels, truth.labels)
    right = shown.verdict == "regions" and shown.region_count == truth.region_count
    rigid = truth.level > np.log(12.0 * MODULUS[60])
    inside = [
        shown.level_interval[a, 0] <= truth.level[b] <= shown.level_interval[a, 1] for a, b in pairs if not rigid[b]
    ]
    levels = [truth.level[b] for _, b in sorted(pairs)]
    return After(
        touches,
        travel_m,
        int(labels.max()) + 1,
        shown.verdict,
        iou,
        boundary_distance(labels, truth.labels, shown.grid.cell_m),
        float(np.mean(inside)) if right else np.nan,
        rms,
        bool(np.all(np.diff(levels) > 0.0)),
        bool(shown.rigid.any()) if rigid.any() else None,
        shown.probability,
        seconds,
        xy_m,
    )


def match_regions(found: IntArray, truth: IntArray) -> tuple[float, list[tuple[int, int]]]:
    """Mean intersection over union of the best matching of labels, over the larger number of regions; and the pairs
    (found, true) that match."""
    one, other = int(found.max()) + 1, int(truth.max()) + 1
    both = np.zeros((one, other))
    np.add.at(both, (found.ravel(), truth.ravel()), 1.0)
    union = both.sum(axis=1, keepdims=True) + both.sum(axis=0) - both
    shares = both / np.maximum(union, 1.0)
    rows, columns = linear_sum_assignment(-shares)
    return float(shares[rows, columns].sum() / max(one, other)), list(zip(rows.tolist(), columns.tolist(), strict=True))


def boundary_distance(found: IntArray, truth: IntArray, cell_m: float) -> float:
    """Mean distance between the boundaries of two label maps, both ways [m]; nan where one has none."""
    edges = [_boundary(labels) for labels in (found, truth)]
    if not all(edge.any() for edge in edges):
        return np.nan
    away = [distance_transform_edt(~edge) for edge in edges]
    return float(cell_m * 0.5 * (away[0][edges[1]].mean() + away[1][edges[0]].mean()))


def _boundary(labels: IntArray) -> BoolArray:
    edge = np.zeros(labels.shape, dtype=bool)
    edge[1:] |= labels[1:] != labels[:-1]
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    return edge


@dataclass(frozen=True, slots=True)
class Summary:
    """All seeds of a scene with one planner after so many touches.

    iou, boundary_m, field_rms, seconds: medians; good: share of seeds with iou 0.85 or better; right_count: share with
    the true number of regions, called regions; gradual, ordered, rigid_found: shares; covered: mean share of levels in
    their intervals, where the number is right; travel_m: mean; slowest: the longest computing after any touch [s]
    stop_after: median of the touches at which the planner would have stopped, inf where most would not
    """

    scene: str
    planner: Planner
    touches: int
    seeds: int
    iou: float
    good: float
    right_count: float
    gradual: float
    boundary_m: float
    covered: float
    field_rms: float
    ordered: float
    rigid_found: float
    travel_m: float
    seconds: float
    slowest: float
    stop_after: float


def summarise(runs: Sequence[Run], truth_count: int, touches: int) -> Summary:
    """Runs of one scene with one planner, whose truth has so many regions."""
    last = [run.after[min(touches, len(run.after)) - 1] for run in runs]
    seconds = [one.seconds for run in runs for one in run.after[:touches]]
    rigid = [float(one.rigid_found) for one in last if one.rigid_found is not None]
    return Summary(
        runs[0].scene,
        runs[0].planner,
        touches,
        len(runs),
        _median([one.iou for one in last]),
        float(np.mean([one.iou >= GOOD_IOU for one in last])),
        float(np.mean([one.verdict == "regions" and one.region_count == truth_count for one in last])),
        float(np.mean([one.verdict == "gradual" for one in last])),
        _median([one.boundary_m for one in last]),
        _mean([one.covered for one in last]),
        _median([one.field_rms for one in last]),
        float(np.mean([one.ordered for one in last])),
        _mean(rigid),
        _mean([one.travel_m for one in last]),
        _median(seconds),
        max(seconds),
        _median([np.inf if run.stop_after is None else run.stop_after for run in runs]),
    )


def _median(values: Sequence[float]) -> float:
    """Of those that are not nan; nan of none."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.median(known)) if known else np.nan


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else np.nan


def first_passage(run: Run, iou: float) -> tuple[float, float, bool]:
    """(touches, travel [m], reached) until the map is first this good; not reached: those of the last touch."""
    for after in run.after:
        if after.iou >= iou:
            return after.touches, after.travel_m, True
    return run.after[-1].touches, run.after[-1].travel_m, False


def ratio(
    runs: Sequence[Run], against: Sequence[Run], iou: float, what: int, draws: int = 2000, seed: int = 0
) -> tuple[float, float, float]:
    """Mean first passage over that of other runs of the same scenes and seeds, with 5 and 95 % of its bootstrap.

    what: 0 touches, 1 travel
    """
    key = {(run.scene, run.seed): run for run in against}
    pairs = np.array(
        [[first_passage(one, iou)[what], first_passage(key[one.scene, one.seed], iou)[what]] for one in runs]
    )
    rng = np.random.default_rng(seed)
    some = pairs[rng.integers(0, len(pairs), (draws, len(pairs)))].mean(axis=1)
    low, high = np.quantile(some[:, 0] / some[:, 1], [0.05, 0.95])
    return float(pairs[:, 0].mean() / pairs[:, 1].mean()), float(low), float(high)
