"""Input of a fit on a page: images whose particles are set there, a fixed pair, or a camera's images."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from deformscope.arrays import FloatArray, ImageArray
from deformscope.config import BetaConfig, ThetaConfig
from deformscope.errors import InputError
from deformscope.experiments.cached_flow import CachedFlow
from deformscope.experiments.calibration_inputs import images_of, mask_of, opened_images, particle_options
from deformscope.experiments.foam_video import last_pose
from deformscope.experiments.live_stages import StageExecutor
from deformscope.file_io import ending_of, make_folder, read_file
from deformscope.files.pairs import parse_pair
from deformscope.frames import ColorFrame
from deformscope.images import encode_jpeg, encode_png
from deformscope.stages.fit.model import Observation
from deformscope.stages.see.particles import clean_mask
from deformscope_drivers.clock import Stamp

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


class FollowedCamera:
    """A camera that is followed. Pictures may come from any thread; only one other thread may call the other methods.

    name: name of the camera; first: its first picture, which shows the thing at rest
    flow: computes the motion in a process in which nothing else uses OpenCV: the same pictures give the same result to
    the last bit; next_folder: makes a folder for pictures to store; want: requests the next picture
    """

    def __init__(
        self,
        name: str,
        first: ImageArray,
        flow: StageExecutor,
        next_folder: Callable[[], Path],
        want: Callable[[], None],
    ) -> None:
        self.name = name
        self._rest = self._newest = first
        self._flow, self._next_folder, self._want = flow, next_folder, want
        self._wants = False
        self._requested: Future[CachedFlow] | None = None
        self._pair: tuple[ImageArray, ImageArray] | None = None
        self._shown: CachedFlow | None = None
        self._folder: Path | None = None
        self._pairs = 0
        self._kept: tuple[str, str] | None = None

    def on_picture(self, image: ImageArray) -> None:
        """A picture (H, W[, 3]) replaces one that was not used."""
        self._wants, self._newest = False, image

    def take_rest(self) -> None:
        """The newest picture shows the thing at rest."""
        self._rest, self._requested, self._pair = self._newest, None, None

    def request(self, call: Callable[[], None]) -> None:
        """Compute the motion from rest to the newest picture, unless it is shown already, or another one is being
        computed. Meanwhile the next picture arrives. call: called when the picture is there, in any thread"""
        if not self._wants:
            self._wants = True
            self._want()
        rest, newest = self._rest, self._newest
        if self._requested is not None or (self._pair and self._pair[0] is rest and self._pair[1] is newest):
            return
        self._pair = rest, newest  # also where nothing comes of it: it is not computed again
        self._requested = self._flow.submit(motion_of, rest, newest, cv2.getNumThreads())
        self._requested.add_done_callback(lambda future: call())

    @property
    def is_ready(self) -> bool:
        """Whether the requested motion is ready."""
        return self._requested is not None and self._requested.done()

    def motion(self) -> CachedFlow:
        """The requested motion, once it is computed. Raises its error."""
        requested, self._requested = self._requested, None
        assert requested is not None
        assert self._pair is not None
        motion = requested.result()
        motion.first, motion.last = self._pair  # these very arrays
        self._shown, self._kept = motion, None
        return motion

    def keep(self) -> None:
        """Write both shown pictures as files, without loss. Raises OSError, or InputError if they cannot be written."""
        if self._kept is not None:
            return
        assert self._shown is not None
        if self._folder is None:
            folder = self._next_folder()
            make_folder(folder)
            self._folder = folder
        self._pairs += 1
        rest, now = (self._folder / f"{name}-{self._pairs}.png" for name in ("rest", "now"))
        rest.write_bytes(encode_png(self._shown.first))
        now.write_bytes(encode_png(self._shown.last))
        self._kept = str(rest), str(now)

    def named(self, config: BetaConfig | ThetaConfig) -> BetaConfig | ThetaConfig:
        """The options, with the stored files. Raises InputError without such files."""
        if self._kept is None:
            raise InputError("stored pictures of the camera", "none", "space and permissions in [record] folder")
        return dataclasses.replace(config, sources=self._kept, images=dataclasses.replace(config.images, camera=None))


def motion_of(rest: ImageArray, newest: ImageArray, threads: int) -> CachedFlow:
    """Motion from one picture (H, W[, 3]) to the other, as with two files. threads: number of threads of OpenCV. Raises
    InputError if the sizes differ."""
    if rest.shape != newest.shape:
        came = f"{newest.shape[1]}x{newest.shape[0]} after {rest.shape[1]}x{rest.shape[0]}"
        raise InputError("pictures of one size", came, "take the image at rest again")
    cv2.setNumThreads(threads)
    pair = [ColorFrame(Stamp(index), index, image) for index, image in enumerate((rest, newest))]
    return CachedFlow(pair, lambda done: None)


def _eight_bits(image: ImageArray, low: float, high: float) -> ImageArray:
    """The image with 8 bits, for a browser: `low` to `high` are spread over them."""
    if image.dtype == np.uint8:
        return image
    return ((image.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))).clip(0, 255).astype(np.uint8)
