"""A deforming thing in a sequence of images: flow, particles, and the fit of the last pose (Thesis 3, experiment 5.2).

The sweep fits the last frame, as in the thesis (`whole_motion` fits every frame). The best value is then simulated at
every frame, so that the timeline `frame` shows simulated next to observed particles."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.config.flags import HeldPart
from deformscope.config.images import ParticleFlags
from deformscope.errors import InputError
from deformscope.experiments.fit.push_force import PushOptions, found_by_force, with_force
from deformscope.session import Experiment, Step, measuring
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Model, Observation, Progress, calibrate
from deformscope.stages.fit.estimate import Comparison
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.camera_turn import CameraTurn
from deformscope.stages.see.follow import Follower
from deformscope.stages.see.particles import ParticleGrid, Rect, Tracked, seed_grid, select_held, start

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
