"""The tracker finds poses that are known, says which directions it does not see, and refuses what it cannot follow."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer, ModelView
from deformscope.stages.squeeze.patch import around
from deformscope.stages.squeeze.track import PoseEstimate, TrackOptions, locate, track
from tests.stages.squeeze.views import BOX, CAMERA, COLUMN, CYLINDER, PIXELS, SHAPE, looking, moved, squeezed


def error(found: PoseEstimate, true: FloatArray) -> FloatArray:
    """(6,) along the estimate's directions [m]; rotation times its lever."""
    off = np.linalg.inv(found.T_camera_container) @ true
    turn = Rotation.from_matrix(off[:3, :3]).as_rotvec() * found.lever_m
    return np.asarray(found.directions @ np.concatenate([off[:3, 3], turn]))


def exact(model: ContainerModel, pose: FloatArray) -> FloatArray:
    return ModelRenderer(model, CAMERA).render(pose, PIXELS).depth_m


@pytest.mark.parametrize("model", [BOX, CYLINDER], ids=["box", "cylinder"])
@pytest.mark.parametrize("seed", range(6))
def test_a_squeezed_containers_pose_is_found_where_it_is_observed(model: ContainerModel, seed: int) -> None:
    random = np.random.default_rng(seed)
    rest = looking(random.uniform(0.7, 1.1), random.uniform(5.0, 50.0), random.uniform(0.0, 360.0))
    true = moved(rest, random.normal(0.0, 0.004, 3), random.normal(0.0, 2.0, 3))
    seen = squeezed(model, rest, true, random)
    excluded = seen.finger | around(seen.tip_px, SHAPE, 35.0)
    found = track(ModelRenderer(model, CAMERA), seen.depth_m, rest, excluded=excluded)
    assert found.good, found.reason
    assert np.count_nonzero(found.observed) >= 4
    off = np.abs(error(found, true))[found.observed]
    assert off.max() < 0.001  # of translation, and of rotation times its lever: below 1.1 degrees
    assert (off < 5.0 * found.deviation_m[found.observed] + 1e-4).all()


def test_a_cylinders_turn_about_its_axis_is_not_observed_and_stays_as_it_was() -> None:
    rest = looking(0.9, 30.0, 40.0)
    true = moved(rest, np.array([0.003, -0.002, 0.0]), np.array([0.0, 0.0, 20.0]))
    found = track(ModelRenderer(CYLINDER, CAMERA), exact(CYLINDER, true), rest)
    assert found.good, found.reason
    assert np.count_nonzero(~found.observed) == 1
    assert np.abs(found.directions[~found.observed][0])[5] > 0.98
    turned = Rotation.from_matrix(rest[:3, :3].T @ found.T_camera_container[:3, :3]).as_euler("zyx", degrees=True)
    assert abs(turned[0]) < 0.5


def test_a_flat_face_alone_holds_three_directions_and_the_others_keep_the_rest_pose() -> None:
    wall = ContainerModel.box((3.0, 0.02, 3.0))  # its edges are outside of the image
    rest = looking(0.9, 0.0, 90.0)
    true = moved(rest, np.array([0.02, 0.005, -0.03]), np.zeros(3))
    found = track(ModelRenderer(wall, CAMERA), exact(wall, true), rest)
    assert np.count_nonzero(found.observed) == 3
    off = np.linalg.inv(rest) @ found.T_camera_container
    np.testing.assert_allclose(off[:3, 3], [0.0, 0.005, 0.0], atol=2e-4)
    np.testing.assert_allclose(off[:3, :3], np.eye(3), atol=1e-4)


def test_a_cable_before_the_container_moves_nothing() -> None:
    rest = looking(0.9, 25.0, 60.0)
    depth = exact(BOX, rest)
    depth[:, 300:312] = np.where(np.isfinite(depth[:, 300:312]), 0.7, np.nan)
    found = track(ModelRenderer(BOX, CAMERA), depth, rest)
    assert found.good, found.reason
    assert np.abs(error(found, rest)).max() < 2e-4


@pytest.mark.parametrize(
    ("depth", "reason"),
    [
        (np.zeros(SHAPE), "0 pixels of the container seen"),
        (np.full(SHAPE, 2.0), "agree with its model"),
        (np.full(SHAPE, np.nan), "0 pixels of the container seen"),
        (np.where(COLUMN < 310, exact(BOX, looking(0.9, 25.0, 60.0)), 1.6), "agree with its model"),
    ],
    ids=["nothing", "a wall behind", "NaN", "half of it gone"],
)
def test_what_cannot_be_tracked_is_bad_and_says_why(depth: FloatArray, reason: str) -> None:
    found = track(ModelRenderer(BOX, CAMERA), depth, looking(0.9, 25.0, 60.0))
    assert not found.good
    assert reason in found.reason
    assert np.isfinite(found.T_camera_container).all()


