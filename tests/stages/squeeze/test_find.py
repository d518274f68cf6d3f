"""A container of known pose, found in rendered depth; and what is not one, refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.container_shell import BOX, CYLINDER, ContainerShape, shell_of
from deformscope.lab.container_view import ContainerView
from deformscope.lab.ray_camera import DepthViewConfig, looking_at
from deformscope.stages.see.cloud import Intrinsics, back_project
from deformscope.stages.squeeze.find import ContainerHidden, compare, find_container, matches
from studies.kinect import NOISE_PER_M, observed_m
from tests.cases import slow

CAMERA = looking_at(np.array([0.0, 0.0, 0.08]), 1.0, 35.0, -70.0)


def pose(x_m: float, y_m: float, yaw_deg: float, shape: ContainerShape) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    T[:3, 3] = x_m, y_m, shape.half_m[2]
    return T


def points(shape: ContainerShape, T: FloatArray, seed: int, noise: float = 1.0) -> FloatArray:
    """What a camera 1 m away makes of it: three images' median, with `noise` times a Kinect's."""
    config = DepthViewConfig()
    shell = shell_of(shape)
    view = ContainerView(shape, (shell.s_m, shell.z_m), pose(0.0, 0.0, 0.0, shape), config, CAMERA)
    exact = view.render(np.zeros((len(shell.s_m), len(shell.z_m))), T, np.zeros(7), ())
    random = np.random.default_rng(seed)
    depth = np.median([observed_m(exact, random, noise * NOISE_PER_M) for _ in range(3)], axis=0)
    lens = view.intrinsics
    return back_project(depth, Intrinsics((lens.fx_px, lens.fy_px), (lens.cx_px, lens.cy_px)), CAMERA)


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
@pytest.mark.parametrize("noise", [slow(1.0), 2.0])
def test_its_place_and_size_are_found_within_what_is_claimed(shape: ContainerShape, noise: float) -> None:
    random = np.random.default_rng(5)
    size = tuple(2.0 * side for side in shape.half_m)
    for seed in range(6):
        T = pose(*random.uniform(-0.08, 0.08, 2), random.uniform(-180.0, 180.0), shape)
        found = matches(find_container(points(shape, T, seed, noise), shape.kind), size)
        assert (np.abs(found.center_m - T[:3, 3]) < 4.0 * np.append(found.deviation_m[:2], 1e-3)).all()
        assert found.deviation_m[:2].max() < 0.002
        np.testing.assert_allclose(found.size_m, size, atol=0.003)
        assert np.linalg.norm(found.lean_rad) < 0.03
        if shape.kind == "box":
            turned = np.radians(Rotation.from_matrix(T[:3, :3]).as_euler("zyx", degrees=True)[0]) - found.yaw_rad
            assert abs((turned + np.pi / 2) % np.pi - np.pi / 2) < 0.02


def test_nothing_and_two_things_are_refused_with_the_reason() -> None:
    one, other = (points(BOX, pose(x, 0.0, 20.0, BOX), 0) for x in (-0.15, 0.15))
    empty = one[one[:, 2] < 0.01]
    with pytest.raises(InputError, match="one container on the table; got nothing that is 4 cm high"):
        find_container(empty, "box")
    with pytest.raises(InputError, match="got 2 things, at"):
        find_container(np.concatenate([one, other]), "box")


def test_another_shape_and_another_size_are_refused() -> None:
    seen = points(BOX, pose(0.0, 0.0, 0.0, BOX), 0)
    with pytest.raises(InputError, match="an upright cylinder"):
        find_container(seen, "cylinder")
    with pytest.raises(InputError, match="an upright box"):
        find_container(points(CYLINDER, pose(0.0, 0.0, 0.0, CYLINDER), 0), "box")
    with pytest.raises(InputError, match=r"60 x 120 x 160 mm; got one of 60 x (89|90) x 160 mm"):
        matches(find_container(seen, "box"), (0.06, 0.12, 0.16))


@pytest.mark.parametrize("shape", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_one_that_stands_moved_or_toppled_is_told(shape: ContainerShape) -> None:
    before = find_container(points(shape, pose(0.02, -0.03, 10.0, shape), 1), shape.kind)
    again = find_container(points(shape, pose(0.02, -0.03, 10.0, shape), 2), shape.kind)
    assert compare(before, again).kind == "stands"
    pushed = compare(before, find_container(points(shape, pose(0.02, -0.018, 10.0, shape), 3), shape.kind))
    assert pushed.kind == "moved"
    assert pushed.moved_m == pytest.approx(0.012, abs=0.001)
    lying = pose(0.02, -0.03, 10.0, shape)
    lying[:3, :3] = lying[:3, :3] @ Rotation.from_euler("x", 90.0, degrees=True).as_matrix()
    lying[2, 3] = shape.half_m[1]
    try:
        fallen = compare(before, find_container(points(shape, lying, 4), shape.kind))
    except InputError as error:
        fallen = compare(before, error)
    assert fallen.kind in ("toppled", "gone")


def test_half_hidden_it_is_found_near_where_it_was_and_too_little_of_it_is_not_known() -> None:
    T = pose(0.0, 0.0, 0.0, BOX)
    before = find_container(points(BOX, T, 1), "box")
    later = points(BOX, T, 2)
    hidden = later[~((np.abs(later[:, 2] - 0.08) < 0.03) & (later[:, 2] > 0.015))]
    assert compare(before, find_container(hidden, "box", expected=before)).kind == "stands"
    with pytest.raises(ContainerHidden) as refused:
        find_container(later[later[:, 2] < 0.02], "box", expected=before)
    assert compare(before, refused.value).kind == "hidden"


def test_one_that_lies_is_told_where_only_its_upper_side_is_seen() -> None:
    """A camera along its longest edge sees no side of it; upright, with its sides hidden, it is not known."""
    before = find_container(points(BOX, pose(0.02, -0.03, 10.0, BOX), 1), "box")
    lying = pose(0.02, -0.03, 10.0, BOX)
    lying[:3, :3] = lying[:3, :3] @ Rotation.from_euler("x", 90.0, degrees=True).as_matrix()
    lying[2, 3] = BOX.half_m[1]
    for T, kind in ((lying, "gone"), (pose(0.02, -0.03, 10.0, BOX), "hidden")):
        seen = points(BOX, T, 4)
        upper = seen[(seen[:, 2] < 0.01) | (seen[:, 2] > seen[:, 2].max() - 0.012)]
        for expected in (None, before):
            with pytest.raises(ContainerHidden) as refused:
                find_container(upper, "box", expected=expected)
            assert compare(before, refused.value).kind == kind


def test_a_box_turned_about_its_middle_is_told() -> None:
    size = tuple(2.0 * side for side in BOX.half_m)
    seen = [points(BOX, pose(0.0, 0.0, turn_deg, BOX), 1) for turn_deg in (0.0, 12.0)]
    change = compare(*(matches(find_container(one, "box"), size) for one in seen))
    assert change.kind == "moved"
    assert np.degrees(change.turned_rad) == pytest.approx(12.0, abs=1.0)
