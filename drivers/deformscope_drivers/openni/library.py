"""OpenNI2's C interface, as much of it as reading a depth camera takes, through ctypes.

The Python bindings on PyPI (`openni`, `primesense`) wrap the same functions. Both call `oniShutdown` when the
interpreter ends, which crashes (measured with Debian's 2.2.0.33), and need a file name that Debian does not have.
Nothing here is called in the process that records.
Sources: OpenNI2's public headers OniCAPI.h, OniCTypes.h, OniCEnums.h, OniCProperties.h (Apache-2.0)."""

import ctypes
import os
from ctypes import POINTER, Structure, byref, c_char, c_char_p, c_float, c_int, c_uint16, c_uint64, c_void_p, sizeof
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from deformscope_drivers.errors import DeviceError, LibraryMissing, LinkLost, NotConnected, SettingsRefused

API_VERSION = 2002  # OpenNI 2.2
SONAME = "libOpenNI2.so.0"
LIBRARY_NAME = "libOpenNI2.so"
REDIST = "OPENNI2_REDIST"
"""Place of the library by the vendor's installer."""
INSTALL = "sudo apt-get install -y libopenni2-0"

OK = 0
TIME_OUT = 102
DEPTH_TO_COLOR = 1
END_OF_FILE = 3
MANUAL_SPEED = -1.0


class Sensor(IntEnum):
    COLOR = 2
    DEPTH = 3


class PixelFormat(IntEnum):
    DEPTH_1_MM = 100
    DEPTH_100_UM = 101
    RGB888 = 200


UNITS_M = {PixelFormat.DEPTH_1_MM: 1e-3, PixelFormat.DEPTH_100_UM: 1e-4}


class DeviceProperty(IntEnum):
    SERIAL_NUMBER = 3
    IMAGE_REGISTRATION = 5
    PLAYBACK_SPEED = 100
    PLAYBACK_REPEAT = 101


class StreamProperty(IntEnum):
    HORIZONTAL_FOV = 1
    VERTICAL_FOV = 2
    VIDEO_MODE = 3
    MIRRORING = 7
    NUMBER_OF_FRAMES = 8


class _VideoMode(Structure):
    _fields_ = (("pixel_format", c_int), ("width", c_int), ("height", c_int), ("fps", c_int))


class _DeviceInfo(Structure):
    _fields_ = (
        *((name, c_char * 256) for name in ("uri", "vendor", "name")),
        *((name, c_uint16) for name in ("usb_vendor", "usb_product")),
    )


class _Frame(Structure):
    _fields_ = (
        ("data_size", c_int),
        ("data", c_void_p),
        ("sensor", c_int),
        ("timestamp_us", c_uint64),
        *((name, c_int) for name in ("index", "width", "height")),
        ("mode", _VideoMode),
        *((name, c_int) for name in ("cropped", "crop_x", "crop_y", "stride")),
    )


class _Callbacks(Structure):
    _fields_ = (("connected", c_void_p), ("disconnected", c_void_p), ("state_changed", c_void_p))


_INFO_CALLBACK = ctypes.CFUNCTYPE(None, POINTER(_DeviceInfo), c_void_p)
_STATE_CALLBACK = ctypes.CFUNCTYPE(None, POINTER(_DeviceInfo), c_int, c_void_p)


@dataclass(frozen=True, slots=True)
class Mode:
    """A stream's size [px], rate [Hz] and format."""

    width: int
    height: int
    fps: int
    pixel_format: int


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame's data, without padding. timestamp_us: the camera's [us]; index: the camera's count of frames"""

    timestamp_us: int
    index: int
    width: int
    height: int
    pixel_format: int
    data: bytes

    @property
    def is_whole(self) -> bool:
        """Whether the data fill the frame: those of a damaged recording may not."""
        return len(self.data) == self.width * self.height * pixel_bytes(self.pixel_format)


@dataclass(frozen=True, slots=True)
class ListedDevice:
    """A camera that OpenNI2 sees."""

    uri: str
    vendor: str
    name: str
    usb_vendor: int
    usb_product: int


