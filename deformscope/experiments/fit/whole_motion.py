"""All frames of a sequence in one fit, and the selection of options by held-out error (Thesis 3, future work).

Every frame has its own held positions; beta, clusters and the held set are shared. How frames count together is in
`deformscope.stages.fit.shared_errors`, how ways of fitting are compared in `deformscope.stages.fit.held_out`. Cluster
size and held set are selected by static states, which do not depend on alpha and dt. alpha and dt are selected
afterwards, by time stepping through the frames.

The fit of the last pose alone is that of the thesis (Thesis 3, experiment 5.2): flow and particles of a deforming thing
in a sequence of images. The sweep fits the last frame; the best value is then simulated at every frame, so that the
timeline `frame` shows simulated next to observed particles."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.config.flags import HeldPart
from deformscope.config.images import ParticleFlags
from deformscope.errors import InputError
from deformscope.experiments.fit.push_force import PushOptions, found_by_force, with_force
from deformscope.session import Experiment, Step, measuring
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model, Observation, Progress, calibrate
from deformscope.stages.fit.dynamics import MovingSearch, Pace
from deformscope.stages.fit.estimate import Choice, Comparison
from deformscope.stages.fit.force import FLOW_WINDOW_PX
from deformscope.stages.fit.held_out import TOLD_LEAST, HeldOut, blocks_of, difference, hold_out, separates
from deformscope.stages.fit.search import Search
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.msm.clusters import held_mask, spacing
from deformscope.stages.see.camera_turn import CameraTurn
from deformscope.stages.see.follow import Follower
from deformscope.stages.see.particles import ParticleGrid, Rect, Tracked, seed_grid, select_held, start

Selectable = Literal["cluster-size", "held", "alpha", "dt"]

CLUSTER_SIZES = (2, 3, 4, 5)
ALPHAS = (0.1, 0.25, 0.5, 0.75, 1.0)
DTS_S = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2)
DT_S = 2e-3
"""Time step if only alpha is selected (Thesis 3)."""

CANDIDATES = 16
"""Number of values of the parameter with which each way of fitting is tried."""

FRAMES_TO_SELECT = 12
"""Number of frames, evenly spread, on which ways of fitting are compared."""

PARTICLES_IN_ALL = 150_000
"""Largest number of particles of all frames that are fitted at once (some 1 GB); of longer sequences evenly spread
frames are fitted."""

JUDGES_LEAST = 8
"""Least number of particles that are free in every way of fitting: with fewer, ways are not compared."""
FRAMES_AT_ONCE = 256
"""Number of frames simulated in one launch; the next launch starts from the last of them."""


@dataclass(frozen=True, slots=True)
class ParticleOptions(ParticleFlags):
    """Options that turn an image into particles, and noise_px, the deviation of a measured position.
    frames_of: number of frames in the sequence, if only some are followed; None = all are followed"""

    held: tuple[HeldPart, ...] = ("top", "bottom")
    px_per_cm: float | None = None
    noise_px: float | None = None
    frames_of: int | None = None

    @property
    def roi_rect(self) -> Rect | None:
        """The region that holds the thing."""
        return None if self.roi is None else Rect(*self.roi)

    @property
    def contact_rect(self) -> Rect | None:
        """The tool's footprint."""
        return None if self.contact is None else Rect(*self.contact)


def foam_video(
    particles: ParticleOptions,
    fit: FitOptions,
    mask: BoolArray | None = None,
    progress: Progress | None = None,
    push: PushOptions | None = None,
    log: PressForce | None = None,
) -> Experiment[Calibration]:
    """Follow particles through the frames, then fit the last pose and simulate every frame. mask: (H, W) True where the
    thing is in the first frame; push: force on the contact, if known; log: force over time, where `push` has none"""
    times: list[float] = []
    cameras: list[CameraTurn] | None = None if push is None else []
    grid, history = yield from track(particles, mask, times, cameras)
    if len(history) < 2:
        raise InputError("at least two frames", "one", "a longer sequence, or a smaller --stride")
    with measuring("estimate"):
        seen, used = last_pose(grid, history, particles)
        if push is None or not cameras:
            found = calibrate([seen], fit, settings=used, progress=progress)
        else:
            parts = particles.held, particles.contact_rect
            pushed = with_force(seen, grid, history, times, cameras[0].turns(), *parts, push, log, fit.level)
            found = calibrate([pushed.seen], fit, settings=used, progress=progress)
            found = dataclasses.replace(found, estimate=found_by_force(found.estimate, pushed, push, fit.seed))
    for index, comparison in enumerate(follow(found.seen[-1], history, fit.model, found)):
        yield Step((comparison,), frame=index)
    yield Step((found.estimate,))
    return found


