"""Input of a fit on a page: images whose particles are set there, or a fixed pair."""

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.config import BetaConfig, ImageOptions, ThetaConfig
from deformscope.config.calibrate import PushFlags
from deformscope.errors import InputError
from deformscope.experiments.fit.calibration_inputs import (
    images_of,
    mask_of,
    on_one_clock,
    opened_images,
    particle_options,
    thinned,
)
from deformscope.experiments.fit.foam_video import ParticleOptions, fit_pose, last_pose
from deformscope.experiments.fit.found_body import found_in
from deformscope.experiments.fit.push_force import PushOptions
from deformscope.file_io import SAMPLE_SCHEME, ending_of, read_file
from deformscope.files.pairs import parse_pair
from deformscope.files.sources import Source
from deformscope.page.fit_settings import picture_of
from deformscope.stages.fit.calibrate import Calibration, FitOptions, Progress, calibrate
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.fit.model import Observation
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.camera_turn import CameraTurn
from deformscope.stages.see.flow import FlowField, FlowStep, flow_onward
from deformscope.stages.see.follow import Follower
from deformscope.stages.see.particles import ParticleGrid, Tracked, advance, clean_mask, seed_grid, select_held, start

Doubts = tuple[Doubt, ...]
Force = tuple[PushOptions | None, PressForce | None]
MOST_BYTES = 2 << 30
"""Memory limit of the frames and of the stored flow."""

WIDTH_PX, RIM_PX = 800.0, 40.0
"""Width and margin of the picture of a pair."""
EYE = np.array([[0.87, 0.0], [0.42, -0.3], [0.0, -1.0]])
"""Projection of a body in space to a picture: from the front, slightly from the right and above."""


class ImagesSubject:
    """A sequence in which particles are followed, a frame at a time. size_px: width, height of its images

    found: options with the body that was found in the images, if none was named; doubts: whether the images suit a fit
    force: the force on the contact, and its log
    count: number of frames; followed: frames through which the particles were followed so far, the one at rest
    included; frames are taken as they are needed. In small images the particles of any grid follow a stored flow in
    milliseconds; in large ones they are followed from the beginning."""

    kind: Literal["images"] = "images"

    def __init__(
        self,
        source: Source,
        frames_of: int | None = None,
        found: ImageOptions | None = None,
        doubts: Doubts = (),
        force: Force = (None, None),
    ) -> None:
        self.found, self.doubts, self._force = found, doubts, force
        self._frames, self._frames_of = iter(source), frames_of
        first = next(self._frames)
        self._images, self._times_ns = [first.image], [first.stamp.host_ns]
        self._flows: list[tuple[FlowField, FlowField]] = []
        self._last: FlowStep | None = None
        self._kept_bytes = 0
        self.count = source.count or 2
        self.goes_on = True
        height, width = self._images[0].shape[:2]
        self.size_px = float(width), float(height)
        self._placed: tuple[ImageOptions, ParticleGrid, IntArray] | None = None
        self._history: list[Tracked] = []

    @property
    def followed(self) -> int:
        """See the class."""
        return len(self._history)

    def picture(self, frame: int) -> bytes:
        """The image of a frame, counted from 0, as JPEG."""
        return picture_of(self._images[frame])

    def place(self, config: BetaConfig | ThetaConfig) -> tuple[ParticleGrid, IntArray]:
        """The particles at rest with these options, and indices of the held ones. Others than before are followed from
        the beginning. Raises InputError without particles."""
        images, size = images_of(config), self._images[0].shape[:2]
        if self._placed is not None and self._placed[0] == images:
            return self._placed[1:]
        particles = particle_options(images)
        mask = mask_of(config.sources, images, (size[0], size[1]))
        region = None if mask is None else clean_mask(mask)
        grid = seed_grid(size, particles.roi_rect, particles.grid, particles.spacing_px, region)
        held = select_held(grid, particles.held, particles.contact_rect)
        if self._placed is None or not np.array_equal(grid.rest_px, self._placed[1].rest_px):
            self._history, self.goes_on = [start(grid)], True
            self._follower = Follower(grid, (size[0], size[1]))
            for flow in self._flows:
                self._history.append(advance(self._history[-1], *flow))
        self._placed = images, grid, held
        return grid, held

    def follow(self) -> None:
        """Follow the particles to the next frame, if there is one. Raises InputError for a single frame, and for more
        than may be held in memory."""
        done = len(self._history)
        if done == len(self._images):
            if (frame := next(self._frames, None)) is None:
                self.goes_on, self.count = False, done
                if done < 2:
                    raise InputError("at least two frames", "fewer", "a longer sequence, or a smaller --stride")
                return
            self._images.append(frame.image)
            self._times_ns.append(frame.stamp.host_ns)
            self._kept_bytes += frame.image.nbytes
        before, after = self._images[done - 1 : done + 1]
        if self._follower.is_large:
            there = self._follower.step(before, after, self._history[-1])[1]
        else:
            self._last = flow_onward(before, after, self._last)
            flow = self._last.forward, FlowField(self._last.backward.flow_px)  # all of it that `advance` looks at
            self._flows.append(flow)
            there = advance(self._history[-1], *flow)
            maps = (*(getattr(flow[0], name) for name in ("flow_px", "noise_px", "misfit")), flow[1].flow_px)
            self._kept_bytes += sum(one.nbytes for one in maps)
        self._history.append(there)
        self.count = max(self.count, done + 1)
        if self._kept_bytes > MOST_BYTES:
            came = f"more: {done + 1} frames so far"
            self.goes_on = False
            raise InputError(f"frames and flow of at most {MOST_BYTES >> 30} GiB", came, "a larger --stride")

    def observe(self, config: BetaConfig | ThetaConfig) -> Observation:
        """The newest pose with these options, once a frame was followed. Raises InputError without particles."""
        return last_pose(self.place(config)[0], self._history, self._particles(config))[0]

    def fit(self, config: BetaConfig | ThetaConfig, options: FitOptions, progress: Progress) -> Calibration:
        """The whole fit of that pose, with its force. Raises InputError."""
        times = [1e-9 * (one - self._times_ns[0]) for one in self._times_ns[: self.followed]]
        grid = self.place(config)[0]
        camera = CameraTurn(self._images[0], grid)
        for image in self._images[1 : self.followed] if self._force[0] else ():
            camera.look(image)
        pose = grid, self._history, times, camera.turns(), self._particles(config)
        return fit_pose(*pose, options, progress, *self._force)

    def _particles(self, config: BetaConfig | ThetaConfig) -> ParticleOptions:
        particles = particle_options(images_of(config), config.search.noise_px)
        return dataclasses.replace(particles, frames_of=self._frames_of)

    def in_picture(self, position: FloatArray) -> FloatArray:
        """(K, d) positions of an observation as (K, 2) x, y [px]."""
        return position


