"""The body is found in scenes whose parts are known, and what makes images unfit is named."""

import cv2
import numpy as np
import pytest

from deformscope.arrays import BoolArray
from deformscope.stages.see.find_body import FoundBody, find_body, polygon
from tests.cases import slow
from tests.stages.see.scenes import Image, Scene, render, truth

WALLED = Scene(jitter=2.0, shadow=0.3, wall=3.0, held=("bottom", "left", "right"))
ON_EDGE = Scene(4, swell=0.2, block=(60, 150, 360, 210), tool=(240, 50), depth=16, jitter=1.5)


def filled(found: FoundBody, size: tuple[int, int]) -> BoolArray:
    mask = np.zeros(size, dtype=np.uint8)
    assert found.outline is not None
    cv2.fillPoly(mask, [np.rint(found.outline).astype(np.int32)], 1)
    return mask > 0


def overlap(a: BoolArray, b: BoolArray) -> float:
    return float(np.mean(a & b) / np.mean(a | b))


@pytest.mark.parametrize("scene", [Scene(), WALLED, ON_EDGE], ids=["pressed", "shaken, held at its sides", "cut off"])
def test_a_pressed_block_is_found_with_what_holds_and_pushes_it(scene: Scene) -> None:
    found = find_body(render(scene))
    assert found.sure
    assert not found.unfit
    assert overlap(filled(found, scene.size), truth(scene)) > 0.95
    assert set(found.held) == {*scene.held, "contact"}
    assert scene.tool is not None
    assert found.contact is not None
    left, wide = scene.tool
    assert found.contact.x == pytest.approx(left, abs=4)
    assert found.contact.width == pytest.approx(wide, abs=8)
    assert found.contact.y == pytest.approx(scene.block[1], abs=3)
    assert found.tool is not None
    assert found.tool[:, 1].max() < scene.block[1] + 4


def test_a_block_that_is_pulled_by_all_of_a_side_is_held_there() -> None:
    scene = Scene(tool=None, colours=((90, 90, 90), (100, 100, 100), (70, 60, 60)))
    found = find_body(render(scene))
    assert set(found.held) == {"top", "bottom"}
    assert found.contact is None
    assert overlap(filled(found, scene.size), truth(scene)) > 0.9


@pytest.mark.parametrize("times", [0.4, slow(1.0)])
def test_a_free_side_far_from_the_tool_is_not_held_at_any_size(times: float) -> None:
    """Its motion fades towards it; that of a held side ends there."""
    fading = Scene(block=(60, 130, 330, 170), tool=(240, 80), swell=0.12)
    small = [cv2.resize(one, None, fx=times, fy=times, interpolation=cv2.INTER_AREA) for one in render(fading)]
    found = find_body(small)  # type: ignore[arg-type]
    assert set(found.held) == {"bottom", "contact"}


def test_places_are_those_of_the_large_image() -> None:
    scene = Scene()
    large = [cv2.resize(one, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC) for one in render(scene)]
    found = find_body(large)  # type: ignore[arg-type]
    mask = cv2.resize(truth(scene).astype(np.uint8), None, fx=2.0, fy=2.0, interpolation=cv2.INTER_NEAREST) > 0
    assert overlap(filled(found, mask.shape), mask) > 0.95
    assert found.contact is not None
    assert found.contact.width == pytest.approx(2 * 60, abs=16)


def test_grey_images_of_16_bits() -> None:
    grey = [one.mean(axis=2).astype(np.uint16) * 64 for one in render(Scene())]
    found = find_body(grey)
    assert overlap(filled(found, (360, 480)), truth(Scene())) > 0.9


def test_a_specimen_that_fills_the_picture_is_the_whole_of_it() -> None:
    filling = Scene(block=(-60, -60, 600, 480), tool=None, depth=12.0)
    found = find_body(render(filling))
    assert found.outline is None
    assert found.sure
    assert found.held == ("top", "bottom")


def test_where_nothing_moves_nothing_is_found() -> None:
    found = find_body(render(Scene(depth=0.0, jitter=2.0)))
    assert found.outline is None
    assert [one.code for one in found.unfit] == ["still"]
    assert found.background[-1, :, 2] != pytest.approx(0.0, abs=0.05)


def inserted(images: list[Image], other: list[Image]) -> list[Image]:
    return [*images[:3], *other[3:]]


