"""The distance of an arm from the table and from itself: links and stick are capsules around the lines between joints.

It replaces a function of the vendor's Cartesian mode, less accurately. Shapes of arms differ by one to two centimetres
from capsules of one radius, which the margin covers."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from deformscope.robot.description import LINK_RADIUS_M
from deformscope.robot.placement import Placement
from deformscope_drivers.arm.kinematics import FloatArray

ArmBox = tuple[tuple[float, float, float], tuple[float, float, float]]
"""A box by its low and high corner [m]."""
APART_M = 0.15
"""Length between two parts of an arm below which they cannot collide, as only their joint is between them.
It is longer than a wrist's links, and shorter than a forearm. With a smaller value, neighbours would always count as
touching; with a larger one, a wrist folded onto its forearm would be missed."""
FROM_ELBOW = 2
"""Links from the base that may be near the table: pedestal and shoulder are mounted on it."""


class ArmClearance:
    """Distances of an arm's links and stick from the table, from each other and from a box, for given link poses."""

    def __init__(self, placement: Placement, T_base_links: FloatArray) -> None:
        """T_base_links: (n + 1, 4, 4) poses of the joints and, last, the arm's end, in any pose, for its lengths [m]"""
        self._placement = placement
        lengths = np.linalg.norm(np.diff(self._points_m(T_base_links), axis=0), axis=1)
        before = np.concatenate([[0.0], np.cumsum(lengths)])
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
