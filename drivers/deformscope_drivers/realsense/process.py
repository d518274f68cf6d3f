"""The process that reads one RealSense camera: a hang or a crash of the library ends neither program nor recording.

`Realsense` starts it (`deformscope_drivers.hosted`). module: pyrealsense2, or its replacement"""

from __future__ import annotations

import importlib
from typing import Any

from deformscope_drivers.errors import DeviceError, LibraryMissing
from deformscope_drivers.hosted import Channel, exit_without_cleanup
from deformscope_drivers.realsense.advice import INSTALL
from deformscope_drivers.realsense.camera import RealsenseCamera, RealsenseSettings, as_device_error, listed

ROUND_S = 0.05


def load(module: str) -> Any:
    """The library. Raises LibraryMissing."""
    exit_without_cleanup()  # the library's own crashes now and then once a camera is gone (librealsense, issue 14470)
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise LibraryMissing("pyrealsense2", str(error), INSTALL, "realsense") from error


def serve(channel: Channel, settings: RealsenseSettings, module: str) -> None:
    """Read a camera until the other end is closed. Raises DeviceError."""
    try:
        camera = RealsenseCamera(settings, load(module))
        channel.send("opened", camera.words())
        while not channel.poll():
            frame = camera.next(ROUND_S)
            for note in camera.take_notes():
                channel.send("note", note)
            if frame is not None:
                channel.send("frame", frame)
        camera.close()
    except (DeviceError, RuntimeError) as error:
        raise as_device_error(error) from error


def report_cameras(channel: Channel, module: str) -> None:
    """Report the cameras that librealsense sees. Raises LibraryMissing."""
    channel.send("opened", listed(load(module)))
