"""An Intel RealSense depth camera of the D400s (D405, D415, D435, D455...) through librealsense's Python module."""

import dataclasses
import math
from dataclasses import dataclass

from deformscope_drivers.depth_camera.hosted import HostedCamera
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import SettingsRefused
from deformscope_drivers.frame_message import NO_TIME_US, FrameMessage
from deformscope_drivers.images import Intrinsics
from deformscope_drivers.realsense.camera import PRESETS, RealsenseSettings, serve

LIBRARY = "pyrealsense2"
LONGEST_WARM_UP_S = 10.0


@dataclass(frozen=True, slots=True)
class RealsenseConfig(RealsenseSettings):
    """How a RealSense camera is opened and set; each setting is read back.

    serial: as `deformscope devices` prints it; empty = the only camera; width, height [px], fps [Hz]: size and rate of
    depth and of colour
    preset: `default`, `hand`, `high_accuracy`, `high_density`, `medium_density`...; empty = the camera's present one
    unit_m: the step of depth [m], such as 0.0001; None = the camera's (0.001, a D405 0.0001)
    warm_up_s: time after opening whose pictures are left out, while the exposure settles
    global_time: time stamps that librealsense fits to the host's clock, in place of the camera's own clock
    color: colour pictures too; registered: depth in the colour camera's pixels, where there is colour
    silence_s: time without a picture after which the camera counts as lost; stuck_after_s: the same picture for this
    long means a frozen one, None = it may"""

    silence_s: float = 2.0
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        if self.preset not in ("", *PRESETS):
            raise SettingsRefused(f"a preset ({', '.join(PRESETS)})", repr(self.preset), where=self.serial)
        if not (math.isfinite(self.warm_up_s) and 0 <= self.warm_up_s <= LONGEST_WARM_UP_S):
            expected = f"a warm_up_s of 0 to {LONGEST_WARM_UP_S:g}"
            raise SettingsRefused(expected, f"{self.warm_up_s:g}", where=self.serial)
        if min(self.width, self.height, self.fps) < 1:
            came = f"{self.width}x{self.height} at {self.fps} Hz"
            raise SettingsRefused("width, height and fps of 1 or more", came, where=self.serial)


class Realsense(HostedCamera):
    """`with Realsense(RealsenseConfig(serial="837212070000")) as camera: camera.next(1.0).depth_m()`

    Never tried on a camera; tried on a double of the library, and on the library itself with a camera made of software.
    library: the module that is imported there"""

    def __init__(
        self, config: RealsenseConfig, *, reconnect: Reconnect | None = RECONNECT, library: str = LIBRARY
    ) -> None:
        super().__init__(
            config.serial or "the only RealSense camera",
            serve,
            config.silence_s,
            reconnect=reconnect,
            stuck_after_s=config.stuck_after_s,
        )
        self.config = config
        self._library = library

    def remarks(self) -> tuple[str, ...]:
        """Remarks on its USB port, time stamps and firmware, and the camera's warnings."""
        return (*self._reported.get("remarks", ()), *(f"it reports: {note}" for note in self._notes))

    def _settings(self) -> tuple[RealsenseSettings, str]:
        asked = {field.name: getattr(self.config, field.name) for field in dataclasses.fields(RealsenseSettings)}
        return RealsenseSettings(**asked), self._library

    def _projection(self) -> Intrinsics:
        (fx_px, fy_px), (cx_px, cy_px) = self._reported["focal_px"], self._reported["center_px"]
        return Intrinsics(fx_px, fy_px, cx_px, cy_px, tuple(self._reported["distortion"]))

    def _ticks(self, frame: FrameMessage) -> int | None:
        return None if frame.timestamp_us == NO_TIME_US else frame.timestamp_us
