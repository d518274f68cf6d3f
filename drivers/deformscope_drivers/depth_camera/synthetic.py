"""A depth camera on a program's scene: what the laboratory, and tests, have in a real one's place."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.depth_camera.sensors import TriangulatingSensor
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.images import DepthImage, Intrinsics, fingerprint
from deformscope_drivers.synthetic import SyntheticConfig, SyntheticSource

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
