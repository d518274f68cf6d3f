"""Anisotropy, fields of stiffness, yielding and recovery from tracked images, or from files: one fit, and its
comparison with every frame."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.fit.whole_motion import ParticleOptions, TrackedMotion, last_pose, tracked_motion
from deformscope.session import Experiment, Step
from deformscope.stages.fit.doubts import little_explained
from deformscope.stages.fit.estimate import Comparison, NoiseSource
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.fit.motion import Motion
from deformscope.stages.fit.search import Progress
from deformscope.stages.materials import press_cycle
from deformscope.stages.materials.anisotropy import fit_axes
from deformscope.stages.materials.axis_estimate import AxisEstimate
from deformscope.stages.materials.field import fit_field
from deformscope.stages.materials.field_estimate import FieldEstimate
from deformscope.stages.materials.plasticity import YieldOptions, fit_yield, simulate_yielding
from deformscope.stages.materials.recovery import RecoveryEstimate, fit_recovery
from deformscope.stages.materials.yield_estimate import YieldEstimate
from deformscope.stages.msm.materials import AxisBeta
from deformscope.stages.see.particles import select_held

MaterialEstimate = AxisEstimate | FieldEstimate | YieldEstimate | RecoveryEstimate

MOST_FRAMES = 8
"""Most frames of a camera's motion to which yielding is fitted: a history of loads takes seconds for each frame."""


@dataclass(frozen=True, slots=True)
class UnloadingOptions:
    """How the end of a push is determined. released: the held parts that are released; at: the loaded and the unloaded
    frame, if given; force: force of the tool, where it was recorded"""

    released: tuple[str, ...] = ("contact",)
    at: tuple[int, int] | None = None
    force: press_cycle.PressForce | None = None


@dataclass(frozen=True, slots=True)
class MaterialFit:
    """Result of a material's fit. comparisons: comparison of some frames, by index; motion: the fitted motion, if
    any"""

    estimate: MaterialEstimate
    comparisons: tuple[tuple[int, Comparison], ...]
    motion: Motion | None = None


def material_video(
    particles: ParticleOptions, find: Callable[[TrackedMotion], MaterialFit], mask: BoolArray | None = None
) -> Experiment[MaterialFit]:
    """Track particles through the frames, fit, and show every frame with the fit. mask: (H, W) True where the thing is
    in the first frame"""
    return (yield from _shown(find((yield from tracked_motion(particles, mask)))))


def material_files(find: Callable[[], MaterialFit]) -> Experiment[MaterialFit]:
    """Fit pairs or a motion from files, which have no images."""
    yield Step()
    return (yield from _shown(find()))


def _shown(found: MaterialFit) -> Experiment[MaterialFit]:
    for frame, comparison in found.comparisons:
        yield Step((comparison,), frame=frame)
    yield Step((found.estimate,), frame=0)
    return found


# Anisotropy ----------------------------------------------------------------------------------------------------------


def axes_of_pairs(
    seen: Sequence[Observation], model: Model, axes: FloatArray, level: float, seed: int, progress: Progress | None
) -> MaterialFit:
    """One fit to all pairs, each of which is a place on the `frame` timeline. axes: (d, d) unit vectors as rows"""
    estimate = fit_axes(seen, model, axes=axes, level=level, seed=seed, progress=progress)
    law = AxisBeta(estimate.value, estimate.axes)
    simulated = [model.body(one).relax(one.deformed[one.held], law).position[0] for one in seen]
    compared = (
        Comparison(one.rest, one.deformed, position, one.observed, one.held, one.unit)
        for one, position in zip(seen, simulated, strict=True)
    )
    return MaterialFit(estimate, tuple(enumerate(compared)))


def field_of_pair(seen: Observation, level: float, seed: int, device: str, progress: Progress | None) -> MaterialFit:
    """Relative stiffness of each place."""
    estimate, comparison = fit_field(seen, level=level, seed=seed, device=device, progress=progress)
    return MaterialFit(estimate, ((0, comparison),))


def pose_of(tracked: TrackedMotion, particles: ParticleOptions, frame: int | None) -> tuple[int, Observation]:
    """The fitted frame, and its observation. frame: None = the last one"""
    last = len(tracked.history) - 1
    if frame is not None and not 0 < frame <= last:
        raise InputError(f"--at FRAME from 1 to {last}, the last frame", str(frame))
    at = last if frame is None else frame
    return at, last_pose(tracked.grid, tracked.history[: at + 1], particles)[0]


