"""Whether something pushes an arm beside its tip: joint torques without those of gravity, against what explains them.

Real torque sensors drift and an arm does not know what it carries, so what counts is the difference from a mean that
follows slowly. What the force at the tip could make of each joint's torque, in whatever direction, counts for nothing:
then neither the sign that a vendor gives its torques matters, nor the axes of the force sensor.
"""

from __future__ import annotations

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross

FOLLOWS_S = 2.0
"""The mean follows the torques within about so long: slower than any collision, faster than drift, and than gravity's
remainder changes at the speed of travel."""
PRESSED_N = 0.5
"""While more than this is on the tip the mean stays as it is: what the tip explains is no drift."""
IN_A_ROW = 2
"""Readings that differ, all beyond the limit, are a collision: one alone may be an outlier."""


class CollisionWatch:
    """Looks at one state after the other; `start` before the first and after each pause."""

    def __init__(self, chain: Chain, T_ee_center: FloatArray) -> None:
        """T_ee_center: (4, 4) the tip's centre in the frame of the arm's end [m]"""
        self._chain, self._T_ee_center = chain, T_ee_center
        self.start()

    def start(self) -> None:
        """Nothing is known of the torques."""
        self._mean_nm: FloatArray | None = None
        self._mean_ns = self._beyond = 0
        self._before: tuple[float, ...] = ()

    def look(
        self, torques_nm: tuple[float, ...], joints_deg: tuple[float, ...], tip_n: float, limit_nm: float, now_ns: int
    ) -> str:
        """Why this is a collision, with which joint; empty where it is none.

        torques_nm: (n,) numbers, without gravity's, the same again until they are read anew; joints_deg: (n,)
        now_ns: when
        tip_n: greatest magnitude lately of the force on the tip [N]; limit_nm: of noise and the model's error [Nm]
        """
        if torques_nm == self._before:
            return ""
        self._before = torques_nm
        torques = np.array(torques_nm)
        if self._mean_nm is None:
            self._mean_nm, self._mean_ns = torques, now_ns
            return ""
        beside_nm = np.abs(torques - self._mean_nm)
        limits_nm = limit_nm + tip_n * self._levers_m(joints_deg)
        worst = int(np.argmax(beside_nm - limits_nm))
        if beside_nm[worst] <= limits_nm[worst]:
            share = min(1.0, (now_ns - self._mean_ns) / (1e9 * FOLLOWS_S)) if tip_n < PRESSED_N else 0.0
            self._mean_nm, self._mean_ns = self._mean_nm + share * (torques - self._mean_nm), now_ns
            self._beyond = 0
            return ""
        self._beyond += 1
        if self._beyond < IN_A_ROW:
            return ""
        return f"joint {worst + 1} feels {beside_nm[worst]:.1f} Nm more than before, limit {limits_nm[worst]:.1f} Nm"

    def _levers_m(self, joints_deg: tuple[float, ...]) -> FloatArray:
        """(n,) torque on each joint [Nm] of 1 N on the tip in the direction in which that is the most."""
        links = self._chain.forward(joints_deg)
        center_m = (links[-1] @ self._T_ee_center)[:3, 3]
        arms = cross(links[:-1, :3, 2], center_m - links[:-1, :3, 3])
        return np.asarray(np.linalg.norm(arms, axis=1))
