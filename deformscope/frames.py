"""What travels from a source to an experiment: stamped, frozen frames."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope.arrays import ImageArray
from deformscope_drivers.clock import Stamp


@dataclass(frozen=True, slots=True)
class ColorFrame:
    """One camera image.

    stamp: when it was taken; index: its place in the stream, from 0
    image: (H, W) grey or (H, W, 3) RGB, uint8 or uint16
    """

    stamp: Stamp
    index: int
    image: ImageArray


Frame = ColorFrame
"""Every kind of frame a source can give (tactile, wrench, depth and arm frames join with their drivers)."""
