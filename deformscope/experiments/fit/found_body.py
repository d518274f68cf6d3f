"""The body in a sequence of images, found where no option names it."""

import dataclasses
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from deformscope.arrays import ImageArray
from deformscope.config import ImageOptions
from deformscope.errors import InputError
from deformscope.files.sources import Source
from deformscope.stages.fit.estimate import Doubt
from deformscope.stages.see.find_body import FoundBody, find_body
from deformscope.stages.see.particles import Rect, clean_mask, outlined, seed_grid, select_held

Draw = Callable[[ImageArray, FoundBody, str], None]

BODY = ("roi", "mask", "outline", "held", "contact")
"""Options that name the body, any of them."""
LOOKED_AT = 7
"""Number of frames, evenly spread, in which the body is sought."""


def found_in(
    source: Source, images: ImageOptions, note: Callable[[str], None], draw: Draw | None = None
) -> tuple[ImageOptions, dict[str, object], tuple[Doubt, ...]]:
    """The options with the body that is found in the images, if none is named; what was found, for the record; and the
    doubts. draw: draws both on the first image. Raises InputError for images of two scenes."""
    source.thin(LOOKED_AT)
    seen = [frame.image for frame in source]
    kept = np.unique(np.linspace(0, len(seen) - 1, LOOKED_AT).round().astype(int))
    body = find_body([seen[index] for index in kept])
    if other := next((one for one in body.unfit if one.code in ("scene-cut", "mirrored", "dark")), None):
        wanted = ("images of one scene", other.text, "leave out what is before or after it")
        lit = ("images that can be followed", other.text, "film again with more light")
        raise InputError(*(lit if other.code == "dark" else wanted), source.name)
    unfit = [one for one in body.unfit if one.code != "still"]  # which the fit says with its own numbers
    doubts = [Doubt("unfit-images", one.text, "weak" if one.lowers else None) for one in unfit]
    named = any(getattr(images, one) is not None for one in BODY)
    body = _given(images, body) if named else _usable(body, images, seen[0].shape)
    if draw is not None:
        text = "Given." if named else f"Found: {body.flags()}." + "".join(f" Not sure: {one}." for one in body.doubts)
        draw(seen[0], body, text)
    if named:
        return images, {}, tuple(doubts)
    if body.doubts:
        text = f"not sure what in the images is the body: {', '.join(body.doubts)}"
        doubts.append(Doubt("body-unsure", text, "weak"))
        note(text)
    if body.roi is None:
        return images, {}, tuple(doubts)
    note(f"found in the images: {body.flags()}")
    contact = None if body.contact is None else dataclasses.astuple(body.contact)
    images = dataclasses.replace(
        images, roi=dataclasses.astuple(body.roi), outline=body.corners, held=body.held, contact=contact
    )
    return images, {"flags": body.flags(), "sure": body.sure, "confidence": body.confidence}, tuple(doubts)


def _given(images: ImageOptions, body: FoundBody) -> FoundBody:
    """What the options name, with what was found of background and tool."""
    contact = None if images.contact is None else Rect(*images.contact)
    outline = None if images.outline is None else np.reshape(images.outline, (-1, 2))
    if images.roi is not None and outline is None:
        x, y, width, height = images.roi
        outline = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
    return dataclasses.replace(body, outline=outline, held=images.held_parts(), contact=contact)


def _usable(body: FoundBody, images: ImageOptions, size: tuple[int, ...]) -> FoundBody:
    """The found body, without what has no particles. size: H, W of the images [px]"""
    for one in (body, body.without_contact()):
        if one.corners is None:
            return one
        with suppress(InputError):
            mask = clean_mask(outlined(None, one.corners, (size[0], size[1])))
            select_held(seed_grid(size, one.roi, images.grid, images.spacing_px, mask), one.held, one.contact)
            return one
    return FoundBody(doubts=("region (--outline or --roi)",))