def test_a_container_far_from_where_it_rested_is_bad() -> None:
    rest = looking(0.9, 25.0, 60.0)
    true = moved(rest, np.array([0.03, 0.02, 0.02]), np.zeros(3))
    start = moved(rest, np.array([0.028, 0.02, 0.02]), np.zeros(3))
    options = TrackOptions(farthest_m=0.03)
    found = track(ModelRenderer(BOX, CAMERA), exact(BOX, true), start, rest=rest, options=options)
    assert not found.good
    assert "from the rest pose" in found.reason


def test_a_container_is_located_from_a_guess() -> None:
    random = np.random.default_rng(5)
    guess = looking(0.9, 35.0, 60.0)
    true = moved(guess, np.array([0.02, -0.015, 0.0]), np.array([0.0, 0.0, 25.0]))
    seen = squeezed(BOX, guess, true, random, dent_m=0.0)
    found = locate(ModelRenderer(BOX, CAMERA), seen.depth_m, guess, excluded=seen.finger)
    assert found.good, found.reason
    assert np.abs(error(found, true)).max() < 0.001


def test_a_rendering_is_where_geometry_says() -> None:
    view = ModelRenderer(BOX, CAMERA).render(looking(1.0, 0.0, 90.0), np.array([[319.5, 239.5], [0.0, 0.0]]))
    np.testing.assert_allclose(view.depth_m, [1.0 - 0.04, np.nan], atol=1e-14)
    np.testing.assert_allclose(view.normal(np.array([True, False])), [[0.0, 0.0, -1.0]], atol=1e-14)
    round_one = ModelRenderer(CYLINDER, CAMERA).render(looking(1.0, 0.0, 33.0), np.array([[319.5, 239.5]]))
    np.testing.assert_allclose(round_one.depth_m, [1.0 - 0.045], atol=1e-5)


def test_words_of_what_is_wrong() -> None:
    with pytest.raises(InputError, match="three sides above 0 m"):
        ContainerModel.box((0.1, 0.0, 0.1))
    with pytest.raises(InputError, match="a radius and a height above 0 m"):
        ContainerModel.cylinder(0.1, float("nan"))
    with pytest.raises(InputError, match="a mask of its size"):
        track(ModelRenderer(BOX, CAMERA), np.ones(SHAPE), np.eye(4), excluded=np.zeros((3, 3), dtype=bool))


def test_a_full_carton_whose_walls_bulge_is_not_taken_for_one_that_stands_nearer() -> None:
    rest = looking(0.9, 25.0, 60.0)
    renderer = ModelRenderer(BOX, CAMERA)
    view, ray = renderer.render(rest, PIXELS), renderer.rays(PIXELS)
    on = np.isfinite(view.depth_m)
    point = (ray * np.nan_to_num(view.depth_m)[..., None] - rest[:3, 3]) @ rest[:3, :3] / (0.5 * BOX.size_m)
    out = np.where(np.abs(view.outward) > 0.5, 1.0, 1.0 - point**2).prod(axis=-1)  # 0 at edges, 1 in the middle
    side = on & (np.abs(view.outward[..., 2]) < 0.5)  # the lid is flat
    along = np.abs(np.einsum("hwi,hwi->hw", view.outward @ rest[:3, :3].T, ray))
    bulging = view.depth_m - np.where(side, 0.003 * out / np.maximum(along, 0.2), 0.0)
    found = track(renderer, bulging, rest)
    assert found.good, found.reason
    assert np.linalg.norm(found.T_camera_container[:3, 3] - rest[:3, 3]) < 6e-4


def test_rounding_of_the_rendering_moves_a_pose_by_no_more_than_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on another processor: last bits of the model's depths, a lid that is level included, are drawn."""
    true, random = looking(0.9, 35.0, 60.0), np.random.default_rng(0)
    seen = squeezed(BOX, true, moved(true, np.array([0.003, -0.002, 0.001]), np.array([0.5, 0.0, 1.0])), random)
    first = track(ModelRenderer(BOX, CAMERA), seen.depth_m, true, excluded=seen.finger)
    render = ModelRenderer.render

    def rounded(self: ModelRenderer, *given: Any) -> ModelView:
        view = render(self, *given)
        bits = random.integers(-1, 2, view.depth_m.shape)
        return dataclasses.replace(view, depth_m=view.depth_m + bits * np.spacing(view.depth_m))

    monkeypatch.setattr(ModelRenderer, "render", rounded)
    again = track(ModelRenderer(BOX, CAMERA), seen.depth_m, true, excluded=seen.finger)
    assert first.good
    np.testing.assert_allclose(again.T_camera_container, first.T_camera_container, atol=1e-13)
    np.testing.assert_allclose(again.directions, first.directions, atol=1e-9)


def test_directions_have_a_sign_of_their_own() -> None:
    true = looking(0.9, 35.0, 60.0)
    for shift_m in (-0.002, 0.0, 0.002):
        seen = squeezed(BOX, true, moved(true, np.array([shift_m, 0.0, 0.0]), np.zeros(3)), np.random.default_rng(0))
        directions = track(ModelRenderer(BOX, CAMERA), seen.depth_m, true, excluded=seen.finger).directions
        for one in directions:
            assert one[np.flatnonzero(np.abs(one) > 0.3)[0]] > 0.0
