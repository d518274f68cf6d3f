"""Depth cameras: through OpenNI2 (camera, recording or dummy), RealSense, and a synthetic one that a program fills.

with DepthCamera(DepthCameraConfig(width=640, height=480, fps=30, color=True)) as camera:
    for picture in camera:
        print(picture.stamp.host_ns, picture.depth_m().shape)
"""

from deformscope_drivers.depth_camera.device import DepthCamera as DepthCamera
from deformscope_drivers.depth_camera.device import DepthCameraConfig as DepthCameraConfig
from deformscope_drivers.depth_camera.discovery import discover as discover
from deformscope_drivers.depth_camera.discovery import discover_realsense as discover_realsense
from deformscope_drivers.depth_camera.realsense import Realsense as Realsense
from deformscope_drivers.depth_camera.realsense import RealsenseConfig as RealsenseConfig
from deformscope_drivers.depth_camera.synthetic import SENSORS as SENSORS
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthCamera as SyntheticDepthCamera
from deformscope_drivers.depth_camera.synthetic import SyntheticDepthConfig as SyntheticDepthConfig
from deformscope_drivers.depth_camera.synthetic import TriangulatingSensor as TriangulatingSensor
from deformscope_drivers.depth_camera.synthetic import View as View
from deformscope_drivers.images import DepthImage as DepthImage
from deformscope_drivers.images import Intrinsics as Intrinsics