def last_pose(
    grid: ParticleGrid, history: Sequence[Tracked], particles: ParticleOptions
) -> tuple[Observation, dict[str, object]]:
    """Input of the fit from tracked particles [px], and the record of their tracking."""
    held, moved = hold_what_is_seen(grid, history[-1], particles.held, particles.contact_rect)
    seen = observe(grid, history[-1], held, particles)
    used: dict[str, object] = {
        "frames": len(history),
        **({} if particles.frames_of is None else {"frames_of": particles.frames_of}),
        "particles": len(grid.rest_px),
        "lost": int(np.count_nonzero(~history[-1].seen)),
        "held": len(seen.held),
        "held_parts": list(particles.held),
        "held_moved": moved,
        "noise_source": "flow" if particles.noise_px is None else "given",
    }
    return seen, used


def track(
    particles: ParticleOptions,
    mask: BoolArray | None = None,
    times: list[float] | None = None,
    cameras: list[CameraTurn] | None = None,
) -> Experiment[tuple[ParticleGrid, list[Tracked]]]:
    """Follow particles through the frames: their positions at rest, and at every frame. mask: (H, W) True where the
    thing is in the first frame; times, cameras: where given, each frame's time after the first [s], and the camera
    whose turns are followed, are added to them"""
    frame = yield Step()
    if frame is None:
        raise InputError("at least two frames", "none")
    grid = seed_grid(frame.image.shape[:2], particles.roi_rect, particles.grid, particles.spacing_px, mask)
    select_held(grid, particles.held, particles.contact_rect)  # refuses at once what cannot be held
    history = [start(grid)]
    began = frame.stamp
    if times is not None:
        times.append(0.0)
    if cameras is not None:
        cameras.append(CameraTurn(frame.image, grid))
    step = Step((grid, history[0]))
    follower = Follower(grid, frame.image.shape[:2])
    while True:
        following = yield step
        if following is None:
            return grid, history
        flow, there = follower.step(frame.image, following.image, history[-1])
        history.append(there)
        if times is not None:
            times.append(1e-9 * (following.stamp.host_ns - began.host_ns))
        for camera in cameras or ():
            camera.look(following.image)
        step = Step((flow, there))
        frame = following


def hold_what_is_seen(
    grid: ParticleGrid, last: Tracked, parts: Sequence[str], contact: Rect | None
) -> tuple[IntArray, list[str]]:
    """Indices (n,) of the held particles whose motion is known, and the parts that were replaced by others.

    Lost particles are not prescribed, but free. If a held part was lost completely (the specimen's end
    has left the image), the outermost row or column in view is held instead."""
    chosen: list[IntArray] = []
    moved: list[str] = []
    still = np.flatnonzero(last.seen)
    for part in parts:
        one = select_held(grid, [part], contact)
        if np.count_nonzero(last.seen[one]) >= min(len(one), 2):  # one particle left of a row says little of its motion
            chosen.append(one[last.seen[one]])
            continue
        if part == "contact" or still.size < 4:
            raise InputError(
                f"held particles of {part!r} that can be tracked",
                "all of them lost",
                "a smaller --stride; the images in order, the one at rest first; or a --roi with more texture",
            )
        rest = ParticleGrid(grid.rest_px[still], grid.shape, grid.cell[still], grid.spacing_px)
        chosen.append(still[select_held(rest, [part])])
        moved.append(part)
    return np.unique(np.concatenate(chosen)), moved


def observe(grid: ParticleGrid, last: Tracked, held: IntArray, particles: ParticleOptions) -> Observation:
    """The last pose as an observation [px]. held: (n,) indices of particles"""
    given = particles.noise_px is not None
    noise = np.full(len(grid.rest_px), particles.noise_px) if given else last.noise_px
    return Observation(
        rest=np.asarray(grid.rest_px, dtype=np.float64),
        deformed=np.asarray(last.position_px, dtype=np.float64),
        held=held,
        observed=last.seen,
        noise=noise,
        shape=grid.shape,
        cell=grid.cell,
        unit="px",
        metres_per_unit=None if particles.px_per_cm is None else 0.01 / particles.px_per_cm,
        held_measured=True,
        noise_source="given" if given else "flow",
    )


