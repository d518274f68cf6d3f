"""First place of the stick, as the person put it."""

from __future__ import annotations

import math
from dataclasses import dataclass

MANUAL = "placed"
"""Model of an arm that a person places: it has no joints that are known."""


@dataclass(frozen=True, slots=True)
class ManualArmConfig:
    """Settings of an arm without an interface.

    start_m: (3,) initial place of the stick's mount, in the frame that `T_arm_surface` relates to the surface;
    theta_rad: its rotation about x, the new y, the new z; default: its z axis, along the stick, points down
    resolution_m: finest step of its scale; no finer one is requested of a person
    state_hz: how often the pose is reported again"""

    start_m: tuple[float, float, float]
    theta_rad: tuple[float, float, float] = (math.pi, 0.0, 0.0)
    resolution_m: float = 1e-4
    state_hz: float = 50.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.start_m, *self.theta_rad))):
            raise ValueError(f"expected a finite start_m and theta_rad; came {self.start_m}, {self.theta_rad}")
        if not 1e-6 <= self.resolution_m <= 1e-3:
            raise ValueError(f"expected resolution_m from 1e-6 to 1e-3; came {self.resolution_m!r}")
        if not 5.0 <= self.state_hz <= 100.0:
            raise ValueError(f"expected state_hz from 5 to 100; came {self.state_hz!r}")
