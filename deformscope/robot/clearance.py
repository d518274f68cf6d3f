"""The distance of an arm from the table and from itself: links and stick are capsules around the lines between joints.

It replaces a function of the vendor's Cartesian mode, less accurately. Shapes of arms differ by one to two centimetres
from capsules of one radius, which the margin covers."""

import math
from collections import deque
from itertools import combinations

import numpy as np

from deformscope.robot.description import LINK_RADIUS_M
from deformscope.robot.placement import Placement
from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross

ArmBox = tuple[tuple[float, float, float], tuple[float, float, float]]
"""A box by its low and high corner [m]."""
APART_M = 0.15
"""Length between two parts of an arm below which they cannot collide, as only their joint is between them.
It is longer than a wrist's links, and shorter than a forearm. With a smaller value, neighbours would always count as
touching; with a larger one, a wrist folded onto its forearm would be missed."""
FROM_ELBOW = 2
"""Links from the base that may be near the table: pedestal and shoulder are mounted on it."""


class ArmClearance:
    """Distances of an arm's links and stick from the table, from each other and from a box, for given link poses.

    reach_m: length of base, links and stick in a row: a turn of one joint by 1 rad moves no part further [m]"""

    def __init__(self, placement: Placement, T_base_links: FloatArray) -> None:
        """T_base_links: (n + 1, 4, 4) poses of the joints and, last, the arm's end, in any pose, for its lengths [m]"""
        self._placement = placement
        lengths = np.linalg.norm(np.diff(self._points_m(T_base_links), axis=0), axis=1)
        before = np.concatenate([[0.0], np.cumsum(lengths)])
        self.reach_m = float(before[-1])
        pairs = [(a, b) for a, b in combinations(range(len(lengths)), 2) if before[b] - before[a + 1] >= APART_M]
        self._pairs = np.array(pairs, dtype=int).reshape(-1, 2)
        radius = np.full(len(lengths), LINK_RADIUS_M)
        radius[-1] = placement.tool.stick_radius_m
        self._radius_m = radius

    def _points_m(self, T_base_links: FloatArray) -> FloatArray:
        """(n + 3, 3) base, joints, end and the tip's centre, in the surface frame [m]."""
        tip = T_base_links[-1] @ self._placement.T_ee_center
        frames = np.concatenate([np.eye(4)[None], T_base_links, tip[None]])
        return np.asarray((self._placement.T_surface_base @ frames)[:, :3, 3])

    def over_table_m(self, T_base_links: FloatArray) -> float:
        """Height of elbow and wrist, without the stick, above the surface's z = 0 [m]. T_base_links: (n + 1, 4, 4)"""
        return float(self._points_m(T_base_links)[:-1][FROM_ELBOW + 1 :, 2].min() - LINK_RADIUS_M)

    def in_box_m(self, T_base_links: FloatArray, box: ArmBox | None) -> float:
        """Least distance of parts inside a box of the base frame [m], or inf. T_base_links: (n + 1, 4, 4)"""
        if box is None:
            return float("inf")
        tip = T_base_links[-1] @ self._placement.T_ee_center
        points = np.concatenate([T_base_links[FROM_ELBOW:, :3, 3], tip[None, :3, 3]])
        radius_m = np.full(len(points), LINK_RADIUS_M)
        radius_m[-1] = self._placement.tool.stick_radius_m
        inside = np.minimum(points - np.array(box[0]), np.array(box[1]) - points).min(axis=1)
        return float((inside - radius_m).min())

    def to_itself_m(self, T_base_links: FloatArray) -> float:
        """Least distance of parts that may collide [m], below 0 in overlap, inf without. T_base_links: (n + 1, 4, 4)"""
        if not len(self._pairs):
            return float("inf")
        points = self._points_m(T_base_links)
        one, other = self._pairs.T
        gap = segment_distance(points[one], points[one + 1], points[other], points[other + 1])
        return float((gap - self._radius_m[one] - self._radius_m[other]).min())


