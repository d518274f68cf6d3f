"""A depth camera on a program's scene: what the laboratory, and tests, have in a real one's place."""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.images import DepthImage, Intrinsics, fingerprint
from deformscope_drivers.synthetic import SyntheticConfig, SyntheticSource

# Errors of cameras that triangulate: with a projector or second imager a baseline away they measure disparity

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


MAX_UINT16 = 65535


@dataclass(frozen=True, slots=True)
class View:
    """The visible scene at one moment.

    depth_m: (H, W) distance along the view [m]; nan or 0 where there is nothing to measure
    color: (H', W', 3) RGB uint8, None where there is no colour camera"""

    depth_m: NDArray[np.floating]
    color: NDArray[np.uint8] | None = None


@dataclass(frozen=True, slots=True)
class SyntheticDepthConfig(SyntheticConfig):
    """Errors that the camera adds to a view.

    unit_m: the step of depth [m]
    noise_m, noise_per_m: deviation of depth z is noise_m + noise_per_m z^2 [m]; the default is a first Kinect's
    (1.4 mm at 1 m, 6 mm at 2 m: Khoshelham and Oude Elberink 2012); missing: share of pixels without a distance
    near_m, far_m: beyond these nothing is measured
    sensor: its error model, in the place of noise_m and noise_per_m; None = those"""

    name: str = "synthetic depth camera"
    unit_m: float = 0.001
    noise_m: float = 0.0
    noise_per_m: float = 1.425e-3
    missing: float = 0.0
    near_m: float = 0.0
    far_m: float = 10.0
    intrinsics: Intrinsics | None = None
    sensor: TriangulatingSensor | None = None


class SyntheticDepthCamera(SyntheticSource[DepthImage, View]):
    """`SyntheticDepthCamera(scene)` with scene(time_s) -> View; or `camera.push(View(depth_m, color))`."""

    def __init__(
        self,
        scene: Callable[[float], View] | None = None,
        config: SyntheticDepthConfig | None = None,
        *,
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        self.config = config or SyntheticDepthConfig()
        super().__init__(scene, self.config, reconnect=reconnect, clock=clock)

    def _take(self, view: View, stamp: Stamp) -> DepthImage:
        config = self.config
        depth_m = np.asarray(view.depth_m, np.float64)
        seen = (depth_m > max(config.near_m, 0.0)) & (depth_m <= config.far_m)
        if config.sensor is not None:
            lens_px = config.sensor.focal_px if config.intrinsics is None else config.intrinsics.fx_px
            depth_m = config.sensor.measure(np.where(seen, depth_m, 0.0), lens_px, self._random)
            seen &= depth_m > 0.0
        if config.missing:
            seen &= self._random.random(depth_m.shape) >= config.missing
        depth_m = np.where(seen, depth_m, 0.0)
        if config.sensor is None and (config.noise_m or config.noise_per_m):
            deviation_m = config.noise_m + config.noise_per_m * depth_m**2
            depth_m = depth_m + self._random.standard_normal(depth_m.shape) * deviation_m
        steps = np.clip(np.rint(depth_m / config.unit_m), 1, MAX_UINT16)
        depth = np.where(seen, steps, 0).astype(np.uint16)
        color = None if view.color is None else np.array(view.color, np.uint8)
        return DepthImage(stamp, depth, config.unit_m, color, config.intrinsics)

    def _fingerprint(self, reading: DepthImage) -> Hashable:
        return fingerprint(reading.depth)
