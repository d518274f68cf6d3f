"""The camera's picture of a container against known geometry."""

import numpy as np
import pytest

from deformscope.lab.container_shell import BOX, CYLINDER, ContainerShape, shell_of
from deformscope.lab.container_view import ContainerView
from deformscope.lab.container_world import hand_from_container
from deformscope.lab.ray_camera import CONTAINER, ROBOT, TABLE

AWAY_DEG = np.array([90.0, -80.0, 0.0, -80.0, 0.0, -80.0, 0.0])
TOUCHING_DEG = np.array([90.0, -5.3, 5.3, -70.0, 0.0, -5.3, 5.3])


def view_of(shape: ContainerShape, pose: np.ndarray) -> tuple[ContainerView, np.ndarray]:
    shell = shell_of(shape)
    return ContainerView(shape, (shell.s_m, shell.z_m), pose), np.zeros((len(shell.s_m), len(shell.z_m)))


def in_container(view: ContainerView, depth_m: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(H, W, 3) what the pixels saw, in the container's frame."""
    return (view.points_m(depth_m) - pose[:3, 3]) @ pose[:3, :3]


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_every_pixel_of_the_container_lies_on_its_surface(shape: ContainerShape) -> None:
    pose = hand_from_container(along_m=0.01, roll_deg=2.0)
    view, still = view_of(shape, pose)
    picture = view.render(still, pose, AWAY_DEG)
    seen = in_container(view, picture.depth_m, pose)[picture.seen == CONTAINER]
    assert len(seen) > 3000
    assert seen[:, 2].max() == pytest.approx(shape.half_m[2], abs=1e-4)
    assert seen[:, 2].min() == pytest.approx(-shape.half_m[2], abs=0.003)
    if shape.kind == "box":
        out = np.abs(seen) / shape.half_m
        np.testing.assert_allclose(out.max(axis=1), 1.0, atol=1e-4)
    else:
        wall = seen[seen[:, 2] < shape.half_m[2] - 1e-3]
        np.testing.assert_allclose(np.hypot(wall[:, 0], wall[:, 1]), shape.half_m[0], atol=1e-4)


def test_a_dent_is_seen_as_deep_as_it_is() -> None:
    pose = hand_from_container()
    view, dent = view_of(BOX, pose)
    s_m, z_m = shell_of(BOX).s_m, shell_of(BOX).z_m
    dent[np.ix_(np.abs(s_m) < 0.02, np.abs(z_m - 0.08) < 0.02)] = 0.004
    picture = view.render(dent, pose, AWAY_DEG)
    seen = in_container(view, picture.depth_m, pose)
    middle = (
        (picture.seen == CONTAINER)
        & (np.abs(seen[..., 1]) < 0.012)
        & (np.abs(seen[..., 2]) < 0.01)
        & (seen[..., 0] > 0)
    )
    assert middle.sum() > 50
    np.testing.assert_allclose(seen[middle][:, 0], 0.03 - 0.004, atol=1e-5)


def test_the_table_is_under_the_container_and_a_finger_hides_its_middle() -> None:
    pose = hand_from_container()
    view, still = view_of(BOX, pose)
    picture = view.render(still, pose, TOUCHING_DEG)
    table = in_container(view, picture.depth_m, pose)[picture.seen == TABLE]
    np.testing.assert_allclose(table[:, 2], -0.08, atol=1e-5)
    column, row = np.rint(view.pixels(pose[:3, 3][None] + pose[:3, 0] * 0.052)[0]).astype(int)
    assert picture.seen[row, column] == ROBOT
    assert view.render(still, pose, AWAY_DEG).seen[row, column] == CONTAINER
    # the finger is 22 mm thick, and touches: its outer side is so far from the wall
    assert in_container(view, picture.depth_m, pose)[row, column][0] == pytest.approx(0.052, abs=0.0015)


def test_the_camera_stays_where_the_hand_has_it() -> None:
    for pose in (hand_from_container(), hand_from_container(along_m=0.02, roll_deg=5.0)):
        view, _ = view_of(BOX, pose)
        np.testing.assert_array_equal(view.T_world_camera, view_of(BOX, hand_from_container())[0].T_world_camera)
