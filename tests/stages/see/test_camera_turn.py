"""The turn of a camera, by what lies around a body that moves otherwise."""

import cv2
import numpy as np
import pytest

from deformscope.stages.see.camera_turn import CameraTurn
from deformscope.stages.see.flow import Image
from deformscope.stages.see.particles import ParticleGrid, Rect, seed_grid

SIZE = (240, 320)
GRID = seed_grid(SIZE, Rect(90, 70, 140, 100), (5, 7), None, None)


def pattern(seed: int) -> Image:
    drawn = np.random.default_rng(seed).standard_normal((300, 400))
    return np.asarray(128.0 + 250.0 * cv2.GaussianBlur(drawn, (0, 0), 2.0))[30:270, 40:360]


def picture(turn: float, shift: tuple[float, float] = (0.0, 0.0), *, body: float = 0.0, hand: float = 0.0) -> Image:
    """A wall seen by a camera that turns and shifts. body: shift of the body in front of it; hand: of what covers a
    third of the picture"""
    wall, mine, other = (pattern(seed) for seed in range(3))
    wall[70:170, 90:230] = np.roll(mine, round(body), axis=0)[70:170, 90:230]
    wall[:, :60] = np.roll(other, round(hand), axis=0)[:, :60]
    c, s = np.cos(turn), np.sin(turn)
    middle = np.array([160.0, 120.0])
    place = np.column_stack([[[c, -s], [s, c]], middle + shift - [[c, -s], [s, c]] @ middle])
    seen = cv2.warpAffine(wall, place, SIZE[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip(seen, 0, 255).astype(np.uint8)


def turn_to(first: Image, after: Image, grid: ParticleGrid = GRID) -> float:
    camera = CameraTurn(first, grid)
    camera.look(after)
    return float(camera.turns()[1])


@pytest.mark.parametrize("turn", [-0.02, 0.002, 0.01])
def test_the_turn_is_that_of_the_surroundings(turn: float) -> None:
    camera = CameraTurn(picture(0.0), GRID)
    shares = np.array([0.0, 0.3, 1.0])  # of one image after another
    for share in shares[1:]:
        camera.look(picture(share * turn, (3.0 * share, -2.0), body=9.0 * share, hand=6.0 * share))
    assert camera.turns() == pytest.approx(shares * turn, abs=6e-4)  # a tenth of a pixel at the picture's edge


def test_light_and_depth_of_grey_do_not_matter() -> None:
    first = picture(0.0).astype(np.uint16) * 100
    colour = np.stack([first] * 3, axis=-1)
    after = np.stack([picture(0.005).astype(np.uint16) * 85] * 3, axis=-1)
    assert turn_to(colour, after) == pytest.approx(0.005, abs=6e-4)


def test_without_surroundings_the_turn_is_not_known() -> None:
    plain = np.full(SIZE, 120, dtype=np.uint8)
    assert np.isnan(turn_to(plain, plain))
    wide = seed_grid(SIZE, Rect(0, 0, 320, 240), (6, 8), None, None)
    assert np.isnan(turn_to(picture(0.0), picture(0.01), wide))
    noise = np.random.default_rng(9).integers(0, 255, SIZE).astype(np.uint8)
    assert np.isnan(turn_to(picture(0.0), noise))