# A motion of a camera ------------------------------------------------------------------------------------------------


def camera_motion(
    tracked: TrackedMotion, particles: ParticleOptions, unloading: UnloadingOptions
) -> tuple[Motion, press_cycle.PressCycle]:
    """All frames, the first one at rest among them, and the time of the release.

    Released parts count as held until the frame of the release. After that the particles count as not seen."""
    released = [part for part in particles.held if part in unloading.released]
    if not released:
        came = f"--held {','.join(particles.held)}"
        hint = "--contact X,Y,WIDTH,HEIGHT where the tool presses, or --released PART"
        raise InputError("a held part that is released at the end", came, hint)
    stays = [part for part in particles.held if part not in released]
    if not stays:
        hint = "hold the fixed part too, such as --held bottom,contact"
        raise InputError("a held part that is not released", f"--held {','.join(particles.held)} alone", hint)
    grid, history = tracked.grid, tracked.history
    still, pressed = (select_held(grid, parts, particles.contact_rect) for parts in (stays, released))
    still = np.setdiff1d(still, pressed)
    seen = np.stack([moment.seen for moment in history])
    position = np.stack([np.asarray(moment.position_px, dtype=np.float64) for moment in history])
    position[~seen] = np.nan
    rest = np.asarray(grid.rest_px, dtype=np.float64)
    noise = particles.noise_px or float(np.median(history[-1].noise_px[seen[-1]]))
    cycle = press_cycle.find_cycle(
        press_cycle.course_of(position - rest, pressed),
        noise,
        time_s=np.asarray(tracked.times),
        force=unloading.force,
        given=unloading.at,
    )
    held = np.zeros(seen.shape, dtype=bool)
    held[:, still] = True
    held[: cycle.unloaded, pressed] = True
    held &= seen
    position[cycle.unloaded :, pressed] = np.nan  # what a tool covered is not followed well once it lifts
    if not held[:, still].any(axis=1).all():
        raise InputError(f"held particles of {','.join(stays)} that can be tracked", "all of them lost at a frame")
    scale = None if particles.px_per_cm is None else 0.01 / particles.px_per_cm
    duration = _durations(np.asarray(tracked.times))
    origin: NoiseSource = "flow" if particles.noise_px is None else "given"
    return Motion(rest, position, held, duration, grid.shape, grid.cell, noise, "px", scale, origin), cycle


def some_frames(motion: Motion, rows: IntArray, end_s: FloatArray) -> Motion:
    """Some frames of a motion, each lasting until the next of them. end_s: (T,) time of each frame [s]"""
    return dataclasses.replace(
        motion, position=motion.position[rows], held=motion.held[rows], duration=_durations(end_s[rows])
    )


def _durations(time_s: FloatArray) -> FloatArray:
    gap = np.diff(time_s)
    if not (gap > 0.0).all():
        raise InputError("frames with rising times", f"a step of {gap.min():g} s", "--fps, or a recording with stamps")
    return np.append(gap, gap[-1])


# Yielding ------------------------------------------------------------------------------------------------------------


def yield_of_motion(motion: Motion, options: YieldOptions, progress: Progress | None) -> MaterialFit:
    """All frames of a motion file."""
    estimate = fit_yield(motion, options, progress)
    return MaterialFit(estimate, _comparisons(motion, estimate.simulated), motion)


def yield_of_camera(
    tracked: TrackedMotion,
    particles: ParticleOptions,
    unloading: UnloadingOptions,
    options: YieldOptions,
    progress: Progress | None,
) -> MaterialFit:
    """Some frames are fitted; the result is then simulated at every one."""
    motion, cycle = camera_motion(tracked, particles, unloading)
    time_s = np.asarray(tracked.times)
    rows = press_cycle.frames_to_fit(cycle, MOST_FRAMES, between=options.creep != "none")
    fitted = some_frames(motion, rows, time_s)
    found = fit_yield(fitted, options, progress)
    settings = found.settings | {"unloading": cycle.as_json(), "fitted_frames": rows.tolist()}
    estimate = dataclasses.replace(found, settings=settings)
    every = np.arange(1, len(time_s))
    later = some_frames(motion, every, time_s)
    shown = _comparisons(later, simulate_yielding(later, options, estimate), first=1)
    return MaterialFit(estimate, shown, fitted)


