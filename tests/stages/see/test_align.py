"""The robot is found where the picture shows it: a known displacement comes back, and nothing else is laid onto it."""

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.solid import Capsule, PosedSolid, Solid
from deformscope.stages.see.cloud import ALIGNED_M, Alignment, align, as_seen
from deformscope.stages.see.robot import PosedRobot
from deformscope_drivers.arm.kinematics import transform

UP = 0.2


def arm() -> tuple[PosedSolid, ...]:
    """Two links at an angle and a box."""
    make = o3d.geometry.TriangleMesh
    cylinders = (make.create_cylinder(radius, length, 24, 1) for radius, length in ((0.035, 0.3), (0.03, 0.2)))
    shapes = (*cylinders, make.create_box(0.1, 0.06, 0.05))
    turns = ((0.0, 0.4, 0.0), (1.2, 0.0, 0.3), (0.0, 0.0, 0.0))
    places = ((0.0, 0.0, UP + 0.3), (0.1, -0.1, UP + 0.15), (0.1, -0.2, UP))
    return tuple(
        PosedSolid(
            transform(Rotation.from_rotvec(turn).as_matrix(), place),
            Solid(np.asarray(shape.vertices), np.asarray(shape.triangles)),
        )
        for shape, turn, place in zip(shapes, turns, places, strict=True)
    )


def seen(solids: tuple[PosedSolid, ...], noise_m: float) -> FloatArray:
    """Points on the sides that a camera at -y sees."""
    made = []
    for one in solids:
        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(one.vertices_m), o3d.utility.Vector3iVector(one.solid.triangles.astype(np.int32))
        )
        mesh.compute_triangle_normals()
        o3d.utility.random.seed(7)
        cloud = mesh.sample_points_uniformly(4000, use_triangle_normal=True)
        made.append(np.asarray(cloud.points)[np.asarray(cloud.normals)[:, 1] < -0.2])
    points = np.concatenate(made)
    return np.asarray(points + noise_m * np.random.default_rng(5).standard_normal(points.shape))


def displacement(seed: int) -> FloatArray:
    """5 mm and 1 degree about what is 0.8 m away."""
    shift, axis = (one / np.linalg.norm(one) for one in np.random.default_rng(seed).standard_normal((2, 3)))
    turn, eye = Rotation.from_rotvec(np.radians(1.0) * axis).as_matrix(), np.array([0.0, -0.6, 0.6])
    return transform(turn, eye - turn @ eye + 0.005 * shift)


def off_m(found: Alignment, truth: FloatArray) -> float:
    """At the lowest of the robot."""
    tip = np.array([0.1, -0.2, UP - 0.1, 1.0])
    return float(np.linalg.norm((found.T_seen_reported @ tip - truth @ tip)[:3]))


@pytest.mark.parametrize("seed", range(6))
def test_a_displacement_is_found_to_a_millimetre_or_two(seed: int) -> None:
    truth, solids = displacement(seed), arm()
    points = seen(solids, 0.0015) @ truth[:3, :3].T + truth[:3, 3]
    others = np.random.default_rng(seed).uniform((-0.5, -0.5, UP), (0.5, 0.5, 1.0), (2000, 3))
    found = align(np.concatenate([points, others]), solids)
    assert off_m(found, truth) < 0.002
    assert off_m(found, np.eye(4)) > 0.004
    assert found.rms_m < 0.003


def test_the_robot_goes_with_it_and_its_doubt_goes() -> None:
    truth, solids = displacement(1), arm()
    points = seen(solids, 0.0) @ truth[:3, :3].T + truth[:3, 3]
    stick = Capsule(np.array([0.1, -0.2, UP]), np.array([0.1, -0.2, UP - 0.1]), 0.01)
    there = as_seen(PosedRobot([stick], solids, margin_m=0.02, solid_margin_m=0.006, aligns=True), points, 0.0)
    assert there.margin_m == ALIGNED_M
    assert there.solid_margin_m == 0.006
    np.testing.assert_allclose(there.capsules[0].end_m, (truth @ [0.1, -0.2, UP - 0.1, 1.0])[:3], atol=0.002)
    np.testing.assert_allclose(
        there.solids[2].vertices_m, solids[2].vertices_m @ truth[:3, :3].T + truth[:3, 3], atol=0.002
    )


def test_it_stays_where_it_is_reported_where_the_picture_does_not_tell() -> None:
    solids = arm()
    points = seen(solids, 0.0)
    robot = PosedRobot((), solids, margin_m=0.02, aligns=True)
    beside = np.add(points, (0.3, 0.0, 0.0))
    anything = np.random.default_rng(2).uniform((-0.5, -0.5, UP), (0.5, 0.5, 1.0), (50_000, 3))
    for given in (points[:50], beside, anything, np.zeros((0, 3))):
        assert as_seen(robot, given, 0.0) is robot
    assert as_seen(robot, points, 5.0) is robot  # nothing is above that
    assert as_seen(PosedRobot((), solids), points, 0.0).solids is solids  # it is not to be aligned
