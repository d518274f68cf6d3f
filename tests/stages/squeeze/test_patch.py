"""The depth change around a fingertip is the dent's, with the thesis's sign, and says what it did not see."""

from __future__ import annotations

import numpy as np
import pytest

from deformscope.capsule import Capsule
from deformscope.errors import InputError
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.see.robot import beside_capsules
from deformscope.stages.squeeze.container import ModelRenderer
from deformscope.stages.squeeze.patch import depth_change, hand_pixels
from tests.stages.squeeze.views import BOX, CAMERA, CYLINDER, NOISE, PIXELS, SHAPE, looking, squeezed

REST = looking(0.95, 10.0, 90.0)


def test_a_known_dent_is_measured_within_the_noise() -> None:
    seen = squeezed(BOX, REST, REST, np.random.default_rng(1))
    renderer = ModelRenderer(BOX, CAMERA)
    tip = renderer.rays(seen.tip_px) * 0.9

    change = depth_change(renderer, REST, seen.depth_m, tip, excluded=seen.finger)

    left, top = (seen.tip_px - 30).astype(int)
    true = seen.dent_m[top : top + 61, left : left + 61]
    measured = np.isfinite(change.change_m)
    off = (change.change_m - true)[measured]
    assert abs(off.mean()) < 3.0 * NOISE / np.sqrt(off.size)
    assert np.sqrt((off**2).mean()) < 1.5 * NOISE
    assert np.nanmax(change.small_m) == pytest.approx(0.009, abs=0.0015)  # farther than the model: positive
    assert change.width_m == pytest.approx(61 * 0.91 / 570.0, rel=0.02)
    assert change.missing == pytest.approx(1.0 - measured.mean())
    assert 0.1 < change.missing < 0.3  # the finger above, and gaps
    assert change.filled_m.shape == (3721,)
    assert np.isfinite(change.filled_m).all()
    assert change.small_filled_m.shape == (121,)
    assert np.isfinite(change.small_filled_m).all()


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
    finger = Capsule(np.array([-0.03, -0.2, 0.8]), np.array([0.0, -0.05, 0.8]), 0.03)

    covered = hand_pixels(depth, CAMERA, [finger])

    assert covered[150, 310]
    assert not covered[depth == 1.0].any()


def test_words_of_what_is_wrong() -> None:
    renderer = ModelRenderer(CYLINDER, CAMERA)
    with pytest.raises(InputError, match="a fingertip before the camera"):
        depth_change(renderer, REST, np.ones(SHAPE), np.array([0.0, 0.0, -1.0]))
    with pytest.raises(InputError, match="no pixel of it"):
        depth_change(renderer, REST, np.zeros(SHAPE), np.array([0.0, 0.0, 0.9]))
    with pytest.raises(InputError, match="an odd number"):
        depth_change(renderer, REST, np.ones(SHAPE), np.array([0.0, 0.0, 0.9]), side_px=60)


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
        within = ~beside_capsules(point.reshape(-1, 3), [link], margin_m=0.008).reshape(120, 160)

        np.testing.assert_array_equal(hand_pixels(depth, camera, [link]), within)
