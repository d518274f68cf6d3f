"""Content of a recording, over touches and over time, as PNG (as figures 2.4, 2.7, 4.5 to 4.7 of the thesis)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from deformscope.arrays import FloatArray, ImageArray
from deformscope.pictures.figures import COLOURS, LINES, canvas, png_of

DPI = 110
MARKED = 30
"""Number of points below which each is marked."""
PHASES = ("#eef3f8", "#dfe6ee")
APART = 0.024
"""Distance between the names of phases, as a share of the axis: short phases follow one another within some tenths of a
second."""
DATA_AXES = "data", "axes fraction"


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Lines in one panel. label: name of the axis, with its unit; at: (n,); values: (n, k), NaN = unknown; names: (k,)
    or none; low, high: (n, k) lower end and upper end of the interval, None = none"""

    label: str
    at: FloatArray
    values: FloatArray
    names: tuple[str, ...] = ()
    low: FloatArray | None = None
    high: FloatArray | None = None


def curves_png(
    panels: Sequence[Curves],
    label: str,
    events: Sequence[tuple[str, float]] = (),
    phases: Sequence[tuple[str, float]] = (),
) -> bytes:
    """Panels below each other over the same axis. label: its name, with its unit; events: vertical lines; phases:
    shaded ranges, by name and start"""
    from matplotlib.ticker import MaxNLocator

    figure = canvas(9.0, 0.9 + 1.75 * len(panels), layout="constrained")
    axes = figure.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
    label_at = -np.inf
    ends = [*phases, ("", max(float(one.at.max(initial=0.0)) for one in panels))]
    for panel, one in zip(axes, panels, strict=True):
        for at in range(one.values.shape[1]):
            color, name = COLOURS[at % len(COLOURS)], one.names[at] if one.names else None
            given = {"color": color, "label": name, "lw": 1.5, "ms": 4, "marker": "o" * (len(one.at) < MARKED)}
            if one.low is None or one.high is None:
                panel.plot(one.at, one.values[:, at], **given)
            else:
                off = np.abs(np.stack([one.low[:, at], one.high[:, at]]) - one.values[:, at])
                panel.errorbar(
                    one.at, one.values[:, at], np.where(np.isfinite(off), off, 0.0), capsize=3, elinewidth=1, **given
                )
        for at, ((name, start), (_, stop)) in enumerate(pairwise(ends)):
            panel.axvspan(start, stop, color=PHASES[at % 2], zorder=0, lw=0)
            if panel is axes[0]:
                label_at = max(start, label_at + APART * ends[-1][1])
                where = {"textcoords": DATA_AXES, "rotation": 90, "ha": "center", "va": "bottom", "fontsize": 8}
                lead = {"arrowstyle": "-", "lw": 0.5, "shrinkA": 0, "shrinkB": 0}
                panel.annotate(name, (start, 1.0), (label_at, 1.1), DATA_AXES, arrowprops=lead, **where)
        for at, (name, when) in enumerate(events):
            panel.axvline(
                when, color="black", ls=LINES[at % len(LINES)], lw=1.1, label=name * (panel is axes[-1]) or None
            )
        panel.set_ylabel(one.label, fontsize=9)
        panel.grid(alpha=0.25)
        if one.names or (events and panel is axes[-1]):
            panel.legend(fontsize=8, loc="best")
    axes[-1].set_xlabel(label)
    axes[-1].xaxis.set_major_locator(MaxNLocator(integer=all(one.at.dtype.kind == "i" for one in panels)))
    return png_of(figure, DPI)


def cells_png(cells: FloatArray) -> bytes:
    """(2, rows, columns) of both fingertips at steady state [counts] (Thesis fig. 2.7)."""
    figure = canvas(7.0, 3.2, layout="constrained")
    for number, (panel, one) in enumerate(zip(figure.subplots(1, 2), cells, strict=True), start=1):
        shown = panel.imshow(one, vmin=0.0, vmax=float(np.nanmax(cells, initial=1.0)), interpolation="nearest")
        panel.set(title=f"fingertip {number}", xlabel="column", ylabel="row")
        figure.colorbar(shown, ax=panel, shrink=0.8, label="pressure [counts]")
    return png_of(figure, DPI)


# Streams of an import as one picture, for a person who judges whether they are what they should be


@dataclass(frozen=True, slots=True)
class Preview:
    """A stream. title: its line above the drawing; times: times of its rows, in the unit of `time` (n,); values: values
    of its quantities, with units in their names (n,); image: one in their place, distances [m] or grey or RGB"""

    title: str
    time: str
    times: FloatArray
    values: Mapping[str, FloatArray]
    image: ImageArray | FloatArray | None = None


def preview_png(shown: Sequence[Preview]) -> bytes:
    """One row for each stream."""
    figure = canvas(7.0, 2.4 * max(len(shown), 1), layout="constrained")
    for axis, one in zip(figure.subplots(max(len(shown), 1), squeeze=False)[:, 0], shown, strict=False):
        axis.set_title(one.title.replace("$", r"\$"), fontsize="small")
        if one.image is not None:
            is_distance = one.image.dtype.kind == "f"
            drawn = axis.imshow(one.image, cmap="viridis" if is_distance else "gray")
            axis.set_axis_off()
            if is_distance:
                figure.colorbar(drawn, ax=axis, label="distance [m]")
            continue
        for at, (name, values) in enumerate(one.values.items()):
            label = name.replace("$", r"\$")
            again, colour = divmod(at, len(COLOURS))
            style = ("-", "--", ":")[again % 3]
            axis.plot(one.times, values, ls=style, marker=".", ms=2, lw=0.8, color=COLOURS[colour], label=label)
        axis.set_xlabel(one.time, fontsize="small")
        axis.grid(alpha=0.3)
        if one.values:
            axis.legend(fontsize="x-small", loc="upper right")
    return png_of(figure, 110)