def segment_distance(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """(n,) shortest distance between segments a-b and c-d, each end (n, 3) [m] (Ericson 2005, 5.1.9)."""
    along, across, between = b - a, d - c, a - c
    aa, ee = np.sum(along * along, axis=1), np.sum(across * across, axis=1)
    f, ab, g = np.sum(across * between, axis=1), np.sum(along * across, axis=1), np.sum(along * between, axis=1)
    tiny = 1e-12
    denominator = aa * ee - ab * ab
    s = np.clip(np.where(denominator > tiny, (ab * f - g * ee) / np.maximum(denominator, tiny), 0.0), 0.0, 1.0)
    alone = np.clip(-g / np.maximum(aa, tiny), 0.0, 1.0)
    s = np.where(ee > tiny, s, alone)  # c-d is a point
    t = np.where(ee > tiny, (ab * s + f) / np.maximum(ee, tiny), 0.0)
    t_in = np.clip(t, 0.0, 1.0)
    s = np.where(t == t_in, s, np.clip(np.where(aa > tiny, (t_in * ab - g) / np.maximum(aa, tiny), 0.0), 0.0, 1.0))
    return np.asarray(np.linalg.norm(between + s[:, None] * along - t_in[:, None] * across, axis=1))


# Detects a push on an arm away from its tip: joint torques without gravity, compared with their known causes.
#
# Real torque sensors drift and the arm's load is unknown, so the difference from a slowly following mean counts. The
# joint torques that the force at the tip could cause, in any direction, are ignored. Therefore neither the sign of a
# vendor's torques nor the axes of the force sensor matter

FOLLOWS_S = 2.0
"""Time constant of the mean: slower than any collision, faster than drift and gravity's error in travel."""
PRESSED_N = 0.5
"""A larger force on the tip freezes the mean, because the tip explains the difference, not drift."""
IN_A_ROW = 2
"""Number of different readings beyond the limit that mean a collision: a single one may be an outlier."""

LEARNS_S, LOOKS_S = 0.8, 0.1
"""Window of currents that predicts the following ones. A longer fit leaves the arm unwatched for longer after a change
of motion (0.9 s in all); a shorter one makes the line, and so the limit, less certain. A longer detection window finds
a collision later, a shorter one uses fewer readings."""
LEAST_READINGS = 20
"""Least number of readings in that time: 20 give the noise's standard deviation within 16 %, 1 / sqrt(2 n)."""
STEADY_DEG, STEADY_SHARE = 5e-4, 0.02
"""Joints have the same motion within this speed and this share of a second's travel: friction and inertia too."""
CURRENT_NOISE = 7.0
"""A current farther off than this, in standard deviations of its noise, is a collision. With 7, a dead sensor lets
doubles of 5, 20 and 100 N/mm press with 8.2, 13.0 and 7.6 N (`docs/results/safety.md`). A smaller value stops for
ripple, a larger one presses harder."""


class CollisionWatch:
    """Detects a collision by joint torques, one state after the other; `start` before each."""

    def __init__(self, chain: Chain, T_ee_center: FloatArray) -> None:
        """T_ee_center: (4, 4) the tip's centre in the frame of the arm's end [m]"""
        self._chain, self._T_ee_center = chain, T_ee_center
        self.start()

    def start(self) -> None:
        """Forget the mean torques: the next reading starts a new mean."""
        self._mean_nm: FloatArray | None = None
        self._mean_ns = self._beyond = 0
        self._before: tuple[float, ...] = ()

    def look(
        self, torques_nm: tuple[float, ...], joints_deg: tuple[float, ...], tip_n: float, limit_nm: float, now_ns: int
    ) -> str:
        """Why this is a collision, with which joint; empty where it is none.

        torques_nm: (n,) numbers, without gravity's, repeated until the next reading; joints_deg: (n,); now_ns: when
        tip_n: greatest recent magnitude of the force on the tip [N]; limit_nm: noise and model [Nm]"""
        if torques_nm == self._before:
            return ""
        self._before = torques_nm
        torques = np.array(torques_nm)
        if self._mean_nm is None:
            self._mean_nm, self._mean_ns = torques, now_ns
            return ""
        beside_nm = np.abs(torques - self._mean_nm)
        links = self._chain.forward(joints_deg)  # the torque on each joint of 1 N on the tip where that is the most
        center_m = (links[-1] @ self._T_ee_center)[:3, 3]
        arms = cross(links[:-1, :3, 2], center_m - links[:-1, :3, 3])
        limits_nm = limit_nm + tip_n * np.asarray(np.linalg.norm(arms, axis=1))
        worst = int(np.argmax(beside_nm - limits_nm))
        if beside_nm[worst] <= limits_nm[worst]:
            share = min(1.0, (now_ns - self._mean_ns) / (1e9 * FOLLOWS_S)) if tip_n < PRESSED_N else 0.0
            self._mean_nm, self._mean_ns = self._mean_nm + share * (torques - self._mean_nm), now_ns
            self._beyond = 0
            return ""
        self._beyond += 1
        if self._beyond < IN_A_ROW:
            return ""
        return f"joint {worst + 1} has {beside_nm[worst]:.1f} Nm more than before, limit {limits_nm[worst]:.1f} Nm"


class CurrentWatch:
    """Detects an obstacle that the force sensor does not measure, from the motors' currents, in any unit.

    Currents contain gravity, friction and gear ripple, which continue as long as the joints move. Therefore each
    joint's current is compared with the line through its last second without contact."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget the currents: nothing is detected until LEAST_READINGS new ones have come."""
        self._seen: deque[tuple[float, FloatArray]] = deque()
        self._beyond = 0

    def look(self, currents: tuple[float, ...], joints_deg: tuple[float, ...], tip_n: float, now_ns: int) -> str:
        """Why this is a collision, with which joint; empty where it is none. currents: (n,) currents of the motors, any
        unit; joints_deg: (n,); tip_n: as in `CollisionWatch.look` [N]; now_ns: when"""
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
