"""Cubes of known Poisson's ratio, pressed between plates: theta estimated for each (Thesis 5.1, experiment 3.A).

The thesis's cubes are made here with finite elements, or any others come from pair files. Each cube has this project's
calibration of theta for one quadratic cluster (as in the thesis). For comparison it has the lowest error of a dense
grid. It also has the lowest errors of one cluster and of overlapping clusters if beta is fitted too."""

import functools
import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

import numpy as np
from scipy.sparse.linalg import cg
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.files.arrays_file import read_arrays
from deformscope.files.pairs import parse_pair
from deformscope.lab.elasticity import ElasticBox
from deformscope.stages.fit.calibrate import calibrate, simulate
from deformscope.stages.fit.estimate import Curve, Estimate
from deformscope.stages.fit.model import FitOptions, Model, Observation, distances
from deformscope.stages.msm import clusters
from deformscope.stages.msm.solver import Msm
from studies.reproduce.both_fit import FitBoth, fit_beta_theta
from studies.reproduce.searches import SearchOutcome, compare_searches

Compare = Literal["deepest", "all", "none"]
POISSON = (0.0, 0.1, 0.25, 0.4, 0.49)
SIDES = (6, 8, 11)
"""Particles along a side: the thesis's coarse, fine and finer cubes."""
DEPTHS_M = (0.01, 0.02, 0.03)
SIDE_M, YOUNG_PA = 0.1, 750e3

DENSE_GRID = 2001
"""Number of values of theta; no estimate may exceed their lowest error."""

SAME_DEPTH = 1e-3
"""Share below which two depths count as one in the tables."""

CG_STEPS = 25
"""Steps of the thesis's SOFA-CG (3.5.1.6)."""

STEPS = 200
"""Number of time steps that are timed together."""

HELD_SHARE = 1.0 / 3.0
"""Share of the body's mass that `equal_share` gives to the held particles: their share in a lattice of 6^3."""


@dataclass(frozen=True, slots=True)
class Cube:
    """A body that is pressed like the thesis's cubes. poisson: its Poisson's ratio; depth: largest motion of a held
    particle [m]; name: where it came from"""

    seen: Observation
    poisson: float
    depth: float
    name: str

    @property
    def resolution(self) -> str:
        """`11^3` or `6x8x8`, or the number of particles without a lattice."""
        shape = self.seen.shape
        if shape is None:
            return f"{len(self.seen.rest)} particles"
        return f"{shape[0]}^{len(shape)}" if len(set(shape)) == 1 else "x".join(map(str, shape))


@dataclass(frozen=True, slots=True)
class ElementTime:
    """Time of the finite elements of one resolution, mean over Poisson's ratios. unknowns: unknowns of the equations
    assemble_s, solve_s: time to assemble, and to solve by a direct solver [s]; cg_s: time of `CG_STEPS` steps of
    conjugate gradients, as in the thesis's SOFA-CG [s]; cg_left: remaining residual after these steps, as a share of
    the right-hand side"""

    resolution: str
    unknowns: int
    assemble_s: float
    solve_s: float
    cg_s: float = float("nan")
    cg_left: float = float("nan")


@dataclass(frozen=True, slots=True)
class CubeFit:
    """How theta of cubes is fitted; see the flags of `studies.reproduce.cubes`."""

    method: Literal["sweep", "gradient"] = "sweep"
    cluster_size: int = 2
    compare: Compare = "deepest"
    level: float = 0.9
    seed: int = 0


@dataclass(frozen=True, slots=True)
class CubeResult:
    """Result of one cube.

    theta: the calibration, whose least AEE is the thesis's
    curve: the dense grid's errors, thinned; grid_theta, grid_aee: its lowest [m]
    one_cluster, overlapping: lowest error with beta fitted too; None without this comparison
    searches: the thesis's searches and that of deformscope on the same errors
    equal_share_theta: theta of the lowest error if the held particles have `HELD_SHARE` of the body's mass
    simulated: (K, d) positions at the thesis's theta; seconds: duration of the calibration [s]"""

    cube: Cube
    theta: Estimate
    simulated: FloatArray
    curve: Curve
    grid_theta: float
    grid_aee: float
    equal_share_theta: float
    one_cluster: FitBoth | None
    overlapping: FitBoth | None
    seconds: float
    searches: tuple[SearchOutcome, ...] = ()

    @property
    def value(self) -> float:
        """The thesis's theta, that of the least AEE."""
        assert self.theta.least_aee is not None
        return self.theta.least_aee[0]

    @property
    def aee(self) -> float:
        """The least AEE [m]."""
        assert self.theta.least_aee is not None
        return self.theta.least_aee[1]

    @property
    def over_grid(self) -> float:
        """Relative excess of the calibration's error over the dense grid's lowest; below 0 if it is lower."""
        return self.aee / self.grid_aee - 1.0 if self.grid_aee > 0.0 else 0.0

    @property
    def ratio(self) -> float | None:
        """Error of overlapping clusters over that of a single cluster with theta only."""
        return None if self.overlapping is None else self.overlapping.aee / self.aee


