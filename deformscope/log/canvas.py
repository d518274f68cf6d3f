"""Common parts of all views over a picture: colours, the picture, its legend and its colour bar."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import rerun as rr

from deformscope.arrays import FloatArray, IntArray
from deformscope.pictures.palette import Rgb, colors, readable

TEXT: Rgb = (225, 225, 225)
"""Text on a dark background."""
LABEL: Rgb = (30, 33, 38)
"""Text on paper: the viewer's themes put grey or white behind it. On a black background dark text could not be read."""

SIDE_LEGEND_FROM = 3.5
"""Height over width from which the legend is at the picture's side, not below it."""
COLUMN_SHARE, ROW_SHARE = 0.8, 0.14
"""Size of the legend at the picture's side, of its width, or below it, of its longer side."""


@dataclass(frozen=True, slots=True)
class Canvas:
    """The picture on which results are drawn.

    low, high: (d,) its corners, d = 2 or 3, in pixels of the image or in the pair's unit
    spacing: distance between neighbouring particles, in the same unit; 0 = not yet known; particles: (K, 2) present
    places of the particles [px], so that nothing is drawn outside of the body; None = draw anywhere
    image: the path of the image under the results; empty = none; origin, scale: (d,) positions are drawn at (position -
    origin) * scale; empty = unchanged. Corners are of the drawing"""

    low: tuple[float, ...] = (0.0, 0.0)
    high: tuple[float, ...] = (1.0, 1.0)
    spacing: float = 0.0
    particles: FloatArray | None = field(default=None, compare=False)
    image: str = ""
    origin: tuple[float, ...] = ()
    scale: tuple[float, ...] = ()

    @property
    def flat(self) -> bool:
        return len(self.low) == 2

    @property
    def width(self) -> float:
        return self.high[0] - self.low[0]

    @property
    def height(self) -> float:
        return self.high[1] - self.low[1]

    @property
    def has_side_legend(self) -> bool:
        """Whether the legend is at the side of the picture: only if that is tall and narrow."""
        return self.height > SIDE_LEGEND_FROM * self.width

    def around(self, position: FloatArray) -> "Canvas":
        """This canvas with the present places of the particles. position: (K, d), NaN where unknown."""
        finite = position[np.isfinite(position).all(axis=1)]
        if not len(finite):
            return self
        if self.image:
            return replace(self, particles=finite)
        low, high = finite.min(axis=0), finite.max(axis=0)
        return replace(self, low=tuple(map(float, low)), high=tuple(map(float, high)))

    def slot(self, place: float, row: int = 0) -> tuple[float, float]:
        """Place of the legend's entry number `place`, 0 to 4, outside the picture [unit of the picture]."""
        if self.has_side_legend:
            return self.low[0] + self.width * (1.25 + 0.45 * row), self.low[1] + self.height * (0.06 + 0.06 * place)
        below = (0.25 + 0.5 * row) * ROW_SHARE * max(self.width, self.height) + self.rim
        return self.low[0] + self.width * (0.1 + 0.2 * place), self.high[1] + below

    @property
    def heights(self) -> str:
        """Words for a title on how many times heights are drawn out; empty where they are not."""
        times = self.scale[2] if len(self.scale) > 2 else 1.0
        return f", heights drawn {times:g} times" if times > 1.0 else ""

    @property
    def rim(self) -> float:
        """Margin for the marks of particles at the edge; an image needs none."""
        return 0.0 if self.image else 0.4 * self.spacing

    @property
    def mark(self) -> float:
        """The radius of a mark in the legend [unit of the picture]."""
        return 0.011 * max(self.width, self.height)


def sides_of(triangles: IntArray) -> IntArray:
    """(n, 2) sides of triangles (m, 3), each once."""
    every = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(every, axis=1), axis=0)


def log_place(rec: rr.RecordingStream, canvas: Canvas, *paths: str) -> None:
    """Draw the positions at these paths, which are unchanged in the recording, at the canvas's scale."""
    if canvas.image:
        return
    scale = np.array([*canvas.scale, 1.0, 1.0, 1.0][:3])
    origin = np.array([*canvas.origin, 0.0, 0.0, 0.0][:3])
    for path in paths:
        rec.log(path, rr.Transform3D(translation=-origin * scale, scale=scale))


def log_legend(
    rec: rr.RecordingStream, path: str, canvas: Canvas, entries: Sequence[tuple[float, str, Rgb]], row: int = 0
) -> None:
    """Name the colours at the picture's edge. entries: (place, label, colour)."""
    points = [canvas.slot(place, row) for place, _, _ in entries]
    rec.log(path, rr.Points2D(points, radii=canvas.mark, colors=[tint for _, _, tint in entries], draw_order=58.0))
    log_labels(
        rec, f"{path}/label", canvas, [(*point, label) for point, (_, label, _) in zip(points, entries, strict=True)]
    )


def log_labels(rec: rr.RecordingStream, path: str, canvas: Canvas, labels: Sequence[tuple[float, float, str]]) -> None:
    """Text under (x, y). Log labels. A label has its mark's colour, and not every colour is readable: therefore labels
    have separate, tiny marks."""
    rec.log(
        path,
        rr.Points2D(
            [(x, y) for x, y, _ in labels],
            radii=canvas.mark * 0.2,
            colors=LABEL,
            labels=[label for _, _, label in labels],
            show_labels=True,
            draw_order=60.0,
        ),
    )


def log_color_bar(rec: rr.RecordingStream, path: str, canvas: Canvas, end: float, unit: str) -> None:
    """A row of coloured marks from 0 to `end` [unit], with its numbers."""
    share = np.linspace(0, 1, 21)
    points = [canvas.slot(4 * float(1 - at if canvas.has_side_legend else at)) for at in share]
    rec.log(path, rr.Points2D(points, radii=canvas.mark, colors=colors(share), draw_order=58.0))
    factor, shown = readable(unit, end)
    numbers = []
    for at in (0.0, 0.5, 1.0):
        x, y = canvas.slot(4 * (1 - at if canvas.has_side_legend else at))
        numbers.append((x, y, f"{end * at * factor:g} {shown}"))
    log_labels(rec, f"{path}/number", canvas, numbers)


def deep_bar(name: Callable[[float], str]) -> list[tuple[float, str, Rgb]]:
    """A colour bar for `log_deep_legend`. name: name of the marks at 0, 0.5 and 1"""
    share = np.linspace(0.0, 1.0, 21)
    return [
        (float(at), name(float(at)) if place % 10 == 0 else "", (int(r), int(g), int(b)))
        for place, (at, (r, g, b)) in enumerate(zip(share, colors(share), strict=True))
    ]


def log_deep_legend(
    rec: rr.RecordingStream, path: str, canvas: Canvas, entries: Sequence[tuple[float, str, Rgb]], row: int = 0
) -> None:
    """Marks with names on the ground before a body in space. entries: (share along x, label or "", colour)."""
    (x0, y0, z0), (x1, y1, _) = canvas.low, canvas.high
    size = max(x1 - x0, y1 - y0)
    away = y0 - (0.12 + 0.19 * row) * size
    points = [(x0 + share * (x1 - x0), away, z0) for share, _, _ in entries]
    rec.log(path, rr.Points3D(points, radii=0.018 * size, colors=[tint for _, _, tint in entries]))
    named = [(point, label) for point, (_, label, _) in zip(points, entries, strict=True) if label]
    rec.log(
        f"{path}/label",
        rr.Points3D(
            [point for point, _ in named],
            radii=0.001 * size,
            colors=LABEL,
            labels=[label for _, label in named],
            show_labels=True,
        ),
    )
