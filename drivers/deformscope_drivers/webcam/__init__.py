"""Colour cameras: a webcam through OpenCV and V4L2, a video file or a folder of images in its place, a synthetic one.

with Webcam(WebcamConfig(port="/dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920-video-index0", fps=30)) as camera:
    for picture in camera:
        print(picture.stamp.host_ns, picture.image.shape)
"""

from deformscope_drivers.images import ColorImage as ColorImage
from deformscope_drivers.webcam.device import ImageFolder as ImageFolder
from deformscope_drivers.webcam.device import PlaybackConfig as PlaybackConfig
from deformscope_drivers.webcam.device import VideoFile as VideoFile
from deformscope_drivers.webcam.device import Webcam as Webcam
from deformscope_drivers.webcam.device import WebcamConfig as WebcamConfig
from deformscope_drivers.webcam.device import discover as discover
from deformscope_drivers.webcam.synthetic import SyntheticCamera as SyntheticCamera
from deformscope_drivers.webcam.synthetic import SyntheticCameraConfig as SyntheticCameraConfig
