"""What every twin shares: colours, the picture that is drawn upon, its legend and its colour bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt
import rerun as rr

from deformscope.arrays import FloatArray

Rgb = tuple[int, int, int]
ColorArray = npt.NDArray[np.uint8]

# Thesis fig. 3.12: observed blue, simulated red; rest green.
OBSERVED: Rgb = (40, 110, 255)
SIMULATED: Rgb = (235, 45, 45)
REST: Rgb = (30, 190, 80)
LOST: Rgb = (245, 245, 245)
HELD: Rgb = (255, 200, 0)

TEXT: Rgb = (225, 225, 225)

BESIDE_FROM = 3.5
"""Height over width from which the legend stands beside the picture rather than below it."""
COLUMN_SHARE, ROW_SHARE = 0.8, 0.14
"""What the legend takes beside the picture, of its width, or below it, of its longer side."""


@dataclass(frozen=True, slots=True)
class Canvas:
    """The picture that results are drawn upon.

    low, high: (d,) its corners, d = 2 or 3: pixels of the image, or the pair's own unit
    spacing: between neighbouring particles, in the same unit; 0 = not known yet
    particles: (K, 2) where the particles are now [px], so that nothing is drawn where the thing is not; None = anywhere
    image: the path of the image under the results; empty = none
    """

    low: tuple[float, ...] = (0.0, 0.0)
    high: tuple[float, ...] = (1.0, 1.0)
    spacing: float = 0.0
    particles: FloatArray | None = field(default=None, compare=False)
    image: str = ""

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
    def legend_beside(self) -> bool:
        """Whether the legend stands beside the picture: only where that is tall and narrow."""
        return self.height > BESIDE_FROM * self.width

    def around(self, position: FloatArray) -> Canvas:
        """This canvas, knowing where the particles are. position: (K, d), NaN where unknown."""
        finite = position[np.isfinite(position).all(axis=1)]
        if not len(finite):
            return self
        if self.image:
            return replace(self, particles=finite)
        low, high = finite.min(axis=0), finite.max(axis=0)
        return replace(self, low=tuple(map(float, low)), high=tuple(map(float, high)))

    def slot(self, place: float, row: int = 0) -> tuple[float, float]:
        """Where the legend's entry number `place`, 0 to 4, stands, outside the picture [unit of the picture]."""
        if self.legend_beside:
            return self.low[0] + self.width * (1.25 + 0.45 * row), self.low[1] + self.height * (0.06 + 0.06 * place)
        below = (0.25 + 0.5 * row) * ROW_SHARE * max(self.width, self.height) + self.rim
        return self.low[0] + self.width * (0.1 + 0.2 * place), self.high[1] + below

    @property
    def rim(self) -> float:
        """Room for the marks of particles on the edge; an image has its own."""
        return 0.0 if self.image else 0.4 * self.spacing

    @property
    def mark(self) -> float:
        """The radius of a mark in the legend [unit of the picture]."""
        return 0.011 * max(self.width, self.height)


def spacing_of(position: FloatArray) -> float:
    """The typical distance between neighbours among (K, d) positions; 0 for fewer than two."""
    from scipy.spatial import cKDTree

    finite = np.asarray(position[np.isfinite(position).all(axis=1)], dtype=np.float64)
    if len(finite) < 2:
        return 0.0
    distance, _ = cKDTree(finite).query(finite, k=2)
    return float(np.median(distance[:, 1]))


def colors(share: FloatArray) -> ColorArray:
    """(n, 3) RGB for (n,) shares of the scale, 0 to 1, dark violet to yellow."""
    level = np.clip(np.nan_to_num(share) * 255, 0, 255).astype(np.uint8).reshape(-1, 1)
    found: ColorArray = cv2.applyColorMap(level, cv2.COLORMAP_PLASMA).reshape(-1, 3)[:, ::-1]  # type: ignore[assignment]
    return found


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10... times a power of ten: the end of a scale that a reader can divide."""
    if not (math.isfinite(value) and value > 0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if value <= step * power * (1 + 1e-9))


def readable(unit: str, largest: float) -> tuple[float, str]:
    """The factor and the unit that show lengths up to `largest` [unit] without a row of zeros."""
    if unit == "m" and largest < 0.1:
        return 1e3, "mm"
    return 1.0, unit


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
    """Text under (x, y). A label takes its mark's colour, and not every colour can be read: its mark is tiny."""
    rec.log(
        path,
        rr.Points2D(
            [(x, y) for x, y, _ in labels],
            radii=canvas.mark * 0.2,
            colors=TEXT,
            labels=[label for _, _, label in labels],
            show_labels=True,
            draw_order=60.0,
        ),
    )


def log_color_bar(rec: rr.RecordingStream, path: str, canvas: Canvas, end: float, unit: str) -> None:
    """A row of coloured marks from 0 to `end` [unit], with its numbers."""
    share = np.linspace(0, 1, 21)
    points = [canvas.slot(4 * float(1 - at if canvas.legend_beside else at)) for at in share]
    rec.log(path, rr.Points2D(points, radii=canvas.mark, colors=colors(share), draw_order=58.0))
    factor, shown = readable(unit, end)
    numbers = []
    for at in (0.0, 0.5, 1.0):
        x, y = canvas.slot(4 * (1 - at if canvas.legend_beside else at))
        numbers.append((x, y, f"{end * at * factor:g} {shown}"))
    log_labels(rec, f"{path}/number", canvas, numbers)
