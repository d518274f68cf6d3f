"""Images: colour as JPEG or without loss, depth always without loss."""

import functools
from collections.abc import Sequence

import cv2
import numpy as np
import pyarrow as pa
import rerun as rr

from deformscope.arrays import ImageArray
from deformscope.frames import ColorFrame, DepthFrame
from deformscope.images import PNG_SIGNATURE, encode_color, encode_png
from deformscope.log.canvas import TEXT
from deformscope.log.rig.columns import Batch, Shown, frame_times, is_news, moments, recorded, root
from deformscope.pictures.palette import BACKGROUND

LOOK_EVERY, RARE, STEP_M = 8, 0.01, 0.05
"""The range of a depth image: which pixels its range is from, the share that may lie beyond, the range's steps [m]."""


def log_color(batch: Batch, device: str, frames: Sequence[ColorFrame], start_ns: int, lossless: bool) -> None:
    encoded = [encode_color(frame.image, lossless=lossless) for frame in frames]
    kinds = [f"image/{'png' if one.startswith(PNG_SIGNATURE) else 'jpeg'}" for one in encoded]
    columns = [*rr.EncodedImage.columns(blob=encoded, media_type=kinds), *recorded(frames)]
    batch.send_columns(root("color", device), frame_times(frames, start_ns), columns)


def log_depth(
    batch: Batch, device: str, frames: Sequence[DepthFrame], start_ns: int, lossless: bool, shown: Shown | None = None
) -> None:
    reach = _range(frames[0].depth, frames[0].unit_m)
    columns = [
        *rr.EncodedDepthImage.columns(
            blob=[encode_png(frame.depth, noisy=True) for frame in frames],
            media_type=["image/png"] * len(frames),
            meter=[1.0 / frame.unit_m for frame in frames],
            colormap=[rr.components.Colormap.Turbo] * len(frames),
            depth_range=[reach] * len(frames),
        ),
        *recorded(frames),
    ]
    if any(frame.color is not None for frame in frames):
        colors = [b"" if one.color is None else encode_color(one.color, lossless=lossless) for one in frames]
        archetype, name = "DepthFrame", "color"
        flat = pa.array(np.frombuffer(b"".join(colors), np.uint8))
        made = rr.DynamicArchetype.columns(archetype=archetype, components={name: flat})
        columns += list(made.partition([len(row) for row in colors]))
    batch.send_columns(root("depth", device), frame_times(frames, start_ns), columns)
    if is_news(shown, device, (*reach, frames[0].depth.shape), frames[0].stamp.host_ns):
        frame = frames[0]
        png = _scale_png(reach[0] * frame.unit_m, reach[1] * frame.unit_m, frame.depth.shape[:2])
        scale = rr.EncodedImage.columns(blob=[png], draw_order=[-30.0])
        batch.send_columns(root("display/depth", device), moments([frame.stamp.host_ns], start_ns), scale)


def _range(depth: ImageArray, unit_m: float) -> tuple[float, float]:
    """The nearest and farthest that colours show apart of an image (h, w), in its own unit: whole steps, so that they
    stay put."""
    seen = depth[::LOOK_EVERY, ::LOOK_EVERY]
    seen = seen[seen > 0]
    if not seen.size:
        return 0.0, 1.0 / unit_m
    near, far = np.quantile(seen, (RARE, 1 - RARE)) * unit_m / STEP_M
    low, high = np.floor(near), max(np.ceil(far), np.floor(near) + 1)
    return float(low * STEP_M / unit_m), float(high * STEP_M / unit_m)


@functools.lru_cache(maxsize=64)
def _scale_png(low_m: float, high_m: float, shape: tuple[int, int]) -> bytes:
    """Room for the image, below it a bar of colours, and below that three numbers."""
    height, width = shape
    size = width / 640
    top = height + round(10 * size)
    bar = top + round(18 * size)
    picture = np.full((bar + round(36 * size), width, 3), BACKGROUND, np.uint8)
    picture[top:bar] = cv2.applyColorMap(np.linspace(0, 255, width).astype(np.uint8)[None], cv2.COLORMAP_TURBO)[
        ..., ::-1
    ]
    for share in (0.0, 0.5, 1.0):
        words = f"{low_m + share * (high_m - low_m):.3g} m"
        (length, _), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.8 * size, max(1, round(2 * size)))
        place = round(share * (width - length)), bar + round(28 * size)
        thick = max(1, round(2 * size))
        cv2.putText(picture, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.8 * size, TEXT, thick, cv2.LINE_AA)
    return encode_png(picture)
