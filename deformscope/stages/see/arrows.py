"""Optical flow for a live view: of a region of the image, at a size that is computed in time, on a few points.

The dense flow of 640 x 480 px takes 1.4 s on one core, of 160 x 120 px 0.06 s. Particles and arrows are given in pixels
of the whole image whatever the size that the flow was computed at."""

from dataclasses import dataclass

import cv2
import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.see.flow import SMALLEST_PX, Image, dense_flow
from deformscope.stages.see.particles import Rect, sample

ARROWS_ALONG = 32
"""Arrows along the longer side of the region."""


@dataclass(frozen=True, slots=True)
class Region:
    """A region of an image, reduced.

    image: (h, w) or (h, w, 3); origin_px: (x, y) origin of its corner in the whole image [px]; scale: pixels of the
    whole image for one of this, 1 or more"""

    image: Image
    origin_px: tuple[int, int]
    scale: float

    def inside(self, xy_px: FloatArray) -> FloatArray:
        """Points (n, 2) of the whole image in pixels of this one; pixel centres are at whole numbers in both."""
        return np.asarray((xy_px - self.origin_px + 0.5) / self.scale - 0.5)

    def whole(self, xy_px: FloatArray) -> FloatArray:
        """Points (n, 2) of this image in pixels of the whole one."""
        return np.asarray((xy_px + 0.5) * self.scale - 0.5 + self.origin_px)


@dataclass(frozen=True, slots=True)
class FlowArrows:
    """The motion from one image to another, on a regular grid of points.

    at_px: (n, 2) points (x, y) in the first image [px]; flow_px: (n, 2) motion of each [px];
    noise_px: (n,) standard deviation of each coordinate [px]"""

    at_px: FloatArray
    flow_px: FloatArray
    noise_px: FloatArray


def region_of(image: Image, roi: Rect | None = None, longest_px: int = 160) -> Region:
    """The region of an image, averaged down until its longer side has at most `longest_px` pixels. Raises InputError
    where the region is not in the image."""
    height, width = image.shape[:2]
    left, top, right, bottom = 0, 0, width, height
    if roi is not None:
        left, top = max(round(roi.x), 0), max(round(roi.y), 0)
        right, bottom = min(round(roi.x + roi.width), width), min(round(roi.y + roi.height), height)
    if min(right - left, bottom - top) < SMALLEST_PX:
        came = "the whole image" if roi is None else roi.described()
        raise InputError(f"a region of {SMALLEST_PX} px or more in the image of {width} x {height} px", came)
    cut = image[top:bottom, left:right]
    scale = max(max(cut.shape[:2]) / longest_px, 1.0)
    if scale > 1.0:
        size = max(round(cut.shape[1] / scale), SMALLEST_PX), max(round(cut.shape[0] / scale), SMALLEST_PX)
        cut = cv2.resize(cut, size, interpolation=cv2.INTER_AREA)
    return Region(cut, (left, top), scale)


def flow_arrows(before: Image, after: Image, roi: Rect | None = None, longest_px: int = 160) -> FlowArrows:
    """Dense optical flow of a region from `before` to `after`, at a regular grid of points [px of the whole image]."""
    first, second = region_of(before, roi, longest_px), region_of(after, roi, longest_px)
    found = dense_flow(first.image, second.image)
    height, width = first.image.shape[:2]
    step = max(max(height, width) / ARROWS_ALONG, 1.0)
    x, y = np.meshgrid(np.arange(0.5 * step, width - 0.5, step), np.arange(0.5 * step, height - 0.5, step))
    at = np.column_stack([x.ravel(), y.ravel()])
    noise = np.zeros(len(at)) if found.noise_px is None else sample(found.noise_px[:, :, None], at)[:, 0]
    return FlowArrows(first.whole(at), sample(found.flow_px, at) * first.scale, noise * first.scale)
