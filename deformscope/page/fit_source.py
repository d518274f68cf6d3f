"""Input of a fit on a page: images whose particles are set there, or a fixed pair."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, ImageArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.errors import InputError
from deformscope.experiments.fit.calibration_inputs import images_of, mask_of, opened_images, particle_options
from deformscope.experiments.fit.foam_video import ParticleOptions, last_pose
from deformscope.file_io import ending_of, read_file
from deformscope.files.pairs import parse_pair
from deformscope.frames import ColorFrame
from deformscope.images import encode_jpeg
from deformscope.stages.fit.model import Observation
from deformscope.stages.see.flow import FlowField, FlowStep, flow_onward
from deformscope.stages.see.particles import ParticleGrid, Tracked, advance, clean_mask, seed_grid, select_held, start

MOST_BYTES = 2 << 30
"""Memory limit of the stored flow."""


class CachedFlow:
    """The stored optical flow of a sequence: particles of any grid follow it in milliseconds. first, last: first and
    last image

    frames: the frames in order; note: called with the number of frames taken so far.
    Raises InputError for a single frame, and for more frames than may be held in memory."""

    def __init__(self, frames: Iterable[ColorFrame], note: Callable[[int], None]) -> None:
        self._flows: list[tuple[FlowField, FlowField]] = []
        images: list[ImageArray] = []
        held_bytes = 0
        step: FlowStep | None = None
        for done, frame in enumerate(frames, 1):
            if images:
                step = flow_onward(images[-1], frame.image, step)
                forward, backward = step.forward, step.backward
                self._flows.append((forward, FlowField(backward.flow_px)))  # all of them that `advance` looks at
                maps = (forward.flow_px, forward.noise_px, forward.misfit, backward.flow_px)
                held_bytes += sum(one.nbytes for one in maps if one is not None)
                if held_bytes > MOST_BYTES:
                    came = f"more: {done} frames so far"
                    raise InputError(f"flow of at most {MOST_BYTES >> 30} GiB to keep", came, "a larger --stride")
            images = [*images[:1], frame.image]
            note(done)
        if len(images) < 2:
            raise InputError("at least two frames", "fewer", "a longer sequence, or a smaller --stride")
        self.first, self.last = images

    def follow(self, particles: ParticleOptions, mask: BoolArray | None) -> tuple[ParticleGrid, list[Tracked]]:
        """Positions of the particles at rest and at every frame [px], as `foam_video.track` returns them. mask: (H, W)
        mask of the body"""
        grid = seed_grid(self.first.shape[:2], particles.roi_rect, particles.grid, particles.spacing_px, mask)
        select_held(grid, particles.held, particles.contact_rect)
        history = [start(grid)]
        for forward, backward in self._flows:
            history.append(advance(history[-1], forward, backward))
        return grid, history


WIDTH_PX, RIM_PX = 800.0, 40.0
"""Width and margin of the picture of a pair."""
EYE = np.array([[0.87, 0.0], [0.42, -0.3], [0.0, -1.0]])
"""Projection of a body in space to a picture: from the front, slightly from the right and above."""


class ImagesSubject:
    """Images with stored optical flow. size_px: width, height; images: rest and deformed, as JPEG"""

    kind: Literal["images"] = "images"

    def __init__(self, motion: CachedFlow) -> None:
        self._motion = motion
        height, width = motion.first.shape[:2]
        self.size_px = float(width), float(height)
        both = (motion.first, motion.last)
        low = min(float(one.min()) for one in both)
        high = max(float(one.max()) for one in both)
        self.images = tuple(encode_jpeg(_eight_bits(one, low, high)) for one in both)

    def observe(self, config: BetaConfig | ThetaConfig) -> tuple[Observation, Mapping[str, object]]:
        """The observation with these options, and a fit's record of it. Raises InputError without particles."""
        images = images_of(config)
        height, width = self._motion.first.shape[:2]
        mask = mask_of(config.sources, images, (height, width))
        particles = particle_options(images, config.search.noise_px)
        grid, history = self._motion.follow(particles, None if mask is None else clean_mask(mask))
        return last_pose(grid, history, particles)

    def in_picture(self, position: FloatArray) -> FloatArray:
        """(K, d) positions of an observation as (K, 2) x, y [px]."""
        return position


class PairSubject:
    """A pair file, in the plane (y up) or in space (z up). size_px: width, height of its picture; it has no images"""

    kind: Literal["pair"] = "pair"
    images: tuple[bytes, ...] = ()

    def __init__(self, config: BetaConfig | ThetaConfig) -> None:
        raw = read_file(config.sources[0], "a pair file (.npz)")
        self._seen = one = parse_pair(raw, config.sources[0], noise_m=config.search.noise_m)
        self._eye = EYE if one.rest.shape[1] == 3 else np.array([[1.0, 0.0], [0.0, -1.0]])
        drawn = np.concatenate([one.rest, one.deformed[np.isfinite(one.deformed).all(axis=1)]]) @ self._eye
        self._low, size = drawn.min(axis=0), np.ptp(drawn, axis=0)
        self._scale = (WIDTH_PX - 2 * RIM_PX) / float(size.max())
        width, height = size * self._scale + 2 * RIM_PX
        self.size_px = float(width), float(height)

    def observe(self, config: BetaConfig | ThetaConfig) -> tuple[Observation, Mapping[str, object]]:
        """See `ImagesSubject.observe`."""
        return self._seen, {}

    def in_picture(self, position: FloatArray) -> FloatArray:
        """(K, 2) [px] of (K, d) positions, as `ImagesSubject.in_picture`."""
        return np.asarray((position @ self._eye - self._low) * self._scale + RIM_PX)


FitSubject = ImagesSubject | PairSubject


def subject_of(config: BetaConfig | ThetaConfig, note: Callable[[str], None]) -> FitSubject:
    """The subject in the files that a command's options name. note: the present step, as text"""
    if ending_of(config.sources[0]) == ".npz":
        return PairSubject(config)
    images = images_of(config)
    with opened_images(config.sources, images) as source:
        of = "" if source.count is None else f" of {source.count}"
        return ImagesSubject(CachedFlow(source, lambda done: note(f"optical flow: frame {done}{of}")))


def _eight_bits(image: ImageArray, low: float, high: float) -> ImageArray:
    """The image with 8 bits, for a browser: `low` to `high` are spread over them."""
    if image.dtype == np.uint8:
        return image
    return ((image.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))).clip(0, 255).astype(np.uint8)
