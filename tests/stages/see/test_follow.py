"""Particles in large pictures, against known motions: as exact as with the whole picture, from a part of it."""

from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from deformscope.stages.see import flow as flows
from deformscope.stages.see import follow
from deformscope.stages.see.flow import FlowField, FlowStep, flow_onward
from deformscope.stages.see.follow import Follower, View
from deformscope.stages.see.particles import ParticleGrid, Rect, Tracked, advance, sample, seed_grid, start

Image = npt.NDArray[np.uint8]
SIZE = 600, 880
BODY = Rect(180, 120, 440, 300)


@cache
def scenery() -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Speckle of the block, share of it in each pixel, and the background, each at rest."""
    rng = np.random.default_rng(4)
    speckle = cv2.GaussianBlur(rng.normal(0, 1, SIZE).astype(np.float32), (0, 0), 2.0)
    speckle = 128 + 40 * np.tanh(1.5 * speckle / speckle.std())
    ground = 120 + 300 * cv2.GaussianBlur(rng.normal(0, 1, SIZE).astype(np.float32), (0, 0), 9.0)
    inside = np.zeros(SIZE, np.float32)
    x, y, wide, high = (int(v) for v in (BODY.x, BODY.y, BODY.width, BODY.height))
    inside[y : y + high, x : x + wide] = 1
    return speckle, inside, ground


def block(at: npt.NDArray[np.float64], noise: float = 2.0, seed: int = 0) -> Image:
    """A speckled block on a still background. at: (2, 3) affine motion from rest to here [px]"""
    (height, width), (speckle, inside, ground) = SIZE, scenery()
    moved, share = (cv2.warpAffine(one, at, (width, height), flags=cv2.INTER_LANCZOS4) for one in (speckle, inside))
    picture = share * moved + (1 - share) * ground + np.random.default_rng(seed).normal(0, noise, SIZE)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def affine(strain: float, dx: float = 0.0, dy: float = 0.0) -> npt.NDArray[np.float64]:
    """Strain across, half of it down, about the middle of the block, and a shift [px]."""
    cx, cy = BODY.x + BODY.width / 2, BODY.y + BODY.height / 2
    return np.array([[1 + strain, 0, dx - strain * cx], [0, 1 - strain / 2, dy + strain / 2 * cy]])


def followed(images: list[Image], grid: ParticleGrid) -> Tracked:
    follower, tracked = Follower(grid, images[0].shape[:2]), start(grid)
    for before, after in pairwise(images):
        _, tracked = follower.step(before, after, tracked)
    return tracked


def rms(tracked: Tracked, grid: ParticleGrid, motion: npt.NDArray[np.float64]) -> float:
    assert tracked.seen.all()
    truth = grid.rest_px @ motion[:, :2].T + motion[:, 2]
    return float(np.sqrt(((tracked.position_px - truth) ** 2).sum(axis=1).mean()))


@pytest.fixture
def worked(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Pixels for which features and DIS, and the refinement, were worked out."""
    count = {"found": 0, "refined": 0}
    both, refine = flows.flow_both_ways, flows._refine

    def found(a: Image, b: Image, at: npt.NDArray[np.float64] | None = None) -> tuple[FlowField, FlowField]:
        count["found"] += a.size
        return both(a, b, at)

    def counted(a: Image, *more: object, **options: object) -> FlowField:
        count["refined"] += a.size
        return refine(a, *more, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(flows, "flow_both_ways", found)
    monkeypatch.setattr(flows, "_refine", counted)
    return count


@pytest.mark.parametrize("steps", [1, 3])
def test_a_part_is_as_exact_as_the_whole_picture(steps: int, worked: dict[str, int]) -> None:
    motions = [affine(0.01 * n, 1.3 * n, -0.7 * n) for n in range(steps + 1)]
    images = [block(motion, seed=n) for n, motion in enumerate(motions)]
    grid = seed_grid(SIZE, BODY, (6, 8))
    error = rms(followed(images, grid), grid, motions[-1])
    few = dict(worked)
    last: FlowStep | None = None
    whole = start(grid)
    for before, after in pairwise(images):
        last = flow_onward(before, after, last)
        whole = advance(whole, last.forward, last.backward)
    assert error < 1.3 * rms(whole, grid, motions[-1]) + 0.002
    assert error < 0.03 * steps**0.5
    assert few["found"] < 0.2 * (worked["found"] - few["found"])
    assert few["refined"] < 0.7 * (worked["refined"] - few["refined"])


def test_a_jump_beyond_the_margin_is_found() -> None:
    motion = affine(0.02, 190.0, 70.0)
    grid = seed_grid(SIZE, BODY, (6, 8))
    assert rms(followed([block(affine(0.0)), block(motion, seed=1)], grid), grid, motion) < 0.08


def test_the_part_goes_along_with_the_particles() -> None:
    motions = [affine(0.0, 15.0 * n) for n in range(8)]
    grid = seed_grid(SIZE, BODY, (6, 8))
    images = [block(motion, seed=n) for n, motion in enumerate(motions)]
    assert rms(followed(images, grid), grid, motions[-1]) < 0.04 * 7  # 0.04 px a step, as in the whole picture


def test_noise_is_honest() -> None:
    motion = affine(0.015, 2.0, 1.0)
    grid = seed_grid(SIZE, BODY, (6, 8))
    tracked = followed([block(affine(0.0), 5.0), block(motion, 5.0, 1)], grid)
    stated = np.sqrt((tracked.noise_px**2).mean())
    assert 0.3 < rms(tracked, grid, motion) / np.sqrt(2) / stated < 2.0


def test_a_small_picture_is_followed_as_a_whole() -> None:
    cut = np.s_[100:440, 60:740]
    images = [block(affine(0.01 * n, 0.4 * n), seed=n)[cut] for n in range(3)]
    grid = seed_grid(images[0].shape, Rect(130, 30, 400, 270))
    last: FlowStep | None = None
    expected = start(grid)
    for before, after in pairwise(images):
        last = flow_onward(before, after, last)
        expected = advance(expected, last.forward, last.backward)
    tracked = followed(images, grid)
    np.testing.assert_array_equal(tracked.position_px, expected.position_px)
    np.testing.assert_array_equal(tracked.noise_px, expected.noise_px)


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_a_flow_that_is_placed_means_the_same_points(scale: int) -> None:
    """A linear flow of the picture, given on a reduced part, is found at points of the picture."""
    y, x = np.mgrid[:40, :50]
    at = np.stack([10 + scale * (x + 0.5) - 0.5, 6 + scale * (y + 0.5) - 0.5], axis=-1)
    small = FlowField(((0.02 * at + 1) / scale).astype(np.float32), np.full((40, 50), 0.1, np.float32))
    placed = small.placed((10, 6), scale)
    points = np.array([[30.25, 21.5], [12.0, 40.0]])
    np.testing.assert_allclose(sample(placed.flow_px, placed.inside(points)), 0.02 * points + 1, atol=1e-5)
    np.testing.assert_allclose(placed.noise_px, 0.1 * scale, rtol=1e-6)


@pytest.mark.parametrize("spacing", [10.0, 30.0, 80.0, 160.0, 500.0])
def test_a_view_lies_in_the_picture_and_is_whole_in_its_pixels(spacing: float) -> None:
    at = np.array([[3.0, 590.0], [877.0, 5.0]])
    view = View.around(at, spacing, SIZE, 2 * spacing)
    cut = view.cut(np.zeros(SIZE, np.uint8))
    assert cut.shape == (view.height, view.width)
    assert view.width % view.coarse == view.height % view.coarse == view.coarse % view.fine == 0
    assert spacing / view.fine >= min(spacing, follow.FINE_PX)
    assert view.holds(at, SIZE)  # the picture's own edges are no limit
    middle = View.around(np.array([[400.0, 250.0], [500.0, 350.0]]), 20.0, SIZE, 60.0)
    assert middle.holds(np.array([[450.0, 300.0]]), SIZE)
    assert not middle.holds(np.array([[middle.x + 1.0, 300.0]]), SIZE)
