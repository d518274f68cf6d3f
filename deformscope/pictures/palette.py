"""Colours, scales and units that every view of a result shares: recordings, pictures and reports."""

import math

import cv2
import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray

Rgb = tuple[int, int, int]
ColorArray = npt.NDArray[np.uint8]

# Thesis fig. 3.12: observed blue, simulated red; rest green. Of another simulator: green too, without rest.
OBSERVED: Rgb = (40, 110, 255)
SIMULATED: Rgb = (235, 45, 45)
TARGET: Rgb = (42, 157, 74)
REST: Rgb = (30, 190, 80)
LOST: Rgb = (245, 245, 245)
HELD: Rgb = (255, 200, 0)

# Of plots: x, y, z as every robotics tool has them; joints as far apart as nine lines can be.
AXES: tuple[Rgb, ...] = ((235, 70, 70), (80, 200, 90), (80, 140, 255))
JOINTS: tuple[Rgb, ...] = (
    *((86, 180, 233), (230, 159, 0), (0, 190, 140), (240, 228, 66), (225, 95, 60), (204, 121, 167), (150, 150, 255)),
    *((190, 190, 190), (140, 200, 80)),
)

BACKGROUND: Rgb = (30, 33, 38)
"""Background of pictures that do not fill their view."""

# Of a device's state.
GOOD: Rgb = (40, 150, 70)
WARN: Rgb = (215, 140, 0)
BAD: Rgb = (200, 40, 40)
IDLE: Rgb = (110, 115, 125)


def tints_of(count: int) -> list[Rgb]:
    """The colours of a plot's lines, in their order."""
    return [JOINTS[at % len(JOINTS)] for at in range(count)]


def colors(share: FloatArray) -> ColorArray:
    """(n, 3) RGB for (n,) shares of the scale, 0 to 1, dark violet to yellow."""
    level = np.clip(np.nan_to_num(share) * 255, 0, 255).astype(np.uint8).reshape(-1, 1)
    if not level.size:
        return np.zeros((0, 3), dtype=np.uint8)
    found: ColorArray = cv2.applyColorMap(level, cv2.COLORMAP_PLASMA).reshape(-1, 3)[:, ::-1]  # type: ignore[assignment]
    return found


def hexadecimal(color: Rgb) -> str:
    """`#rrggbb`, as matplotlib and HTML write a colour."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def round_up(value: float, steps: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)) -> float:
    """The next of 1, 2, 5, 10... times a power of ten: the end of a scale that a reader can divide."""
    if not (math.isfinite(value) and value > 0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in steps if value <= step * power * (1 + 1e-9))


def round_down(value: float) -> float:
    """The last of 1, 2, 5, 10... times a power of ten that is not above."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value)


def readable(unit: str, largest: float) -> tuple[float, str]:
    """The factor and the unit that show lengths up to `largest` [unit] without a row of zeros."""
    if unit == "m" and largest < 0.1:
        return (1e3, "mm") if largest >= 1e-4 or largest == 0.0 else (1e6, "µm")
    return 1.0, unit
