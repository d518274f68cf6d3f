"""Depth cameras: through OpenNI2 (camera, recording or dummy), and a synthetic one that a program fills.

with DepthCamera(DepthCameraConfig(width=640, height=480, fps=30, color=True)) as camera:
    for picture in camera:
        print(picture.stamp.host_ns, picture.depth_m().shape)
"""

from deformscope_drivers.depth_camera.device import DepthCamera, DepthCameraConfig
from deformscope_drivers.depth_camera.discovery import discover
from deformscope_drivers.depth_camera.image import DepthImage, Intrinsics
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthCamera, SyntheticDepthConfig, View

__all__ = [
    "DepthCamera",
    "DepthCameraConfig",
    "DepthImage",
    "Intrinsics",
    "SyntheticDepthCamera",
    "SyntheticDepthConfig",
    "View",
    "discover",
]
