"""A RealSense camera by librealsense: chosen by its serial number, configured, every setting read back.

Frames come through a frame queue. `pipeline.wait_for_frames` is not used: after the loss of a camera it blocks for up
to 15 s, and restarts it without the settings (librealsense, src/pipeline/pipeline.cpp). `rs`: the module pyrealsense2,
or its replacement. `Realsense` runs `serve` in a process of its own (`deformscope_drivers.hosted`): a hang or a crash
of the library ends neither program nor recording."""

import importlib
import threading
import time
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from deformscope_drivers.clock import Unwrap
from deformscope_drivers.errors import Busy, DeviceError, LibraryMissing, LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.frame_message import INDEX_MASK, NO_TIME_US, FrameMessage
from deformscope_drivers.hosted import Channel, exit_without_cleanup

INSTALL = "pip install deformscope[realsense]"
UDEV = (
    "librealsense's udev rules (config/99-realsense-libusb.rules into /etc/udev/rules.d), then reconnect it; "
    "in a container pass /dev through as a whole"
)
NO_PICTURES = "a USB 3 port of the computer itself and the camera's own cable; reconnect it"
_BUSY = ("busy", "errno=16", "failed to set power state")
_DENIED = ("status_access", "permission denied", "operation not permitted", "errno=13", "errno=1,")


PRESETS = (
    *("custom", "default", "hand", "high_accuracy", "high_density", "medium_density"),
    *("remove_ir_pattern", "edge_enhancement"),
)
"""Names of rs400_visual_preset's members."""
CLOCK_ROUND_US = 2**32
"""The hardware clock counts microseconds in 32 bits: it wraps after 71.6 minutes."""
FIRST_FRAME_S = 6.0
QUEUE_FRAMES = 8
"""Share of the library's own 16: it cannot fill a frame again while that is in use."""
UNIT_STEP_M = 1.01e-6
"""The camera stores its unit in whole micrometres, cut off."""


@dataclass(frozen=True, slots=True)
class RealsenseSettings:
    """How a camera is opened. serial: empty = the only one; preset: empty, unit_m: None = the camera's present ones
    warm_up_s: time whose pictures are left out, while the exposure settles; global_time: stamps on the host's clock"""

    serial: str = ""
    width: int = 848
    height: int = 480
    fps: int = 30
    preset: str = ""
    unit_m: float | None = None
    warm_up_s: float = 1.0
    global_time: bool = False
    color: bool = False
    registered: bool = True


@dataclass(frozen=True, slots=True)
class ListedRealsense:
    """A camera that librealsense sees. usb: "3.2", "2.1"; trouble: why it could not be read, else empty"""

    serial: str
    name: str = ""
    firmware: str = ""
    usb: str = ""
    trouble: str = ""


def listed(rs: ModuleType) -> list[ListedRealsense]:
    """The connected cameras; with its trouble for one that the library cannot open."""
    try:
        return [_described(rs, device) for device in rs.context().query_devices()]
    except RuntimeError as error:
        return [_troubled(error)]