class Openni:
    """The library, loaded and initialised. library: its path or folder; empty = the system's"""

    def __init__(self, library: str = "") -> None:
        self.lib = load(library)
        self._events: list[tuple[str, int]] = []
        self._held: list[Any] = []
        self.check(self.lib.oniInitialize(API_VERSION), "OpenNI2 with its drivers")
        gone = _INFO_CALLBACK(lambda _info, _cookie: self._events.append(("disconnected", 0)))
        state = _STATE_CALLBACK(lambda _info, number, _cookie: self._events.append(("state", number)))
        handle = c_void_p()
        callbacks = _Callbacks(None, ctypes.cast(gone, c_void_p), ctypes.cast(state, c_void_p))
        self._held += [gone, state, callbacks, handle]  # the library calls them from its own threads
        self.lib.oniRegisterDeviceCallbacks(byref(callbacks), None, byref(handle))

    def check(self, status: int, expected: str, where: str = "", error: type[DeviceError] = NotConnected) -> None:
        """Raises `error` where a call's status is not OK. expected: what the call was for"""
        if status != OK:
            words = (self.lib.oniGetExtendedError() or b"").decode(errors="replace")
            raise error(expected, " ".join(words.split()) or f"status {status}", where=where)

    def devices(self) -> list[ListedDevice]:
        """The cameras that are plugged in."""
        first, count = POINTER(_DeviceInfo)(), c_int()
        self.check(self.lib.oniGetDeviceList(byref(first), byref(count)), "a list of cameras")
        found = [_listed(first[index]) for index in range(count.value)]
        self.lib.oniReleaseDeviceList(first)
        return found

    def open(self, uri: str) -> "OpenniDevice":
        """Open a camera, or a recording by its path; an empty uri is the first camera."""
        handle = c_void_p()
        status = self.lib.oniDeviceOpen(uri.encode() if uri else None, byref(handle))
        self.check(status, "a depth camera, or a recording that can be played", uri)
        return OpenniDevice(self, handle, uri)

    def take_events(self) -> list[tuple[str, int]]:
        """Events of cameras since the last call: ("disconnected", 0) or ("state", number)."""
        events, self._events = self._events, []
        return events

    def wait(self, streams: "list[OpenniStream]", timeout_s: float) -> "OpenniStream | None":
        """The stream that has a frame; None when none came in time."""
        handles = (c_void_p * len(streams))(*[stream.handle for stream in streams])
        index = c_int(-1)
        timeout_ms = max(round(timeout_s * 1e3), 1)
        status = self.lib.oniWaitForAnyStream(handles, len(streams), byref(index), timeout_ms)
        if status == TIME_OUT:
            return None
        self.check(status, "a frame", error=LinkLost)
        return streams[index.value]


class OpenniDevice:
    """An opened camera or recording."""

    def __init__(self, openni: Openni, handle: c_void_p, uri: str) -> None:
        self._openni, self._lib, self.handle, self._uri = openni, openni.lib, handle, uri

    def info(self) -> ListedDevice:
        info = _DeviceInfo()
        self._openni.check(self._lib.oniDeviceGetInfo(self.handle, byref(info)), "a camera's name", self._uri)
        return _listed(info)

    def serial(self) -> str:
        """Its serial number; empty where it does not report one."""
        text, size = ctypes.create_string_buffer(256), c_int(256)
        if self._lib.oniDeviceGetProperty(self.handle, DeviceProperty.SERIAL_NUMBER, text, byref(size)) != OK:
            return ""
        return text.value.decode(errors="replace")

    @property
    def is_recording(self) -> bool:
        return bool(self._lib.oniDeviceIsPropertySupported(self.handle, DeviceProperty.PLAYBACK_SPEED))

    def play(self, speed: float, repeat: bool) -> None:
        """Play a recording: at a speed, or frame by frame as they are read (MANUAL_SPEED); again from its end."""
        for number, value in (
            (DeviceProperty.PLAYBACK_SPEED, c_float(speed)),
            (DeviceProperty.PLAYBACK_REPEAT, c_int(repeat)),
        ):
            status = self._lib.oniDeviceSetProperty(self.handle, number, byref(value), sizeof(value))
            self._openni.check(status, f"a recording that plays at speed {speed:g}", self._uri, SettingsRefused)

    def register_depth_to_color(self) -> None:
        """Have depth pictures in the colour camera's pixels. Raises SettingsRefused."""
        value, size = c_int(DEPTH_TO_COLOR), c_int(sizeof(c_int))
        number = DeviceProperty.IMAGE_REGISTRATION
        self._lib.oniDeviceSetProperty(self.handle, number, byref(value), sizeof(value))
        came = c_int(0)
        if (
            self._lib.oniDeviceGetProperty(self.handle, number, byref(came), byref(size)) != OK
            or came.value != value.value
        ):
            raise SettingsRefused(
                "depth registered to colour", "a camera that does not", "registered = false", self._uri
            )
        self._lib.oniDeviceEnableDepthColorSync(self.handle)

    def stream(self, sensor: Sensor) -> "OpenniStream":
        handle = c_void_p()
        status = self._lib.oniDeviceCreateStream(self.handle, sensor, byref(handle))
        self._openni.check(status, f"a camera with a {sensor.name.lower()} stream", self._uri, SettingsRefused)
        return OpenniStream(self._openni, handle, sensor, self._uri)

    def close(self) -> None:
        self._lib.oniDeviceClose(self.handle)


