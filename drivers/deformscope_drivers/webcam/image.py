"""Common parts of every colour camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Stamp


@dataclass(frozen=True, slots=True)
class ColorImage:
    """One picture.

    stamp: when it arrived; its device_ticks are the camera's own timestamp [us], None where it gives none
    image: (H, W, 3) RGB, uint8"""

    stamp: Stamp
    image: NDArray[np.uint8]