class RealsenseCamera:
    """A camera that streams, configured. Raises DeviceError."""

    def __init__(self, settings: RealsenseSettings, rs: ModuleType) -> None:
        self._rs, self._settings = rs, settings
        self._context = rs.context()
        self._device, self._known = self._choose()
        self._where = self._known.serial
        self._gone = threading.Event()
        self._notes: list[str] = []
        self._context.set_devices_changed_callback(self._changed)
        self._queue = rs.frame_queue(QUEUE_FRAMES)
        self._pipeline = rs.pipeline(self._context)
        self._profile = self._start()
        self._device = self._profile.get_device()
        self._sensor = self._device.first_depth_sensor()
        self._align = rs.align(rs.stream.color) if self._registers else None
        self._last_number: int | None = None
        self._domain: Any = None
        self._unwrap = Unwrap(CLOCK_ROUND_US, 1e3)
        self._unit_m = self._set()
        self._warm_up()

    def words(self) -> dict[str, object]:
        """Message to the program when the camera is open: sizes [px], rate [Hz], unit [m], lens, names, remarks."""
        rs = self._rs
        seen = self._stream(rs.stream.color if self._registers else rs.stream.depth)
        lens = seen.get_intrinsics()
        return {
            "width": seen.width(),
            "height": seen.height(),
            "fps": self._stream(rs.stream.depth).fps(),
            "unit_m": round(self._unit_m, 9),  # it is a float of 32 bits
            "focal_px": (lens.fx, lens.fy),
            "center_px": (lens.ppx, lens.ppy),
            "distortion": self._distortion(lens),
            "name": self._known.name,
            "serial": self._known.serial,
            "firmware": self._known.firmware,
            "remarks": self._remarks(),
        }

    def next(self, timeout_s: float) -> FrameMessage | None:
        """The next picture, None when none came in time. Raises LinkLost."""
        frames, host_ns = self._frames(timeout_s)
        if frames is None:
            return None
        depth = frames.get_depth_frame()
        # Depth and colour that do not belong together come as a pair with what came last of the other (aggregator.cpp).
        if not depth or depth.get_frame_number() == self._last_number:
            return None
        self._last_number = int(depth.get_frame_number())
        unit_m = depth.get_units()
        if abs(unit_m - self._unit_m) > UNIT_STEP_M:
            came = f"of {unit_m:g} m (set by another program?)"
            raise LinkLost(f"depth in steps of {self._unit_m:g} m", came, where=self._where)
        timestamp_us = self._timestamp_us(depth, host_ns)
        color = self._color_of(frames, depth)
        if self._align is not None:
            depth = self._align.process(frames).get_depth_frame()
        width, height = depth.get_width(), depth.get_height()
        data, number = _packed(depth, 2), self._last_number & INDEX_MASK
        if color is None:
            return FrameMessage(host_ns, timestamp_us, number, width, height, 0, 0, data, b"")
        wide, high = color.get_width(), color.get_height()
        return FrameMessage(host_ns, timestamp_us, number, width, height, wide, high, data, _packed(color, 3))

    def take_notes(self) -> list[str]:
        """Warnings of the camera since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def close(self) -> None:
        self._pipeline.stop()

    # Within ----------------------------------------------------------------------------------------------------------

    def _choose(self) -> tuple[Any, ListedRealsense]:
        """By serial number, before anything is started: the library waits 15 s for a camera that is not there."""
        serial = self._settings.serial
        devices = [(device, _described(self._rs, device)) for device in self._context.query_devices()]
        chosen = [found for found in devices if serial in ("", found[1].serial)]
        there = ", ".join(known.serial or known.trouble for _, known in devices) or "none"
        if not chosen:
            try_this = "deformscope devices" if devices else f"plug it in; {UDEV}"
            what = f"RealSense camera {serial}" if serial else "a RealSense camera"
            raise NotConnected(what, there, try_this, serial or "realsense")
        if len(chosen) > 1:
            raise NotConnected("serial = one of several RealSense cameras", "no serial", there, "realsense")
        if chosen[0][1].trouble:
            raise meaning(RuntimeError(chosen[0][1].trouble), "a RealSense camera", serial or "realsense")
        return chosen[0]

    def _start(self) -> Any:
        rs, settings = self._rs, self._settings
        asked = rs.config()
        asked.enable_device(self._known.serial)
        size = settings.width, settings.height
        asked.enable_stream(rs.stream.depth, *size, rs.format.z16, settings.fps)
        if settings.color:
            asked.enable_stream(rs.stream.color, *size, rs.format.rgb8, settings.fps)
        try:
            return self._pipeline.start(asked, self._queue)
        except RuntimeError as error:
            if "resolve requests" not in str(error):
                raise meaning(error, "a RealSense camera that starts", self._where) from error
            expected = f"{size[0]}x{size[1]} at {settings.fps} Hz" + (" with colour" if settings.color else "")
            came = f"a camera on USB {self._known.usb or '(unknown)'} without it"
            port = "a USB 3 port and cable, or " if self._known.usb.startswith("2") else ""
            raise SettingsRefused(expected, came, f"{port}one of {self._modes()}", self._where) from error

    def _modes(self) -> str:
        """Depth modes of the camera in its present connection, the largest at each rate."""
        largest: dict[int, tuple[int, int]] = {}
        for profile in self._device.first_depth_sensor().get_stream_profiles():
            if profile.stream_type() == self._rs.stream.depth:
                video = profile.as_video_stream_profile()
                size = video.width(), video.height()
                largest[video.fps()] = max(largest.get(video.fps(), size), size)
        return ", ".join(f"{w}x{h} at {fps} Hz" for fps, (w, h) in sorted(largest.items())) or "none"

    def _set(self) -> float:
        """A preset, which is a table of many settings, before the unit. The unit that is in force [m]."""
        rs, settings = self._rs, self._settings
        for sensor in self._device.query_sensors():
            if sensor.supports(rs.option.global_time_enabled):
                sensor.set_option(rs.option.global_time_enabled, float(settings.global_time))
            if settings.color and sensor.supports(rs.option.auto_exposure_priority):
                sensor.set_option(rs.option.auto_exposure_priority, 0.0)  # else colour slows down in the dark
            sensor.set_notifications_callback(self._noted)
        if settings.preset:
            preset = float(int(getattr(rs.rs400_visual_preset, settings.preset)))
            self._put(rs.option.visual_preset, preset, f"preset {settings.preset}", 0.0)
        if settings.unit_m is not None:
            self._put(rs.option.depth_units, settings.unit_m, f"steps of {settings.unit_m:g} m", UNIT_STEP_M)
        return float(self._sensor.get_depth_scale())

    def _put(self, option: object, value: float, expected: str, off: float) -> None:
        try:
            self._sensor.set_option(option, value)
            came = self._sensor.get_option(option)
        except RuntimeError as error:
            words = " ".join(str(error).split())
            raise SettingsRefused(expected, words, "another value, or firmware", self._where) from error
        if abs(came - value) > off:
            raise SettingsRefused(expected, f"{came:g}", "another value", self._where)

    def _warm_up(self) -> None:
        """Until pictures come and the exposure has settled; the clock of the last one is the camera's."""
        until = time.monotonic() + FIRST_FRAME_S
        seen_s: float | None = None
        while seen_s is None or time.monotonic() - seen_s < self._settings.warm_up_s:
            frames, _ = self._frames(0.05)
            if frames is not None:
                seen_s = time.monotonic() if seen_s is None else seen_s
                self._domain = frames.get_depth_frame().get_frame_timestamp_domain()
            if seen_s is None and time.monotonic() > until:
                raise NotConnected(f"pictures within {FIRST_FRAME_S:g} s", "none", NO_PICTURES, self._where)

    def _frames(self, timeout_s: float) -> tuple[Any, int]:
        """Frames of one moment and when they came [ns]; None when none came in time. Raises LinkLost."""
        if self._gone.is_set():
            raise LinkLost("a camera that is there", "none (unplugged?)", "check the cable", self._where)
        came, frame = self._queue.try_wait_for_frame(max(round(timeout_s * 1e3), 1))
        host_ns = time.monotonic_ns()
        return (frame.as_frameset() if came else None), host_ns

    def _color_of(self, frames: Any, depth: Any) -> Any:
        """Colour within half a period of depth, by their own clock; None where there is none."""
        color = frames.get_color_frame() if self._settings.color else None
        if not color or color.get_frame_timestamp_domain() != depth.get_frame_timestamp_domain():
            return None
        apart_ms = abs(color.get_timestamp() - depth.get_timestamp())
        return color if apart_ms <= 500.0 / self._settings.fps else None

    def _timestamp_us(self, frame: Any, host_ns: int) -> int:
        """On the camera's clock, unwrapped; what the host stamped in its place is left out."""
        domain, domains = frame.get_frame_timestamp_domain(), self._rs.timestamp_domain
        if domain != self._domain or domain == domains.system_time:
            return NO_TIME_US
        ticks = round(frame.get_timestamp() * 1e3)
        return self._unwrap(ticks % CLOCK_ROUND_US, host_ns) if domain == domains.hardware_clock else ticks

    def _distortion(self, lens: Any) -> tuple[float, ...]:
        """OpenCV's k1, k2, p1, p2, k3; empty if there is none, as in all depth of the D400s. librealsense itself
        projects `inverse_brown_conrady` by the forward model (rsutil)."""
        models = self._rs.distortion
        coefficients = tuple(map(float, lens.coeffs))
        if not any(coefficients) or lens.model == models.none:
            return ()
        if lens.model not in (models.brown_conrady, models.inverse_brown_conrady, models.modified_brown_conrady):
            raise SettingsRefused("a lens of Brown's model", str(lens.model), "registered = false", self._where)
        return coefficients

    def _remarks(self) -> list[str]:
        """Remarks for a user on the connected camera."""
        rs, remarks = self._rs, []
        if self._known.usb.startswith("2"):
            remarks.append(f"it is on USB {self._known.usb}: low rates only; a USB 3 port and cable give all of them")
        if self._domain == rs.timestamp_domain.system_time:
            remarks.append("no time stamps of its own: the kernel passes no metadata (librealsense's kernel patch)")
        latest = _info(rs, self._device, rs.camera_info.recommended_firmware_version)
        if latest and latest != self._known.firmware:
            remarks.append(f"firmware {self._known.firmware}, and {latest} is recommended: rs-fw-update")
        return remarks

    @property
    def _registers(self) -> bool:
        return self._settings.color and self._settings.registered

    def _stream(self, stream: object) -> Any:
        return self._profile.get_stream(stream).as_video_stream_profile()

    # Called by the library's threads ---------------------------------------------------------------------------------

    def _changed(self, event: Any) -> None:
        if event.was_removed(self._device):
            self._gone.set()

    def _noted(self, note: Any) -> None:
        self._notes.append(" ".join(str(note.get_description()).split()))


