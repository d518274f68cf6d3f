"""The camera's view of a pressed foam: the inverse motion, the outline, the noise, and that rendering moves nothing."""

import cv2
import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.see.flow import dense_flow
from studies.reproduce import speckle
from studies.reproduce.pressed_block import Block, PressedBlock, press
from studies.reproduce.speckle import SpeckleMotion, View, film
from studies.reproduce.virtual_foams import FOAMS

BLOCK, CLAMP_M = Block(0.12, 0.04, 0.1), 0.02
VIEW = View(width=300, height=240, middle_px=150.0, top_px=29.5, px_per_m=4500.0)
GROUND_PX = 29.5 + 0.04 * 4500


@pytest.fixture(scope="module")
def pose() -> PressedBlock:
    return press(FOAMS[2].law(), BLOCK, CLAMP_M, [0.004, 0.008], 0.008)[-1]


def even(shift_m: float, strain: float) -> PressedBlock:
    """A made-up pose: all moves by `shift_m` to the right and is pressed by `strain`."""

    def interpolate(rest: FloatArray) -> FloatArray:
        return np.column_stack([np.full(len(rest), shift_m), -strain * rest[:, 1]])

    class Even(PressedBlock):
        def at(self, rest: FloatArray) -> FloatArray:
            return interpolate(rest)

    nothing = np.empty((0, 2))
    return Even(strain * BLOCK.height_m, 0.0, 0.0, nothing, nothing, interpolate)


def inside(count: int) -> FloatArray:
    return np.random.default_rng(1).uniform((10, 40), (290, 200), (count, 2))


def test_motion_is_the_finite_elements(pose: PressedBlock) -> None:
    place = inside(200)
    moved = SpeckleMotion(pose, BLOCK, VIEW).displacement(place)
    truth = pose.at(VIEW.in_metres(place, BLOCK)) * VIEW.px_per_m * [1, -1]
    np.testing.assert_allclose(moved, truth, atol=0.1)  # px; the spline rounds the elements' kinks
    assert np.sqrt(np.mean((moved - truth) ** 2)) < 0.02


def test_what_is_seen_is_traced_back_to_where_it_was(pose: PressedBlock) -> None:
    motion, place = SpeckleMotion(pose, BLOCK, VIEW), inside(2000)
    np.testing.assert_allclose(motion.rest_of(place + motion.displacement(place), place.copy()), place, atol=2e-3)


def test_foam_at_rest_lies_between_ground_and_clamp() -> None:
    mask = film([], BLOCK, CLAMP_M, VIEW).mask
    rows = np.flatnonzero(mask.all(axis=1))
    assert (rows[0], rows[-1]) == (30, 209)
    assert not mask[:30].any()
    assert not mask[210:].any()


def test_rendering_moves_nothing_but_what_moves() -> None:
    shift, strain = 3.37, 0.04
    one, two = film([even(shift / VIEW.px_per_m, strain)], BLOCK, CLAMP_M, VIEW, noise=0.0, seed=3).images()
    flow = dense_flow(one, two).flow_px[60:190, 30:-30]
    y, _ = np.mgrid[60:190, 30:270]
    off = flow - np.stack([np.full(y.shape, shift), strain * (GROUND_PX - y)], axis=-1)
    assert np.abs(off.reshape(-1, 2).mean(axis=0)).max() < 0.005
    assert np.sqrt(np.mean(off**2)) < 0.02


def test_outline_covers_the_share_of_a_pixel_that_it_covers() -> None:
    left, top, right, bottom = 99.75, 49.5, 120.0, 60.125
    share = speckle._covered(np.array([[left, top], [right, top], [right, bottom], [left, bottom]]), VIEW)
    x, y = (np.arange(size) for size in (VIEW.width, VIEW.height))
    along = np.clip(np.minimum(x + 0.5, right) - np.maximum(x - 0.5, left), 0, 1)
    down = np.clip(np.minimum(y + 0.5, bottom) - np.maximum(y - 0.5, top), 0, 1)
    np.testing.assert_allclose(share, down[:, None] * along, atol=1.5 / speckle.EDGE_FINENESS)
    assert share.sum() == pytest.approx((right - left) * (bottom - top), rel=0.02)


def test_noise_is_as_large_as_said_and_new_in_each_image() -> None:
    still = even(0.0, 1e-9)
    clean, noisy = (list(film([still], BLOCK, CLAMP_M, VIEW, noise=n, seed=5).images()) for n in (0.0, 3.0))
    added = [noisy[i].astype(float) - clean[i] for i in range(2)]
    assert [np.std(one) for one in added] == pytest.approx([3.0, 3.0], rel=0.03)
    assert abs(np.corrcoef(added[0].ravel(), added[1].ravel())[0, 1]) < 0.02


def test_seed_decides_the_images() -> None:
    one, same, other = (next(film([], BLOCK, CLAMP_M, VIEW, seed=s).images()) for s in (1, 1, 2))
    assert np.array_equal(one, same)
    assert np.corrcoef(one[60:190].ravel(), other[60:190].ravel())[0, 1] < 0.1


def test_clamp_stands_on_the_foam_without_a_gap(pose: PressedBlock) -> None:
    still, pushed = film([pose], BLOCK, CLAMP_M, VIEW, noise=0.0).images()
    bottom = 29.5 + 0.008 * 4500
    below = pushed[int(bottom) + 3 : int(bottom) + 40, 130:170].astype(float)
    above = pushed[: int(bottom) - 2, 130:170].astype(float)
    edge = cv2.blur(pushed, (9, 1))[int(bottom) - 1 : int(bottom) + 2, 140:160]
    assert above.mean() > 170 > below.mean() > 110
    assert edge.min() > 60  # what stands behind is darker
    assert still[10, 20] < 100