def _comparisons(motion: Motion, states: FloatArray, first: int = 0) -> tuple[tuple[int, Comparison], ...]:
    """Every frame with the simulation (T, K, d). first: index of the first frame"""
    return tuple(
        (frame, Comparison(motion.rest, seen, state, np.isfinite(seen).all(axis=1), np.flatnonzero(held), motion.unit))
        for frame, (seen, state, held) in enumerate(zip(motion.position, states, motion.held, strict=True), first)
    )


# Recovery ------------------------------------------------------------------------------------------------------------


def recovery_of_motion(motion: Motion, level: float, seed: int) -> MaterialFit:
    """The recovery in a motion file: particles that are held at the greatest depth and not at the end count as
    released."""
    if motion.duration is None:
        raise InputError("the time between frames", "none", "give `dt` [s] in the file")
    gone = np.flatnonzero(motion.held.any(axis=0) & ~motion.held[-1])
    if not gone.size:
        came = "the same particles held in every frame"
        raise InputError("a motion with a release", came, "`held` as bool (T, K), and frames after the tool is off")
    time_s = np.concatenate([[0.0], motion.duration[0] + np.cumsum(np.append(0.0, motion.duration[:-1]))])
    whole = dataclasses.replace(
        motion,
        position=np.concatenate([motion.rest[None], motion.position]),
        held=np.concatenate([motion.held[:1], motion.held]),
        duration=np.append(motion.duration[0], motion.duration),
    )
    released = int(np.flatnonzero(whole.held[:, gone].any(axis=1))[-1]) + 1
    course = press_cycle.course_of(whole.position - whole.rest, gone)
    loaded = int(course[:released].argmax())
    cycle = press_cycle.PressCycle(loaded, released, course, float(course[released] / course[loaded]), "given")
    return _recovery(whole, cycle, time_s, None, level, seed, first=-1)


def recovery_of_camera(
    tracked: TrackedMotion, particles: ParticleOptions, unloading: UnloadingOptions, level: float, seed: int
) -> MaterialFit:
    """Recovery from a camera's images, with a force if it was recorded."""
    motion, cycle = camera_motion(tracked, particles, unloading)
    return _recovery(motion, cycle, np.asarray(tracked.times), unloading.force, level, seed)


def _recovery(
    motion: Motion,
    cycle: press_cycle.PressCycle,
    time_s: FloatArray,
    force: press_cycle.PressForce | None,
    level: float,
    seed: int,
    first: int = 0,
) -> MaterialFit:
    moved = motion.position - motion.rest
    amplitude, deepest, known = press_cycle.share_of_push(moved)
    shape = moved[deepest, known]
    found = fit_recovery(
        time_s,
        amplitude,
        loaded=cycle.loaded,
        released=None if cycle.source == "displacement" else cycle.unloaded,
        force_n=None if force is None else force.at(time_s),
        force_sd_n=0.0 if force is None else force.zero_sd_n,
        largest=float(cycle.course[cycle.loaded]),
        level=level,
        seed=seed,
    )
    after = moved[cycle.loaded :, known]
    left = after - amplitude[cycle.loaded :, None, None] * shape
    explained = 1.0 - float(np.sum(left**2) / np.sum(after**2))
    reasons = (*little_explained(explained, left_is_noise=False), *found.reasons)
    verdict = "unidentified" if any(one.allows == "unidentified" for one in reasons) else found.verdict
    settings = found.settings | {"unloading": cycle.as_json(), "particles": int(known.sum())}
    estimate = dataclasses.replace(
        found,
        verdict=verdict,
        reasons=reasons,
        explained=explained,
        unit=motion.unit,
        metres_per_unit=motion.metres_per_unit,
        settings=settings,
    )
    size = np.where(np.isfinite(found.simulated), found.simulated, amplitude)
    rise = np.where(known[:, None], moved[deepest], np.nan)
    states = motion.rest + size[:, None, None] * rise
    every = _comparisons(motion, states, first)
    return MaterialFit(estimate, every[max(0, -first) :], motion)