def _described(rs: ModuleType, device: Any) -> ListedRealsense:
    names = rs.camera_info
    try:
        return ListedRealsense(
            device.get_info(names.serial_number),
            device.get_info(names.name),
            _info(rs, device, names.firmware_version),
            _info(rs, device, names.usb_type_descriptor),
        )
    except RuntimeError as error:  # one in recovery mode has no serial number, one without udev rules nothing
        return _troubled(error)


def _troubled(error: RuntimeError) -> ListedRealsense:
    return ListedRealsense("", trouble=" ".join(str(error).split()))


def _info(rs: ModuleType, device: Any, info: object) -> str:
    return str(device.get_info(info)) if device.supports(info) else ""


def _packed(frame: Any, pixel_bytes: int) -> bytes:
    """A frame's data without padding; copied, for the library fills the frame again."""
    row, stride = frame.get_width() * pixel_bytes, frame.get_stride_in_bytes()
    data = bytes(frame.get_data())
    if stride > row:
        return b"".join(data[at : at + row] for at in range(0, stride * frame.get_height(), stride))
    return data


# In the camera's own process ----------------------------------------------------------------------------------------

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
        if isinstance(error, DeviceError):
            raise
        raise meaning(error, "a RealSense camera", "realsense") from error


def report_cameras(channel: Channel, module: str) -> None:
    """Report the cameras that librealsense sees. Raises LibraryMissing."""
    channel.send("opened", listed(load(module)))


def meaning(error: Exception, expected: str, where: str) -> DeviceError:
    """The error of a device's that an error of the library's is.

    librealsense words them by the failure below it: `xioctl(VIDIOC_S_FMT) failed, errno=16 Last Error: Device or
    resource busy` and `failed to set power state` for a camera that another program uses (issues 1828, 12382, 6555).
    Without udev rules it is `RS2_USB_STATUS_ACCESS` (issue 4951; realsense-ros 1408)."""
    words = " ".join(str(error).split())
    lower = words.lower()
    if any(sign in lower for sign in _BUSY):
        what = "close other programs that read it: realsense-viewer, a ROS node, an earlier run"
        return Busy(f"{expected} that no other program reads", words, what, where)
    if any(sign in lower for sign in _DENIED):
        return NotConnected(f"{expected} that this user may open", words, UDEV, where)
    return NotConnected(expected, words or type(error).__name__, "reconnect it", where)
