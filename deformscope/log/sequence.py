"""The images of a sequence: recorded without loss, and the picture below the results."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

from deformscope.arrays import ImageArray
from deformscope.frames import ColorFrame
from deformscope.images import JPEG_QUALITY
from deformscope.log.canvas import Canvas
from deformscope.log.rig import Batch, prepare_items
from deformscope.log.rig.columns import frame_times, root

DISPLAY = "display/image"


def canvas_of(frame: ColorFrame) -> Canvas:
    """The picture on which results are drawn."""
    height, width = frame.image.shape[:2]
    path = root("color", frame.device) if frame.image.dtype == np.uint8 else DISPLAY
    return Canvas(low=(0.0, 0.0), high=(float(width), float(height)), image=path)


def range_of(image: ImageArray) -> tuple[float, float]:
    """The darkest and the brightest value of an image (h, w) or (h, w, 3), at least 1 apart."""
    return float(image.min()), max(float(image.max()), float(image.min()) + 1.0)


def prepare_image(frame: ColorFrame, start_ns: int, limits: tuple[float, float], *, lossless: bool) -> Batch:
    """Prepare one image for a recording or, with losses, for a live view. start_ns: host time at which
    `session` is 0 [ns]; limits: range that is mapped to 8 bits if the image has 16, as viewers do not show these"""
    batch = Batch()
    eight = frame.image.dtype == np.uint8
    if eight or lossless:
        batch = prepare_items([frame], start_ns, (), {frame.device} if lossless else ())
    if not eight:
        low, high = limits
        spread = ((frame.image.astype(np.float32) - low) * (255.0 / (high - low))).clip(0, 255).astype(np.uint8)
        ordered = spread if spread.ndim == 2 else spread[..., ::-1]
        jpeg = cv2.imencode(".jpg", ordered, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        columns = rr.EncodedImage.columns(blob=[jpeg], media_type=["image/jpeg"], draw_order=[-10.0])
        batch.send_columns(DISPLAY, frame_times([frame], start_ns), columns)
    return batch