def follow(seen: Observation, history: list[Tracked], model: Model, found: Calibration) -> list[Comparison]:
    """The best value simulated at every frame, many frames in one launch, each with that frame's held positions."""
    positions: FloatArray = np.stack([np.asarray(moment.position_px, dtype=np.float64) for moment in history])
    value = found.estimate.value
    beta, theta = (value, model.theta) if model.parameter == "beta" else (model.beta, value)
    body = model.body(seen)
    simulated: list[FloatArray] = []
    for first in range(0, len(positions), FRAMES_AT_ONCE):
        held = positions[first : first + FRAMES_AT_ONCE, seen.held]
        simulated.extend(body.relax(held, beta, theta, start=simulated[-1] if simulated else None).position)
    still = found.comparisons[0]
    return [
        dataclasses.replace(still, observed=positions[index], simulated=simulated[index], seen=moment.seen)
        for index, moment in enumerate(history)
    ]


@dataclass(frozen=True, slots=True)
class TrackedMotion:
    """Particles followed through a sequence: the grid, their positions at each frame, and the frames' times [s]."""

    grid: ParticleGrid
    history: list[Tracked]
    times: list[float]

    def frames(self, most: int) -> IntArray:
        """(n,) frames after the first, which has no information: all, or evenly spread ones including the last."""
        count = len(self.history) - 1
        return np.unique(np.linspace(count, 1, min(count, max(most, 1))).round().astype(int))

    def observations(self, rows: IntArray, held: IntArray, particles: ParticleOptions) -> list[Observation]:
        """Frames (n,), as observations of one body [px]. held: (m,) indices of particles"""
        every = [observe(self.grid, self.history[row], held, particles) for row in rows]
        return [dataclasses.replace(one, rest=every[0].rest, held=held, cell=every[0].cell) for one in every]


