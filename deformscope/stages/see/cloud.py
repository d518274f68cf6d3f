"""From a depth image to the surface's points: back-projection, crop, outliers, reduction, the robot taken away.

All points are in the surface frame, in which `T_world_camera` and the robot's links are given. Points are
(n, 3) [m]. Functions that select points return a mask, which can then select noise or colour too."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.see.align import as_seen
from deformscope.stages.see.pixel_labels import LabelArray, PixelLabel
from deformscope.stages.see.robot import NO_ROBOT, PosedRobot, label_robot, measured

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
