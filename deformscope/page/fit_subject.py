"""What a fit on a page is made of: a sequence of images whose particles are set there, or a pair as it is."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Literal, Protocol

import numpy as np

from deformscope.arrays import FloatArray, ImageArray
from deformscope.calibration_options import images_of, mask_of, opened_images, particle_options
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.errors import InputError
from deformscope.experiments.foam_video import last_pose
from deformscope.experiments.kept_motion import KeptMotion
from deformscope.file_io import ending_of, read_file
from deformscope.files.pairs import parse_pair
from deformscope.images import encode_jpeg
from deformscope.stages.fit.model import Observation
from deformscope.stages.see.particles import clean_mask

WIDTH_PX, RIM_PX = 800.0, 40.0
"""Of the picture of a pair."""
EYE = np.array([[0.87, 0.0], [0.42, -0.3], [0.0, -1.0]])
"""From x, y, z of a body in space to a picture of it: from the front, a little from the right and above."""


class FitSubject(Protocol):
    """What is fitted.

    size_px: width, height of its picture; images: rest and deformed, empty where there are none
    """

    kind: Literal["images", "pair"]
    size_px: tuple[float, float]
    images: tuple[bytes, ...]

    def observe(self, config: BetaConfig | ThetaConfig) -> tuple[Observation, Mapping[str, object]]:
        """What was seen with these options, and what a fit records of it. Raises InputError where there is nothing."""

    def in_picture(self, position: FloatArray) -> FloatArray:
        """(K, d) positions of an observation as (K, 2) x, y [px]."""


class MotionSubject:
    """Images whose optical flow is kept."""

    kind: Literal["images", "pair"] = "images"

    def take(self, motion: KeptMotion) -> None:
        """From now on it is made of these."""
        self._motion = motion
        height, width = motion.first.shape[:2]
        self.size_px = float(width), float(height)
        both = (motion.first, motion.last)
        low = min(float(one.min()) for one in both)
        high = max(float(one.max()) for one in both)
        self.images = tuple(encode_jpeg(_eight_bits(one, low, high)) for one in both)

    def observe(self, config: BetaConfig | ThetaConfig) -> tuple[Observation, Mapping[str, object]]:
        """As `FitSubject.observe`."""
        images = images_of(config)
        height, width = self._motion.first.shape[:2]
        mask = mask_of(config.sources, images, (height, width))
        particles = particle_options(images, config.search.noise_px)
        grid, history = self._motion.follow(particles, None if mask is None else clean_mask(mask))
        return last_pose(grid, history, particles)

    def in_picture(self, position: FloatArray) -> FloatArray:
        """As `FitSubject.in_picture`."""
        return position


class ImagesSubject(MotionSubject):
    """A video, a folder, images, a sample, or a camera's images in a recording. note: of what is done"""

    def __init__(self, config: BetaConfig | ThetaConfig, note: Callable[[str], None]) -> None:
        images = images_of(config)
        with opened_images(config.sources, images) as source:
            of = "" if source.count is None else f" of {source.count}"
            self.take(KeptMotion(source, images.flow, lambda done: note(f"optical flow: frame {done}{of}")))


class PairSubject:
    """A pair file, in the plane (y up) or in space (z up)."""

    kind: Literal["images", "pair"] = "pair"
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
        """As `FitSubject.observe`."""
        return self._seen, {}

    def in_picture(self, position: FloatArray) -> FloatArray:
        """As `FitSubject.in_picture`."""
        return np.asarray((position @ self._eye - self._low) * self._scale + RIM_PX)


def subject_of(config: BetaConfig | ThetaConfig, note: Callable[[str], None]) -> FitSubject:
    """What a command's options name. Raises InputError for what cannot be set on a page."""
    if (reason := not_on_a_page(config)) is not None:
        raise InputError("images, or one pair file, to be set on a page", reason, "leave out --adjust")
    if ending_of(config.sources[0]) == ".npz":
        return PairSubject(config)
    return ImagesSubject(config, note)


def not_on_a_page(config: BetaConfig | ThetaConfig) -> str | None:
    """What keeps a fit from being set on a page; None = nothing."""
    pairs = [source for source in config.sources if ending_of(source) == ".npz"]
    if pairs and len(config.sources) > 1:
        return f"{len(config.sources)} files"
    if isinstance(config, BetaConfig) and (config.layers.thickness_m is not None or config.motion.whole_motion):
        return "--thickness-m or --whole-motion"
    return None


def asked_on_page(config: BetaConfig | ThetaConfig) -> bool:
    """Whether the fit is to be set on a page: where somebody sits at a terminal, or where it is asked for."""
    if config.output.viewer != "page":
        return False
    terminal = sys.stdin is not None and sys.stdin.isatty() and sys.stdout.isatty()
    return config.adjust or config.from_rig or (terminal and not_on_a_page(config) is None)


def _eight_bits(image: ImageArray, low: float, high: float) -> ImageArray:
    """As a browser shows it: 16 bits are spread over 8."""
    if image.dtype == np.uint8:
        return image
    return ((image.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))).clip(0, 255).astype(np.uint8)