@dataclass(frozen=True, slots=True)
class Way:
    """A way of fitting: a model, the held parts with their particles, and the settings of time stepping, if any."""

    model: Model
    parts: tuple[str, ...]
    held: IntArray
    moved: tuple[str, ...]
    pace: Pace | None = None


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected model, all candidates, and remarks on the selection."""

    way: Way
    table: tuple[Choice, ...]
    text: str


def tracked_motion(particles: ParticleOptions, mask: BoolArray | None) -> Experiment[TrackedMotion]:
    """Follow particles through the frames. mask: (H, W) True where the thing is in the first frame"""
    times: list[float] = []
    grid, history = yield from track(particles, mask, times)
    if len(history) < 2:
        raise InputError("at least two frames", "one", "a longer sequence, or a smaller --stride")
    return TrackedMotion(grid, history, times)


def whole_motion(
    particles: ParticleOptions,
    fit: FitOptions,
    asked: tuple[Selectable, ...],
    mask: BoolArray | None = None,
    progress: Progress | None = None,
) -> Experiment[Calibration]:
    """Follow particles through the frames, fit all frames, and simulate every one.

    asked: options that are selected by held-out error; others are those of `fit` and `particles`
    mask: (H, W) True where the thing is in the first frame"""
    motion = yield from tracked_motion(particles, mask)
    with measuring("estimate"):
        found, way = fit_motion(motion, particles, fit, asked, progress)
    for index, comparison in enumerate(simulated(motion, particles, way, found)):
        yield Step((comparison,), frame=index)
    yield Step((found.estimate,))
    return found


def fit_motion(
    motion: TrackedMotion,
    particles: ParticleOptions,
    fit: FitOptions,
    asked: tuple[Selectable, ...],
    progress: Progress | None = None,
) -> tuple[Calibration, Way]:
    """The fit of all frames, and the options that were selected for it."""
    chosen = select(motion, particles, fit, asked, progress)
    way = chosen.way
    rows = motion.frames(PARTICLES_IN_ALL // len(motion.grid.rest_px) if way.pace is None else len(motion.history))
    last = motion.history[-1]
    settings: dict[str, object] = {
        "frames": len(motion.history),
        "frames_fitted": len(rows),
        "whole_motion": True,
        "select": list(asked),
        "particles": len(motion.grid.rest_px),
        "lost": int(np.count_nonzero(~last.seen)),
        "held": len(way.held),
        "held_parts": list(way.parts),
        "held_moved": list(way.moved),
        "noise_source": "flow" if particles.noise_px is None else "given",
        "dt": None if way.pace is None else way.pace.dt,
        "dynamic": way.pace is not None,
    }
    found = calibrate(
        motion.observations(rows, way.held, particles),
        dataclasses.replace(fit, model=way.model),
        one_motion=True,
        pace=way.pace,
        settings=settings,
        progress=progress,
    )
    estimate = dataclasses.replace(found.estimate, selection=chosen.table, selection_text=chosen.text)
    return dataclasses.replace(found, estimate=estimate), way


def simulated(motion: TrackedMotion, particles: ParticleOptions, way: Way, found: Calibration) -> list[Comparison]:
    """The best value simulated at every frame."""
    if way.pace is None:
        seen = motion.observations(np.array([len(motion.history) - 1]), way.held, particles)[0]
        return follow(seen, motion.history, way.model, found)
    still = motion.observations(np.array([0]), way.held, particles)[0]
    first = Comparison(still.rest, still.deformed, still.rest, still.observed, still.held, still.unit)
    return [first, *found.comparisons]


# Selection -----------------------------------------------------------------------------------------------------------


def select(
    motion: TrackedMotion,
    particles: ParticleOptions,
    fit: FitOptions,
    asked: tuple[Selectable, ...],
    progress: Progress | None = None,
) -> Selection:
    """Select the options by the error on particles left out."""
    if not asked:
        return Selection(_ways(motion, particles, fit.model, ())[0], (), "")
    ways = _ways(motion, particles, fit.model, asked)
    # (K,) particles that are free with every held set: else holding more would always win
    judged: BoolArray = ~np.any([held_mask(len(motion.grid.rest_px), way.held) for way in ways], axis=0)
    if np.count_nonzero(judged & motion.history[-1].seen) < JUDGES_LEAST:
        raise InputError(
            f"{JUDGES_LEAST} particles that are free with all held parts, for the comparison",
            str(np.count_nonzero(judged & motion.history[-1].seen)),
            "a finer --grid, or --select without held",
        )
    static = [choice for choice in ("cluster-size", "held") if choice in asked]
    tried = _try(motion, particles, fit, ways, judged, "selecting", progress)
    best = _best(tried)
    text = _static_messages(tried, best, static) if static else []
    table = _rows(tried, best)
    if "alpha" in asked or "dt" in asked:
        moving = _moving_ways(motion, fit.model, ways[best], asked)
        stepped = _try(motion, particles, fit, moving, judged, "time stepping", progress)
        fastest = _best(stepped)
        still = tried[best][1]
        text.append(_pace_message(stepped, fastest, still, asked))
        table += _rows(stepped, fastest)
        if separates(still, stepped[fastest][1]):
            table = [dataclasses.replace(one, chosen=one.chosen and one.alpha is not None) for one in table]
            return Selection(moving[fastest], tuple(table), "; ".join(text))
        table = [dataclasses.replace(one, chosen=one.chosen and one.alpha is None) for one in table]
    return Selection(ways[best], tuple(table), "; ".join(text))


def held_sets(particles: ParticleOptions) -> list[tuple[str, ...]]:
    """The held sets that are tried: the requested one, and others that the flags make possible."""
    every: list[tuple[str, ...]] = [("bottom",), ("top", "bottom"), ("border",)]
    if particles.contact is not None:
        every = [("bottom", "contact"), ("top", "bottom", "contact"), ("border", "contact")]
    return list(dict.fromkeys([particles.held, *every]))


def _ways(motion: TrackedMotion, particles: ParticleOptions, model: Model, choices: Sequence[Selectable]) -> list[Way]:
    """Those of static states; the first is the requested one."""
    last, contact = motion.history[-1], particles.contact_rect
    sizes: list[int | None] = [model.cluster_size]
    if "cluster-size" in choices:
        sizes += [size for size in CLUSTER_SIZES if size <= min(motion.grid.shape) and size != model.cluster_size]
    ways: list[Way] = []
    for parts in held_sets(particles) if "held" in choices else [particles.held]:
        try:
            held, moved = hold_what_is_seen(motion.grid, last, parts, contact)
        except InputError:
            if not ways:  # what was asked for
                raise
            continue  # a part that cannot be followed, or that leaves no particle free
        some = [dataclasses.replace(model, cluster_size=size) for size in sizes]
        ways += [Way(one, parts, held, tuple(moved)) for one in some]
    return ways


def _moving_ways(motion: TrackedMotion, model: Model, still: Way, choices: Sequence[Selectable]) -> list[Way]:
    """Time stepping with each alpha and dt, the frames' times permitting."""
    alphas = sorted({*ALPHAS, model.alpha}) if "alpha" in choices else [model.alpha]
    times = tuple(float(time) for time in motion.times[1:])
    shortest = float(np.diff(motion.times).min())
    dts = [dt for dt in DTS_S if dt <= shortest] or [shortest] if "dt" in choices else [min(DT_S, shortest)]
    return [
        dataclasses.replace(still, model=dataclasses.replace(still.model, alpha=alpha), pace=Pace(alpha, dt, times))
        for dt in dts
        for alpha in alphas
    ]


