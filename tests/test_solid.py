"""Solids: what is near a surface of triangles, by distances that are known."""

import pickle

import numpy as np
import open3d as o3d

from deformscope.solid import PosedSolid, Solid

SIDES_M = np.array([0.04, 0.06, 0.10])


def box() -> Solid:
    """Around the origin."""
    made = o3d.geometry.TriangleMesh.create_box(*SIDES_M)
    return Solid(np.asarray(made.vertices) - 0.5 * SIDES_M, np.asarray(made.triangles))


def test_near_is_inside_or_within_the_distance() -> None:
    points = np.random.default_rng(3).uniform(-0.12, 0.12, (4000, 3))
    beyond = np.abs(points) - 0.5 * SIDES_M
    away = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    sure = np.abs(away - 0.01) > 1e-6  # float32
    near = box().near(points, 0.01)
    np.testing.assert_array_equal(near[sure], (away <= 0.01)[sure])
    assert 0 < np.count_nonzero(near) < len(points)


def test_a_solid_goes_to_other_processes_and_frames_as_it_is() -> None:
    solid = box()
    solid.near(np.zeros((1, 3)), 0.0)  # what it keeps for that does not go with it
    again = pickle.loads(pickle.dumps(solid))
    np.testing.assert_array_equal(again.vertices_m, solid.vertices_m)
    T = np.eye(4)
    T[:3, 3] = (0.5, 0.0, -0.25)
    np.testing.assert_allclose(solid.moved(T).vertices_m, PosedSolid(T, solid).vertices_m, atol=1e-7)
    middle, radius = again.ball
    np.testing.assert_allclose(middle, 0.0, atol=1e-9)
    np.testing.assert_allclose(radius, 0.5 * np.linalg.norm(SIDES_M), rtol=1e-6)
