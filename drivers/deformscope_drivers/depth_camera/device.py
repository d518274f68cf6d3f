"""A depth camera through OpenNI2: an Xtion, a PrimeSense Carmine or a first Kinect; a recording of one; or a dummy."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import re
import socket
import subprocess
import time
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deformscope_drivers import errors
from deformscope_drivers.clock import ClockFit, Stamp
from deformscope_drivers.depth_camera.discovery import resolve_port
from deformscope_drivers.depth_camera.image import DepthImage, Intrinsics
from deformscope_drivers.device import RECONNECT, Device, EndOfReadings, Reconnect
from deformscope_drivers.errors import DeviceError, LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.images import QUEUE_IMAGES, fingerprint
from deformscope_drivers.openni.camera import OpenniSettings
from deformscope_drivers.openni.command import process_command, process_environment
from deformscope_drivers.openni.library import library_file
from deformscope_drivers.openni.messages import END, FAILED, FRAME, OPENED, unpack_frame, unpack_words

RECORDING_SUFFIX = ".oni"
_CAMERA = re.compile(r"(\w[\w:/@.-]*)?")
"""What OpenNI2 may be given as the name of a camera. It takes any other name for a file's, and opens that."""
OPEN_TIMEOUT_S = 20.0
END_TIMEOUT_S = 2.0
WRONG_SIZE = "size"


@dataclass(frozen=True, slots=True)
class DepthCameraConfig:
    """How a depth camera is opened and set.

    port: empty = the first camera; `usb:1-2` = the one in that socket, as `deformscope devices` prints it, which stays
    when it is plugged in again; a uri of OpenNI2's; the path of a recording (.oni); `Dummy` = OpenNI2's own test camera
    width, height [px], fps [Hz], unit_m (0.001 or 0.0001): None = as the camera has it; of a recording they are checked
    color: colour pictures too; registered: depth in the colour camera's pixels, where there is colour
    mirror: pictures mirrored, as many cameras have them unless set otherwise
    speed, loop: of a recording; speed 0 = as fast as its readers take it, and no reader loses any
    library: path or folder of libOpenNI2.so; empty = where the system has it
    silence_s: no picture for this long means a lost camera; stuck_after_s: the same picture for this long means a
    frozen one, None = it may (a recording always may)
    """

    port: str = ""
    width: int | None = None
    height: int | None = None
    fps: int | None = None
    unit_m: float | None = None
    color: bool = False
    registered: bool = True
    mirror: bool = False
    speed: float = 1.0
    loop: bool = False
    library: str = ""
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


