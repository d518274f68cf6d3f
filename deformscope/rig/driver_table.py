"""The drivers that a rig can name, with their modules. Nothing here imports a driver before it is used."""

import importlib
from dataclasses import dataclass
from typing import Any

from deformscope.frames import Kind


@dataclass(frozen=True, slots=True)
class Driver:
    """One kind of device.

    package, device, config: place of its class (or of its factory) and its configuration
    kind: kind of its frames; doubled: whether there is a double
    probed: whether it can be opened with only its port or bus, and without a motion"""

    name: str
    package: str
    device: str
    config: str
    kind: Kind
    doubled: bool = True
    probed: bool = False

    def make(self, config: object) -> Any:
        """A device with this configuration, not opened."""
        return self._find(self.device)(config)

    def config_class(self) -> Any:
        return self._find(self.config)

    def _find(self, path: str) -> Any:
        found: Any = importlib.import_module(self.package)
        for name in path.split("."):
            found = getattr(found, name)
        return found


_ALL = (
    Driver("dsa", "deformscope_drivers.dsa", "Dsa", "DsaConfig", "tactile", probed=True),
    Driver("sdh", "deformscope_drivers.sdh", "Sdh", "SdhConfig", "hand", probed=True),
    Driver("optoforce", "deformscope_drivers.optoforce", "Optoforce", "OptoforceConfig", "wrench", probed=True),
    Driver("jaco", "deformscope_drivers.jaco", "open_jaco", "JacoConfig", "arm"),
    Driver("kuka", "deformscope_drivers.kuka", "open_kuka", "KukaConfig", "arm"),
    Driver("placed", "deformscope_drivers.manual_arm", "ManualArm", "ManualArmConfig", "arm"),
    Driver("webcam", "deformscope_drivers.webcam", "Webcam", "WebcamConfig", "color"),
    Driver("depth_camera", "deformscope_drivers.depth_camera", "DepthCamera", "DepthCameraConfig", "depth"),
    Driver("realsense", "deformscope_drivers.depth_camera", "Realsense", "RealsenseConfig", "depth"),
    Driver("video_file", "deformscope_drivers.webcam", "VideoFile.configured", "PlaybackConfig", "color", False),
    Driver("image_folder", "deformscope_drivers.webcam", "ImageFolder.configured", "PlaybackConfig", "color", False),
)
DRIVERS = {driver.name: driver for driver in _ALL}
"""Drivers by the name that a rig file uses."""