# The cubes -----------------------------------------------------------------------------------------------------------


def thesis_cubes(
    poisson: Sequence[float] = POISSON, sides: Sequence[int] = SIDES, depths: Sequence[float] = DEPTHS_M
) -> tuple[list[Cube], list[ElementTime]]:
    """The thesis's cubes: 10 cm, 750 kPa, bottom fixed, top pressed down without motion sideways, linear elastic.

    Particles are the corners of the elements. The equations are linear, so one solution serves every depth (m)."""
    made: list[Cube] = []
    times: list[ElementTime] = []
    for side in sides:
        axis = np.linspace(0.0, SIDE_M, side)
        spent = np.zeros(4)
        unknowns = 0
        for ratio in poisson:
            began = time.perf_counter()
            box = ElasticBox(axis, axis, axis, young=YOUNG_PA, poisson=ratio)
            assembled = time.perf_counter()
            bottom, top = box.plane(2, 0.0), box.plane(2, SIDE_M)
            pressed = np.zeros(box.nodes.shape)
            pressed[top, 2] = -1.0
            fixed = np.repeat((bottom | top)[:, None], 3, axis=1)
            with threadpool_limits(1):
                by_depth = box.hold(fixed).solve(pressed).displacement[box.corners]
            solved = time.perf_counter()
            spent += assembled - began, solved - assembled, *_few_gradients(box, fixed, pressed)
            unknowns = int(np.count_nonzero(~fixed))
            rest = box.nodes[box.corners]
            held = np.flatnonzero((bottom | top)[box.corners])
            made.extend(_made(rest, by_depth, held, side, ratio, depth) for depth in depths)
        each = spent / len(poisson)
        times.append(ElementTime(f"{side}^3", unknowns, *map(float, each)))
    return made, times


def _few_gradients(box: ElasticBox, fixed: BoolArray, pressed: FloatArray) -> tuple[float, float]:
    """Seconds of `CG_STEPS` conjugate gradients on the same equations, and their remaining share of the load. fixed,
    pressed: (N, 3) prescribed displacements, and their values"""
    free = np.flatnonzero(~fixed.ravel())
    own = box.stiffness[free]
    right = -(own @ np.where(fixed, pressed, 0.0).ravel())
    own = own[:, free]
    began = time.perf_counter()
    with threadpool_limits(1):
        found, _ = cg(own, right, rtol=0.0, maxiter=CG_STEPS)
    return time.perf_counter() - began, float(np.linalg.norm(right - own @ found) / np.linalg.norm(right))


def _made(rest: FloatArray, by_depth: FloatArray, held: IntArray, side: int, poisson: float, depth: float) -> Cube:
    everyone: BoolArray = np.ones(len(rest), dtype=bool)
    shape, cell = (side, side, side), np.arange(len(rest))
    seen = Observation(rest, rest + depth * by_depth, held, everyone, shape=shape, cell=cell, held_measured=False)
    return Cube(seen, poisson, depth, f"finite elements, {side}^3, nu {poisson:g}, {100 * depth:g} cm")


_RATIO_IN_NAME = re.compile(r"nu_?(0?\.\d+|0(?![\d.]))", re.IGNORECASE)


