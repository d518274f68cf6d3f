"""The shape that stands for a link of the arm or a stick: what a camera sees of the robot, and what is not surface."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Capsule:
    """All within `radius_m` of the line from start_m (3,) to end_m (3,) [m]; where both are the same, a ball."""

    start_m: FloatArray
    end_m: FloatArray
    radius_m: float
