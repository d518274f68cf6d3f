"""Scenes of a block that a tool presses, as a camera would see them: what is where is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Scene:
    """A block [px] in a picture of `size` (H, W), pressed at its top by `depth`; what is left out does not happen.

    held: sides that stay; tool: x and width of the tool, None = the block is pulled by its top; grain: size of the
    speckles of background, block and tool; colours: of the three; jitter: shift of the camera in each frame; zoom: of
    the last frame; swell: how far the sides give way, as a share of the push; wall: contrast of the background"""

    seed: int = 0
    size: tuple[int, int] = (360, 480)
    block: tuple[int, int, int, int] = (110, 120, 240, 170)
    depth: float = 22.0
    tool: tuple[int, int] | None = (200, 60)
    held: tuple[str, ...] = ("bottom",)
    frames: int = 6
    grain: tuple[float, float, float] = (3.0, 1.8, 2.5)
    colours: tuple[tuple[int, int, int], ...] = ((90, 95, 100), (200, 180, 90), (70, 60, 150))
    jitter: float = 0.0
    zoom: float = 0.0
    swell: float = 0.3
    wall: float = 14.0
    shadow: float = 0.0
    noise: float = 1.5

    def with_(self, **changes: object) -> Scene:
        return replace(self, **changes)  # type: ignore[arg-type]


def texture(rng: np.random.Generator, size: tuple[int, int], grain: float, contrast: float) -> Floats:
    soft = cv2.GaussianBlur(rng.standard_normal(size), (0, 0), grain)
    return contrast * soft / soft.std()


def motion(scene: Scene, x: Floats, y: Floats, share: float) -> tuple[Floats, Floats]:
    """Displacement of the block's points at rest (x, y) [px]."""
    left, top, wide, high = scene.block
    up = np.clip((top + high - y) / high, 0.0, 1.0)
    if scene.tool is None:  # pulled up as a whole
        across = np.ones_like(x)
        push = -scene.depth * share
    else:
        middle, half = scene.tool[0] + scene.tool[1] / 2, scene.tool[1] / 2
        away = np.maximum(np.abs(x - middle) - half, 0.0)
        across = np.exp(-away / (0.35 * high * (1.2 - up) + 12.0))
        push = scene.depth * share
    v = push * across * up
    middle_x = left + wide / 2 if scene.tool is None else scene.tool[0] + scene.tool[1] / 2
    u = (
        np.sign(push)
        * scene.swell
        * scene.depth
        * share
        * 4
        * up
        * (1 - up)
        * np.clip((x - middle_x) / (wide / 2), -1, 1)
    )
    for side, near in (("left", (x - left) / wide), ("right", (left + wide - x) / wide)):
        if side in scene.held:
            u, v = (one * np.clip(near / 0.25, 0.0, 1.0) for one in (u, v))
    return u, v


def render(scene: Scene) -> list[Image]:
    """Frames (H, W, 3)."""
    return [one.copy() for one in rendered(scene)]


@cache
def rendered(scene: Scene) -> list[Image]:
    rng = np.random.default_rng(scene.seed)
    height, width = scene.size
    wall, foam, steel = (
        np.stack([texture(rng, scene.size, grain, contrast) for _ in range(1)] * 3, axis=2) + np.array(colour)
        for grain, contrast, colour in zip(scene.grain, (scene.wall, 22.0, 10.0), scene.colours, strict=True)
    )
    y, x = np.mgrid[:height, :width].astype(np.float64)
    left, top, wide, high = scene.block
    frames = []
    for index in range(scene.frames):
        share = index / (scene.frames - 1)
        shift = scene.jitter * rng.standard_normal(2) * (index > 0)
        zoom = 1.0 + scene.zoom * share
        px = (x - width / 2 - shift[0]) / zoom + width / 2  # in the scene
        py = (y - height / 2 - shift[1]) / zoom + height / 2
        rx, ry = px, py
        for _ in range(25):
            before_x, before_y = rx, ry
            u, v = motion(scene, rx, ry, share)
            rx, ry = px - u, py - v
            if max(np.abs(rx - before_x).max(), np.abs(ry - before_y).max()) < 1e-9:
                break
        inside = (rx >= left) & (rx < left + wide) & (ry >= top) & (ry < top + high)

        def seen(picture: Floats, at_x: Floats, at_y: Floats) -> Floats:
            return cv2.remap(
                picture,
                at_x.astype(np.float32),
                at_y.astype(np.float32),
                cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REFLECT,
            )

        image = seen(wall, px, py)
        image[inside] = seen(foam, rx, ry)[inside]
        if scene.tool is not None:
            ty = py - scene.depth * share
            on = (px >= scene.tool[0]) & (px < sum(scene.tool)) & (ty < top)
            image[on] = seen(steel, px, ty)[on]
        light = 1.0 - scene.shadow * (px + 0.3 * py < 0.4 * width)
        image = image * cv2.GaussianBlur(light, (0, 0), 12)[:, :, None] + scene.noise * rng.standard_normal(image.shape)
        frames.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return frames


def truth(scene: Scene) -> npt.NDArray[np.bool_]:
    mask = np.zeros(scene.size, dtype=bool)
    left, top, wide, high = scene.block
    mask[max(top, 0) : top + high, max(left, 0) : left + wide] = True
    return mask
