"""What every twin shares: colours, the picture that is drawn upon, its legend and its colour bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
LOST: Rgb = (150, 150, 150)
HELD: Rgb = (255, 200, 0)

LEGEND_SHARE = 0.5
"""The legend's part of the picture's short side, added beside or below it."""


@dataclass(frozen=True, slots=True)
class Canvas:
    """The picture that results are drawn upon.

    low, high: (d,) its corners, d = 2 or 3: pixels of the image, or the pair's own unit
    spacing: between neighbouring particles, in the same unit; 0 = not known yet
    region: (2, 2) lowest and highest corner of where the particles are now [px]; None = everywhere
    image: whether there is an image under the results
    """

    low: tuple[float, ...] = (0.0, 0.0)
    high: tuple[float, ...] = (1.0, 1.0)
    spacing: float = 0.0
    region: tuple[tuple[float, float], tuple[float, float]] | None = None
    image: bool = False

    @property
    def flat(self) -> bool:
        return len(self.low) == 2

    @property
    def upright(self) -> bool:
        """Whether the picture is taller than wide: the legend then stands beside it, else below it."""
        return self.high[1] - self.low[1] > self.high[0] - self.low[0]

    def around(self, position: FloatArray) -> Canvas:
        """This canvas, knowing where the particles are. position: (K, d), NaN where unknown."""
        finite = position[np.isfinite(position).all(axis=1)]
        if not len(finite):
            return self
        low, high = finite.min(axis=0), finite.max(axis=0)
        if self.image:
            return replace(self, region=((float(low[0]), float(low[1])), (float(high[0]), float(high[1]))))
        return replace(self, low=tuple(map(float, low)), high=tuple(map(float, high)))

    def slot(self, place: float) -> tuple[float, float]:
        """Where the legend's entry number `place` stands, outside the picture [unit of the picture]."""
        (x, y), (width, height) = self.low[:2], (self.high[0] - self.low[0], self.high[1] - self.low[1])
        if self.upright:
            return x + width * (1 + LEGEND_SHARE * 0.45), y + height * (0.04 + 0.075 * place)
        return x + width * (0.1 + 0.2 * place), y + height * (1 + LEGEND_SHARE * 0.2)

    def mark(self) -> float:
        """The radius of a mark in the legend [unit of the picture]."""
        return 0.014 * max(self.high[0] - self.low[0], self.high[1] - self.low[1])


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


def log_legend(rec: rr.RecordingStream, path: str, canvas: Canvas, entries: Sequence[tuple[float, str, Rgb]]) -> None:
    """Name the colours beside the picture. entries: (place, label, colour)."""
    if not canvas.flat:
        return
    rec.log(
        path,
        rr.Points2D(
            [canvas.slot(place) for place, _, _ in entries],
            radii=canvas.mark(),
            colors=[color for _, _, color in entries],
            labels=[label for _, label, _ in entries],
            show_labels=True,
            draw_order=60.0,
        ),
    )


def log_color_bar(rec: rr.RecordingStream, path: str, canvas: Canvas, end: float, unit: str, note: str = "") -> None:
    """A row of coloured marks from 0 to `end` [unit], with its numbers; `note` stands at its end."""
    if not canvas.flat:
        return
    share = np.linspace(0, 1, 13)
    places = 0.5 + 4 * share if not canvas.upright else 4.5 - 4 * share
    labels = [f"{end * at:g} {unit}" if index % 6 == 0 else "" for index, at in enumerate(share)]
    points = [canvas.slot(float(place)) for place in places]
    tints = colors(share)
    numbered = [index for index, label in enumerate(labels) if label]
    plain = [index for index, label in enumerate(labels) if not label]
    rec.log(path, rr.Points2D([points[i] for i in plain], radii=canvas.mark(), colors=tints[plain], draw_order=59.0))
    rec.log(
        f"{path}/number",
        rr.Points2D(
            [points[i] for i in numbered],
            radii=canvas.mark() * 1.2,
            colors=tints[numbered],
            labels=[labels[i] for i in numbered],
            show_labels=True,
            draw_order=60.0,
        ),
    )
    if note:
        log_legend(rec, f"{path}/note", canvas, [(6.0 if canvas.upright else 5.0, note, LOST)])
