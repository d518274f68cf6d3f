"""Flow against displacements that are exact: one analytic texture, evaluated at displaced coordinates."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import scipy.io

from deformscope.errors import InputError
from deformscope.stages.see import flow as flows
from deformscope.stages.see.flow import SMALLEST_PX, FlowStep, dense_flow, flow_both_ways, flow_onward, grey
from tests.cases import slow_but

Array = npt.NDArray[np.float64]
Motion = Callable[[Array, Array], tuple[Array, Array]]
CHALLENGE = Path(__file__).parents[4] / "shared" / "data" / "dic_challenge14"
SIDE = 240


def texture(x: Array, y: Array, seed: int = 0, shortest: float = 7.0, longest: float = 50.0) -> Array:
    """A sum of random cosines around 128, standard deviation 40; wavelengths in px."""
    rng = np.random.default_rng(seed)
    length, angle, phase = (
        rng.uniform(low, high, 90) for low, high in ((shortest, longest), (0, np.pi), (0, 2 * np.pi))
    )
    wave = 2 * np.pi / length
    out = np.zeros_like(x)
    for kx, ky, p in zip(wave * np.cos(angle), wave * np.sin(angle), phase, strict=True):
        out += np.cos(kx * x + ky * y + p)
    return 128 + 40 * out / np.sqrt(45)


def pair(motion: Motion, noise: float = 2.0, side: int = SIDE) -> tuple[Array, Array, Array]:
    """Before, after (grey values), and the true flow (side, side, 2).

    `motion` leads from the second image back to the first: after(y) = T(y + motion(y)). The flow then solves
    f(x) = -motion(x + f(x)), by iteration to convergence.
    """
    y, x = np.mgrid[:side, :side].astype(float)
    before = texture(x, y)
    back = motion(x, y)
    after = texture(x + back[0], y + back[1])
    u, v = np.zeros_like(x), np.zeros_like(x)
    for _ in range(100):
        gx, gy = motion(x + u, y + v)
        u, v = -gx, -gy
    rng = np.random.default_rng(7)
    return before + rng.normal(0, noise, x.shape), after + rng.normal(0, noise, x.shape), np.stack([u, v], axis=-1)


def eight_bit(image: Array) -> npt.NDArray[np.uint8]:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def rms(flow: npt.NDArray[np.floating], truth: Array, border: int = 20) -> float:
    """Vector error over the pixels that stay `border` px inside both images."""
    side = len(truth)
    y, x = np.mgrid[:side, :side].astype(float)
    points = [x, y, x + truth[:, :, 0], y + truth[:, :, 1]]
    inside = np.all([(p >= border) & (p <= side - 1 - border) for p in points], axis=0)
    return float(np.sqrt(((flow - truth) ** 2).sum(axis=2)[inside].mean()))


def shift(dx: float, dy: float) -> Motion:
    return lambda x, y: (np.full_like(x, -dx), np.full_like(y, -dy))


def linear(xx: float, xy: float, yx: float, yy: float) -> Motion:
    c = SIDE / 2
    return lambda x, y: (-xx * (x - c) - xy * (y - c), -yx * (x - c) - yy * (y - c))


def turn(degrees: float) -> Motion:
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return linear(1 - cos, sin, -sin, 1 - cos)


def waves(amplitude: float, length: float) -> Motion:
    k = 2 * np.pi / length
    return lambda x, y: (amplitude * np.sin(k * y), amplitude * np.cos(k * x))


def dent(x: Array, y: Array) -> tuple[Array, Array]:
    bell = np.exp(-((x - 120) ** 2 + (y - 100) ** 2) / (2 * 45**2))
    return 3 * bell, -12 * bell


MOTIONS = {
    "rest": (shift(0, 0), 0.015),
    "part of a pixel": (shift(0.3, -0.37), 0.02),
    "a few pixels": (shift(5.3, -3.7), 0.03),
    "tens of pixels": (shift(-41.6, 18.3), 0.07),
    "strain of 5 %": (linear(0.05, 0, 0, -0.02), 0.03),
    "strain of 18 %": (linear(0.18, 0, 0, -0.07), 0.06),
    "shear": (linear(0, 0.1, 0, 0), 0.05),
    "turn by 3 degrees": (turn(3), 0.03),
    "turn by 10 degrees": (turn(10), 0.06),
    "small waves": (waves(0.1, 120), 0.03),
    "waves": (waves(1.0, 120), 0.05),
    "dent": (dent, 0.05),
}


@pytest.mark.parametrize(
    "name", slow_but(["rest", "part of a pixel", "strain of 18 %", "turn by 10 degrees", "small waves"], MOTIONS)
)
def test_finds_known_motion(name: str) -> None:
    motion, bound = MOTIONS[name]
    before, after, truth = pair(motion)
    assert rms(dense_flow(eight_bit(before), eight_bit(after)).flow_px, truth) < bound


@pytest.mark.parametrize("name", slow_but(["waves"], ["a few pixels", "strain of 5 %", "turn by 3 degrees", "waves"]))
def test_is_more_accurate_than_dis_alone(name: str) -> None:
    before, after, truth = pair(MOTIONS[name][0])
    a, b = eight_bit(before), eight_bit(after)
    alone = cv2.DISOpticalFlow.create(cv2.DISOpticalFlow_PRESET_MEDIUM).calc(a, b, None)  # type: ignore[call-overload]
    assert rms(dense_flow(a, b).flow_px, truth) < 0.6 * rms(np.asarray(alone), truth)


def test_light_may_change() -> None:
    before, after, truth = pair(shift(1.3, -0.6))
    slope = np.linspace(-12, 12, SIDE)
    assert rms(dense_flow(eight_bit(before), eight_bit(0.8 * after + 20 + slope)).flow_px, truth) < 0.05


@pytest.mark.slow
def test_meets_the_dic_challenge() -> None:
    if not CHALLENGE.is_dir():
        pytest.skip("needs the DIC Challenge images in ../shared/data/dic_challenge14")
    before = cv2.imread(str(CHALLENGE / "reference.tif"), cv2.IMREAD_UNCHANGED)
    after = cv2.imread(str(CHALLENGE / "L1_amp0.1.tif"), cv2.IMREAD_UNCHANGED)
    assert before is not None
    assert after is not None
    exact = scipy.io.loadmat(CHALLENGE / "sample14_exact.mat")["Sample14Exact"][:, 1]
    flow = dense_flow(before, after).flow_px[20:-20, 20:-20]
    error_u, error_v = flow[:, :, 0] - exact[20:-20], flow[:, :, 1]
    assert np.sqrt((error_u**2).mean()) < 0.010
    assert np.sqrt((error_u**2 + error_v**2).mean()) < 0.014


def test_eight_and_sixteen_bits_agree() -> None:
    before, after, _ = pair(shift(2.4, 1.1))
    a, b = eight_bit(before), eight_bit(after)
    flow = dense_flow(a, b).flow_px
    for factor in (257, 16):  # the whole range, and 12 bits of 16
        wide = dense_flow(a.astype(np.uint16) * factor, b.astype(np.uint16) * factor).flow_px
        np.testing.assert_allclose(wide, flow, atol=1e-3)


def test_a_dark_sixteen_bit_pair_keeps_its_contrast() -> None:
    before, after, truth = pair(shift(2.4, 1.1))
    a, b = (np.rint(4 * np.clip(x, 0, 255)).astype(np.uint16) for x in (before, after))
    assert rms(dense_flow(a, b).flow_px, truth) < 0.03


def test_colour_is_its_grey() -> None:
    before, after, _ = pair(shift(2.4, 1.1))
    a, b = eight_bit(before), eight_bit(after)
    flow = dense_flow(a, b).flow_px
    for channels in (3, 4):
        colour = dense_flow(np.dstack([a] * channels), np.dstack([b] * channels)).flow_px
        np.testing.assert_allclose(colour, flow, atol=1e-3)


def test_grey_weighs_red_first() -> None:
    red = np.zeros((4, 4, 3), dtype=np.uint8)
    red[:, :, 0] = 100
    np.testing.assert_allclose(grey(red), 29.9, rtol=1e-6)
    assert grey(np.full((4, 4), 60000, dtype=np.uint16)).max() == 60000


@pytest.mark.parametrize("value", [0, 7, 255])
def test_uniform_images_have_no_flow(value: int) -> None:
    image = np.full((64, 80), value, dtype=np.uint8)
    field = dense_flow(image, image)
    assert np.abs(field.flow_px).max() < 1e-3
    assert field.noise_px.min() > 0.3  # nothing to see is not the same as no motion


@pytest.mark.parametrize("shape", [(SMALLEST_PX, SMALLEST_PX), (32, 32), (33, 47), (24, 200)])
def test_small_images(shape: tuple[int, int]) -> None:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    a, b = eight_bit(texture(x, y)), eight_bit(texture(x - 1.4, y))
    flow = dense_flow(a, b).flow_px
    assert flow.shape == (*shape, 2)
    np.testing.assert_allclose(np.median(flow.reshape(-1, 2), axis=0), [1.4, 0], atol=0.2)


def test_repeats_bit_for_bit() -> None:
    before, after, _ = pair(turn(3))
    one, two = (dense_flow(eight_bit(before), eight_bit(after)) for _ in range(2))
    np.testing.assert_array_equal(one.flow_px, two.flow_px)
    assert one.flow_px.dtype == np.float32


@pytest.mark.parametrize("noise", [1.0, 5.0])
def test_says_how_noisy_it_is(noise: float) -> None:
    before, after, truth = pair(shift(3.3, -1.4), noise)
    field = dense_flow(eight_bit(before), eight_bit(after))
    stated = np.sqrt((field.noise_px[30:-30, 30:-30] ** 2).mean())
    assert 0.4 < rms(field.flow_px, truth, 30) / np.sqrt(2) / stated < 2.0


def test_misfit_tells_a_covered_patch() -> None:
    before, after, _ = pair(shift(3.3, -1.4))
    after[80:140, 90:150] = texture(*np.meshgrid(np.arange(60.0), np.arange(60.0)), seed=5)
    misfit = dense_flow(eight_bit(before), eight_bit(after)).misfit
    assert np.median(misfit[92:130, 98:136]) > 0.6
    assert np.percentile(misfit[160:220, 20:220], 99) < 0.1


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (np.zeros((40, 40), np.uint8), np.zeros((40, 41), np.uint8), "one size"),
        (np.zeros((40, 40), np.uint8), np.zeros((40, 40), np.uint16), "one type"),
        (np.zeros((8, 40), np.uint8), np.zeros((8, 40), np.uint8), "at least"),
        (np.zeros((40, 40, 2), np.uint8), np.zeros((40, 40, 2), np.uint8), "shape"),
        (np.full((40, 40), np.nan), np.zeros((40, 40)), "finite"),
    ],
)
def test_refuses(before: npt.NDArray[np.uint8], after: npt.NDArray[np.uint8], said: str) -> None:
    with pytest.raises(InputError, match=said):
        dense_flow(before, after)


@pytest.mark.parametrize("threads", [1, 2])
def test_both_ways_at_once_are_bit_equal_to_one_after_the_other(threads: int) -> None:
    before, after, _ = pair(MOTIONS["waves"][0], side=96)
    usual = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        both = flow_both_ways(before, after)
        apart = dense_flow(before, after), dense_flow(after, before)
    finally:
        cv2.setNumThreads(usual)
    for one, other in zip(both, apart, strict=True):
        np.testing.assert_array_equal(one.flow_px, other.flow_px)


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """An entry for each step of a sequence that is worked out as a pair."""
    calls: list[str] = []

    def counted(before: Array, after: Array, at: Array | None = None) -> tuple[flows.FlowField, flows.FlowField]:
        calls.append("pair")
        return flow_both_ways(before, after, at)

    monkeypatch.setattr(flows, "flow_both_ways", counted)
    return calls


def frames_of(motions: list[Motion]) -> tuple[list[npt.NDArray[np.uint8]], list[Array]]:
    """Images of one texture at rest and after each motion, with new noise in each; the true flow from rest to each."""
    made = [pair(motion) for motion in motions]
    rng = np.random.default_rng(11)
    images = [eight_bit(after + rng.normal(0, 1.0, after.shape)) for _, after, _ in made]
    return [eight_bit(made[0][0]), *images], [truth for _, _, truth in made]


def test_steady_motion_is_refined_alone_and_as_exact_as_of_pairs(whole: list[str]) -> None:
    steps = [linear(0.01 * n, 0.004 * n, 0, -0.006 * n) for n in range(1, 5)]
    images, _ = frames_of(steps)
    last: FlowStep | None = None
    for n, (before, after) in enumerate(pairwise(images)):
        last = flow_onward(before, after, last)
        # the motion of a step, exactly: rest of the place, then on to the next image
        y, x = np.mgrid[:SIDE, :SIDE].astype(float)
        rest = np.stack([x, y]) if n == 0 else np.stack([x, y]) + np.stack(steps[n - 1](x, y))
        u, v = np.zeros_like(x), np.zeros_like(y)
        for _ in range(50):
            back = steps[n](x + u, y + v)
            u, v = rest[0] - x - back[0], rest[1] - y - back[1]
        truth = np.stack([u, v], axis=-1)
        alone = rms(dense_flow(before, after).flow_px, truth)
        assert alone < 0.04
        assert rms(last.forward.flow_px, truth) < 1.1 * alone + 0.002
    assert whole == ["pair"]


def test_a_jump_and_a_change_of_light_give_what_a_pair_gives(whole: list[str]) -> None:
    images, _ = frames_of([shift(0.4, 0.1), shift(0.8, 0.2), shift(14.0, -6.0)])
    images.append(np.roll(images[-1][::-1], 40, axis=1))  # what was there is gone
    last: FlowStep | None = None
    for before, after in pairwise(images):
        last = flow_onward(before, after, last)
    assert len(whole) == 3  # the first, the jump, what is new
    again = flow_both_ways(images[-2], images[-1])
    np.testing.assert_array_equal(last.forward.flow_px, again[0].flow_px)
    np.testing.assert_array_equal(last.backward.flow_px, again[1].flow_px)


def test_a_camera_that_shakes_adds_no_drift() -> None:
    """Smooth texture correlates well 2 px beside its place: that is not the place."""
    shaken = [(0.0, 0.0), (0.8, -1.1), (-0.9, -0.4), (-4.0, -0.5), (-1.7, 4.6)]
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    rng = np.random.default_rng(11)
    images = [eight_bit(texture(x - dx, y - dy, 0, 20.0, 120.0) + rng.normal(0, 2.0, x.shape)) for dx, dy in shaken]
    at = np.stack(np.meshgrid(np.arange(60.0, 180.0, 20.0), np.arange(60.0, 180.0, 20.0)), axis=-1).reshape(-1, 2)
    last: FlowStep | None = None
    for (before, after), (was, now) in zip(pairwise(images), pairwise(shaken), strict=True):
        last = flow_onward(before, after, last, at)
        error = last.forward.flow_px[60:-60, 60:-60] - np.subtract(now, was)
        assert np.abs(np.median(error, axis=(0, 1))).max() < 0.1
