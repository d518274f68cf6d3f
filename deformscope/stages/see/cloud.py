"""From a depth image to the surface's points: back-projection, crop, outliers, reduction, the robot taken away.

All points are in the surface frame, in which `T_world_camera` and the robot's links are given. Points are
(n, 3) [m]. Functions that select points return a mask, which can then select noise or colour too.

High above the sample all points belong to the robot. They are registered to the robot's solids, point to plane, with
the calibration's uncertainty as a prior. The remaining error of the calibration is small, and so little of the surface
around the robot has to be left out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.solid import Capsule, PosedSolid, merged
from deformscope.stages.see.pixel_labels import LabelArray, PixelLabel
from deformscope.stages.see.robot import NO_ROBOT, PosedRobot, label_robot, measured

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


NEIGHBOURS, OUTLYING = 20, 2.0
"""Neighbours of a point, and deviations of their mean distance, for a statistical outlier."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera, z along its axis, x right, y down. focal, centre: (x, y) [px]; distortion: OpenCV's k1, k2, p1,
    p2, k3, or fewer"""

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Box:
    """low_m, high_m: corners (3,) of a box along the axes [m]"""

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Perceived:
    """The remaining points of a depth image. points_m: (n, 3); noise_m: (n,) deviation of each height [m]; label: (H,
    W) `PixelLabel` of each pixel; point: (m,) point of each used pixel, row by row, the point it is a part of"""

    points_m: FloatArray
    noise_m: FloatArray
    label: LabelArray
    point: IntArray


def back_project(depth_m: FloatArray, camera: Intrinsics, T_world_camera: FloatArray) -> FloatArray:
    """Points (n, 3) [m] of a depth image (H, W) [m], row by row; pixels of 0 or NaN saw nothing. depth: along the
    camera's axis, not along the ray; T_world_camera: (4, 4), p_world = T_world_camera @ p_camera"""
    depth = np.asarray(depth_m, dtype=np.float64)
    transform = np.asarray(T_world_camera, dtype=np.float64)
    if depth.ndim != 2:
        raise InputError("a depth image (H, W)", f"shape {depth.shape}")
    if transform.shape != (4, 4) or not np.isfinite(transform).all():
        raise InputError("T_world_camera (4, 4), finite", f"shape {transform.shape}")
    row, column = np.nonzero(measured(depth))
    z = depth[row, column]
    aside = (np.column_stack([column, row]) - camera.centre_px) / camera.focal_px
    if any(camera.distortion):
        import cv2

        coefficients = np.pad(camera.distortion, (0, 5 - len(camera.distortion)))
        aside = np.asarray(cv2.undistortPoints(aside[:, None, :], np.eye(3), coefficients)[:, 0, :], dtype=np.float64)
    return np.asarray(np.column_stack([aside * z[:, None], z]) @ transform[:3, :3].T + transform[:3, 3])


def within(points: FloatArray, box: Box) -> BoolArray:
    """(n,) points inside a box, its faces included."""
    return np.asarray(((points >= box.low_m) & (points <= box.high_m)).all(axis=1))


def not_alone(points: FloatArray) -> BoolArray:
    """(n,) points that are no statistical outliers. A point is retained if its mean distance to its `NEIGHBOURS`
    nearest is at most that of all points plus `OUTLYING` deviations (Rusu et al. 2008).

    If there are no more than `NEIGHBOURS` points, all are retained. Open3D has the same rule and takes a third of the
    time, but blocks all other threads meanwhile (0.5 s for 100 000 points on a busy machine)."""
    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    distance, _ = cKDTree(points).query(points, k=NEIGHBOURS + 1)
    mean = distance[:, 1:].mean(axis=1)
    return np.asarray(mean <= mean.mean() + OUTLYING * mean.std())


