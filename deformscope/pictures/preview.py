"""Streams of an import as one picture, for a person who judges whether they are what they should be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from deformscope.arrays import FloatArray, ImageArray
from deformscope.pictures.figures import COLOURS, canvas, png_of


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
