"""Whether something pushes an arm beside its tip: joint torques without those of gravity, against what explains them.

Real torque sensors drift and an arm does not know what it carries, so what counts is the difference from a mean that
follows slowly. What the force at the tip could make of each joint's torque, in whatever direction, counts for nothing:
then neither the sign that a vendor gives its torques matters, nor the axes of the force sensor.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross

FOLLOWS_S = 2.0
"""The mean follows the torques within about so long: slower than any collision, faster than drift, and than gravity's
remainder changes at the speed of travel."""
PRESSED_N = 0.5
"""While more than this is on the tip the mean stays as it is: what the tip explains is no drift."""
IN_A_ROW = 2
"""Readings that differ, all beyond the limit, are a collision: one alone may be an outlier."""

LEARNS_S, LOOKS_S = 0.8, 0.1
"""What currents were for so long says what they are to be in the time after it. Learning for longer leaves the arm
unwatched for longer after a motion changes (0.9 s in all), shorter makes the line, and with it the limit, less certain;
looking for longer finds a collision later, shorter by fewer readings."""
LEAST_READINGS = 20
"""Of that time, fewer say nothing: of 20 readings the deviation of the noise is known within 16 %, one over the root of
twice as many."""
STEADY_DEG, STEADY_SHARE = 5e-4, 0.02
"""Joints go on as they went within so much, and so much of a second's way: else friction and inertia change too."""
CURRENT_NOISE = 7.0
"""Deviations of their noise by which currents are off in a collision. With 7, a sensor that feels nothing any more lets
doubles of 5, 20 and 100 N/mm press 8.2, 13.0 and 7.6 N (`docs/results/safety.md`); smaller stops for ripple, larger presses
harder."""


class CollisionWatch:
    """Detects a collision by joint torques, one state after the other; `start` before the first and after each
    pause."""

    def __init__(self, chain: Chain, T_ee_center: FloatArray) -> None:
        """T_ee_center: (4, 4) the tip's centre in the frame of the arm's end [m]"""
        self._chain, self._T_ee_center = chain, T_ee_center
        self.start()

    def start(self) -> None:
        """Forget the mean torques: the next reading begins a new one."""
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


class CurrentWatch:
    """Whether something stops an arm that its force sensor does not feel, by its motors' currents, in whatever unit.

    They hold gravity, friction, and what the gears make of a turn, all of which go on as they went for as long as the
    joints do: so each joint's current is compared with the line through its last second, while nothing is felt.
    """

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget the currents: nothing is detected until LEAST_READINGS new ones have come."""
        self._seen: deque[tuple[float, FloatArray]] = deque()
        self._beyond = 0

    def look(self, currents: tuple[float, ...], joints_deg: tuple[float, ...], tip_n: float, now_ns: int) -> str:
        """Why this is a collision, with which joint; empty where it is none.

        currents: (n,) of the motors, any unit; joints_deg: (n,); tip_n: as of `CollisionWatch.look` [N]; now_ns: when
        """
        if not all(map(math.isfinite, currents)):
            return "a motor's current is no number"
        if tip_n > PRESSED_N:
            self.start()
            return ""
        self._seen.append((now_ns / 1e9, np.array([*currents, *joints_deg])))
        while self._seen[0][0] < now_ns / 1e9 - LEARNS_S - LOOKS_S:
            self._seen.popleft()
        time_s = np.array([one for one, _ in self._seen]) - now_ns / 1e9
        learnt = int(np.searchsorted(time_s, -LOOKS_S))
        if learnt < LEAST_READINGS or learnt == len(time_s):
            return ""
        values, count = np.array([one for _, one in self._seen]), len(currents)
        middle_s = time_s[:learnt].mean()
        spread = np.sum((time_s[:learnt] - middle_s) ** 2)
        slopes = (time_s[:learnt] - middle_s) @ values[:learnt] / spread
        off = values - values[:learnt].mean(axis=0) - np.outer(time_s - middle_s, slopes)
        if np.any(np.abs(off[:, count:]) > STEADY_DEG + STEADY_SHARE * np.abs(slopes[count:])):
            self._beyond = 0
            return ""
        looked = np.median(off[learnt:, :count], axis=0)  # of joints that begin to turn, most have not yet
        ahead = (time_s[learnt:].mean() - middle_s) ** 2 / spread + 1.0 / learnt + 1.0 / (len(time_s) - learnt)
        steps = np.abs(np.diff(values[:learnt, :count], axis=0))
        finest = np.where(steps > 0.0, steps, np.inf).min(axis=0)  # no limit where nothing changes: nothing is sent
        limits = CURRENT_NOISE * math.sqrt(ahead) * off[:learnt, :count].std(axis=0, ddof=2) + finest
        worst = int(np.argmax(np.abs(looked) - limits))
        self._beyond = self._beyond + 1 if abs(looked[worst]) > limits[worst] else 0
        if self._beyond < IN_A_ROW:
            return ""
        return f"the motor of joint {worst + 1} has {looked[worst]:+.2g} of current, limit {limits[worst]:.2g}"