def cube_from_pair(raw: bytes, name: str) -> Cube:
    """A pair file's bytes as a cube; Poisson's ratio is its `nu`, or in its name (`..._nu0.25...`).

    Raises InputError for another kind of file, or without the ratio."""
    seen = parse_pair(raw, name)
    given = read_arrays(raw, "a pair file (.npz of arrays)", name).get("nu", np.empty(0)).reshape(-1)
    if given.size == 1 and given.dtype.kind in "fiu":
        poisson = float(given[0])
    elif found := _RATIO_IN_NAME.search(PurePath(name).stem):
        poisson = float(found[1])
    else:
        raise InputError("nu (Poisson's ratio) in the pair file", "none there or in its name", "add nu=0.3", name)
    if not -1.0 < poisson <= 0.5:
        raise InputError("a Poisson's ratio above -1 and up to 0.5", f"{poisson:g}", where=name)
    moved = np.linalg.norm((seen.deformed - seen.rest)[seen.held], axis=1)
    return Cube(seen, poisson, float(moved.max()), name)


def depth_of(cube: Cube, depths: Sequence[float]) -> float:
    """The one of `depths` that the cube's depth counts as."""
    return min(depths, key=lambda depth: abs(depth - cube.depth))


def depths_of(cubes: Sequence[Cube]) -> list[float]:
    """The distinct depths of cubes, rising [m]."""
    distinct: list[float] = []
    for depth in sorted(cube.depth for cube in cubes):
        if not distinct or depth > distinct[-1] * (1.0 + SAME_DEPTH):
            distinct.append(depth)
    return distinct


# One cube ------------------------------------------------------------------------------------------------------------


def examine(cube: Cube, options: CubeFit, compare: bool) -> CubeResult:
    """All results of one cube; compare: fit beta too."""
    model = Model("theta", "quadratic", None)
    with threadpool_limits(1):
        began = time.perf_counter()
        fit = FitOptions(model, (0.0, 1.0), options.method, level=options.level, seed=options.seed)
        found = calibrate([cube.seen], fit)
        seconds = time.perf_counter() - began
        assert found.estimate.least_aee is not None
        thesis = found.estimate.least_aee[0]
        curve = dense_curve(cube.seen, model.body(cube.seen), model.beta)
        low = int(np.nanargmin(curve.aee))
        one = both = None
        if compare:
            body = model.body(cube.seen)
            one = _fit_both(cube.seen, body, (model.beta, thesis), "scale")
            small = Model("theta", "linear", options.cluster_size, volume="project").body(cube.seen)
            both = _fit_both(cube.seen, small, (0.9, 0.5), "project")
        return CubeResult(
            cube=cube,
            theta=found.estimate,
            simulated=simulate(cube.seen, model, np.array([thesis]))[0].simulated,
            curve=Curve(curve.parameter[::20], curve.aee[::20]),
            grid_theta=float(curve.parameter[low]),
            grid_aee=float(curve.aee[low]),
            equal_share_theta=equal_share(cube.seen, model.beta),
            one_cluster=one,
            overlapping=both,
            seconds=seconds,
            searches=compare_searches(cube.seen, model, (0.0, 1.0)),
        )


def _fit_both(seen: Observation, body: Msm, start: tuple[float, float], volume: Literal["scale", "project"]) -> FitBoth:
    observed = np.where(seen.observed[:, None], seen.deformed, np.nan)
    return fit_beta_theta(body, seen.deformed[seen.held], observed, start=start, volume=volume)


