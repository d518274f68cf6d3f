"""A colour camera on a program's scene: what the laboratory, and tests, have in a webcam's place."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.images import ColorImage, fingerprint
from deformscope_drivers.synthetic import SyntheticConfig, SyntheticSource

Picture = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class SyntheticCameraConfig(SyntheticConfig):
    """noise: deviation of each channel [grey levels of 255]"""

    name: str = "synthetic camera"
    noise: float = 0.0


class SyntheticCamera(SyntheticSource[ColorImage, Picture]):
    """`SyntheticCamera(scene)` with scene(time_s) -> (H, W, 3) RGB uint8; or `camera.push(image)`."""

    def __init__(
        self,
        scene: Callable[[float], Picture] | None = None,
        config: SyntheticCameraConfig | None = None,
        *,
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        self.config = config or SyntheticCameraConfig()
        super().__init__(scene, self.config, reconnect=reconnect, clock=clock)

    def _take(self, view: Picture, stamp: Stamp) -> ColorImage:
        if self.config.noise:
            noise = self._random.normal(0.0, self.config.noise, view.shape)
            return ColorImage(stamp, np.clip(np.rint(view + noise), 0, 255).astype(np.uint8))
        return ColorImage(stamp, np.array(view, np.uint8))

    def _fingerprint(self, reading: ColorImage) -> Hashable:
        return fingerprint(reading.image)