Trial = tuple[Way, HeldOut]


def _try(
    motion: TrackedMotion,
    particles: ParticleOptions,
    fit: FitOptions,
    ways: Sequence[Way],
    judged: BoolArray,
    what: str,
    progress: Progress | None,
) -> list[Trial]:
    """The held-out error of every way."""
    rest = np.asarray(motion.grid.rest_px, dtype=np.float64)
    block, fold = blocks_of(rest, spacing(rest), FLOW_WINDOW_PX)
    found = []
    for number, way in enumerate(ways):
        if progress is not None:
            progress(what, number, len(ways))
        seen = motion.observations(motion.frames(len(motion.history)), way.held, particles)
        some = motion.frames(FRAMES_TO_SELECT) - 1
        search: Search
        if way.pace is None:
            search = Search([seen[row] for row in some], way.model, fit.bounds)
        else:
            search = MovingSearch(seen, way.model, fit.bounds, way.pace).only(some, np.ones(len(some)))
        low, high = (search.stretch(bound) for bound in fit.bounds)
        search.simulate(search.shrink(np.linspace(low, high, CANDIDATES)))
        found.append((way, hold_out(search, judged, block, fold)))
    return found


def _best(tried: Sequence[Trial]) -> int:
    """The least held-out error; of those within a hundredth of it, the one with the fewest particles held."""
    errors = np.array([out.error if out.usable else np.inf for _, out in tried])
    if not np.isfinite(errors).any():
        raise InputError("a simulation that stays finite", "every one diverged", "a lower --theta")
    near: list[int] = np.flatnonzero(errors <= (1.0 + TOLD_LEAST) * errors.min()).tolist()
    return min(near, key=lambda i: (len(tried[i][0].held), errors[i]))


def _rows(tried: Sequence[Trial], best: int) -> list[Choice]:
    rows = []
    for index, (way, out) in enumerate(tried):
        pace = way.pace
        rows.append(
            Choice(
                cluster_size=way.model.cluster_size,
                held=way.parts,
                alpha=None if pace is None else pace.alpha,
                dt=None if pace is None else pace.dt,
                held_out=out.error,
                scatter=difference(out, tried[best][1])[1],
                fit=out.fit,
                value=out.value,
                chosen=index == best,
            )
        )
    return rows


def _static_messages(tried: Sequence[Trial], best: int, choices: Sequence[str]) -> list[str]:
    """Whether the data determine each choice."""
    way, out = tried[best]
    said = []
    for choice in choices:

        def value(one: Way, choice: str = choice) -> str:
            return f"{one.model.cluster_size} a side" if choice == "cluster-size" else ",".join(one.parts)

        others = [one for one in tried if value(one[0]) != value(way) and one[1].usable]
        same = list(dict.fromkeys(value(one[0]) for one in others if not separates(one[1], out)))
        name = "clusters" if choice == "cluster-size" else "held"
        also = f" ({' and '.join(same)} fit as well)" if same else ""
        said.append(f"{name}: {value(way)}{also}")
    return said


def _pace_message(tried: Sequence[Trial], best: int, still: HeldOut, choices: Sequence[Selectable]) -> str:
    """Whether the data determine alpha and dt at all, and which values fit as well as the best."""
    out = tried[best][1]
    names = " and ".join(choice for choice in ("alpha", "dt") if choice in choices)
    if not separates(still, out):
        late = sum(not one.usable or separates(one, still) for _, one in tried)
        but = f" ({late} of {len(tried)} settings tried would lag behind)" if late else ""
        return f"the motion was slow enough to be static: it does not determine {names}{but}"
    good = [way.pace for way, one in tried if one.usable and way.pace is not None and not separates(one, out)]
    said = []
    if "alpha" in choices:
        said.append("alpha " + _span([pace.alpha for pace in good]))
    if "dt" in choices:
        said.append("dt " + _span([pace.dt for pace in good]) + " s")
    return f"time stepping fits better than static states: {', '.join(said)} (creep and yield have the same effect)"


def _span(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
