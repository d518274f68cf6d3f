"""Figures as PNG, by matplotlib without a display."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
