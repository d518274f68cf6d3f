"""Rendered videos: their mechanics, their pictures and their readings are what they say."""

import dataclasses
import json
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
from scipy import ndimage
from scipy.optimize import brentq

from studies.independent import plane_elements
from studies.independent.large_strain import Law, Motion, Sheet
from studies.rendered_video import (
    HOLDINGS,
    SCALE,
    LogCase,
    Scene,
    VideoCase,
    camera_path,
    case,
    followed,
    pressed,
    px_per_m,
    render,
    write,
)
from tests.cases import slow

SMALL = {"width_px": 320, "height_px": 240, "frames": 6, "rest": 2, "ramp": 4}
CLEAN = {"shadow": 0.0, "flicker": 0.0, "noise": 0.0, "hand": False}


def plates(sheet: Sheet, *, slip: bool) -> np.ndarray:
    """Prescribed components: both ends along y, and with slip the middle line alone along x."""
    fixed = np.zeros((*sheet.shape, 2), dtype=bool)
    fixed[:, [0, -1], 1] = True
    fixed[sheet.shape[0] // 2 if slip else slice(None), [0, -1], 0] = True
    return fixed


@pytest.mark.parametrize("law", get_args(Law))
def test_small_deformations_are_those_of_hooke(law: Law) -> None:
    side, modulus, nu, push = 0.08, 40e3, 0.3, 1e-7
    lines = np.linspace(0.0, side, 5)
    sheet = Sheet(lines, lines, modulus, nu, law)
    fixed = plates(sheet, slip=False)
    target = np.zeros(fixed.shape)
    target[:, -1, 1] = -push
    (motion,), (force,) = sheet.deform(fixed, [target])
    shape = (5, 5)
    ends = np.flatnonzero(np.isin(np.tile(np.arange(5), 5), [0, 4]))
    moved = np.zeros((25, 2))
    moved[4::5, 1] = -push
    linear = plane_elements.deform(shape, 0.02, plane_elements.stiffness(1.0, nu), ends, moved[ends])
    np.testing.assert_allclose(motion.moved[::2, ::2].reshape(-1, 2), linear, atol=1e-5 * push)
    assert -force[:, -1, 1].sum() == pytest.approx(force[:, 0, 1].sum())


@pytest.mark.parametrize("law", get_args(Law))
@pytest.mark.parametrize("nu", [0.0, 0.25, 0.45])
def test_a_deep_push_between_plates_that_slip_is_the_closed_form(nu: float, law: Law) -> None:
    width, height, modulus, pressed = 0.06, 0.04, 25e3, 0.8
    sheet = Sheet(np.linspace(0.0, width, 4), np.linspace(0.0, height, 3), modulus, nu, law)
    fixed = plates(sheet, slip=True)
    target = np.zeros(fixed.shape)
    target[:, -1, 1] = (pressed - 1.0) * height
    (motion,), (force,) = sheet.deform(fixed, [target])
    mu, lam = modulus / (2 + 2 * nu), modulus * nu / ((1 + nu) * (1 - 2 * nu))
    if law == "neo-hooke":
        wide = brentq(lambda wide: mu * (wide**2 - 1.0) + lam * np.log(pressed * wide**2), 0.5, 3.0)
        stress = mu * (pressed - 1.0 / pressed) + lam * np.log(pressed * wide**2) / pressed
    else:
        green = 0.5 * (pressed**2 - 1.0)
        wide, stress = np.sqrt(1.0 - 2.0 * nu * green), pressed * modulus * green
    assert force[:, -1, 1].sum() == pytest.approx(stress * width)
    assert np.ptp(motion.moved[:, -1, 0]) == pytest.approx((wide - 1.0) * width)


def test_the_place_at_rest_of_a_moved_point_is_found_again() -> None:
    lines = np.linspace(0.0, 0.1, 7)
    sheet = Sheet(lines, lines, 20e3, 0.4)
    fixed = np.zeros((*sheet.shape, 2), dtype=bool)
    fixed[:, 0] = fixed[4:9, -1] = True
    target = np.zeros(fixed.shape)
    target[4:9, -1, 1] = -0.015
    motion = sheet.deform(fixed, [0.5 * target, target])[0][-1]
    rest = np.random.default_rng(0).uniform(0.001, 0.099, (500, 2))
    seen = rest + motion.at(rest)[0]
    np.testing.assert_allclose(motion.rest_of(seen, seen, 1e-10), rest, atol=1e-8)


@pytest.mark.slow
def test_between_the_balanced_depths_a_block_moves_as_the_elements_do() -> None:
    made = VideoCase(0, push=0.2)
    deepest = 0.2 * made.size_m[1]
    motions, force = pressed(made, deepest * np.array([0.31, 1.0]))
    direct, alone = pressed(made, deepest * np.array([0.31]))
    assert np.abs(motions[0].moved - direct[0].moved).max() * px_per_m(made) < 1e-3
    assert force[0] == pytest.approx(alone[0], rel=1e-4)


def misplaced(before: np.ndarray, after: np.ndarray, place: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(k, 2) how far the surroundings (21 x 21 px) of each place in the first image are from where they are expected in
    the second [px], by least squares. place, expected: (k, 441, 2)"""
    spline = ndimage.spline_filter(after)
    there = [
        ndimage.map_coordinates(spline, expected[..., ::-1].T + np.array(off)[:, None, None], prefilter=False)
        for off in ((0, 0), (0, 0.01), (0, -0.01), (0.01, 0), (-0.01, 0))
    ]
    here = ndimage.map_coordinates(before, place[..., ::-1].T, order=1)
    slope = np.stack([there[1] - there[2], there[3] - there[4]], axis=-1) / 0.02
    off = here - there[0]
    return np.stack([np.linalg.lstsq(slope[:, one], off[:, one])[0] for one in range(off.shape[1])])


@pytest.mark.parametrize("affine", [slow(True), False])
def test_a_known_motion_is_rendered_to_a_hundredth_of_a_pixel(affine: bool) -> None:
    made = dataclasses.replace(case(2000), **CLEAN, shake_px=0.0, height_px=320, width_px=480, fill=0.7)
    scene = Scene(made)
    width, height, _ = made.size_m
    deepest = pressed(made, np.array([0.15 * height]))[0][0]
    still = Motion(deepest.xs, deepest.ys, 0.0 * deepest.moved)
    if affine:
        nodes = Sheet(deepest.xs, deepest.ys, 1.0, 0.0).nodes()
        motion = Motion(deepest.xs, deepest.ys, nodes @ np.array([[0.03, 0.01], [0.05, -0.1]]))
    else:
        motion = deepest
    cameras = camera_path(made)[:2]
    grey = [scene.shades(one, 0.01, camera)[..., 1] for one, camera in zip((still, motion), cameras, strict=True)]
    x, y = np.meshgrid(np.linspace(-0.35, 0.35, 7) * width, np.linspace(0.25, 0.75, 4) * height)
    y_px = 0.5 * (made.height_px - 1) + 0.06 * made.height_px - (y - 0.5 * height) * px_per_m(made)
    middle = np.column_stack([(0.5 * (made.width_px - 1) + x * px_per_m(made)).ravel(), y_px.ravel()]).round()
    near = np.stack(np.meshgrid(np.arange(-10, 11), np.arange(-10, 11)), axis=-1).reshape(-1, 2)
    place = middle[:, None] + near
    expected = followed(place.reshape(-1, 2), cameras, (still, motion))[1].reshape(place.shape)
    assert np.linalg.norm(expected - place, axis=-1).max() > 3.0
    assert np.abs(misplaced(grey[0], grey[1], place, expected)).max() < 0.01


@pytest.mark.slow
def test_a_case_gives_the_same_images_and_other_seeds_others() -> None:
    one, again, other = (render(case(seed, **SMALL)) for seed in (2001, 2001, 2004))
    assert all((a == b).all() for a, b in zip(one.frames, again.frames, strict=True))
    assert one.frames[0].shape == (240, 320, 3)
    assert (one.frames[0] != other.frames[0]).any()


@pytest.mark.parametrize("seed", range(2000, 2003))
def test_the_truth_of_each_holding_fits_its_images(seed: int) -> None:
    video = render(case(seed, **SMALL, **CLEAN, shake_px=0.0))
    assert video.case.holding == HOLDINGS[seed % 3]
    x, y, width, height = video.roi
    for corner in video.outline:
        assert x - 1 <= corner[0] <= x + width + 1
        assert y - 1 <= corner[1] <= y + height + 1
    cx, cy, _, _ = video.contact
    below = video.follow(np.array([[cx + 0.5 * video.contact[2], cy + 1.0]]))[:, 0]
    assert below[-1, 1] - below[0, 1] == pytest.approx(video.depth_m[-1] * 100 * video.px_per_cm, abs=1.0)
    assert video.stiffness_n_per_mm == pytest.approx(video.force_n[-1] / video.depth_m[-1] / 1e3)
    changed = np.abs(video.frames[-1].astype(int) - video.frames[0]).max(axis=2) > 12
    assert not changed[:, : x - 6].any() or video.case.holding != "clamped"
    assert changed[y : y + height, x : x + width].mean() > 0.1


@pytest.mark.slow
def test_the_camera_is_moved_by_a_hand_and_its_truth_follows() -> None:
    video = render(case(2000, **SMALL, **CLEAN, shake_px=2.0))
    still = render(case(2000, **SMALL, **CLEAN, shake_px=0.0))
    middle = np.array([[160.0, 120.0]])
    shift = (video.follow(middle) - still.follow(middle))[:, 0]
    assert np.allclose(shift[0], 0.0)
    assert np.sqrt((shift**2).sum(axis=1).mean()) == pytest.approx(2.0, rel=0.2)
    assert not np.allclose(video.cameras[0], video.cameras[3])


def test_a_scale_shows_whole_grams_late() -> None:
    log = dataclasses.replace(SCALE, offset_s=1.5)
    video = render(dataclasses.replace(case(2000, **SMALL), log=log))
    assert video.log.unit == "g"
    np.testing.assert_allclose(video.log.value, video.log.value.round(), atol=1e-9)
    assert not video.log.value[video.log.time_s < 1.5].any()
    shown = video.log.value[-1] * 9.80665e-3
    assert 0.9 * video.force_n[-1] < shown < video.force_n[-1] + 0.005


def test_an_exact_log_holds_the_force_of_each_image_at_its_offset() -> None:
    video = render(dataclasses.replace(case(2001, **SMALL), log=LogCase(rate_hz=200.0, offset_s=0.75)))
    at = 0.75 + np.arange(6) / video.fps
    seen = np.interp(at, video.log.time_s, video.log.value)
    np.testing.assert_allclose(seen, video.force_n, atol=0.03 * video.force_n.max())


def test_files_of_a_video_hold_its_images_readings_and_truth(tmp_path: Path) -> None:
    video = render(case(2002, **SMALL))
    write(video, tmp_path)
    film = cv2.VideoCapture(str(tmp_path / "video.mp4"))
    read = []
    while (one := film.read())[0]:
        read.append(one[1][..., ::-1])
    assert len(read) == len(video.frames)
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(video.fps)
    assert np.abs(read[-1].astype(float) - video.frames[-1]).mean() < 6.0
    lines = (tmp_path / "force.csv").read_text().splitlines()
    assert lines[0] in ("time [s],force [N]", "time [s],weight [g]")
    assert len(lines) == len(video.log.time_s) + 1
    kept = json.loads((tmp_path / "truth.json").read_text())
    assert kept["modulus_pa"] == video.modulus_pa
    assert tuple(kept["held"]) == video.held
