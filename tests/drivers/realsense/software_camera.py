"""pyrealsense2 with one camera made of software, for a process that has no other: librealsense's own pipeline, queue,
frames and options, over a device that this module fills."""

import threading
import time
from typing import Any

import pyrealsense2 as rs
from pyrealsense2 import *  # noqa: F403 - it is that module, but for two names

WIDTH, HEIGHT, FPS = 64, 48, 30
ROUND_MS = 2**32 / 1e3


class _Info:
    """What was removed."""

    def was_removed(self, _: Any) -> bool:
        return False


class context:
    def __init__(self) -> None:
        self._own = rs.context()

    def query_devices(self) -> list[Any]:
        return [_device]

    def set_devices_changed_callback(self, callback: Any) -> None:
        self._own.set_devices_changed_callback(lambda _: callback(_Info()))


def pipeline(_: context) -> Any:
    made = rs.pipeline(rs.context())
    made.set_device(_device)
    threading.Thread(target=_fill, daemon=True).start()
    return made


def _made() -> tuple[Any, Any, Any]:
    device = rs.software_device()
    device.register_info(rs.camera_info.name, "software")
    device.register_info(rs.camera_info.serial_number, "42")
    sensor = device.add_sensor("Stereo Module")
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = WIDTH, HEIGHT, 60.0, 61.0, 31.0, 23.0
    lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fmt = rs.stream.depth, 0, 0, rs.format.z16
    stream.width, stream.height, stream.fps, stream.bpp, stream.intrinsics = WIDTH, HEIGHT, FPS, 2, lens
    profile = sensor.add_video_stream(stream)
    sensor.add_read_only_option(rs.option.depth_units, 0.001)
    return device, sensor, profile.as_video_stream_profile()


def _fill() -> None:
    """A frame each period; number 40 is missing; the clock begins anew after the 60th."""
    import numpy as np

    number, next_s = 0, time.monotonic()
    while True:
        number += 2 if number == 39 else 1
        seen = rs.software_video_frame()
        seen.pixels = np.full((HEIGHT, WIDTH), 1000 + number, np.uint16)
        seen.stride, seen.bpp, seen.profile, seen.depth_units = 2 * WIDTH, 2, _profile, 0.001
        seen.domain, seen.frame_number = rs.timestamp_domain.hardware_clock, number
        seen.timestamp = (ROUND_MS + (number - 60) * 1e3 / FPS) % ROUND_MS
        _sensor.on_video_frame(seen)
        next_s += (2.0 if number == 39 else 1.0) / FPS
        time.sleep(max(next_s - time.monotonic(), 0.0))


_device, _sensor, _profile = _made()
