"""What deformscope needs of the drivers of colour cameras."""

import contextlib

from deformscope_drivers.interface import DeviceDriver
from deformscope_drivers.webcam.device import ImageFolder, PlaybackConfig, VideoFile, Webcam, WebcamConfig
from deformscope_drivers.webcam.synthetic import SyntheticCamera, SyntheticCameraConfig

DRIVER = DeviceDriver(
    "color",
    WebcamConfig,
    Webcam,
    simulated=lambda config, scene: contextlib.nullcontext(
        SyntheticCamera(scene, SyntheticCameraConfig(rate_hz=config.fps))
    ),
)
VIDEO_FILE = DeviceDriver("color", PlaybackConfig, VideoFile.configured)
IMAGE_FOLDER = DeviceDriver("color", PlaybackConfig, ImageFolder.configured)
