"""The process that reads one camera through OpenNI2: a hang or a crash of it ends neither program nor recording.

`DepthCamera` starts it (`deformscope_drivers.hosted`)."""

from __future__ import annotations

import time

from deformscope_drivers.hosted import Channel, exit_without_cleanup
from deformscope_drivers.openni.camera import OpenniCamera, OpenniSettings, Pairs
from deformscope_drivers.openni.library import Openni

ROUND_S = 0.05


def serve(channel: Channel, settings: OpenniSettings) -> None:
    """Read a camera until the other end is closed. Raises DeviceError."""
    exit_without_cleanup()  # the library's own crashes
    camera = OpenniCamera(settings)
    channel.send("opened", camera.words())
    camera.start()
    pairs = Pairs(camera.depth.mode().fps, wanted=settings.color)
    while not channel.poll():
        try:
            frame = camera.next(ROUND_S)
        except EOFError:
            for pair in pairs.rest():
                channel.send("frame", pair)
            channel.send("end")
            break
        if frame is not None:
            for pair in pairs.add(frame, time.monotonic_ns()):
                channel.send("frame", pair)
    camera.close()


def report_cameras(channel: Channel) -> None:
    """Report the cameras that OpenNI2 sees. Raises LibraryMissing."""
    exit_without_cleanup()  # the library's own crashes
    channel.send("opened", Openni().devices())
