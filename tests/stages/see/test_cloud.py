"""From a depth image to the surface's points: geometry with known answers."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.solid import Capsule
from deformscope.stages.see import cloud
from deformscope.stages.see.pixel_labels import PixelLabel
from deformscope.stages.see.robot import PosedRobot, outside_capsules

CAMERA = cloud.Intrinsics((300.0, 310.0), (80.0, 60.0))
BOX = cloud.Box((0.0, 0.0, -0.1), (0.6, 0.4, 0.3))


def looking_down_at_45_degrees() -> FloatArray:
    """0.8 m from (0.3, 0.2, 0), on the side of -y, x to the right."""
    c = np.sqrt(0.5)
    transform = np.eye(4)
    transform[:3, :3] = np.column_stack([[1.0, 0.0, 0.0], [0.0, -c, -c], [0.0, c, -c]])
    transform[:3, 3] = np.array([0.3, 0.2, 0.0]) + 0.8 * np.array([0.0, -c, c])
    return transform


def seen(transform: FloatArray, height: float = 0.0) -> FloatArray:
    """Depth image (120, 160) of a level plane [m]."""
    column, row = np.meshgrid(np.arange(160), np.arange(120))
    ray = np.stack([(column - 80.0) / 300.0, (row - 60.0) / 310.0, np.ones(row.shape)], axis=-1) @ transform[:3, :3].T
    depth = (height - transform[2, 3]) / ray[..., 2]
    return np.where(depth > 0, depth, 0.0)


def test_a_plane_comes_back_where_it_is() -> None:
    transform = looking_down_at_45_degrees()
    depth = seen(transform, 0.05)
    depth[3, 4], depth[5, 6] = 0.0, np.nan
    points = cloud.back_project(depth, CAMERA, transform)
    assert len(points) == 120 * 160 - 2
    np.testing.assert_allclose(points[:, 2], 0.05, atol=1e-12)
    middle = cloud.back_project(np.pad([[0.8]], ((60, 59), (80, 79))), CAMERA, transform)
    np.testing.assert_allclose(middle, [[0.3, 0.2, 0.0]], atol=1e-12)


def test_a_box_keeps_what_is_inside() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.6, 0.4, 0.3], [0.61, 0.2, 0.0], [0.3, -0.001, 0.0], [0.3, 0.2, 0.31]])
    assert cloud.within(points, BOX).tolist() == [True, True, False, False, False]


def test_lone_points_go_and_a_surface_stays() -> None:
    rng = np.random.default_rng(0)
    surface = np.column_stack([rng.uniform(size=(4000, 2)) * [0.6, 0.4], rng.normal(size=4000) * 1e-3])
    lone = rng.uniform(size=(20, 3)) * [0.6, 0.4, 0.2] + [0, 0, 0.05]
    kept = cloud.not_alone(np.concatenate([surface, lone]))
    assert not kept[4000:].any()
    assert kept[:4000].mean() > 0.93
    assert cloud.not_alone(lone).all()  # too few to say


def test_one_point_a_cell_is_the_mean_of_its_points() -> None:
    points = np.random.default_rng(1).uniform(-0.05, 0.05, size=(500, 3))
    reduced, count, place = cloud.reduce_to_grid(points, 0.01)
    np.testing.assert_array_equal(np.bincount(place), count)
    np.testing.assert_allclose(points[place == 3].mean(axis=0), reduced[3])
    assert count.sum() == 500
    np.testing.assert_allclose(count @ reduced, points.sum(axis=0), atol=1e-12)
    cells = np.floor(reduced[:, :2] / 0.01)
    assert len(np.unique(cells, axis=0)) == len(reduced)
    first = np.floor(points[:, :2] / 0.01) == cells[0]
    np.testing.assert_allclose(reduced[0], points[first.all(axis=1)].mean(axis=0))
    with pytest.raises(InputError, match="cell above 0"):
        cloud.reduce_to_grid(points, 0.0)


def test_links_take_exactly_the_points_of_the_arm() -> None:
    rng = np.random.default_rng(2)
    link = Capsule(np.array([0.3, 0.2, 0.02]), np.array([0.3, 0.25, 0.3]), 0.012)
    points = rng.uniform([0.25, 0.15, -0.05], [0.35, 0.3, 0.35], size=(5000, 3))
    fine = link.start_m + np.linspace(0, 1, 4001)[:, None] * (link.end_m - link.start_m)
    away = np.min([np.linalg.norm(points - one, axis=1) for one in fine], axis=0)
    np.testing.assert_array_equal(outside_capsules(points, [link], margin_m=0.005), away > 0.017)
    ball = Capsule(np.zeros(3), np.zeros(3), 0.01)
    assert outside_capsules(np.array([[0.0, 0.0, 0.016], [0.0, 0.0, 0.014]]), [ball], margin_m=0.005).tolist() == [
        True,
        False,
    ]


def test_noise_grows_with_distance_and_angle() -> None:
    assert cloud.axial_noise_m(np.array([0.4])) == pytest.approx(0.0012)
    assert cloud.axial_noise_m(np.array([1.4])) == pytest.approx(0.0031)
    assert cloud.axial_noise_m(np.array([0.8]), 1.4) > 1.5 * cloud.axial_noise_m(np.array([0.8]))
    down = np.eye(4)
    down[:3, :3] = np.diag([1.0, -1.0, -1.0])
    down[2, 3] = 0.8
    assert cloud.height_noise_m(np.zeros((1, 3)), down) == pytest.approx(cloud.axial_noise_m(np.array([0.8])))
    # at 45 degrees an error along the ray is cos 45 of it in height
    aslant = cloud.height_noise_m(np.array([[0.3, 0.2, 0.0]]), looking_down_at_45_degrees())
    assert aslant == pytest.approx(np.sqrt(0.5) * cloud.axial_noise_m(np.array([0.8]), np.pi / 4))


def test_perceiving_keeps_the_surface_alone() -> None:
    transform = looking_down_at_45_degrees()
    depth = seen(transform, 0.05)
    stick = Capsule(np.array([0.3, 0.2, 0.06]), np.array([0.3, 0.2, 0.25]), 0.01)
    depth[40:60, 78:83] *= 0.9  # something nearer, where the stick is seen
    hidden = cloud.back_project(
        np.where(np.isin(np.arange(120), np.arange(40, 60))[:, None], depth, 0.0), CAMERA, transform
    )
    on_the_stick = ~outside_capsules(hidden, [stick], margin_m=0.01)
    found = cloud.perceive(depth, CAMERA, transform, BOX, robot=PosedRobot([stick], margin_m=0.01), cell_m=0.005)
    count = np.bincount(found.label.ravel(), minlength=len(PixelLabel))
    assert count[PixelLabel.NOTHING_SEEN] == 0
    assert count[PixelLabel.ROBOT_CAPSULE] >= np.count_nonzero(on_the_stick) > 0
    assert len(found.point) == count[PixelLabel.USED] > 0
    flat = np.abs(found.points_m[:, 2] - 0.05) < 1e-9
    assert flat.mean() > 0.98
    assert (found.noise_m > 0).all()
    assert found.noise_m.min() < found.noise_m.max()
    with pytest.raises(InputError, match="points of the surface"):
        cloud.perceive(depth, CAMERA, transform, cloud.Box((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)))


def test_images_and_poses_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="depth image"):
        cloud.back_project(np.zeros(5), CAMERA, np.eye(4))
    with pytest.raises(InputError, match="T_world_camera"):
        cloud.back_project(np.zeros((5, 5)), CAMERA, np.full((4, 4), np.nan))
