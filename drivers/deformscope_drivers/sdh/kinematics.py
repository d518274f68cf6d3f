"""Poses of the SDH's fingers, from the angles of its seven axes. Pure arithmetic.

Hand frame: origin at the foot of the palm, z away from the wrist, x from finger 2 to finger 0, y from finger 1 (the
thumb) to the middle between the two others. The proximal joints are on an equilateral triangle with side 66 mm, 17 mm
above the origin. Numbers and signs are those of Schunk's library (ipab-slmc/SDHLibrary-CPP, sdh.cpp); the assignment of
the tactile controller's pads to links is an assumption there, see package `dsa`."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PROXIMAL_LINK_M: Final = 0.0865
DISTAL_LINK_M: Final = 0.0685
BASE_SIDE_M: Final = 0.066
BASE_HEIGHT_M: Final = 0.017

AXIS_NAMES: Final = (
    "fingers 0 and 2, base rotation",
    "finger 0, proximal",
    "finger 0, distal",
    "finger 1 (thumb), proximal",
    "finger 1 (thumb), distal",
    "finger 2, proximal",
    "finger 2, distal",
)


@dataclass(frozen=True, slots=True)
class Finger:
    """One finger: its axes, and its pose on the palm.

    base_axis: the axis that turns it about z; None = it does not turn (the thumb)
    base_m: its proximal joint in the hand frame
    bend_sign: direction in which positive proximal angles lean, along (x, y), before the base turns"""

    name: str
    base_axis: int | None
    proximal_axis: int
    distal_axis: int
    base_m: tuple[float, float, float]
    bend_sign: tuple[float, float]


_INRADIUS_M = BASE_SIDE_M / 2 * math.tan(math.radians(30))
_CIRCUMRADIUS_M = BASE_SIDE_M / 2 / math.cos(math.radians(30))

FINGERS: Final = (
    Finger("finger 0", 0, 1, 2, (BASE_SIDE_M / 2, _INRADIUS_M, BASE_HEIGHT_M), (-1.0, -1.0)),
    Finger("thumb", None, 3, 4, (0.0, -_CIRCUMRADIUS_M, BASE_HEIGHT_M), (1.0, 1.0)),
    Finger("finger 2", 0, 5, 6, (-BASE_SIDE_M / 2, _INRADIUS_M, BASE_HEIGHT_M), (1.0, -1.0)),
)


def finger_points(position_deg: FloatArray | tuple[float, ...], finger: int) -> FloatArray:
    """Proximal joint, distal joint and tip of finger 0, 1 (the thumb) or 2 in the hand frame: (3, 3) [m]. position_deg:
    (7,) angles by axis. At 0 a finger is upright; positive angles lean it over the palm."""
    angles = np.radians(np.asarray(position_deg, dtype=np.float64))
    if angles.shape != (len(AXIS_NAMES),):
        raise ValueError(f"position_deg must be ({len(AXIS_NAMES)},), not {angles.shape}")
    kind = FINGERS[finger]
    turn = 0.0 if kind.base_axis is None else float(angles[kind.base_axis])
    lean = np.array([kind.bend_sign[0] * math.sin(turn), kind.bend_sign[1] * math.cos(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    proximal = float(angles[kind.proximal_axis])
    distal = proximal + float(angles[kind.distal_axis])
    points = np.empty((3, 3))
    points[0] = kind.base_m
    points[1] = points[0] + PROXIMAL_LINK_M * (math.sin(proximal) * lean + math.cos(proximal) * up)
    points[2] = points[1] + DISTAL_LINK_M * (math.sin(distal) * lean + math.cos(distal) * up)
    return points


def fingertips(position_deg: FloatArray | tuple[float, ...]) -> FloatArray:
    """The tips of fingers 0, 1 (the thumb) and 2 in the hand frame: (3, 3) [m]. Fingertips are the ends of the distal
    links' axes; the pads are in front of them."""
    return np.stack([finger_points(position_deg, finger)[2] for finger in range(len(FINGERS))])
