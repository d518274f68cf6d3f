"""Velocity along the normal, from a force that is still below the set force."""

from __future__ import annotations

from collections import deque


class ForceControl:
    """The force along the normal becomes a velocity: `v = (set - force) / (stiffness * tau)`, admittance control.

    The stiffness is the slope of force over depth of the last periods. Before contact it is that of a rigid contact
    behind a compliant arm, which prevents overshoot."""

    TAU_S = 0.12
    RIGID_N_M, SOFT_N_M = 6000.0, 150.0
    LEAST_WAY_M = 1e-4

    def __init__(self, fastest_m_s: float, rigid_n_m: float = RIGID_N_M) -> None:
        """fastest_m_s: bound of the velocity; rigid_n_m: stiffness taken before one is measured [N/m]"""
        self._fastest_m_s = fastest_m_s
        self._seen: deque[tuple[float, float]] = deque(maxlen=16)
        self.stiffness_n_m = rigid_n_m
        self._most_n_m = max(10 * self.RIGID_N_M, rigid_n_m)

    def see(self, depth_m: float, force_n: float) -> None:
        """Update the stiffness with one period's depth [m] and force along the normal [N]."""
        self._seen.append((depth_m, force_n))
        slopes = []
        for back in (4, 15):
            if len(self._seen) > back:
                then_m, then_n = self._seen[-1 - back]
                if (way_m := depth_m - then_m) > self.LEAST_WAY_M:
                    slopes.append((force_n - then_n) / way_m)
        if slopes:
            self.stiffness_n_m = min(max(*slopes, self.SOFT_N_M), self._most_n_m)

    def velocity_m_s(self, set_n: float, force_n: float) -> float:
        """Velocity along -normal, positive into the surface [m/s]. set_n, force_n: requested and measured [N]"""
        asked = (set_n - force_n) / (self.stiffness_n_m * self.TAU_S)
        return min(max(asked, -self._fastest_m_s), self._fastest_m_s)
