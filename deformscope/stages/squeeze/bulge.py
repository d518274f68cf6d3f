"""Walls that bulge or are pressed in, by a container's content, by the air in it, or by fingers.

A wall does not move at the container's edges, where another one holds it, and moves most in its middle. A tracker of
rigid bodies would follow it; so the bulge of each visible wall is estimated together with the pose."""

from __future__ import annotations

import cv2
import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.squeeze.container import ModelView

BULGE_M = 0.003
"""Prior standard deviation of the bulge of a wall's middle. Chosen: a carton's walls."""
CREASE_DEG = 30.0
"""Least angle between neighbouring pixels of different walls; a round wall turns less."""
LEAST_PIXELS = 150
"""Fewest pixels of a wall: a smaller one is treated as rigid."""
MOST = 4
"""Most walls that are used: the largest ones."""
LEVEL_M = 0.01
"""Smallest slope of a wall's height: less is rounding of the rendering."""


def bulge_shapes(view: ModelView, height_m: FloatArray) -> FloatArray:
    """(H, W, 2 k) motion of the k largest walls of a rendering (H, W) along their normals per unit motion of their
    middle, and per unit difference between below and above, as under a liquid's pressure. The shape of a bulge is 0 at
    the edges and on other walls.

    height_m: (H, W) height of each pixel's point, container frame. A wall that is only partly in the image counts as
    rigid"""
    seen = np.isfinite(view.depth_m)
    inner = seen & ~_creases(view.outward, seen)
    _, label, size, _ = cv2.connectedComponentsWithStats(inner.astype(np.uint8), connectivity=4)
    beyond = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])  # their edges are not seen
    large = np.flatnonzero(size[:, cv2.CC_STAT_AREA] >= LEAST_PIXELS)
    walls = sorted(set(large) - {0, *beyond}, key=lambda wall: -size[wall, cv2.CC_STAT_AREA])
    away = cv2.distanceTransform(inner.astype(np.uint8), cv2.DIST_L2, 3).astype(np.float64)
    shapes = np.zeros((*seen.shape, 2 * min(len(walls), MOST)))
    for number, wall in enumerate(walls[:MOST]):
        own = label == wall
        share, height = np.where(own, away, 0.0) / away[own].max(), height_m[own]
        low, high = height.min(), height.max()
        above = np.where(own, 2.0 * height_m - low - high, 0.0) / max(high - low, LEVEL_M)
        shapes[..., 2 * number] = share * (2.0 - share)
        shapes[..., 2 * number + 1] = shapes[..., 2 * number] * above
    return shapes


def _creases(normal: FloatArray, seen: BoolArray) -> BoolArray:
    """(H, W) pixels next to one of another wall."""
    found = np.zeros(seen.shape, dtype=bool)
    least = np.cos(np.radians(CREASE_DEG))
    for axis in (0, 1):
        first = tuple(slice(None, -1) if one == axis else slice(None) for one in (0, 1))
        second = tuple(slice(1, None) if one == axis else slice(None) for one in (0, 1))
        apart = np.einsum("hwi,hwi->hw", normal[first], normal[second]) < least
        apart &= seen[first] & seen[second]
        found[first] |= apart
        found[second] |= apart
    return found