class PairSubject:
    """A pair file, in the plane (y up) or in space (z up). size_px: width, height of its picture; it has no images"""

    kind: Literal["pair"] = "pair"
    followed, count, goes_on = 2, 2, False
    found: ImageOptions | None = None
    doubts = Doubts()

    def __init__(self, config: BetaConfig | ThetaConfig) -> None:
        raw = read_file(config.sources[0], "a pair file (.npz)")
        self._seen = one = parse_pair(raw, config.sources[0], noise_m=config.search.noise_m)
        self._eye = EYE if one.rest.shape[1] == 3 else np.array([[1.0, 0.0], [0.0, -1.0]])
        drawn = np.concatenate([one.rest, one.deformed[np.isfinite(one.deformed).all(axis=1)]]) @ self._eye
        self._low, size = drawn.min(axis=0), np.ptp(drawn, axis=0)
        self._scale = (WIDTH_PX - 2 * RIM_PX) / float(size.max())
        width, height = size * self._scale + 2 * RIM_PX
        self.size_px = float(width), float(height)

    def observe(self, config: BetaConfig | ThetaConfig) -> Observation:
        """See `ImagesSubject.observe`."""
        return self._seen

    def fit(self, config: BetaConfig | ThetaConfig, options: FitOptions, progress: Progress) -> Calibration:
        """See `ImagesSubject.fit`."""
        return calibrate([self._seen], options, progress=progress)

    def in_picture(self, position: FloatArray) -> FloatArray:
        """(K, 2) [px] of (K, d) positions, as `ImagesSubject.in_picture`."""
        return np.asarray((position @ self._eye - self._low) * self._scale + RIM_PX)


FitSubject = ImagesSubject | PairSubject


def subject_of(
    config: BetaConfig | ThetaConfig, note: Callable[[str], None], read_force: Callable[[PushFlags], Force]
) -> FitSubject:
    """The subject in the files that a command's options name. note: the present step, as text; read_force: reads the
    options' force"""
    if ending_of(config.sources[0]) == ".npz":
        return PairSubject(config)
    push, log = read_force(config.push)
    images = images_of(config)
    found, doubts = images, Doubts()
    if (images.roi is None and images.mask is None) or not config.sources[0].startswith(SAMPLE_SCHEME):
        with opened_images(config.sources, images) as source:
            if config.push.force_frame is not None:
                source.end_at(config.push.force_frame)
            found, _, doubts = found_in(source, images, note)
    timed = log is not None
    source = opened_images(config.sources, images, timed=timed).__enter__()  # read until it ends, or this process does
    frames_of = thinned(source, particle_options(images), config, note).frames_of
    force = on_one_clock(source, config, push, log)
    return ImagesSubject(source, frames_of, found if found != images else None, doubts, force)
