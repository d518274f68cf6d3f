"""Meaning of the options of `calibrate beta|theta`: the frames to read, their particles, and the fit."""

import dataclasses
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deformscope.arrays import ImageArray
from deformscope.config import BetaConfig, ImageOptions, MaterialOptions, ThetaConfig
from deformscope.config.images import ParticleFlags
from deformscope.experiments.fit.push_force import PushOptions
from deformscope.experiments.fit.whole_motion import ParticleOptions
from deformscope.file_io import SAMPLE_SCHEME, sample_path
from deformscope.files.sources import Source, open_source
from deformscope.images import read_image
from deformscope.stages.materials.press_cycle import PressForce
from deformscope.stages.see.follow import LARGE_PX
from deformscope.stages.see.particles import outlined

FLOW_S_PER_PX = 5e-7
"""Time of the flow both ways from a frame to the next in steady motion, on two cores [s/px]."""
FOLLOWED_S, FEWEST_FRAMES = 7.5, 16
"""Time limit of tracking a long sequence, and least number of its frames; jumps take up to 7 times that."""


def images_of(config: BetaConfig | ThetaConfig | MaterialOptions) -> ImageOptions:
    """The options that turn images into particles: the requested ones, or those of a sample."""
    sources = config.sources
    if len(sources) == 1 and sources[0].startswith(SAMPLE_SCHEME):
        return for_sample(sources[0].removeprefix(SAMPLE_SCHEME), config.images)
    return config.images


def sample_images(name: str) -> ImageOptions:
    """The options that suit a sample that ships, out of its `sample.toml`."""
    folder = sample_path(name)
    given = tomllib.loads((folder / "sample.toml").read_text(encoding="utf-8"))
    names = ("roi", "grid", "spacing_px", "held", "contact", "fps")
    known = {name: given[name] for name in names if name in given}
    return ImageOptions.of(mask=folder / given["mask"] if "mask" in given else None, **known)


def for_sample(name: str, asked: ImageOptions) -> ImageOptions:
    """The requested options, with the sample's own particles by default."""
    known = sample_images(name)
    particles = (asked.roi, asked.grid, asked.spacing_px, asked.mask, asked.outline, asked.held)
    if any(value is not None for value in particles):
        return dataclasses.replace(asked, fps=asked.fps or known.fps)
    fps = asked.fps or known.fps
    scale: dict[str, Any] = {"px_per_cm": asked.px_per_cm, "scale_from": asked.scale_from}
    return dataclasses.replace(known, fps=fps, stride=asked.stride, **scale)


def particle_options(images: ParticleFlags, noise_px: float | None = None) -> ParticleOptions:
    """The options for the stages."""
    own: dict[str, Any] = {"held": images.held_parts(), "noise_px": noise_px}
    own |= {"px_per_cm": images.scale_px_per_cm} if isinstance(images, ImageOptions) else {}
    return ParticleOptions(**images.shared(ParticleOptions) | own)


def opened_images(sources: Sequence[str], images: ImageOptions, *, timed: bool = False) -> Source:
    """The user's source, opened as a source of frames. timed: see `open_source`"""
    return open_source(
        sources, stride=images.stride, fps=images.fps, mask=images.mask, camera=images.camera, timed=timed
    )


def on_one_clock(
    source: Source, config: BetaConfig | ThetaConfig, push: PushOptions | None, log: PressForce | None
) -> tuple[PushOptions | None, PressForce | None]:
    """The force and its log; one that is in the images' own recording begins with the first image."""
    if log is None or push is None or str(config.sources[0]) != config.push.force:
        return push, log
    log = dataclasses.replace(log, time_s=log.time_s - 1e-9 * source.began_ns)
    return dataclasses.replace(push, force_offset_s=push.force_offset_s or 0.0), log


def thinned(
    source: Source,
    particles: ParticleOptions,
    config: BetaConfig | ThetaConfig,
    note: Callable[[str], None],
    *,
    every: bool = False,
) -> ParticleOptions:
    """End the source at the frame of the force, and thin a long one, unless all frames are requested; the number of
    frames is announced. Returns the options with that number."""
    if config.push.force_frame is not None:
        source.end_at(config.push.force_frame)
    each_s, count = FLOW_S_PER_PX * min(float(np.prod(source.size)), LARGE_PX), source.count or 0
    if count <= (most := max(FEWEST_FRAMES, round(FOLLOWED_S / each_s))):
        return particles
    if every or config.search.fine or images_of(config).stride != 1:
        note(f"{count} frames are tracked")
        return particles
    if (there := source.thin(most)) <= most:
        return particles
    note(f"{most} of {there} frames are tracked, evenly spread; --fine tracks all")
    return dataclasses.replace(particles, frames_of=there)


def mask_of(sources: Sequence[str], images: ImageOptions, size: tuple[int, int]) -> ImageArray | None:
    """The mask (H, W[, 3]) that the user named, or that of a recording, within the outline. size: H, W of the images
    [px]"""
    mask: ImageArray | None = None
    if images.mask is not None:
        mask = read_image(images.mask)
    elif len(sources) == 1 and Path(sources[0]).suffix.lower() == ".rrd":
        from deformscope.recording.reader import Replay

        mask = Replay(Path(sources[0]), trust=True).mask  # its ledger was compared when it was looked at for pairs
    return mask if images.outline is None else outlined(mask, images.outline, size)
