"""Replaces the module pyrealsense2, as far as `camera.py` uses it, by cameras that a file describes.

It behaves as librealsense 2.59 does with a software camera, and as its source and issues describe:
- frames have numbers and time stamps from a camera on its own clock: a late reader finds numbers missing
- an empty queue reports that after its time; a camera that was unplugged gives no more frames, and an event
- the hardware clock wraps after 2^32 us; without the kernel's metadata the host stamps frames
- starting a camera that another process reads, or in an unsupported mode, raises RuntimeError with the library's words
The file that the environment names (CAMERAS_FILE) is read again whenever it changes; without it one camera is there."""

import dataclasses
import fcntl
import json
import os
import random
import struct
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

CAMERAS_FILE = "DEFORMSCOPE_REALSENSE_DOUBLE"
MODES = {"3.2": ((1280, 720, 30), (848, 480, 90), (640, 480, 30), (64, 48, 200)), "2.1": ((480, 270, 15), (64, 48, 6))}
"""Width, height and highest rate, by USB; those of a D435, and a small one that tests read quickly."""
CLOCK_ROUND_US = 2**32
WALL_M, NOISE_M = 0.6, 0.0008
"""Its scene: a wall, and the error of each pixel [m]."""
FOCAL_OF_WIDTH = 0.5044
"""Focal length over width: 427.7 px at 848 px, as a D435's (issue 11511)."""


@dataclass(frozen=True, slots=True)
class DoubleCamera:
    """A simulated camera with its faults.

    usb: "3.2" or "2.1"; hidden: what keeps the library from knowing it; busy: what starting it raises
    silent: no frames; frozen: the same picture; hung: a call that never comes back; lost: frames lost so far
    clock_us: reading of its clock at the host's zero; metadata: the kernel passes its time stamps
    drifting_unit_m: the unit of its frames, whatever was set; notes: its warnings; deaf: it ignores settings; lens:
    distortion of its colour camera; color_late_ms: delay of its stamps relative to those of depth
    repeating: a picture of depth comes again with the next one's colour, as where pairs do not match"""

    serial: str = "837212070000"
    name: str = "Intel RealSense D435"
    firmware: str = "5.16.0.1"
    recommended: str = "5.16.0.1"
    usb: str = "3.2"
    hidden: str = ""
    busy: str = ""
    silent: bool = False
    frozen: bool = False
    hung: bool = False
    lost: int = 0
    clock_us: int = 0
    metadata: bool = True
    drifting_unit_m: float = 0.0
    notes: tuple[str, ...] = ()
    deaf: bool = False
    lens: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    color_late_ms: float = 2.0
    repeating: bool = False


def plug(file: Path, *cameras: DoubleCamera) -> None:
    """From now on these cameras are present, for processes that were started with that file as CAMERAS_FILE."""
    written = file.with_suffix(".new")
    written.write_text(json.dumps([dataclasses.asdict(one) for one in cameras]), encoding="utf-8")
    written.replace(file)