class OpenniStream:
    """A camera's depth or colour."""

    def __init__(self, openni: Openni, handle: c_void_p, sensor: Sensor, uri: str) -> None:
        self._openni, self._lib, self.handle, self.sensor, self._uri = openni, openni.lib, handle, sensor, uri

    def mode(self) -> Mode:
        mode, size = _VideoMode(), c_int(sizeof(_VideoMode))
        status = self._lib.oniStreamGetProperty(self.handle, StreamProperty.VIDEO_MODE, byref(mode), byref(size))
        self._openni.check(status, "a stream that reports its size", self._uri)
        return Mode(mode.width, mode.height, mode.fps, mode.pixel_format)

    def set_mode(self, mode: Mode) -> None:
        """Request a mode; `mode` is the one in force."""
        asked = _VideoMode(mode.pixel_format, mode.width, mode.height, mode.fps)
        self._lib.oniStreamSetProperty(self.handle, StreamProperty.VIDEO_MODE, byref(asked), sizeof(asked))

    def mirror(self) -> bool | None:
        """Whether pictures are mirrored; None where the camera does not say."""
        value, size = c_int(), c_int(sizeof(c_int))
        status = self._lib.oniStreamGetProperty(self.handle, StreamProperty.MIRRORING, byref(value), byref(size))
        return bool(value.value) if status == OK else None

    def frame_count(self) -> int | None:
        """Number of frames of a recording; None for a camera."""
        value, size = c_int(), c_int(sizeof(c_int))
        number = StreamProperty.NUMBER_OF_FRAMES
        status = self._lib.oniStreamGetProperty(self.handle, number, byref(value), byref(size))
        return value.value if status == OK else None

    def set_mirror(self, mirror: bool) -> None:
        value = c_int(mirror)
        self._lib.oniStreamSetProperty(self.handle, StreamProperty.MIRRORING, byref(value), sizeof(value))

    def field_of_view_rad(self) -> tuple[float, float] | None:
        """Horizontal and vertical [rad]; None where the camera does not say."""
        angles = []
        for number in (StreamProperty.HORIZONTAL_FOV, StreamProperty.VERTICAL_FOV):
            value, size = c_float(), c_int(sizeof(c_float))
            if self._lib.oniStreamGetProperty(self.handle, number, byref(value), byref(size)) != OK or value.value <= 0:
                return None
            angles.append(float(value.value))
        return angles[0], angles[1]

    def start(self) -> None:
        self._openni.check(self._lib.oniStreamStart(self.handle), "a stream that starts", self._uri)

    def read(self) -> Frame:
        """The waiting frame. It blocks forever without one, so call it only after `Openni.wait`."""
        pointer = POINTER(_Frame)()
        status = self._lib.oniStreamReadFrame(self.handle, byref(pointer))
        self._openni.check(status, "a frame", self._uri, LinkLost)
        frame = pointer.contents
        try:
            row = frame.width * pixel_bytes(frame.mode.pixel_format)
            data = ctypes.string_at(frame.data, frame.data_size)
            if frame.stride > row:
                data = b"".join(data[at : at + row] for at in range(0, frame.stride * frame.height, frame.stride))
            mode = frame.mode.pixel_format
            return Frame(frame.timestamp_us, frame.index, frame.width, frame.height, mode, data)
        finally:
            self._lib.oniFrameRelease(pointer)

    def close(self) -> None:
        self._lib.oniStreamStop(self.handle)
        self._lib.oniStreamDestroy(self.handle)


def pixel_bytes(pixel_format: int) -> int:
    """Bytes per pixel."""
    return 3 if pixel_format == PixelFormat.RGB888 else 2


def load(library: str = "") -> ctypes.CDLL:
    """Load OpenNI2; raises LibraryMissing. The library finds its drivers in `OpenNI2/Drivers` in its folder."""
    redist = os.environ.get(REDIST)
    tried = [*([str(Path(redist) / LIBRARY_NAME)] if redist else []), SONAME, LIBRARY_NAME]
    if library:
        tried = [str(library_file(library))]
    for path in tried:
        try:
            lib = ctypes.CDLL(path)
        except OSError:
            continue
        lib.oniGetExtendedError.restype = c_char_p
        for name in ("oniStreamDestroy", "oniStreamStop", "oniFrameRelease", "oniUnregisterDeviceCallbacks"):
            getattr(lib, name).restype = None
        return lib
    raise LibraryMissing("OpenNI2", "none that loads", INSTALL, ", ".join(tried))


def library_file(path: str) -> Path:
    """The library file of a path: the file itself, or the file of the vendor's name in a folder."""
    chosen = Path(path).expanduser()
    return chosen / LIBRARY_NAME if chosen.is_dir() else chosen


def _listed(info: _DeviceInfo) -> ListedDevice:
    uri, vendor, name = (text.decode(errors="replace") for text in (info.uri, info.vendor, info.name))
    return ListedDevice(uri, vendor, name, info.usb_vendor, info.usb_product)
