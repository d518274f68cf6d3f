"""Common parts of colour and depth images."""

import math
import zlib
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Stamp

QUEUE_IMAGES = 64
"""Images that wait for a slow reader: two seconds at 30 Hz; at 640 x 480, 59 MB of colour, or 98 MB with depth."""


def fingerprint(image: NDArray[np.uint8] | NDArray[np.uint16]) -> Hashable:
    """A checksum of an image's bytes (h, w) or (h, w, 3); a sensor's noise alone makes two pictures differ."""
    return zlib.crc32(np.ascontiguousarray(image).data.cast("B"))


@dataclass(frozen=True, slots=True)
class ColorImage:
    """One picture.

    stamp: when it arrived; its device_ticks are the camera's own timestamp [us], None where it gives none
    image: (H, W, 3) RGB, uint8"""

    stamp: Stamp
    image: NDArray[np.uint8]


# Common parts of every depth camera


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A camera's projection: u = fx x / z + cx, v = fy y / z + cy, in a frame with x to the right, y down and z along
    the view.

    fx_px, fy_px: focal lengths [px]; cx_px, cy_px: principal point [px], counted from the centre of the first pixel
    distortion: OpenCV's k1, k2, p1, p2, k3, which move x / z and y / z before; empty = none"""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal_rad: float, vertical_rad: float) -> "Intrinsics":
        """Intrinsics as in OpenNI2's converter: the axis goes through pixel (width / 2, height / 2)."""
        fx_px, fy_px = width / (2 * math.tan(horizontal_rad / 2)), height / (2 * math.tan(vertical_rad / 2))
        return cls(fx_px, fy_px, width / 2, height / 2)


@dataclass(frozen=True, slots=True)
class DepthImage:
    """One depth picture, and the picture of its colour camera.

    stamp: when it arrived; its device_ticks are the camera's own timestamp [us]
    depth: (H, W) uint16, distance along the view in units of `unit_m`; 0 where the camera measured nothing
    unit_m: 0.001 for millimetres
    color: (H', W', 3) RGB uint8 of the same time (within half a period), None without one
    intrinsics: intrinsics of `depth`, from the camera (OpenNI2's: its field of view alone); None without them"""

    stamp: Stamp
    depth: NDArray[np.uint16]
    unit_m: float
    color: NDArray[np.uint8] | None = None
    intrinsics: Intrinsics | None = None

    def depth_m(self) -> NDArray[np.float32]:
        """(H, W) distances along the view [m], nan where the camera saw none."""
        return depth_m(self.depth, self.unit_m)


def depth_m(depth: NDArray[np.uint16], unit_m: float) -> NDArray[np.float32]:
    """(H, W) distances along the view [m], nan where the camera saw none, of a depth image in units of unit_m."""
    return np.where(depth > 0, depth * np.float32(unit_m), np.float32(np.nan)).astype(np.float32)
