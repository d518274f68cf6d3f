"""Flow at a reduced size, against motion that is known in pixels of the whole image."""

import cv2
import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.stages.see.arrows import flow_arrows, region_of
from deformscope.stages.see.particles import Rect


def texture(height: int = 240, width: int = 320) -> np.ndarray:
    grains = np.random.default_rng(0).random((height // 4 + 8, width // 4 + 8)).astype(np.float32)
    smooth = cv2.resize(grains, (width + 32, height + 32), interpolation=cv2.INTER_CUBIC)
    return np.clip(40 + 180 * smooth, 0, 255).astype(np.uint8)


def test_arrows_are_the_motion_in_pixels_of_the_whole_image() -> None:
    large = texture()
    before, after = large[10:250, 12:332], large[6:246, 6:326]  # moves by (6, 4) px
    found = flow_arrows(before, after, Rect(40, 30, 240, 180), longest_px=120)
    inner = (found.at_px > (60, 50)).all(axis=1) & (found.at_px < (250, 180)).all(axis=1)
    np.testing.assert_allclose(found.flow_px[inner], np.tile([6.0, 4.0], (inner.sum(), 1)), atol=0.25)
    assert inner.sum() > 300
    assert (found.at_px >= (40, 30)).all()
    assert (found.at_px <= (280, 210)).all()


def test_a_region_keeps_its_places() -> None:
    image = np.zeros((200, 300), np.uint8)
    image[80:90, 140:150] = 255  # its middle is at (144.5, 84.5)
    region = region_of(image, Rect(100, 40, 160, 120), longest_px=80)
    row, column = np.nonzero(region.image > 200)
    middle = np.array([[column.mean(), row.mean()]])
    assert region.image.shape == (60, 80)
    np.testing.assert_allclose(region.whole(middle), [[144.5, 84.5]])
    np.testing.assert_allclose(region.inside(region.whole(middle)), middle)


def test_a_small_image_is_not_enlarged_and_a_region_beside_it_is_refused() -> None:
    image = np.zeros((40, 60), np.uint8)
    assert region_of(image).scale == 1.0
    with pytest.raises(InputError, match="region of 16 px or more"):
        region_of(image, Rect(100, 100, 50, 50))
