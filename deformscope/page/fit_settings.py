"""What is set on the page of a fit, as options of its command."""

from __future__ import annotations

import dataclasses

from deformscope.config.images import ImageOptions
from deformscope.page.server.fit_messages import FitSettings

IN_PICTURE = ("roi", "grid", "spacing_px", "outline", "contact", "held")
"""Settings of it."""


def images_with(images: ImageOptions, asked: FitSettings) -> ImageOptions:
    """The options with what was set in the picture. Raises InputError where it does not go together."""
    outline = tuple(value for corner in asked.outline for value in corner) or None
    same = {name: getattr(asked, name) for name in ("roi", "grid", "spacing_px", "contact")}
    images = dataclasses.replace(images, **same, outline=outline, held=None)
    return images if set(asked.held) == set(images.held_parts()) else dataclasses.replace(images, held=asked.held)
