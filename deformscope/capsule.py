"""The shape that represents a link of the arm or a stick, to find which points of a camera show the robot and not the
surface."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Capsule:
    """All within `radius_m` of the line from start_m (3,) to end_m (3,) [m]; where both are the same, a ball."""

    start_m: FloatArray
    end_m: FloatArray
    radius_m: float


def outside_m(points_m: FloatArray, half_m: FloatArray, *, round: bool = False) -> FloatArray:
    """(...) distance of points (..., 3) from a box of half its sides (3,) around the origin, or from the upright
    cylinder in it; below 0 within [m]."""
    off = np.abs(points_m)
    if round:
        off = np.stack([np.hypot(off[..., 0], off[..., 1]), off[..., 2]], axis=-1)
    off = off - (half_m[1:] if round else half_m)
    return np.asarray(np.linalg.norm(np.maximum(off, 0.0), axis=-1) + np.minimum(off.max(axis=-1), 0.0))


def moved(capsules: Iterable[Capsule], T: FloatArray) -> list[Capsule]:
    """The capsule in another frame. T: (4, 4) from the capsules' frame to the new one"""
    found = []
    for one in capsules:
        start_m, end_m = np.stack([one.start_m, one.end_m]) @ T[:3, :3].T + T[:3, 3]
        found.append(Capsule(start_m, end_m, one.radius_m))
    return found
