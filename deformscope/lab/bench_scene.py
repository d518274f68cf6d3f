"""Scene of the bench's doubles: a block of foam that a stick presses from time to time, the same for all doubles."""

import math
from functools import cache, lru_cache

import cv2
import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope_drivers.depth_camera import View
from deformscope_drivers.webcam.synthetic import Picture

PRESS_PERIOD_S, PRESS_S, PRESS_N = 4.0, 1.5, 6.0
HEIGHT_PX, WIDTH_PX = 480, 640
TABLE_M, FOAM_M = 0.60, 0.52
"""Distances from the camera."""
DENT_M, DENT_PX = 0.025, 60.0
STICK_PX, STICK_M = 14, 0.10
FOAM_PX = (80, 400, 120, 520)
"""Top, bottom, left, right of the foam in the picture."""
FOAM_RGB, TABLE_RGB = (235, 205, 90), (120, 122, 126)
MIDDLE_PX = (240.0, 330.0)
PLATE_PX, STROKE_PX, BULGE = 70.0, 40.0, 0.5
"""From the side: the lower edge of the plate at rest, its press depth, and the foam's widening in its middle per share
of shortening; plate and table hold its ends."""
PLATE_RGB = (95, 98, 110)


def pressed(time_s: float) -> float:
    """How far the stick is down, 0 to 1: it moves down and up for 1.5 s out of every 4 s."""
    phase = time_s % PRESS_PERIOD_S / PRESS_S
    return math.sin(math.pi * phase) ** 2 if phase < 1.0 else 0.0


def loads(time_s: float) -> tuple[float, float, float]:
    """Loads on the stick's tip [N], up to 6 N, dragged a little sideways."""
    normal = PRESS_N * pressed(time_s)
    return 0.15 * normal * math.sin(math.pi * (time_s % PRESS_PERIOD_S)), 0.1 * normal, normal


def view(time_s: float) -> View:
    """Scene of a depth camera."""
    return View(distances(time_s), picture(time_s))


def distances(time_s: float) -> FloatArray:
    """(480, 640) distances from the camera [m]: a table, the foam on it, the dent, the stick."""
    share = pressed(time_s)
    seen = _background() + np.float32(DENT_M * share) * _dent()
    lift = 0.04 * (1.0 - share)
    seen[_stick()] = FOAM_M + DENT_M * share - STICK_M - lift
    return seen


def picture(time_s: float) -> Picture:
    """(480, 640, 3) colour picture of the scene, RGB."""
    return _picture(pressed(time_s))


@lru_cache(maxsize=1)
def _picture(share: float) -> Picture:
    """share: how far the stick has gone, 0 to 1"""
    shade = 1.0 - 0.45 * share * _dent()
    seen = (_texture() * shade[..., None]).astype(np.uint8)
    seen[_stick()] = (60, 60, 70)
    return seen


def side(time_s: float) -> Picture:
    """(480, 640, 3) view of a camera at the foam's side, RGB: a plate presses it from above, every speck moves with the
    material."""
    way_px = STROKE_PX * pressed(time_s)
    if way_px == 0.0:
        return _side_texture()
    strain = way_px / (HEIGHT_PX - PLATE_PX)
    row = np.arange(HEIGHT_PX, dtype=np.float32)[:, None]
    y = np.where(row < PLATE_PX + way_px, row - way_px, HEIGHT_PX - (HEIGHT_PX - row) / (1.0 - strain))
    wider = 1.0 + BULGE * strain * np.sin(np.pi * np.clip((y - PLATE_PX) / (HEIGHT_PX - PLATE_PX), 0.0, 1.0))
    x = WIDTH_PX / 2 + (np.arange(WIDTH_PX) - WIDTH_PX / 2) / wider
    y = np.broadcast_to(y, x.shape)
    seen: Picture = cv2.remap(  # type: ignore[assignment]
        _side_texture(), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    return seen


@cache
def _side_texture() -> Picture:
    """The plate above the foam, both with specks."""
    plate = (_grid()[0] < PLATE_PX)[..., None]
    colours = np.where(plate, np.array(PLATE_RGB, np.float32), np.array(FOAM_RGB, np.float32))
    return (colours * _light()).astype(np.uint8)


@cache
def _light() -> FloatArray:
    """(480, 640, 1) specks of 4 x 4 px, up to a quarter darker."""
    grains = np.random.default_rng(0).random((HEIGHT_PX // 4, WIDTH_PX // 4)).repeat(4, 0).repeat(4, 1)
    light: FloatArray = (0.75 + 0.25 * grains)[..., None].astype(np.float32)
    return light


@cache
def _grid() -> tuple[FloatArray, FloatArray]:
    """(480, 640) row and (480, 640) column of every pixel."""
    rows, columns = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float32)
    return rows, columns


@cache
def _foam() -> BoolArray:
    """(480, 640) pixels that show foam."""
    rows, columns = _grid()
    top, bottom, left, right = FOAM_PX
    return (rows > top) & (rows < bottom) & (columns > left) & (columns < right)


@cache
def _dent() -> FloatArray:
    """(h, w) depth of the dent at each pixel, as a share of the deepest, 0 to 1."""
    rows, columns = _grid()
    away = np.hypot(rows - MIDDLE_PX[0], columns - MIDDLE_PX[1])
    dent: FloatArray = (np.exp(-away / DENT_PX) * _foam()).astype(np.float32)
    return dent


@cache
def _stick() -> BoolArray:
    """(480, 640) pixels that show the stick."""
    rows, columns = _grid()
    stick: BoolArray = np.hypot(rows - MIDDLE_PX[0], columns - MIDDLE_PX[1]) < STICK_PX
    return stick


@cache
def _background() -> FloatArray:
    """(480, 640) distance of foam and table [m]."""
    return np.where(_foam(), FOAM_M, TABLE_M).astype(np.float32)


@cache
def _texture() -> FloatArray:
    """(h, w, 3) RGB of yellow foam with dark specks on a grey table."""
    colours = np.where(_foam()[..., None], np.array(FOAM_RGB, np.float32), np.array(TABLE_RGB, np.float32))
    texture: FloatArray = (colours * _light()).astype(np.float32)
    return texture
