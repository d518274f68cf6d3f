"""Where the body, what holds it and what pushes it are in the first image, as one picture."""

import textwrap
from collections.abc import Sequence

import numpy as np

from deformscope.arrays import ImageArray
from deformscope.pictures.figures import COLOURS, canvas, png_of
from deformscope.stages.see.find_body import FoundBody

OUTLINE, CONTACT, HELD, TOOL, SCALE = COLOURS[2], COLOURS[3], COLOURS[4], COLOURS[1], COLOURS[0]


def found_png(image: ImageArray, found: FoundBody, text: str, scale: Sequence[float] | None = None) -> bytes:
    """The first image (H, W[, 3]) with outline, held sides, contact, tool, and the background's motion as arrows.
    scale: x, y of two places [px], and their distance [m]"""
    height, width = image.shape[:2]
    figure = canvas(8.0, 8.0 * height / width + 1.5, layout="constrained")
    axes = figure.subplots()
    axes.imshow(image / max(int(image.max()), 1), cmap="gray")
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) if found.outline is None else found.outline
    for shape, colour, name in ((corners, OUTLINE, "body"), (found.tool, TOOL, "moves as a rigid body")):
        if shape is not None:
            axes.plot(*np.vstack([shape, shape[:1]]).T, color=colour, lw=1.5, label=name)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    ends = {"top": ((left, right), (top, top)), "bottom": ((left, right), (bottom, bottom))}
    ends |= {"left": ((left, left), (top, bottom)), "right": ((right, right), (top, bottom))}
    for part in ends if "border" in found.held else found.held:
        if part in ends:
            axes.plot(*ends[part], color=HELD, lw=5, alpha=0.7, label=f"held: {part}", solid_capstyle="butt")
    if (one := found.contact) is not None:
        x, y = one.x + np.array([0, 1, 1, 0, 0]) * one.width, one.y + np.array([0, 0, 1, 1, 0]) * one.height
        axes.plot(x, y, color=CONTACT, lw=1.5, label="contact")
    if scale is not None:
        axes.plot(scale[:4:2], scale[1:4:2], "|-", color=SCALE, lw=2, label=f"{1e3 * scale[4]:.4g} mm")
    if len(found.background):
        at = np.stack(np.meshgrid(*(np.linspace(0.06, 0.94, 6) * side for side in (width, height))), axis=-1).reshape(
            -1, 2
        )
        moved = at @ (found.background[-1, :, :2].T - np.eye(2)) + found.background[-1, :, 2]
        axes.quiver(*at.T, *moved.T, angles="xy", scale_units="xy", scale=0.1, color=COLOURS[5], width=0.003)
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    axes.legend(loc="upper right", fontsize="small")
    axes.set_title(textwrap.fill(f"{text} Arrows: the background's motion, ten times.", 110), fontsize="small")
    return png_of(figure, 110)
