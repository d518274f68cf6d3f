"""Optical flow as a picture: arrows over the first image."""

from __future__ import annotations

import numpy as np

from deformscope.arrays import FloatArray, ImageArray
from deformscope.pictures.figures import canvas, png_of

ARROWS = 36
"""Number of arrows along the longer side of the picture."""


def flow_png(image: ImageArray, flow_px: FloatArray) -> bytes:
    """The flow (H, W, 2) [px] over the first image: arrows, coloured by length."""
    height, width = flow_px.shape[:2]
    step = max(1, max(height, width) // ARROWS)
    y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    u, v = flow_px[y, x, 0], flow_px[y, x, 1]
    length_px = np.hypot(u, v)
    # Arrows as long as their spacing can be seen whatever the motion; the colour bar has the true length.
    typical_px = float(np.percentile(length_px, 95))
    factor = step / typical_px if typical_px > 0 else 1.0

    inches = 9 / max(height, width)
    figure = canvas(width * inches + 2, max(2.5, height * inches), layout="constrained")
    axes = figure.subplots()
    shown = image if image.ndim == 2 else image.mean(axis=2)
    axes.imshow(shown, cmap="gray", alpha=0.6)
    arrows = axes.quiver(
        x, y, u * factor, v * factor, length_px, angles="xy", scale_units="xy", scale=1, cmap="viridis", width=0.003
    )
    figure.colorbar(arrows, ax=axes, label="motion [px]")
    axes.set(xlim=(0, width - 1), ylim=(height - 1, 0), xlabel="x [px]", ylabel="y [px]")
    axes.set_title(f"optical flow, arrows {factor:.3g} times as long as the motion", fontsize=10)
    return png_of(figure, 110)
