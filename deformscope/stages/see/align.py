"""Difference of the robot's pose in the camera's image from that given by arm and calibration, found from the robot's
points.

High above the sample all points belong to the robot. They are registered to the robot's solids, point to plane, with
the calibration's uncertainty as a prior. The remaining error of the calibration is small, and so little of the surface
around the robot has to be left out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.solid import Capsule, PosedSolid, merged
from deformscope.stages.see.robot import PosedRobot

LOOKED_AT, POINTS = 3000, 600
"""Number of points that may be the robot's, and of those near it: evenly out of all."""
FEWEST = 200
"""Fewest points: from fewer nothing is concluded."""
REACH_M = (0.03, 0.025, 0.02, 0.015, 0.012, 0.01, 0.01, 0.01)
"""Largest distance of points from the solids, in each step."""
ROBUST_M = 0.003
"""Residual from which a point counts less (Huber 1964): cables, mixed pixels."""
PRIOR_M, PRIOR_RAD = 0.015, 0.02
"""Deviations of the robot's place, and of its rotation, before anything is seen."""
SENSOR_M, INDEPENDENT = 0.002, 100.0
"""Standard deviation of a measured point [m], and the largest number of points that count as independent: neighbours
share errors of the model's shape."""
ALIKE_M = 0.004
"""Points with a larger mean distance belong to something else."""
ALIGNED_M = 0.003
"""Remaining error of the camera's pose, at the tip: 2.4 mm at most of 108 pictures of `studies.removal`, 0.6 mm as the
median (seeds 1000 to 1005: `studies.seeds`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """T_seen_reported: (4, 4) transform from the robot's reported to its seen pose; points: number of points that were
    aligned; rms_m: root mean square of the points' distances"""

    T_seen_reported: FloatArray
    points: int
    rms_m: float


def as_seen(robot: PosedRobot, points: FloatArray, above_m: float) -> PosedRobot:
    """The robot at its pose in the image, if it is to be aligned and its solids determine the pose. points: (n, 3)
    points of all of the picture [m]; above_m: height above which there are only the robot and objects far from it"""
    if not robot.aligns or (found := align(points[points[:, 2] > above_m], robot.solids)) is None:
        return robot
    T = found.T_seen_reported
    capsules = tuple(
        Capsule(T[:3, :3] @ one.start_m + T[:3, 3], T[:3, :3] @ one.end_m + T[:3, 3], one.radius_m)
        for one in robot.capsules
    )
    solids = tuple(PosedSolid(T @ one.T_world_solid, one.solid) for one in robot.solids)
    return replace(robot, capsules=capsules, solids=solids, margin_m=min(robot.margin_m, ALIGNED_M))


def align(points: FloatArray, solids: Sequence[PosedSolid]) -> Alignment | None:
    """Lay points (n, 3) [m], among which are those of the robot, onto its solids; None where too few are near them, or
    these do not fit."""
    if not solids or len(points) < FEWEST:
        return None
    whole = merged(solids)
    near = _evenly(points, LOOKED_AT)
    near = _evenly(near[np.linalg.norm(near - whole.closest(near)[0], axis=1) < REACH_M[0]], POINTS)
    T_reported_seen: FloatArray = np.eye(4)
    used, rms_m = 0, np.inf
    for reach_m in REACH_M:
        moved = near @ T_reported_seen[:3, :3].T + T_reported_seen[:3, 3]
        foot, normal = whole.closest(moved)
        there = np.linalg.norm(moved - foot, axis=1) < reach_m
        used = int(np.count_nonzero(there))
        if used < FEWEST:
            return None
        step, rms_m = _step(moved[there], foot[there], normal[there], T_reported_seen)
        T_reported_seen = step @ T_reported_seen
    return Alignment(np.linalg.inv(T_reported_seen), used, rms_m) if rms_m <= ALIKE_M else None


def _evenly(points: FloatArray, most: int) -> FloatArray:
    """At most this number of the points (n, 3), evenly spaced in their order."""
    return points[np.linspace(0, len(points) - 1, min(len(points), most)).astype(np.int64)]


def _step(points: FloatArray, foot: FloatArray, normal: FloatArray, T_so_far: FloatArray) -> tuple[FloatArray, float]:
    """(4, 4) motion of points (n, 3) onto planes through feet; robust rms of their residuals [m]."""
    middle = points.mean(axis=0)
    off = np.einsum("ij,ij->i", normal, points - foot)
    weight = np.minimum(1.0, ROBUST_M / np.maximum(np.abs(off), 1e-12))
    jacobian = np.concatenate([np.cross(points - middle, normal), normal], axis=1)
    scale = min(1.0, INDEPENDENT / len(points)) / SENSOR_M**2
    prior = np.repeat([PRIOR_RAD, PRIOR_M], 3) ** -2.0
    # so far moved, by a rotation and of the middle: the prior is about where it began
    start = np.linalg.inv(T_so_far)
    turned = Rotation.from_matrix(T_so_far[:3, :3]).as_rotvec()
    shifted = middle - (start[:3, :3] @ middle + start[:3, 3])
    normal_matrix = scale * (jacobian.T * weight) @ jacobian + np.diag(prior)
    right = -scale * (jacobian.T * weight) @ off - prior * np.concatenate([turned, shifted])
    found = np.linalg.solve(normal_matrix, right)
    T: FloatArray = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(found[:3]).as_matrix()
    T[:3, 3] = middle + found[3:] - T[:3, :3] @ middle
    return T, float(np.sqrt((weight * off**2).sum() / weight.sum()))