def reduce_to_grid(points: FloatArray, cell_m: float) -> tuple[FloatArray, FloatArray, IntArray]:
    """One point (m, 3) for each occupied cell seen from above: the mean of the points in it; their number (m,); and
    (n,) index of each point's mean.

    Noise that is independent from point to point falls by the root of the count; the cells' order is fixed."""
    if cell_m <= 0.0 or not np.isfinite(cell_m):
        raise InputError("a cell above 0 m", f"{cell_m:g}")
    cell = np.floor(points[:, :2] / cell_m).astype(np.int64)
    _, place, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    place = place.ravel()
    mean = np.column_stack([np.bincount(place, weights=points[:, d], minlength=len(count)) for d in range(3)])
    return mean / count[:, None], count.astype(np.float64), place


# Noise and touch ------------------------------------------------------------------------------------------------------


def axial_noise_m(distance_m: FloatArray, incidence_rad: FloatArray | float = 0.0) -> FloatArray:
    """Standard deviation of a structured-light camera's depth along its axis [m] at distances and angles between the
    ray and the surface's normal (Nguyen, Izadi and Lovell 2012, eq. 4; a Kinect, 0.4 to 3 m)."""
    distance, angle = np.asarray(distance_m, dtype=np.float64), np.asarray(incidence_rad, dtype=np.float64)
    flat = 0.0012 + 0.0019 * (distance - 0.4) ** 2
    steep = np.minimum(angle, 0.48 * np.pi)
    return np.asarray(flat + 1e-4 / np.sqrt(distance) * steep**2 / (0.5 * np.pi - steep) ** 2)


def height_noise_m(points: FloatArray, T_world_camera: FloatArray) -> FloatArray:
    """(n,) deviation of the height of points (n, 3) on a level surface, from a camera's axial noise [m]. An error of
    depth moves a point along its ray; a surface seen at an angle is then off by the ray's share along z."""
    transform = np.asarray(T_world_camera, dtype=np.float64)
    ray = points - transform[:3, 3]
    axial = ray @ transform[:3, 2]  # the camera's axis in the world
    length = np.linalg.norm(ray, axis=1)
    steepness = np.abs(ray[:, 2])
    incidence = np.arccos(np.clip(steepness / length, 0.0, 1.0))
    return np.asarray(axial_noise_m(axial, incidence) * steepness / axial)


def contact_radius_m(radius_m: float, depth_m: float) -> float:
    """Radius of the contact of a ball with an elastic half-space, sqrt(R d) (Hertz), at most its radius [m]."""
    return float(min(np.sqrt(radius_m * max(depth_m, 0.0)), radius_m))


def perceive(
    depth_m: FloatArray,
    camera: Intrinsics,
    T_world_camera: FloatArray,
    box: Box,
    *,
    robot: PosedRobot = NO_ROBOT,
    cell_m: float | None = None,
) -> Perceived:
    """The surface's points in a depth image (H, W) [m]: cropped to a box, without the robot and without lone points.
    With `cell_m` the points are reduced to one per cell.

    robot: the arm with all its parts, at its reported pose; above the box nothing else is near it Raises InputError if
    no points remain."""
    points = back_project(depth_m, camera, T_world_camera)
    robot = as_seen(robot, points, box.high_m[2])
    every = np.full(len(points), PixelLabel.OUTSIDE_THE_BOX, np.uint8)
    inside = within(points, box)
    points = points[inside]
    label = label_robot(points, robot, depth_m, inside)
    used = label == PixelLabel.USED
    label[used] = np.where(not_alone(points[used]), PixelLabel.USED, PixelLabel.LONE)
    every[inside] = label
    points = points[label == PixelLabel.USED]
    if not len(points):
        came = f"none of {len(every)} seen"
        raise InputError("points of the surface in the depth image", came, "check T_world_camera and the box")
    noise = height_noise_m(points, T_world_camera)
    place: IntArray = np.arange(len(points))
    if cell_m is not None:
        points, count, place = reduce_to_grid(points, cell_m)
        noise = height_noise_m(points, T_world_camera) / np.sqrt(count)
    image = np.full(np.shape(depth_m), PixelLabel.NOTHING_SEEN, np.uint8)
    image[measured(depth_m)] = every
    return Perceived(points, noise, image, place)
