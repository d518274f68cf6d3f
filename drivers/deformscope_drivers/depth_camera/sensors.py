"""Errors of cameras that triangulate: with a projector or second imager a baseline away they measure disparity."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

JUMP = 0.04
"""Jump of depth, as a share of the distance, from which two neighbouring pixels belong to two surfaces."""


@dataclass(frozen=True, slots=True)
class TriangulatingSensor:
    """Depth z of disparity d = focal_px baseline_m / z [px].

    focal_px: focal length of the sensor itself; step_px: step of the disparity; noise_px: deviation of disparity
    before that, which neighbours share within noise_width pixels of the picture
    bleeding: pixels of the picture next to an edge that take the depth of a neighbour at random; flying: pixels at a
    jump have a depth between the two; grazing_deg: surfaces seen at a smaller angle than this have no depth"""

    focal_px: float
    baseline_m: float
    step_px: float
    noise_px: float
    noise_width: int = 1
    bleeding: int = 1
    flying: bool = False
    grazing_deg: float = 12.0

    def step_m(self, depth_m: float) -> float:
        """The difference between neighbouring depths that the sensor can report, at depth_m [m]: it grows with depth
        squared."""
        return self.step_px * depth_m**2 / (self.focal_px * self.baseline_m)

    def measure(
        self, depth_m: NDArray[np.floating], lens_px: float, random: np.random.Generator
    ) -> NDArray[np.float64]:
        """(H, W) measured depths of exact ones (H, W) [m], 0 where nothing is measured, as in exact ones. lens_px:
        focal length of the picture [px]"""
        exact = np.nan_to_num(np.asarray(depth_m, np.float64), nan=0.0, posinf=0.0)
        seen = exact > 0.0
        strength = self.focal_px * self.baseline_m
        disparity = np.divide(strength, exact, out=np.zeros_like(exact), where=seen)
        measured = self._bled(disparity, seen, random)
        noise = random.standard_normal([-(-side // self.noise_width) for side in exact.shape])
        for axis in (0, 1):
            noise = noise.repeat(self.noise_width, axis)
        noise = noise[: exact.shape[0], : exact.shape[1]]
        measured = np.rint((measured + self.noise_px * noise) / self.step_px) * self.step_px
        # (h, w) pixels that the projector, or the other imager, does not reach: it is to the right, and something
        # nearer lies between. A pixel is lost where one to its right comes to lie at its place, or left of it, there.
        column = np.arange(disparity.shape[1])
        there = np.where(seen, column - disparity * (lens_px / self.focal_px), np.inf)
        nearest = np.minimum.accumulate(there[:, ::-1], axis=1)[:, ::-1]
        known = seen & (measured > 0.0) & (there <= nearest + 1e-9) & ~self._grazed(exact, lens_px)
        return np.divide(strength, measured, out=np.zeros_like(exact), where=known)

    def _bled(
        self, disparity: NDArray[np.float64], seen: NDArray[np.bool_], random: np.random.Generator
    ) -> NDArray[np.float64]:
        """(h, w) disparities [px], those next to a jump taken from a neighbour."""
        if not self.bleeding:
            return disparity
        reach = [step for step in range(-self.bleeding, self.bleeding + 1) if step]
        neighbours = []
        for step in reach:
            for axis, side in enumerate(disparity.shape):  # at the border, the border's own
                one = np.take(disparity, np.clip(np.arange(side) + step, 0, side - 1), axis)
                neighbours.append(np.where(one > 0.0, one, disparity))
        edge = seen & (np.max(neighbours, axis=0) - np.min(neighbours, axis=0) > JUMP * disparity)
        chosen = random.integers(len(neighbours), size=(1, *seen.shape))
        taken = np.take_along_axis(np.stack(neighbours), chosen, axis=0)[0]
        share = random.random(seen.shape) if self.flying else 1.0
        return np.where(edge, disparity + share * (taken - disparity), disparity)

    def _grazed(self, exact: NDArray[np.float64], lens_px: float) -> NDArray[np.bool_]:
        """(rows, columns) where the surface is seen flatter than `grazing_deg`; jumps of depth do not count as such."""
        steepest = 1.0 / (lens_px * math.tan(math.radians(self.grazing_deg)))
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = [np.abs(np.gradient(exact, axis=axis)) / exact for axis in (0, 1)]
            return np.asarray((np.hypot(*slope) > steepest) & (np.maximum(*slope) < JUMP))


PRIMESENSE = TriangulatingSensor(focal_px=580.0, baseline_m=0.075, step_px=1 / 8, noise_px=0.408 / 8, bleeding=2)
"""A first Kinect, Carmine or Xtion. Depth comes in steps of 2.85 mm at 1 m that grow with z^2 (1/8 px of disparity).
Its standard deviation is half a step, 1.4 mm at 1 m (Khoshelham and Oude Elberink 2012, Sensors 12(2)): 0.408 of a step
before it is rounded, 0.289 by rounding."""
REALSENSE = TriangulatingSensor(
    focal_px=427.0, baseline_m=0.050, step_px=1 / 32, noise_px=0.08, noise_width=3, bleeding=2, flying=True
)
"""A D435 at 848 x 480: standard deviation z^2 subpixel / (focal baseline) with subpixel 0.08, 3.7 mm at 1 m
(Grunnet-Jepsen, Sweetser and Woodfill, Best-Known-Methods for Tuning Intel RealSense D400 Depth Cameras, Intel), in
1/32 px."""
SENSORS = {"primesense": PRIMESENSE, "realsense": REALSENSE}