def test_a_cut_and_a_mirrored_image_are_named() -> None:
    images = render(Scene())
    cut = find_body(inserted(images, render(Scene(seed=8, block=(200, 60, 200, 200), tool=(280, 40)))))
    assert [one.code for one in cut.unfit] == ["scene-cut"]
    assert "between images 3 and 4" in cut.unfit[0].text
    mirrored = find_body(inserted(images, [np.ascontiguousarray(one[:, ::-1]) for one in images]))
    assert [one.code for one in mirrored.unfit] == ["mirrored"]


def test_what_a_camera_does_is_named_with_its_size() -> None:
    found = find_body(render(Scene(zoom=0.03)))
    assert [one.code for one in found.unfit] == ["zoom"]
    assert "+3.0%" in found.unfit[0].text
    assert overlap(filled(found, (360, 480)), truth(Scene())) > 0.9


@pytest.mark.parametrize("light", [0.07, slow(0.04)])
def test_a_video_without_light_is_no_cut(light: float) -> None:
    rng = np.random.default_rng(4)
    images = [light * one + rng.normal(0.0, 4.0, one.shape) for one in render(Scene())]
    dark = find_body([np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in images])
    assert [one.code for one in dark.unfit] == ["dark"]
    assert "dark ones: 99 % of the pixels are below" in dark.unfit[0].text


def orbited(image: Image, share: float) -> Image:
    """A phone that turns around what it films by 12 degrees."""
    (height, width), angle, focal = image.shape[:2], np.deg2rad(12.0) * share, 1.2 * image.shape[1]
    plane = np.array([[np.cos(angle), 0.0, 0.0], [0.0, 1.0, 0.0], [np.sin(angle) / focal, 0.0, 1.0]])
    middle = np.array([[1.0, 0.0, 0.5 * width], [0.0, 1.0, 0.5 * height], [0.0, 0.0, 1.0]])
    seen = middle @ plane @ np.linalg.inv(middle)
    return np.asarray(cv2.warpPerspective(image, seen, (width, height), borderMode=cv2.BORDER_REFLECT))


def turned(image: Image, share: float) -> Image:
    plane = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [4e-5 * share, 0.0, 1.0]])
    return np.asarray(cv2.warpPerspective(image, plane, image.shape[1::-1], borderMode=cv2.BORDER_REFLECT))


def bent(image: Image, share: float) -> Image:
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    shift = 1.2 * share * np.sin(x / 40.0)
    return np.asarray(
        cv2.remap(image, x, (y + shift).astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    )


@pytest.mark.parametrize(
    ("change", "code"), [slow(turned, "out-of-plane"), (orbited, "out-of-plane"), (bent, "warped")]
)
def test_a_camera_that_turns_and_a_picture_that_is_stabilised(change: object, code: str) -> None:
    images = [change(one, index / 5) for index, one in enumerate(render(Scene()))]  # type: ignore[operator]
    assert code in [one.code for one in find_body(images).unfit]


def test_a_body_that_fills_the_picture_and_stretches_is_no_camera_that_turns() -> None:
    assert not find_body(render(Scene(block=(-60, -60, 600, 480), tool=None, depth=40.0))).unfit
    assert not find_body(render(Scene(block=(-60, -60, 600, 480), swell=0.0, tool=None, depth=30.0))).unfit


def test_a_rigid_thing_alone_is_not_surely_a_body() -> None:
    still = Scene(depth=0.0)
    frames = render(still)
    mark = frames[0][20:80, 20:80].copy()
    for index, one in enumerate(frames):
        one[100:160, 40 + 6 * index : 100 + 6 * index] = 255 - mark
    assert not find_body(frames).sure


def test_holes_are_left_out_of_a_polygon() -> None:
    ring: BoolArray = np.zeros((120, 160), dtype=bool)
    ring[20:100, 20:140] = True
    ring[40:70, 50:90] = False
    mask = np.zeros(ring.shape, dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(polygon(ring)).astype(np.int32)], 1)
    assert overlap(mask > 0, ring) > 0.97


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(20, 40), (33, 90), (120, 160), (90, 120, 3)])
def test_images_without_a_body_are_no_error(size: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    noise = [rng.integers(0, 255, size, dtype=np.uint8) for _ in range(3)]
    plain = [np.full(size, 40 * index, dtype=np.uint8) for index in range(3)]
    dot = [np.zeros(size, dtype=np.uint8) for _ in range(3)]
    for index, one in enumerate(dot):
        one[10:16, 10 + 4 * index : 16 + 4 * index] = 255
    for images in (noise, plain, dot, noise[:1], [*plain[:2], noise[0]]):
        found = find_body(images)
        assert found.outline is None or len(found.outline) > 2
