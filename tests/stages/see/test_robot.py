"""Points of the robot, and those that hang in the air at its edges: geometry with known answers."""

import numpy as np
import open3d as o3d

from deformscope.solid import PosedSolid, Solid
from deformscope.stages.see.pixel_labels import PixelLabel
from deformscope.stages.see.robot import EDGE_PX, HOVER_M, PosedRobot, at_jumps, label_robot, outside_solids, standing
from deformscope_drivers.arm.kinematics import rotation_from_rpy, transform

BALL = o3d.geometry.TriangleMesh.create_sphere(0.03, resolution=60)


def test_solids_take_the_points_within_their_margin_wherever_they_are() -> None:
    ball = Solid(np.asarray(BALL.vertices), np.asarray(BALL.triangles))
    middles = np.array([[0.1, 0.2, 0.3], [0.15, 0.2, 0.3], [5.0, 5.0, 5.0]])
    posed = [PosedSolid(transform(rotation_from_rpy(0.3, 0.8, -1.0), middle), ball) for middle in middles]
    points = np.random.default_rng(1).uniform((0.0, 0.1, 0.2), (0.25, 0.3, 0.4), (20_000, 3))
    away = np.linalg.norm(points[:, None] - middles, axis=2).min(axis=1)
    sure = np.abs(away - 0.04) > 1e-4  # a ball of flat triangles
    np.testing.assert_array_equal(outside_solids(points, posed, margin_m=0.01)[sure], (away > 0.04)[sure])
    assert outside_solids(points, [], margin_m=0.01).all()
    assert outside_solids(np.zeros((0, 3)), posed, margin_m=0.01).shape == (0,)


def test_jumps_reach_as_far_as_pixels_are_mixed() -> None:
    depth = np.full((20, 40), 0.8)
    depth[:, 20:] = 0.7
    depth[:, 5] = 0.0  # saw nothing: no jump
    np.testing.assert_array_equal(np.flatnonzero(at_jumps(depth).any(axis=0)), np.arange(20 - EDGE_PX, 20 + EDGE_PX))
    assert not at_jumps(np.broadcast_to(0.6 + 0.003 * np.arange(40), (20, 40))).any()


def test_what_hangs_above_the_surface_goes_and_what_stands_on_it_stays() -> None:
    x, y = (one.ravel() for one in np.meshgrid(np.arange(0.0, 0.3, 0.002), np.arange(0.0, 0.2, 0.002)))
    slope = np.column_stack([x, y, 0.05 + 0.2 * x])  # 11 degrees
    mixed = (np.abs(x - 0.15) < 0.006) & (np.abs(y - 0.1) < 0.03)
    hanging = slope.copy()
    hanging[mixed, 2] += np.linspace(0.0, 0.1, np.count_nonzero(mixed))
    stands = standing(hanging, mixed)
    above = hanging[:, 2] - slope[:, 2]
    assert stands[~mixed].all()
    assert stands[above < HOVER_M - 0.002].all()
    assert not stands[above > HOVER_M + 0.002].any()
    # dents beside the robot are below what is around them
    dent = slope.copy()
    dent[mixed, 2] -= 0.015
    assert standing(dent, mixed).all()
    assert standing(slope, np.ones(len(slope), dtype=bool)).all()


def test_mixed_depths_are_looked_at_only_where_the_robots_shape_is_known() -> None:
    depth = np.full((10, 10), 0.8)
    depth[4:6, 4:6] = 0.6
    points = np.column_stack([*(one.ravel() for one in np.meshgrid(np.arange(10), np.arange(10))), 0.8 - depth.ravel()])
    points[:, :2] *= 0.002
    used = np.ones(100, dtype=bool)
    assert (label_robot(points, PosedRobot(), depth, used) == PixelLabel.USED).all()
    label = label_robot(points, PosedRobot(mixes=True), depth, used)
    expected = np.where(depth > 0.7, PixelLabel.USED, PixelLabel.HANGING)
    np.testing.assert_array_equal(label.reshape(10, 10), expected)
