"""A depth camera through OpenNI2: an Xtion, a PrimeSense Carmine or a first Kinect; a recording of one; or a dummy."""

import dataclasses
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from deformscope_drivers.clock import ClockFit
from deformscope_drivers.depth_camera.discovery import resolve_port
from deformscope_drivers.depth_camera.hosted import HostedCamera
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import NotConnected, SettingsRefused
from deformscope_drivers.frame_message import FrameMessage
from deformscope_drivers.images import DepthImage, Intrinsics
from deformscope_drivers.openni.camera import OpenniSettings, serve
from deformscope_drivers.openni.library import library_file

RECORDING_SUFFIX = ".oni"
_CAMERA = re.compile(r"(\w[\w:/@.-]*)?")
"""Names of cameras for OpenNI2. It takes any other name for a file's, and opens that."""


@dataclass(frozen=True, slots=True)
class DepthCameraConfig(OpenniSettings):
    """How a depth camera is opened and set.

    port: empty = the first camera; `usb:1-2` = the one in that socket, as `deformscope devices` prints it, which is the
    same after reconnection; a uri of OpenNI2's; the path of a recording (.oni); `Dummy` = OpenNI2's test camera; width,
    height [px], fps [Hz], unit_m (0.001 or 0.0001): None = the camera's; in a recording they are checked
    color: colour pictures too; registered: depth in the colour camera's pixels, where there is colour
    mirror: pictures mirrored, as many cameras have them unless set otherwise
    speed, loop: speed and loop of a recording; speed 0 = as fast as its readers take it, and no reader loses any
    library: path or folder of libOpenNI2.so; empty = where the system has it
    silence_s: time without a picture after which the camera counts as lost; stuck_after_s: the same picture for this
    long means a frozen one, None = it may (a recording always may)"""

    silence_s: float = 5.0
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        if not self.is_recording and not _CAMERA.fullmatch(self.port):
            raise NotConnected("a camera's name, or the path of a recording (.oni)", repr(self.port))

    @property
    def is_recording(self) -> bool:
        """Whether the port is a recording's path."""
        return self.port.lower().endswith(RECORDING_SUFFIX)

    def library_file(self) -> Path | None:
        """The file that `library` names; None = what the system has."""
        return library_file(self.library) if self.library else None


class DepthCamera(HostedCamera):
    """`with DepthCamera(DepthCameraConfig(color=True)) as camera: camera.next(1.0).depth_m()`

    OpenNI2 runs in a child process: a hang or crash there is a lost link here, and it is restarted. It was not tested
    on a camera, but on OpenNI2's dummy and on recordings written for it."""

    def __init__(
        self,
        config: DepthCameraConfig,
        *,
        reconnect: Reconnect | None = RECONNECT,
        usb: Path = Path("/sys/bus/usb/devices"),
    ) -> None:
        if not (math.isfinite(config.speed) and config.speed >= 0):
            raise SettingsRefused("a speed of 0 or more", f"{config.speed:g}", where=config.port)
        is_file = config.is_recording
        super().__init__(
            config.port or "the first depth camera",
            serve,
            config.silence_s,
            reconnect=None if is_file else reconnect,
            stuck_after_s=None if is_file else config.stuck_after_s,
        )
        self.config = config
        self._usb = usb
        self._ticks_before = self._ticks_offset = 0

    # A camera in a process of its own --------------------------------------------------------------------------------

    def _settings(self) -> tuple[OpenniSettings]:
        if self.config.is_recording and not Path(self.config.port).is_file():
            raise NotConnected("an existing recording", "none", where=self.config.port)
        self._ticks_before = self._ticks_offset = 0
        asked = {field.name: getattr(self.config, field.name) for field in dataclasses.fields(OpenniSettings)}
        return (OpenniSettings(**asked | {"port": resolve_port(self.config.port, self._usb)}),)

    def _projection(self) -> Intrinsics | None:
        angles = self._reported["field_of_view_rad"]
        if angles is None:
            return None
        return Intrinsics.from_field_of_view(int(self._reported["width"]), int(self._reported["height"]), *angles)

    def _rate_hz(self) -> float | None:
        return None if self._as_fast_as_read else float(self.config.fps or 0) * self.config.speed

    def _fitted_clock(self) -> ClockFit | None:
        return super()._fitted_clock() if self.config.speed == 1.0 else None

    def _receive(self, timeout_s: float) -> Iterable[DepthImage]:
        if self._as_fast_as_read and not self._wanted():
            self._heard_ns = self._clock()
            self._closing.wait(0.001)
            return []
        return super()._receive(timeout_s)

    def _arrived_ns(self, frame: FrameMessage) -> int:
        """A frame that was read ahead arrives when it is requested."""
        return self._clock() if self._as_fast_as_read else frame.host_ns

    def _before(self, index: int, last: int) -> int:
        """A recording's counter begins again with each round (OpenNI2's player swallows a round's last frame)."""
        frame_count = self._reported["frame_count"]
        if index > last or frame_count is None:
            return super()._before(index, last)
        return last - int(frame_count)

    def _ticks(self, frame: FrameMessage) -> int:
        """The camera's time, which continues where a recording begins again."""
        timestamp_us = frame.timestamp_us
        if timestamp_us + self._ticks_offset < self._ticks_before and self.config.is_recording:
            self._ticks_offset = self._ticks_before + round(1e6 / max(int(self._reported["fps"]), 1)) - timestamp_us
        self._ticks_before = timestamp_us + self._ticks_offset
        return self._ticks_before

    @property
    def _as_fast_as_read(self) -> bool:
        return self.config.is_recording and self.config.speed == 0
