"""The depth change around a fingertip is the dent's, with the thesis's sign, and says what it did not see."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.solid import Capsule
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.see.robot import outside_capsules
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer
from deformscope.stages.squeeze.patch import depth_change, filled, hand_pixels
from tests.stages.squeeze.views import BOX, CAMERA, CYLINDER, NOISE, PIXELS, SHAPE, looking, squeezed

REST = looking(0.95, 10.0, 90.0)


@pytest.mark.parametrize(("model", "seed"), [(BOX, 1), (BOX, 2), (CYLINDER, 3), (CYLINDER, 4)])
@pytest.mark.parametrize("frayed", [0.0, 0.5])
def test_a_known_dent_is_measured_within_the_noise(model: ContainerModel, seed: int, frayed: float) -> None:
    seen = squeezed(model, REST, REST, np.random.default_rng(seed), frayed=frayed)
    renderer = ModelRenderer(model, CAMERA)
    tip = renderer.rays(seen.tip_px) * 0.9

    change = depth_change(renderer, REST, seen.depth_m, tip, excluded=seen.finger, closed_m=0.02)

    left, top = (seen.tip_px - 30).astype(int)
    patch = slice(top, top + 61), slice(left, left + 61)
    wall = np.isfinite(renderer.render(REST, PIXELS[patch]).depth_m)
    true = seen.dent_m[patch]
    measured = np.isfinite(change.change_m)
    off = (change.change_m - true)[measured]
    assert not (measured & ~wall).any()
    assert change.noise_m == pytest.approx(NOISE, rel=0.1)
    assert abs(off.mean()) < 3.0 * NOISE / np.sqrt(off.size)
    assert np.sqrt((off**2).mean()) < 1.5 * NOISE
    assert np.abs(off).max() < 5.0 * change.noise_m
    assert np.abs(filled(change.change_m) - true)[wall].max() < 5.0 * change.noise_m  # also behind the finger
    # beside the container, where nothing is true
    assert np.abs(filled(change.change_m)).max() < 0.01 + 5.0 * change.noise_m
    edge = np.rint(np.linspace(0, 61, 12)).astype(int)
    total, count = (
        np.add.reduceat(np.add.reduceat(one, edge[:-1], axis=0), edge[:-1], axis=1)
        for one in (np.where(measured, true, 0.0), measured.astype(float))
    )
    blocks = count > 0.0
    np.testing.assert_array_equal(np.isfinite(change.small_m), blocks)
    assert (np.abs(change.small_m * count - total)[blocks] < 5.0 * change.noise_m * np.sqrt(count)[blocks]).all()
    assert np.nanmax(change.small_m[count > 15]) == pytest.approx(0.009, abs=0.0015)  # farther: positive
    assert np.isfinite(change.small_filled_m).all()
    assert change.width_m == pytest.approx(61 * 0.91 / 570.0, rel=0.03)
    assert change.missing == pytest.approx(1.0 - measured.mean())
    assert 0.1 < change.missing < 0.5  # the finger above, outlines, gaps, and what is beside the cylinder


def test_what_no_dent_can_be_is_missing_and_does_not_spread() -> None:
    """A pixel, a row of them and a hole, all far behind the model, next to what the finger hides."""
    model = ModelRenderer(BOX, CAMERA).render(REST, PIXELS).depth_m
    hand = np.zeros(SHAPE, dtype=bool)
    hand[200:240, 310:330] = True
    wrong = np.zeros(SHAPE, dtype=bool)
    wrong[240 + 2, 320] = wrong[215, 332] = wrong[250, 300:310] = wrong[255:263, 320:328] = True
    for behind_m in (0.039, 0.025, -0.03):
        depth = np.where(wrong, model + behind_m, model + 0.002)
        found = depth_change(
            ModelRenderer(BOX, CAMERA), REST, depth, np.array([0.0, 0.0, 0.9]), excluded=hand, closed_m=0.01
        )
        assert not np.isfinite(found.change_m[wrong[210:271, 290:351]]).any()
        np.testing.assert_allclose(filled(found.change_m), 0.002, atol=1e-6)
        np.testing.assert_allclose(found.small_filled_m, 0.002, atol=1e-6)


def test_a_wall_is_pressed_in_no_farther_than_the_fingers_closed() -> None:
    model = ModelRenderer(BOX, CAMERA).render(REST, PIXELS).depth_m
    tip = np.array([0.0, 0.0, 0.9])
    for pressed_m, closed_m, seen in ((0.02, 0.02, True), (0.02, 0.0, False), (-0.01, 0.0, True), (-0.04, 0.04, False)):
        depth = model + pressed_m
        if seen:
            found = depth_change(ModelRenderer(BOX, CAMERA), REST, depth, tip, closed_m=closed_m)
            np.testing.assert_allclose(filled(found.change_m), pressed_m, atol=1e-6)
        else:
            with pytest.raises(InputError, match="10% of the container"):
                depth_change(ModelRenderer(BOX, CAMERA), REST, depth, tip, closed_m=closed_m)


def test_missing_values_are_within_those_around_them() -> None:
    values = np.add.outer(np.arange(7.0), 2.0 * np.arange(5.0))
    hollow = values.copy()
    hollow[2:5, 1:4] = np.nan
    np.testing.assert_allclose(filled(hollow), values)
    alone = np.full((4, 6), np.nan)
    alone[1, 2] = 3.0
    np.testing.assert_allclose(filled(alone), 3.0)


def test_blocks_are_means_of_what_was_measured() -> None:
    depth = ModelRenderer(BOX, CAMERA).render(REST, PIXELS).depth_m + 0.004
    excluded = np.zeros(SHAPE, dtype=bool)
    excluded[:239, :] = True
    change = depth_change(ModelRenderer(BOX, CAMERA), REST, depth, np.array([0.0, 0.0, 0.9]), excluded=excluded)
    np.testing.assert_allclose(change.small_m[6:], 0.004, atol=1e-6)
    assert np.isnan(change.small_m[:4]).all()
    np.testing.assert_allclose(change.small_filled_m, 0.004, atol=1e-6)


def test_a_hand_is_found_by_its_links() -> None:
    depth = np.full(SHAPE, 1.0)
    depth[100:200, 300:320] = 0.8
    covered = hand_pixels(depth, CAMERA, [Capsule(np.array([-0.03, -0.2, 0.8]), np.array([0.0, -0.05, 0.8]), 0.03)])
    assert covered[150, 310]
    assert not covered[depth == 1.0].any()


def test_words_of_what_is_wrong() -> None:
    renderer = ModelRenderer(CYLINDER, CAMERA)
    with pytest.raises(InputError, match="a fingertip before the camera"):
        depth_change(renderer, REST, np.ones(SHAPE), np.array([0.0, 0.0, -1.0]))
    with pytest.raises(InputError, match="10% of the container"):
        depth_change(renderer, REST, np.zeros(SHAPE), np.array([0.0, 0.0, 0.9]))


def test_a_links_pixels_are_those_of_its_points_wherever_it_is() -> None:
    random = np.random.default_rng(3)
    row, column = np.mgrid[:120, :160]
    camera = Intrinsics((140.0, 140.0), (79.5, 59.5))
    for _ in range(40):
        depth = random.uniform(0.3, 1.5, (120, 160))
        ends = random.uniform((-0.6, -0.5, 0.2), (0.6, 0.5, 1.4), (2, 3))
        link = Capsule(ends[0], ends[1], random.uniform(0.01, 0.2))
        aside = (np.stack([column, row], axis=-1) - camera.centre_px) / camera.focal_px
        point = np.concatenate([aside, np.ones((120, 160, 1))], axis=-1) * depth[..., None]
        within = ~outside_capsules(point.reshape(-1, 3), [link], margin_m=0.008).reshape(120, 160)
        np.testing.assert_array_equal(hand_pixels(depth, camera, [link]), within)
