"""Figures as PNG, by matplotlib without a display; of them those of one array: optical flow, distributions."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from collections.abc import Mapping, Sequence

import numpy as np

from deformscope.arrays import FloatArray, ImageArray

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours that colour-blind readers can distinguish (Okabe and Ito 2008)."""

LINES = ("-", "--", ":", "-.")


def canvas(
    width: float, height: float, *, dpi: float | None = None, layout: Literal["constrained"] | None = None
) -> Figure:
    """An empty figure [inch], drawn off screen on any display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), dpi=dpi, layout=layout)
    FigureCanvasAgg(made)
    return made


def png_of(drawn: Figure, dpi: int) -> bytes:
    """The same bytes for the same drawing."""
    encoded = io.BytesIO()
    drawn.savefig(encoded, format="png", dpi=dpi, metadata={"Software": None})
    return encoded.getvalue()


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


COLUMNS, BINS, DPI = 3, 24, 110


def distributions_png(quantities: Mapping[str, Mapping[str, Sequence[float]]]) -> bytes:
    """How many cases gave which value, a panel for each quantity. quantities: finite values by the varied setting"""
    rows = -(-len(quantities) // COLUMNS)
    drawn = canvas(3.6 * COLUMNS, 2.7 * rows, layout="constrained")
    flat = list(np.ravel(drawn.subplots(rows, COLUMNS, squeeze=False)))
    for panel, (name, groups) in zip(flat, quantities.items(), strict=False):
        every = np.concatenate([np.asarray(values, np.float64) for values in groups.values()])
        low, high = every.min(), every.max()
        bins = np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])
        for number, (group, values) in enumerate(groups.items()):
            filled = "step" if len(groups) > 1 else "stepfilled"
            panel.hist(values, bins, histtype=filled, color=COLOURS[number % len(COLOURS)], label=group)
        panel.locator_params("x", nbins=4)
        panel.set_xlabel(name)
        panel.set_ylabel("cases")
    for panel in flat[len(quantities) :]:
        panel.set_visible(False)
    groups = next(iter(quantities.values()), {})
    if len(groups) > 1:
        flat[0].legend(fontsize="small")
    return png_of(drawn, DPI)