class DepthCamera(Device[DepthImage]):
    """`with DepthCamera(DepthCameraConfig(color=True)) as camera: camera.next(1.0).depth_m()`

    OpenNI2 runs in a process of its own: what hangs or crashes there is a lost link here, and is started anew.
    Frames lost are counted by the camera's own counter. Never tried on a camera; tried on OpenNI2's dummy and on
    recordings written for it.
    """

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    def __init__(
        self,
        config: DepthCameraConfig,
        *,
        reconnect: Reconnect | None = RECONNECT,
        usb: Path = Path("/sys/bus/usb/devices"),
    ) -> None:
        if not (math.isfinite(config.speed) and config.speed >= 0):
            raise SettingsRefused("a speed of 0 or more", f"{config.speed:g}", where=config.port)
        name = config.port or "the first depth camera"
        is_file = config.is_recording
        stuck_after_s = None if is_file else config.stuck_after_s
        super().__init__(name, reconnect=None if is_file else reconnect, stuck_after_s=stuck_after_s)
        self.config = config
        self._usb = usb
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._reported: dict[str, Any] = {}
        self._intrinsics: Intrinsics | None = None
        self._heard_ns = 0
        self._last_index: int | None = None
        self._ticks_before = self._ticks_offset = 0

    @property
    def model(self) -> str:
        """The camera's maker and name, once it was opened."""
        return str(self._reported.get("name", ""))

    @property
    def serial(self) -> str:
        """The camera's serial number, once it was opened; empty where it reports none."""
        return str(self._reported.get("serial", ""))

    @property
    def intrinsics(self) -> Intrinsics | None:
        """From the camera's field of view, once it was opened; None where it reports none."""
        return self._intrinsics

    # A device --------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        if self.config.is_recording and not Path(self.config.port).is_file():
            raise NotConnected("a recording that is there", "none", where=self.config.port)
        self._start_process(resolve_port(self.config.port, self._usb))
        self._reported = self._await_opened()
        width, height = int(self._reported["width"]), int(self._reported["height"])
        angles = self._reported["field_of_view_rad"]
        self._intrinsics = None if angles is None else Intrinsics.from_field_of_view(width, height, *angles)
        self._heard_ns = self._clock()
        self._last_index = None
        self._ticks_before = self._ticks_offset = 0
        self._clock_fit = ClockFit(1000.0) if self.config.speed == 1.0 else None
        self._expect(None if self._as_fast_as_read else float(self.config.fps or 0) * self.config.speed)

    def _receive(self, timeout_s: float) -> Iterable[DepthImage]:
        if self._as_fast_as_read and not self._wanted():
            self._heard_ns = self._clock()
            self._closing.wait(0.001)
            return []
        message = self._message(timeout_s)
        if message is None:
            silence_s = (self._clock() - self._heard_ns) / 1e9
            if silence_s > self.config.silence_s:
                raise LinkLost("a picture", f"none for {silence_s:.3g} s", "look at the camera", self.name)
            return []
        self._heard_ns = self._clock()
        if message[:1] == END:
            raise EndOfReadings(f"the end of {Path(self.config.port).name}")
        if message[:1] == FAILED:
            raise LinkLost("pictures", _failure(message), where=self.name)
        return self._picture(message) if message[:1] == FRAME else []

    def _disconnect(self) -> None:
        connection, self._connection = self._connection, None
        process, self._process = self._process, None
        if connection is not None:
            connection.close()
        if process is not None:
            try:
                process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _fingerprint(self, reading: DepthImage) -> Hashable:
        return fingerprint(reading.depth)

    @property
    def _as_fast_as_read(self) -> bool:
        return self.config.is_recording and self.config.speed == 0

    # Within ----------------------------------------------------------------------------------------------------------

    def _start_process(self, uri: str) -> None:
        asked = {field.name: getattr(self.config, field.name, uri) for field in dataclasses.fields(OpenniSettings)}
        ours, theirs = socket.socketpair()
        with theirs:
            self._connection = Connection(ours.detach())
            self._process = subprocess.Popen(
                process_command(str(theirs.fileno()), json.dumps(asked)),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=process_environment(),
            )

    def _await_opened(self) -> dict[str, Any]:
        until = time.monotonic() + OPEN_TIMEOUT_S
        while time.monotonic() < until and not self._closing.is_set():
            try:
                message = self._message(0.05)
            except LinkLost as error:
                status = None if self._process is None else self._process.returncode
                came = f"the end of the process that reads it (exit status {status})"
                raise NotConnected("a depth camera", came, "another file or library", self.name) from error
            if message is None:
                continue
            if message[:1] == OPENED:
                return unpack_words(message)
            kind: type[DeviceError] = getattr(errors, str(unpack_words(message)["kind"]))
            raise kind.in_words(_failure(message))
        raise NotConnected("a depth camera", f"none within {OPEN_TIMEOUT_S:g} s", "plug it in anew", self.name)

    def _message(self, timeout_s: float) -> bytes | None:
        """The next message of the process; None when none came in time. Raises LinkLost when it has ended."""
        if self._connection is None or self._process is None:
            raise NotConnected("an open camera", "one that is closed", where=self.name)
        try:
            return self._connection.recv_bytes() if self._connection.poll(timeout_s) else None
        except (EOFError, OSError) as error:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT_S)
            came = f"its end (exit status {self._process.returncode})"
            raise LinkLost("the process that reads the camera", came, "", self.name) from error

    def _picture(self, message: bytes) -> Iterable[DepthImage]:
        frame = unpack_frame(message)
        self._count(frame.index)
        if (frame.width, frame.height) != (self._reported["width"], self._reported["height"]):
            self._count_refused(WRONG_SIZE)
            return []
        # What was read ahead has not arrived before it is wanted.
        host_ns = self._clock() if self._as_fast_as_read else frame.host_ns
        stamp = Stamp(host_ns, self._ticks(frame.timestamp_us))
        if self._clock_fit is not None and stamp.device_ticks is not None:
            self._clock_fit.add(stamp.device_ticks, stamp.host_ns)
        depth = np.frombuffer(frame.depth, np.uint16).reshape(frame.height, frame.width)
        color = None
        if frame.color:
            color = np.frombuffer(frame.color, np.uint8).reshape(frame.color_height, frame.color_width, 3)
        return [DepthImage(stamp, depth, float(self._reported["unit_m"]), color, self._intrinsics)]

    def _count(self, index: int) -> None:
        """Count what is missing before a frame, by the camera's counter; a recording's begins again with each round
        (and OpenNI2's player, at its own pace, swallows a round's last frame)."""
        last, self._last_index = self._last_index, index
        if last is None:
            return
        frame_count = self._reported["frame_count"]
        if index <= last:
            last = index - 1 if frame_count is None else last - int(frame_count)
        if index > last + 1:
            self._count_lost(index - last - 1)

    def _ticks(self, timestamp_us: int) -> int:
        """The camera's time, which goes on where a recording begins again."""
        if timestamp_us + self._ticks_offset < self._ticks_before and self.config.is_recording:
            self._ticks_offset = self._ticks_before + round(1e6 / max(int(self._reported["fps"]), 1)) - timestamp_us
        self._ticks_before = timestamp_us + self._ticks_offset
        return self._ticks_before


def _failure(message: bytes) -> str:
    return str(unpack_words(message).get("words", ""))
