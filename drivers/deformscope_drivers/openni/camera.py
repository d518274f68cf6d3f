"""A depth camera by OpenNI2, configured and read back; and depth and colour of one moment put together.

`DepthCamera` runs `serve` in a process of its own (`deformscope_drivers.hosted`): a hang or a crash of the library ends
neither program nor recording."""

import time
from collections import deque
from dataclasses import dataclass

from deformscope_drivers.errors import LinkLost, SettingsRefused
from deformscope_drivers.frame_message import INDEX_MASK, FrameMessage
from deformscope_drivers.hosted import Channel, exit_without_cleanup
from deformscope_drivers.openni import library as openni

WAITING = 4


@dataclass(frozen=True, slots=True)
class OpenniSettings:
    """Settings for opening a camera; None = unchanged. port: OpenNI2's uri; speed: speed of a recording, 0 = as fast as
    it is read"""

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


class OpenniCamera:
    """An opened and configured camera, every setting read back. Raises SettingsRefused on a mismatch."""

    def __init__(self, settings: OpenniSettings) -> None:
        self._settings = settings
        self._openni = openni.Openni(settings.library)
        self._device = self._openni.open(settings.port)
        self.depth = self._device.stream(openni.Sensor.DEPTH)
        self.color = self._device.stream(openni.Sensor.COLOR) if settings.color else None
        self._ended = False
        if self._device.is_recording:
            self._device.play(settings.speed or openni.MANUAL_SPEED, settings.loop)
        for stream in self._streams():
            self._set_mode(stream)
            if stream.mirror() is not None and stream.mirror() != settings.mirror:
                stream.set_mirror(settings.mirror)
            came = stream.mirror()
            if (came is None and settings.mirror) or (came is not None and came != settings.mirror):
                raise SettingsRefused(f"mirror {settings.mirror}", f"mirror {came}", where=settings.port)
        if self.color is not None and self._registers:
            self._device.register_depth_to_color()

    def words(self) -> dict[str, object]:
        """Message to the program at opening: sizes [px], rate [Hz], unit [m], field of view [rad], names."""
        mode, info = self.depth.mode(), self._device.info()
        seen_as = self.color if self.color is not None and self._registers else self.depth
        field_of_view = seen_as.field_of_view_rad() or self.depth.field_of_view_rad()
        return {
            "width": mode.width,
            "height": mode.height,
            "fps": mode.fps,
            "unit_m": openni.UNITS_M[openni.PixelFormat(mode.pixel_format)],
            "field_of_view_rad": field_of_view,
            "name": " ".join(f"{info.vendor} {info.name}".split()),
            "serial": self._device.serial(),
            "is_recording": self._device.is_recording,
            "frame_count": self.depth.frame_count(),
        }

    def start(self) -> None:
        for stream in self._streams():
            stream.start()

    def next(self, timeout_s: float) -> openni.Frame | None:
        """The next frame of any stream, None when none came in time. Raises LinkLost, and EOFError at the end."""
        stream = self._openni.wait(self._streams(), timeout_s)
        for event, number in self._openni.take_events():
            if event == "disconnected":
                raise LinkLost("a camera that is there", "none (unplugged?)", "check the cable", self._settings.port)
            self._ended = self._ended or number == openni.END_OF_FILE
        if stream is not None:
            return stream.read()
        if self._ended:
            raise EOFError
        return None

    def close(self) -> None:
        """Streams first. The library itself is left to the end of the process: shutting it down crashes."""
        for stream in self._streams():
            stream.close()
        self._device.close()

    @property
    def _registers(self) -> bool:
        return self._settings.registered and not self._device.is_recording

    def _streams(self) -> list[openni.OpenniStream]:
        return [self.depth] if self.color is None else [self.depth, self.color]

    def _set_mode(self, stream: openni.OpenniStream) -> None:
        """Size, rate and unit, if requested."""
        now, settings = stream.mode(), self._settings
        if stream.sensor is openni.Sensor.COLOR:
            pixel_format = int(openni.PixelFormat.RGB888)
        elif settings.unit_m is None:
            pixel_format = now.pixel_format
        else:
            pixel_format = next((int(form) for form, unit_m in openni.UNITS_M.items() if unit_m == settings.unit_m), 0)
        asked = openni.Mode(
            settings.width or now.width, settings.height or now.height, settings.fps or now.fps, pixel_format
        )
        if asked != now and not self._device.is_recording:
            stream.set_mode(asked)
        came = stream.mode()
        if came != asked or (stream.sensor is openni.Sensor.DEPTH and came.pixel_format not in openni.UNITS_M):
            kind = stream.sensor.name.lower()
            raise SettingsRefused(
                f"{kind} {_to_text(asked)}", _to_text(came), "another size, rate or unit", settings.port
            )


class Pairs:
    """Puts depth and colour of the same moment together: timestamps within half a period.

    Streams may lag behind each other. Pairs of depth and colour. A depth frame waits for its colour until a later
    colour frame shows that there is none, or until WAITING depth frames wait."""

    def __init__(self, fps: int, *, wanted: bool) -> None:
        self._half_us = 0.5e6 / max(fps, 1)
        self._wanted = wanted
        self._colors: deque[openni.Frame] = deque(maxlen=WAITING)
        self._depths: deque[tuple[openni.Frame, int]] = deque()

    def add(self, frame: openni.Frame, host_ns: int) -> list[FrameMessage]:
        """The pictures that are complete with this frame. host_ns: its arrival [ns]"""
        if not self._wanted:
            return [_message(frame, host_ns, None)]
        if frame.pixel_format == openni.PixelFormat.RGB888:
            self._colors.append(frame)
        else:
            self._depths.append((frame, host_ns))
        found = []
        newest_us = self._colors[-1].timestamp_us if self._colors else None
        while self._depths and (
            len(self._depths) > WAITING
            or self._color_of(self._depths[0][0]) is not None
            or (newest_us is not None and newest_us > self._depths[0][0].timestamp_us)
        ):
            found.append(self._take())
        return found

    def rest(self) -> list[FrameMessage]:
        """The depth frames that wait, with or without colour."""
        return [self._take() for _ in range(len(self._depths))]

    def _take(self) -> FrameMessage:
        depth, host_ns = self._depths.popleft()
        return _message(depth, host_ns, self._color_of(depth))

    def _color_of(self, depth: openni.Frame) -> openni.Frame | None:
        def apart_us(color: openni.Frame) -> int:
            return abs(color.timestamp_us - depth.timestamp_us)

        nearest = min(self._colors, key=apart_us, default=None)
        return nearest if nearest is not None and apart_us(nearest) <= self._half_us else None


def _message(depth: openni.Frame, host_ns: int, color: openni.Frame | None) -> FrameMessage:
    """A frame that is cut off goes as one of no size: it is refused, and counted, where it is taken."""
    width, height, data = (depth.width, depth.height, depth.data) if depth.is_whole else (0, 0, b"")
    index = depth.index & INDEX_MASK
    if color is None or not color.is_whole:
        return FrameMessage(host_ns, depth.timestamp_us, index, width, height, 0, 0, data, b"")
    return FrameMessage(host_ns, depth.timestamp_us, index, width, height, color.width, color.height, data, color.data)


def _to_text(mode: openni.Mode) -> str:
    form = (
        openni.PixelFormat(mode.pixel_format).name
        if mode.pixel_format in set(openni.PixelFormat)
        else f"format {mode.pixel_format}"
    )
    return f"{mode.width}x{mode.height} at {mode.fps} Hz in {form}"


# In the camera's own process ----------------------------------------------------------------------------------------

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
    channel.send("opened", openni.Openni().devices())
