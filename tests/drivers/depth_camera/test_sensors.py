"""What cameras that triangulate get wrong, beside the published figures."""

import dataclasses

import numpy as np
import pytest

from deformscope_drivers.depth_camera.synthetic import PRIMESENSE, REALSENSE, TriangulatingSensor

LENS_PX = 285.0  # 320 pixels wide
EXACT = TriangulatingSensor(580.0, 0.075, 1e-9, 0.0, bleeding=0)


def seen(sensor: TriangulatingSensor, depth_m: np.ndarray, seed: int = 5) -> np.ndarray:
    return sensor.measure(depth_m, LENS_PX, np.random.default_rng(seed))


@pytest.mark.parametrize("depth_m", [0.6, 1.0, 2.0, 4.0])
def test_a_primesenses_depth_comes_in_the_steps_that_were_measured(depth_m: float) -> None:
    """2.85e-5 z^2 [cm] (Khoshelham and Oude Elberink 2012: 7 cm at 5 m), on a surface aslant."""
    slope = np.linspace(0.98, 1.02, 320) * np.ones((20, 1)) * depth_m
    steps = np.diff(np.unique(seen(dataclasses.replace(PRIMESENSE, noise_px=0.0, bleeding=0), slope)))
    assert len(steps) > 2
    assert np.median(steps) == pytest.approx(2.85e-3 * depth_m**2, rel=0.03)
    assert PRIMESENSE.step_m(5.0) == pytest.approx(0.07, abs=0.003)


@pytest.mark.parametrize("depth_m", [1.003, 2.03])
def test_a_primesense_deviates_by_half_a_step(depth_m: float) -> None:
    """1.425e-5 z^2 [cm], what the same paper finds; averaged over where the steps fall."""
    aslant = depth_m * np.linspace(0.97, 1.03, 240)[:, None] * np.ones((1, 320))
    error = (seen(PRIMESENSE, aslant) - aslant) / aslant**2
    assert error.std() == pytest.approx(1.425e-3, rel=0.05)


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 2.0])
def test_a_realsense_deviates_by_its_makers_formula(depth_m: float) -> None:
    """RMS = z^2 subpixel / (focal length baseline), in mm as published: 0.08 px, 427 px, 50 mm."""
    error_mm = 1e3 * (seen(REALSENSE, np.full((240, 320), depth_m)) - depth_m)
    assert np.sqrt((error_mm**2).mean()) == pytest.approx((1e3 * depth_m) ** 2 * 0.08 / (427 * 50), rel=0.06)


def test_the_shadow_beside_an_edge_is_as_wide_as_disparities_differ() -> None:
    """A plate at 0.6 m before a wall at 0.9 m: 285 px * 75 mm * (1/0.6 - 1/0.9) = 11.9 px, on one side of it alone."""
    scene = np.full((8, 320), 0.9)
    scene[:, 120:200] = 0.6
    missing = seen(EXACT, scene) == 0.0
    columns = np.flatnonzero(missing[4])
    assert len(columns) in (11, 12)
    assert columns[-1] == 119
    assert (np.diff(columns) == 1).all()


def test_pixels_fly_between_two_surfaces_or_take_one_of_them() -> None:
    scene = np.full((60, 320), 0.9)
    scene[:, 120:200] = 0.6
    near, far = 0.6, 0.9
    between = {}
    for sensor in (PRIMESENSE, REALSENSE):
        found = seen(dataclasses.replace(sensor, noise_px=0.0), scene)
        found = found[found > 0.0]
        between[sensor] = ((found > near + 0.02) & (found < far - 0.02)).sum()
        assert (np.abs(seen(sensor, scene)[:, 140:180] - near) < 0.02).all()  # away from edges nothing flies
    assert between[PRIMESENSE] == 0
    assert 20 < between[REALSENSE] < 60 * 8


def test_edges_are_ragged() -> None:
    """The plate's border moves by up to what bleeds, to either side."""
    scene = np.full((200, 320), 0.9)
    scene[:, 120:200] = 0.6
    found = seen(dataclasses.replace(PRIMESENSE, noise_px=0.0), scene)
    wide = ((found > 0.0) & (found < 0.7)).sum(axis=1)
    assert 76 <= wide.min() < 80 < wide.max() <= 84


@pytest.mark.parametrize(("flat_deg", "there"), [(9.0, False), (15.0, True)])
def test_surfaces_seen_flat_have_no_depth(flat_deg: float, there: bool) -> None:
    """A floor that goes away from the camera: z = h / (row tan)."""
    angle = np.deg2rad(flat_deg)
    across = (np.arange(100) - 50) / LENS_PX
    floor = (np.sin(angle) / (np.sin(angle) - across * np.cos(angle)))[:, None] * np.ones((1, 64))
    found = seen(EXACT, floor)
    assert (found[48:52] > 0.0).all() == there
    assert (found[48:52] > 0.0).any() == there


def test_nothing_stays_nothing() -> None:
    scene = np.full((20, 30), np.nan)
    scene[5:10, 5:10] = 1.0
    assert not seen(REALSENSE, scene)[np.isnan(scene)].any()
