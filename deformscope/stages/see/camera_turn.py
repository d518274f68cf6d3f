"""Turn of a camera about its line of sight, by what lies around the body.

A hand turns a camera by some thousandths: a pixel or two between a clamp and a contact far from it, as a push would."""

from typing import Any

import cv2
import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.see.flow import Image, grey
from deformscope.stages.see.particles import ParticleGrid

POINTS, FEWEST = 300, 20
"""Number of points that are followed, and of those that turn as one in a known turn: half of them at least."""
RETURNS_PX, ALIKE_PX = 0.3, 1.0
"""Largest forward-backward residual of a point, and distance from the place to which it turns."""
STAYS = 0.9
"""Share of the images in which a point of the surroundings turns with the others: a tool does at first."""
WINDOW = (21, 21)


class CameraTurn:
    """Follows points outside the particles' cells (Lucas and Kanade 1981). grid: the particles at rest"""

    def __init__(self, first: Image, grid: ParticleGrid) -> None:
        shade = grey(first)
        self._factor = 255.0 / max(float(np.percentile(shade, 99.9)), 1e-6)
        self._first = self._eight_bits(first)
        around = np.full(shade.shape, 255, dtype=np.uint8)
        low = np.maximum(grid.rest_px.min(axis=0) - grid.spacing_px, 0.0).astype(int)
        high = np.ceil(grid.rest_px.max(axis=0) + grid.spacing_px).astype(int)
        around[low[1] : high[1], low[0] : high[0]] = 0
        found: Any = cv2.goodFeaturesToTrack(self._first, POINTS, 0.01, max(shade.shape) / 100.0, mask=around)
        self._at: Any = np.zeros((1, 1, 2), dtype=np.float32) if found is None else found
        self._now = self._at
        self._seen: list[tuple[Any, Any]] = []

    def _eight_bits(self, image: Image) -> Image:
        return np.asarray(cv2.convertScaleAbs(grey(image), alpha=self._factor))

    def look(self, image: Image) -> None:
        """Follow the points to the next image."""
        shade = self._eight_bits(image)
        how: Any = {"winSize": WINDOW, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        self._now, there, _ = cv2.calcOpticalFlowPyrLK(self._first, shade, self._at, self._now.copy(), **how)
        back, returned, _ = cv2.calcOpticalFlowPyrLK(shade, self._first, self._now, self._at.copy(), **how)
        good = np.logical_and(there, returned).ravel()
        good &= np.linalg.norm(back - self._at, axis=2).ravel() < RETURNS_PX
        self._seen.append((self._now, good))

    def turns(self) -> FloatArray:
        """(T,) the turn at each image from x to y, since the first [rad]; NaN where too little around is seen."""
        each = [self._turn(now, good) for now, good in self._seen]
        found = np.sum([good for _, good in self._seen], axis=0)
        stays = np.sum([alike for _, alike in each], axis=0) >= STAYS * np.maximum(found, 1)
        return np.array([0.0, *(self._turn(now, good & stays)[0] for now, good in self._seen)])

    def _turn(self, now: Any, good: Any) -> tuple[float, Any]:
        """The turn to places (n, 1, 2) of which (n,) some count, and those that agree with it."""
        if good.sum() < FEWEST:
            return float("nan"), np.zeros_like(good)
        way: Any = {"method": cv2.RANSAC, "ransacReprojThreshold": ALIKE_PX}
        fit, alike = cv2.estimateAffinePartial2D(self._at[good], now[good], **way)
        agree = np.zeros_like(good)
        agree[good] = alike.ravel() > 0
        known = fit is not None and agree.sum() >= max(FEWEST, 0.5 * good.sum())
        return float(np.arctan2(fit[1, 0], fit[0, 0])) if known else float("nan"), agree
