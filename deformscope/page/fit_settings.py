"""Settings on the page of a fit, and the options of its command."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.images import ImageOptions
from deformscope.file_io import ending_of
from deformscope.images import encode_jpeg
from deformscope.page.server.fit_messages import FitSettings

COMMANDS = ("stop", "set-fit", "run-fit", "fit-drawn")
IN_PICTURE = ("roi", "grid", "spacing_px", "outline", "contact", "held")
"""Settings of the picture's fit."""
LONGEST_PX = 1920
"""Longer side of a picture on a page."""


def images_with(images: ImageOptions, asked: FitSettings) -> ImageOptions:
    """The options with the settings made in the picture. Raises InputError if they contradict each other."""
    outline = tuple(value for corner in asked.outline for value in corner) or None
    same = {name: getattr(asked, name) for name in ("roi", "grid", "spacing_px", "contact")}
    images = dataclasses.replace(images, **same, outline=outline, held=None)
    return images if set(asked.held) == set(images.held_parts()) else dataclasses.replace(images, held=asked.held)


def settings_of(config: BetaConfig | ThetaConfig, images: ImageOptions) -> FitSettings:
    """First settings of a page. images: options that turn images into particles"""
    corners = images.outline or ()
    beta = config.beta if isinstance(config, ThetaConfig) else 0.5 if config.at is None else config.at
    theta = config.fitted_theta if isinstance(config, BetaConfig) else 0.5 if config.at is None else config.at
    return FitSettings(
        roi=images.roi,
        grid=images.grid,
        spacing_px=images.spacing_px,
        outline=tuple(zip(corners[::2], corners[1::2], strict=True)),
        held=images.held_parts(),
        contact=images.contact,
        cluster_size=config.fitted_cluster_size if isinstance(config, BetaConfig) else config.cluster_size,
        beta=beta,
        theta=theta,
    )


def picture_of(image: npt.NDArray[Any]) -> bytes:
    """An image as JPEG for a browser, of at most `LONGEST_PX` along its longer side."""
    times = LONGEST_PX / max(image.shape[:2])
    if times < 1:
        image = np.asarray(cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_AREA))
    if image.dtype != np.uint8:
        low, high = float(image.min()), float(image.max())
        image = ((image.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))).clip(0, 255).astype(np.uint8)
    return encode_jpeg(image)


def set_on_a_page(config: BetaConfig | ThetaConfig) -> bool:
    """Whether the fit's settings are made on its page: of images or one pair, without layers or the whole motion."""
    pairs = [source for source in config.sources if ending_of(source) == ".npz"]
    more = isinstance(config, BetaConfig) and (config.has_layers or config.motion.whole_motion)
    return config.output.viewer == "page" and not more and not (pairs and len(config.sources) > 1)