def dense_curve(seen: Observation, body: Msm, beta: float, count: int = DENSE_GRID) -> Curve:
    """The error (eq. 3.18) at `count` values of theta, evenly spaced over [0, 1]; NaN if the body diverged."""
    theta = np.linspace(0.0, 1.0, count)
    parts = []
    for some in np.array_split(theta, max(1, count * len(seen.rest) // 200_000)):
        found = body.relax(seen.deformed[seen.held], beta, some)
        error = distances(found.position[:, seen.observed], seen.deformed[seen.observed]).mean(axis=1)
        parts.append(np.where(found.diverged, np.nan, error))
    return Curve(theta, np.concatenate(parts))


def equal_share(seen: Observation, beta: float) -> float:
    """theta of the lowest error if the held particles have `HELD_SHARE` of the body's mass.

    With equal masses the share of held particles falls when a lattice is finer (6^3: a third, 11^3: 18 %), and so does
    their effect on the cluster's fit. A smaller theta then has the same effect, and theta drifts with resolution."""
    count, held = len(seen.rest), len(seen.held)
    mass = np.ones(count)
    mass[seen.held] = HELD_SHARE / (1.0 - HELD_SHARE) * (count - held) / held
    body = Msm(seen.rest, clusters.single(count), seen.held, mass=mass, basis="quadratic")
    curve = dense_curve(seen, body, beta, 401)
    usable = np.flatnonzero(np.isfinite(curve.aee))
    return float(curve.parameter[usable[curve.aee[usable].argmin()]]) if usable.size else float("nan")


# All of them ---------------------------------------------------------------------------------------------------------


def compared(cubes: Sequence[Cube], which: Compare) -> list[bool]:
    """Whether overlapping clusters are fitted to this cube."""
    if which != "deepest":
        return [which == "all"] * len(cubes)
    deepest: dict[tuple[str, float], float] = {}
    for cube in cubes:
        key = cube.resolution, cube.poisson
        deepest[key] = max(deepest.get(key, 0.0), cube.depth)
    return [cube.depth >= deepest[cube.resolution, cube.poisson] for cube in cubes]


def standard_error(values: Iterable[float]) -> float:
    """Standard error of the mean (SEM); NaN for fewer than two values."""
    given = np.fromiter(values, dtype=np.float64)
    return float(given.std(ddof=1) / np.sqrt(given.size)) if given.size > 1 else float("nan")


@dataclass(frozen=True, slots=True)
class Spread:
    """theta over cubes of one Poisson's ratio.

    of: other properties that they share, "" without any; count: number of cubes; sem: standard error of the mean;
    equal_share_sem: that of `Found.equal_share_theta`"""

    poisson: float
    of: str
    count: int
    mean: float
    sem: float
    equal_share_sem: float


def spreads(found: Sequence[CubeResult], of: Callable[[Cube], str] = lambda _: "") -> list[Spread]:
    """Mean and SEM of theta for each Poisson's ratio and each value of `of` (figure 3.10 a, b and c)."""
    groups: dict[tuple[float, str], list[CubeResult]] = {}
    for one in found:
        groups.setdefault((one.cube.poisson, of(one.cube)), []).append(one)
    return [
        Spread(
            poisson,
            name,
            len(group),
            float(np.mean([one.value for one in group])),
            standard_error(one.value for one in group),
            standard_error(one.equal_share_theta for one in group),
        )
        for (poisson, name), group in sorted(groups.items(), key=lambda item: item[0][0])
    ]


def rises(found: Sequence[CubeResult], *, to_bound: bool = False) -> bool:
    """Whether theta rises strictly with Poisson's ratio at every resolution and depth. to_bound: theta need not rise
    any further at the end of its range"""
    depths = depths_of([one.cube for one in found])
    series: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for one in found:
        key = one.cube.resolution, depth_of(one.cube, depths)
        value = one.value
        if to_bound and value >= one.theta.bounds[1]:
            value += one.cube.poisson  # any further ratio counts as a rise
        series.setdefault(key, []).append((one.cube.poisson, value))
    return all(bool((np.diff([theta for _, theta in sorted(pairs)]) > 0.0).all()) for pairs in series.values())


@dataclass(frozen=True, slots=True)
class ModelTime:
    """Time of MSM at one resolution [s]. step: time of one time step of one quadratic cluster; static: its static
    state; theta: theta with its interval, mean over cubes"""

    resolution: str
    step: float
    static: float
    theta: float


def model_times(found: Sequence[CubeResult], repeats: int = 15) -> list[ModelTime]:
    """Times of the model for each resolution, medians of `repeats`."""
    every: dict[str, list[CubeResult]] = {}
    for one in found:
        every.setdefault(one.cube.resolution, []).append(one)
    times = []
    for name, group in every.items():
        seen, theta = group[-1].cube.seen, group[-1].value
        model = Model("theta", "quadratic", None)
        body, held = model.body(seen), seen.deformed[seen.held]
        step = (
            _median(functools.partial(body.step, body.start(), held, model.beta, theta, steps=STEPS), repeats) / STEPS
        )
        static = _median(functools.partial(body.relax, held, model.beta, theta), repeats)
        times.append(ModelTime(name, step, static, float(np.mean([one.seconds for one in group]))))
    return times


def _median(run: Callable[[], object], repeats: int) -> float:
    run()  # compiles, and fills scratch
    spent = []
    for _ in range(repeats):
        began = time.perf_counter()
        run()
        spent.append(time.perf_counter() - began)
    return float(np.median(spent))
