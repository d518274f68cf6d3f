"""Common parts of colour and depth images."""

from __future__ import annotations

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
