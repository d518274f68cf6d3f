"""Figures and tables of experiments, as files: PNG by matplotlib without a display, and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

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


@contextmanager
def figure(path: Path, columns: int, rows: int = 1, *, share_y: bool = False) -> Iterator[Any]:
    """Axes (rows, columns) to draw on; written to `path` as PNG at the end. Unused axes (without a title) are
    removed."""
    drawn = canvas(4.6 * columns, 3.9 * rows, layout="constrained")
    axes = drawn.subplots(rows, columns, squeeze=False, sharey=share_y)
    yield axes
    for one in axes.flat:
        one.set_visible(bool(one.get_title()))
        one.grid(alpha=0.25)
    drawn.savefig(path, dpi=140)


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write a CSV table of rows with the same names; floats have six significant digits, None is an empty field."""
    if not rows:
        return
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(rows[0]))
        out.writeheader()
        for row in rows:
            out.writerow({name: f"{one:.6g}" if isinstance(one, float) else one for name, one in row.items()})