class _World:
    """The cameras that are plugged in, from the file that CAMERAS_FILE names; read again whenever it changed."""

    def __init__(self) -> None:
        self._file = os.environ.get(CAMERAS_FILE, "")
        self._seen = (0, 0)
        self._cameras: tuple[DoubleCamera, ...] = () if self._file else (DoubleCamera(),)
        self._locks: list[int] = []

    def cameras(self) -> tuple[DoubleCamera, ...]:
        if self._file:
            now = Path(self._file).stat()
            if (now.st_ino, now.st_mtime_ns) != self._seen:
                self._seen = now.st_ino, now.st_mtime_ns
                read = json.loads(Path(self._file).read_text(encoding="utf-8"))
                self._cameras = tuple(DoubleCamera(**one) for one in read)
        return self._cameras

    def camera(self, serial: str) -> DoubleCamera | None:
        return next((one for one in self.cameras() if one.serial == serial), None)

    def lock(self, serial: str) -> None:
        """Have a camera for this process alone, until it ends."""
        if not self._file:
            return
        handle = os.open(f"{self._file}.{serial}", os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(handle)
            raise RuntimeError("xioctl(VIDIOC_S_FMT) failed, errno=16 Last Error: Device or resource busy") from error
        self._locks.append(handle)


_world = _World()


def _answers(**values: Any) -> Any:
    """An object of the library whose methods, without arguments, return these values."""
    return SimpleNamespace(**{name: lambda value=value: value for name, value in values.items()})


# The library's names -------------------------------------------------------------------------------------------------


class stream(IntEnum):
    depth = 1
    color = 2


class format(IntEnum):
    z16 = 1
    rgb8 = 5


class option(IntEnum):
    visual_preset = 12
    depth_units = 28
    auto_exposure_priority = 30
    global_time_enabled = 56


class rs400_visual_preset(IntEnum):
    custom = 0
    default = 1
    hand = 2
    high_accuracy = 3
    high_density = 4
    medium_density = 5
    remove_ir_pattern = 6
    edge_enhancement = 7


class camera_info:
    name = 0
    serial_number = 1
    firmware_version = 2
    recommended_firmware_version = 3
    usb_type_descriptor = 9


class timestamp_domain(IntEnum):
    hardware_clock = 0
    system_time = 1
    global_time = 2


class distortion(IntEnum):
    none = 0
    modified_brown_conrady = 1
    inverse_brown_conrady = 2
    ftheta = 3
    brown_conrady = 4


def video_stream_profile(of: stream, width: int, height: int, fps: int, coeffs: tuple[float, ...] = (0.0,) * 5) -> Any:
    """Mode of one stream; coeffs: distortion of its lens."""
    focal = FOCAL_OF_WIDTH * width
    model = distortion.brown_conrady if of is stream.depth else distortion.inverse_brown_conrady
    lens = {"fx": focal, "fy": focal, "ppx": width / 2 - 1.6, "ppy": height / 2 - 6.2}
    intrinsics = SimpleNamespace(**lens, coeffs=list(coeffs), model=model)
    profile = _answers(stream_type=of, width=width, height=height, fps=fps, get_intrinsics=intrinsics)
    profile.as_video_stream_profile = lambda: profile
    return profile


class sensor:
    """The sensor of depth or colour, with the settings of one device object, which end with it."""

    def __init__(self, serial: str, of: stream) -> None:
        self._serial, self._of = serial, of
        self.options = {option.global_time_enabled: 1.0}
        self.options |= (
            {option.visual_preset: 1.0, option.depth_units: 0.001}
            if of is stream.depth
            else {option.auto_exposure_priority: 1.0}
        )
        self.noted: Callable[[Any], None] = lambda note: None

    def supports(self, wanted: option) -> bool:
        return wanted in self.options

    def get_option(self, wanted: option) -> float:
        return _float32(self.options[wanted])

    def set_option(self, wanted: option, value: float) -> None:
        if wanted not in self.options:
            raise RuntimeError(f"object doesn't support option {wanted.name}")
        if (camera := _world.camera(self._serial)) is not None and camera.deaf:
            return
        if wanted is option.depth_units:  # stored in whole micrometres, cut off (src/ds/ds-options.cpp)
            value = int(_float32(1e6 * _float32(value))) * 1e-6
        self.options[wanted] = value

    def get_depth_scale(self) -> float:
        return self.get_option(option.depth_units)

    def get_stream_profiles(self) -> list[Any]:
        camera = _world.camera(self._serial)
        modes = () if camera is None else MODES[camera.usb]
        return [video_stream_profile(self._of, *mode) for mode in modes]

    def set_notifications_callback(self, callback: Callable[[Any], None]) -> None:
        self.noted = callback


class device:
    def __init__(self, serial: str) -> None:
        self.serial = serial
        self.depth, self.color = sensor(serial, stream.depth), sensor(serial, stream.color)

    def supports(self, info: int) -> bool:
        return self._infos().get(info) is not None

    def get_info(self, info: int) -> str:
        camera = _world.camera(self.serial)
        if camera is not None and camera.hidden:
            raise RuntimeError(camera.hidden)
        found = self._infos().get(info)
        if found is None:
            raise RuntimeError("info does not exist")
        return found

    def _infos(self) -> dict[int, str]:
        camera = _world.camera(self.serial)
        if camera is None:
            return {}
        names = camera_info
        infos = {names.name: camera.name, names.serial_number: camera.serial, names.firmware_version: camera.firmware}
        return infos | {names.recommended_firmware_version: camera.recommended, names.usb_type_descriptor: camera.usb}

    def first_depth_sensor(self) -> sensor:
        return self.depth

    def query_sensors(self) -> list[sensor]:
        return [self.depth, self.color]


class context:
    def __init__(self) -> None:
        self._callback: Callable[[Any], None] | None = None

    def query_devices(self) -> list[device]:
        return [device(one.serial) for one in _world.cameras()]

    def set_devices_changed_callback(self, callback: Callable[[Any], None]) -> None:
        self._callback = callback

    def lose(self, serial: str) -> None:
        """A camera was unplugged."""
        if self._callback is not None:
            self._callback(SimpleNamespace(was_removed=lambda one: one.serial == serial))


class config:
    def __init__(self) -> None:
        self.serial = ""
        self.streams: dict[stream, tuple[int, int, int]] = {}

    def enable_device(self, serial: str) -> None:
        self.serial = serial

    def enable_stream(self, of: stream, width: int, height: int, _: format, fps: int) -> None:
        self.streams[of] = (width, height, fps)


def frame(
    data: bytes, size: tuple[int, int], number: int, ms: float, domain: timestamp_domain, unit_m: float = 0.0
) -> Any:
    """Depth or colour of one moment."""
    return _answers(
        get_data=data,
        get_frame_number=number,
        get_timestamp=ms,
        get_frame_timestamp_domain=domain,
        get_units=unit_m,
        get_width=size[0],
        get_height=size[1],
        get_stride_in_bytes=len(data) // max(size[1], 1),
    )


def frameset(depth: Any, color: Any) -> Any:
    frames = _answers(get_depth_frame=depth, get_color_frame=color)
    frames.as_frameset = lambda: frames
    return frames


class align:
    """The double's two cameras are at one place: depth is on colour's pixels already."""

    def __init__(self, _: stream) -> None:
        pass

    def process(self, frames: Any) -> Any:
        return frames


class pipeline:
    def __init__(self, of: context) -> None:
        self._context = of

    def start(self, asked: config, queue: "frame_queue") -> Any:
        camera = _world.camera(asked.serial)
        if camera is None:
            raise RuntimeError("No device connected")
        for width, height, fps in asked.streams.values():
            if not any((width, height) == mode[:2] and fps <= mode[2] for mode in MODES[camera.usb]):
                raise RuntimeError("Couldn't resolve requests")
        if camera.busy:
            raise RuntimeError(camera.busy)
        _world.lock(camera.serial)
        lens = {stream.color: camera.lens}
        streams = {of: video_stream_profile(of, *mode, lens.get(of, (0.0,) * 5)) for of, mode in asked.streams.items()}
        opened = device(camera.serial)
        queue.source = Streaming(opened, streams, self._context)
        return SimpleNamespace(get_device=lambda: opened, get_stream=streams.__getitem__)

    def stop(self) -> None:
        pass


class frame_queue:
    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self.source: Streaming | None = None

    def try_wait_for_frame(self, timeout_ms: int) -> tuple[bool, Any]:
        if self.source is None:
            time.sleep(timeout_ms / 1e3)
            return False, None
        found = self.source.next(time.monotonic() + timeout_ms / 1e3, self._capacity)
        return found is not None, found


class Streaming:
    """A camera that runs: its next frame when it is due."""

    def __init__(self, opened: device, streams: dict[stream, Any], of: context) -> None:
        self._device, self._context = opened, of
        self._depth = streams[stream.depth]
        self._color = stream.color in streams
        self._start_s, self._number = time.monotonic(), 0
        self._noted: set[str] = set()
        self._lines: dict[float, bytes] = {}

    def next(self, until_s: float, capacity: int) -> Any:
        """The next frames, None when none are due in time. capacity: largest number of frames that wait"""
        fps = self._depth.fps()
        camera = _world.camera(self._device.serial)
        due = max(self._number + 1, int((time.monotonic() - self._start_s) * fps) - capacity + 1)
        due_s = self._start_s + due / fps
        time.sleep(max(min(due_s, until_s) - time.monotonic(), 0.0))
        if camera is None:
            self._context.lose(self._device.serial)
        if camera is None or camera.silent or due_s > until_s:
            time.sleep(max(until_s - time.monotonic(), 0.0))
            return None
        while camera.hung:
            time.sleep(1.0)
        self._number = due
        for words in camera.notes:
            if words not in self._noted:
                self._noted.add(words)
                self._device.depth.noted(_answers(get_description=words))
        return self._seen(camera, due, due_s)

    def _seen(self, camera: DoubleCamera, due: int, due_s: float) -> Any:
        options = self._device.depth.options
        unit_m = camera.drifting_unit_m or self._device.depth.get_depth_scale()
        domain, ms = timestamp_domain.hardware_clock, (camera.clock_us + due_s * 1e6) % CLOCK_ROUND_US / 1e3
        if not camera.metadata:
            domain, ms = timestamp_domain.system_time, time.monotonic() * 1e3
        elif options[option.global_time_enabled]:
            domain, ms = timestamp_domain.global_time, (camera.clock_us + due_s * 1e6) / 1e3
        number = due - (due % 2 if camera.repeating else 0) + camera.lost
        size = self._depth.width(), self._depth.height()
        depth = frame(self._wall(0 if camera.frozen else due, unit_m), size, number, ms, domain, unit_m)
        if not self._color:
            return frameset(depth, None)
        color = bytes((due % 256, 100, 200)) * (size[0] * size[1])
        return frameset(depth, frame(color, size, number, ms + camera.color_late_ms, domain))

    def _wall(self, shown: int, unit_m: float) -> bytes:
        """Each row is another piece of one long line of noise."""
        width, height = self._depth.width(), self._depth.height()
        if unit_m not in self._lines:
            noise = random.Random(7)
            line = array("H", (round(noise.gauss(WALL_M, NOISE_M) / unit_m) for _ in range(2 * width)))
            self._lines[unit_m] = line.tobytes()
        line_bytes, starts = self._lines[unit_m], ((7 * shown + 13 * row) % width for row in range(height))
        return b"".join(line_bytes[2 * start : 2 * (start + width)] for start in starts)


def _float32(value: float) -> float:
    """A number rounded to 32-bit floating point, in which the library stores it."""
    return float(struct.unpack("f", struct.pack("f", value))[0])
