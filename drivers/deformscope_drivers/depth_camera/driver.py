"""What deformscope needs of the drivers of depth cameras."""

import contextlib

from deformscope_drivers.depth_camera.device import DepthCamera, DepthCameraConfig
from deformscope_drivers.depth_camera.realsense import Realsense, RealsenseConfig
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthCamera, SyntheticDepthConfig
from deformscope_drivers.interface import DeviceDriver

DRIVER = DeviceDriver(
    "depth",
    DepthCameraConfig,
    DepthCamera,
    simulated=lambda config, scene: contextlib.nullcontext(
        SyntheticDepthCamera(scene, SyntheticDepthConfig(rate_hz=config.fps or 30.0))
    ),
)
REALSENSE = DeviceDriver(
    "depth",
    RealsenseConfig,
    Realsense,
    simulated=lambda config, scene: contextlib.nullcontext(
        Realsense(config, library="deformscope_drivers.realsense.double")
    ),
)
