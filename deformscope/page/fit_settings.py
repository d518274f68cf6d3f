"""Settings on the page of a fit, and the options of its command."""

from __future__ import annotations

import dataclasses

from deformscope.config import BetaConfig, ThetaConfig
from deformscope.config.images import ImageOptions
from deformscope.file_io import ending_of
from deformscope.page.server.fit_messages import FitSettings

IN_PICTURE = ("roi", "grid", "spacing_px", "outline", "contact", "held")
"""Settings of the picture's fit."""


def images_with(images: ImageOptions, asked: FitSettings) -> ImageOptions:
    """The options with the settings made in the picture. Raises InputError if they contradict each other."""
    outline = tuple(value for corner in asked.outline for value in corner) or None
    same = {name: getattr(asked, name) for name in ("roi", "grid", "spacing_px", "contact")}
    images = dataclasses.replace(images, **same, outline=outline, held=None)
    return images if set(asked.held) == set(images.held_parts()) else dataclasses.replace(images, held=asked.held)


def not_on_a_page(config: BetaConfig | ThetaConfig) -> str | None:
    """The reason against a fit on a page; None = none."""
    pairs = [source for source in config.sources if ending_of(source) == ".npz"]
    if pairs and len(config.sources) > 1:
        return f"{len(config.sources)} files"
    if isinstance(config, BetaConfig) and (config.has_layers or config.motion.whole_motion):
        return "--thickness-m or --whole-motion"
    return None


def asked_on_page(config: BetaConfig | ThetaConfig, *, at_terminal: bool) -> bool:
    """Whether the fit's settings are made on a page: if a person is at a terminal, or if it is requested."""
    if config.output.viewer != "page":
        return False
    return config.adjust or (at_terminal and not_on_a_page(config) is None)
