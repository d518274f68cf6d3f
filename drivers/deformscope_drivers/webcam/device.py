"""A webcam: opened by its stable name, set as configured, every setting read back and a mismatch refused.

A video file, or a folder of images, may take a camera's place."""

import contextlib
import math
import os
import re
from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Clock, ClockFit, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Device, EndOfReadings, Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected, SettingsRefused
from deformscope_drivers.images import QUEUE_IMAGES, ColorImage, fingerprint
from deformscope_drivers.pacing import Pacer
from deformscope_drivers.ports import FoundDevice, stable_name, sysfs_text, usb_device

# Access to a camera: OpenCV over Video4Linux (V4L2), behind an interface as small as a test's fake can be.
#
# OpenCV waits for an image without end, or 10 s, unless a timeout is set: `waitAny` waits for its given time. Only the
# first image after opening is waited for inside OpenCV; `OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT` bounds that [s], and is set
# to 2 unless the user has set it. The kernel's own calls (opening, setting) cannot be bounded from here.
# Sources: OpenCV's documentation and its cap_v4l.cpp; V4L2's documents for the units of controls

SELECT_TIMEOUT = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
SELECT_TIMEOUT_S = 2


if TYPE_CHECKING:
    import cv2

DEFAULT_FPS = 30.0
IMAGE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp"})
UNREADABLE = "unreadable"
FAILED_READS = 8
"""Number of successive failed reads that end a video: single pictures may be damaged."""

Picture = NDArray[np.uint8]
TimedPicture = tuple[Picture | None, float]
"""A picture, RGB, None for one that cannot be read; and its time in the file [s], NaN where it has none."""


@dataclass(frozen=True, slots=True)
class PlaybackConfig:
    """A file in a camera's place, as a rig file names it. path: the file or folder; the rest as `Playback` has it"""

    path: str = ""
    fps: float | None = None
    real_time: bool = True
    loop: bool = False


class Playback(Device[ColorImage]):
    """Pictures of a file, as from a camera.

    fps: pictures a second; None = at the times in the file, else 30
    real_time: play at that rate, like a camera, so that a slow reader loses pictures. False = as fast as the readers
    take them, and no reader loses any. No picture is read before a reader starts, and `next` advances by one picture
    loop: begin again at the end; otherwise the readers end A picture's device_ticks are its time in the file [us],
    which continues from round to round."""

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    @classmethod
    def configured(cls, config: PlaybackConfig) -> Self:
        """The same from a rig file's section."""
        if not config.path:
            raise NotConnected("a file or a folder of pictures", "none", 'path = "FILE"')
        return cls(config.path, fps=config.fps, real_time=config.real_time, loop=config.loop)

    def __init__(
        self,
        path: str | Path,
        *,
        fps: float | None = None,
        real_time: bool = True,
        loop: bool = False,
        clock: Clock = monotonic_ns,
    ) -> None:
        if fps is not None and not (math.isfinite(fps) and fps > 0):
            raise NotConnected("a positive frame rate", str(fps), where=path)
        super().__init__(str(path), reconnect=None, clock=clock)
        self.path = Path(path)
        self._asked_fps = fps
        self._real_time = real_time
        self._loop = loop
        self._pacer = Pacer(clock)
        self._pictures: Iterator[TimedPicture] = iter(())
        self._ahead: Picture | EllipsisType | None = ...
        self._media_s = self._file_s = 0.0
        self.fps = fps or DEFAULT_FPS  # pictures a second, a mean where that varies; known once it is open
        self._shown = self._shown_this_round = 0
        self._started_ns = 0

    @abstractmethod
    def _open_file(self) -> tuple[Iterator[TimedPicture], float | None]:
        """The pictures, and the file's own rate [Hz]. Raises NotConnected."""

    def _connect(self) -> None:
        if not self.path.exists():
            raise NotConnected("a file that is there", "none", where=self.path)
        self._pictures, own_fps = self._open_file()
        self.fps = self._asked_fps or own_fps or DEFAULT_FPS
        self._shown = self._shown_this_round = 0
        self._media_s, self._ahead = 0.0, ...
        self._started_ns = self._clock()
        self._clock_fit = ClockFit(1000.0) if self._real_time else None
        self._expect(self.fps if self._real_time else None)

    def _receive(self, timeout_s: float) -> Iterable[ColorImage]:
        if not self._real_time and not self._wanted():
            self._pacer.wait_until(self._clock() + 1_000_000, timeout_s)
            return []
        if self._ahead is ...:
            self._ahead = self._next_picture()
        if self._real_time and not self._pacer.wait_until(self._started_ns + round(self._media_s * 1e9), timeout_s):
            return []
        picture, self._ahead = self._ahead, ...
        media_us = round(self._media_s * 1e6)
        if picture is None:
            self._count_refused(UNREADABLE)
            return []
        stamp = Stamp(self._clock(), media_us)
        if self._clock_fit is not None:
            self._clock_fit.add(media_us, stamp.host_ns)
        return [ColorImage(stamp, picture)]

    def _next_picture(self) -> Picture | None:
        for picture, time_s in self._pictures:
            step_s = time_s - self._file_s
            if self._asked_fps or not self._shown_this_round or not step_s > 0.0:
                step_s = 1.0 / self.fps if self._shown else 0.0
            self._media_s += step_s
            self._file_s = self._file_s + step_s if math.isnan(time_s) else time_s
            self._shown += 1
            self._shown_this_round += 1
            return picture
        if not self._loop or not self._shown_this_round:
            raise EndOfReadings(f"the end of {self.path.name}")
        self._pictures, _ = self._open_file()
        self._shown_this_round = 0
        return self._next_picture()

    def _disconnect(self) -> None:
        pictures, self._pictures = self._pictures, iter(())
        getattr(pictures, "close", lambda: None)()

    def _wake(self) -> None:
        self._pacer.wake()


class VideoFile(Playback):
    """A video as a camera: any file that OpenCV's FFmpeg reads."""

    def _open_file(self) -> tuple[Iterator[TimedPicture], float | None]:
        import cv2

        if not self.path.is_file():
            raise NotConnected("a video", "a folder or a device", 'driver = "image_folder"', self.path)
        # From the root on: FFmpeg takes a name such as `concat:a|b` for a protocol of its own.
        capture = cv2.VideoCapture(str(self.path.absolute()), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            capture.release()
            raise NotConnected("a video", "a damaged file, or one of another kind", f"ffprobe {self.path}", self.path)
        reported = float(capture.get(cv2.CAP_PROP_FPS))
        return _VideoPictures(capture), reported if math.isfinite(reported) and reported > 0 else None


class ImageFolder(Playback):
    """A folder of images as a camera, in natural order (img2 before img10); hidden and other files are left out."""

    def _open_file(self) -> tuple[Iterator[TimedPicture], float | None]:
        import cv2

        if not self.path.is_dir():
            raise NotConnected("a folder of images", "a file", "VideoFile for a video", self.path)
        paths = sorted(
            (
                path
                for path in self.path.iterdir()
                if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
            ),
            key=lambda path: [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name)],
        )
        if not paths:
            raise NotConnected("images", "none", "files that end in " + " ".join(sorted(IMAGE_SUFFIXES)), self.path)
        for path in paths:
            if path.suffix.lower() in (".tif", ".tiff") and (pages := cv2.imcount(str(path))) > 1:
                raise NotConnected("images of one page", f"{pages} pages", "save each page as an image", path)
        return ((_read(path), math.nan) for path in paths), None


class _VideoPictures:
    """The pictures of an opened `cv2.VideoCapture`; not a generator, which is closed only once it was started."""

    def __init__(self, capture: "cv2.VideoCapture") -> None:
        self._capture = capture
        self._unreadable = 0

    def __iter__(self) -> Iterator[TimedPicture]:
        return self

    def __next__(self) -> TimedPicture:
        import cv2

        if self._unreadable:
            self._unreadable -= 1
            return None, math.nan
        failed = 0
        while not self._capture.grab():
            failed += 1
            if failed == FAILED_READS:
                self.close()
                raise StopIteration
        if failed:  # damaged pictures, and a good one behind them, which is lost with them
            self._unreadable = failed
            return None, math.nan
        decoded, picture = self._capture.retrieve()
        time_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8) if decoded else None, time_s

    def close(self) -> None:
        self._capture.release()


def _read(path: Path) -> Picture | None:
    import cv2

    with contextlib.suppress(OSError):
        # Not imread, which writes to the terminal about what it cannot read.
        picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_COLOR) if path.stat().st_size else None
        if picture is not None:
            return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
    return None


class Setting(Enum):
    """A setting of a camera: the name of OpenCV's property."""

    FOURCC = "CAP_PROP_FOURCC"
    WIDTH = "CAP_PROP_FRAME_WIDTH"
    HEIGHT = "CAP_PROP_FRAME_HEIGHT"
    FPS = "CAP_PROP_FPS"
    AUTO_EXPOSURE = "CAP_PROP_AUTO_EXPOSURE"  # V4L2's menu: 1 = manual, 3 = by itself at a fixed aperture
    EXPOSURE = "CAP_PROP_EXPOSURE"  # in 100 us
    GAIN = "CAP_PROP_GAIN"
    AUTO_WHITE_BALANCE = "CAP_PROP_AUTO_WB"
    WHITE_BALANCE = "CAP_PROP_WB_TEMPERATURE"  # in K
    AUTOFOCUS = "CAP_PROP_AUTOFOCUS"
    FOCUS = "CAP_PROP_FOCUS"


class Capture(Protocol):
    """An opened camera. Reads images from a camera; only one thread may use it."""

    def set(self, setting: Setting, value: float) -> None:
        """Request a setting; only `get` shows whether the camera accepted it."""

    def get(self, setting: Setting) -> float | None:
        """The setting that is in force; None where the camera has no such thing."""

    def wait(self, timeout_s: float) -> bool:
        """Take hold of the next image; False when none came in time. Raises LinkLost."""

    def timestamp_us(self) -> int | None:
        """The camera's time of the image taken hold of [us]; None where it gives none."""

    def retrieve(self) -> NDArray[np.uint8] | None:
        """The grabbed image, decoded: (H, W, 3) RGB; None if it cannot be decoded."""

    def close(self) -> None:
        """Let go of the camera, in whatever state it is."""


def open_v4l2(path: str) -> Capture:
    """Open a V4L2 camera. path: /dev/video0, /dev/v4l/by-id/...; raises NotConnected"""
    if not Path(path).exists():
        raise NotConnected("a camera that is there", "none", "ls /dev/v4l/by-id; deformscope devices", path)
    if not os.access(path, os.R_OK | os.W_OK):
        raise NotConnected("a camera that may be opened", "permission denied", "sudo usermod -aG video $USER", path)
    return OpencvCapture(path)


class OpencvCapture:
    """A camera through OpenCV's V4L2 back end. Never tried on a camera: the machine it was written on has none."""

    def __init__(self, path: str) -> None:
        import cv2

        os.environ.setdefault(SELECT_TIMEOUT, str(SELECT_TIMEOUT_S))
        self._path = path
        self._cv2 = cv2
        self._capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            self._capture.release()
            advice = f"fuser {path}; a camera's second node gives no images: take the other"
            raise NotConnected("a camera that gives images", "one that is in use, or gives none", advice, path)

    def set(self, setting: Setting, value: float) -> None:
        self._capture.set(getattr(self._cv2, setting.value), value)

    def get(self, setting: Setting) -> float | None:
        value = float(self._capture.get(getattr(self._cv2, setting.value)))
        return None if value == -1.0 else value

    def wait(self, timeout_s: float) -> bool:
        timeout_ns = max(round(timeout_s * 1e9), 1_000_000)  # none would be for ever
        try:
            came, ready = self._cv2.VideoCapture.waitAny([self._capture], timeout_ns)
        except self._cv2.error as error:
            advice = "check the cable; dmesg"
            raise LinkLost("an image", "an error (unplugged, or its driver failed)", advice, self._path) from error
        if came and len(ready) > 0:
            return True
        if came or not Path(self._path).exists():
            raise LinkLost("a camera that is there", "none (unplugged?)", "check the cable", self._path)
        return False

    def timestamp_us(self) -> int | None:
        milliseconds = float(self._capture.get(self._cv2.CAP_PROP_POS_MSEC))
        return round(milliseconds * 1000) if milliseconds > 0 else None

    def retrieve(self) -> NDArray[np.uint8] | None:
        """The picture that was grabbed, (h, w, 3) RGB; None where it cannot be decoded."""
        decoded, image = self._capture.retrieve()
        if not decoded or image.ndim != 3 or image.shape[2] != 3:
            return None
        return np.asarray(self._cv2.cvtColor(image, self._cv2.COLOR_BGR2RGB), np.uint8)

    def close(self) -> None:
        self._capture.release()


EXPOSURE_UNIT_S = 1e-4
MANUAL_EXPOSURE = 1
FPS_TOLERANCE = 0.01
GAP_PERIODS = 1.5
NO_IMAGE = "undecodable"
WRONG_SIZE = "size"


@dataclass(frozen=True, slots=True)
class WebcamConfig:
    """How a webcam is opened and set.

    port: a path (best one under /dev/v4l/by-id, which is stable when cameras are renumbered), or a number: 0 is
    /dev/video0; width, height [px]; fps [Hz]; fourcc: the format on the wire, such as MJPG or YUYV
    exposure_s, gain, white_balance_k, focus: None = the camera's own (most choose automatically); gain and focus are in
    the driver's own units; autofocus: False switches it off where the camera has it, for a picture whose scale stays
    silence_s: time without an image after which the camera counts as lost; stuck_after_s: the same image for this long
    means a frozen one, None = it may"""

    port: str | int = 0
    width: int = 640
    height: int = 480
    fps: float = 30.0
    fourcc: str = "MJPG"
    exposure_s: float | None = None
    gain: float | None = None
    white_balance_k: float | None = None
    focus: float | None = None
    autofocus: bool = False
    silence_s: float = 3.0
    stuck_after_s: float | None = 5.0

    def __post_init__(self) -> None:
        if not self.path.startswith("/"):  # an address or a pipeline, which OpenCV might open
            raise NotConnected("a camera's number or path", repr(self.port), "ls /dev/v4l/by-id")
        if not (self.width > 0 and self.height > 0 and self.fps > 0):
            came = f"{self.width} x {self.height} at {self.fps:g} Hz"
            raise SettingsRefused("width, height and fps above 0", came, where=self.path)

    @property
    def path(self) -> str:
        """The port as a path."""
        text = str(self.port)
        return f"/dev/video{text}" if text.isdecimal() else text


class Webcam(Device[ColorImage]):
    """`with Webcam(WebcamConfig(port="/dev/v4l/by-id/...")) as camera: camera.next(1.0).image`

    open() raises SettingsRefused when the camera runs otherwise than configured. `health().extra["gaps"]` counts pauses
    between images longer than one and a half periods, by the camera's timestamps if it gives them. They are lost
    images, or longer exposures in the dark (OpenCV gives no frame counter). Never tried on a camera."""

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    def __init__(
        self,
        config: WebcamConfig,
        *,
        open_capture: Callable[[str], Capture] = open_v4l2,
        links: Path = Path("/dev/v4l/by-id"),
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        super().__init__(config.path, reconnect=reconnect, stuck_after_s=config.stuck_after_s, clock=clock)
        self.config = config
        self._open_capture = open_capture
        self._links = links
        self._path = config.path
        self._capture: Capture | None = None
        self._heard_ns = 0
        self._gaps = 0
        self._before_ns: int | None = None

    def _connect(self) -> None:
        # Plugged in again, a camera may come back under another number; its stable name stays.
        self._path = stable_name(self._path, self._links)
        self._capture = self._open_capture(self._path)
        apply(self.config, self._capture, self._path)
        self._heard_ns = self._clock()
        self._before_ns = None
        self._clock_fit = ClockFit(1000.0)
        self._expect(self.config.fps)

    def _receive(self, timeout_s: float) -> Iterable[ColorImage]:
        if self._capture is None:
            raise NotConnected("an open camera", "one that is closed", where=self.name)
        if not self._capture.wait(timeout_s):
            silence_s = (self._clock() - self._heard_ns) / 1e9
            if silence_s > self.config.silence_s:
                raise LinkLost("an image", f"none for {silence_s:.3g} s", "check the camera", self._path)
            return []
        # Before decoding, which takes milliseconds that are not the camera's.
        self._heard_ns = host_ns = self._clock()
        stamp = Stamp(host_ns, self._capture.timestamp_us())
        picture = self._capture.retrieve()
        if picture is None:
            self._count_refused(NO_IMAGE)
            return []
        if picture.shape != (self.config.height, self.config.width, 3):
            self._count_refused(WRONG_SIZE)
            return []
        self._watch(stamp)
        return [ColorImage(stamp, picture)]

    def _disconnect(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.close()

    def _fingerprint(self, reading: ColorImage) -> Hashable:
        return fingerprint(reading.image)

    def _extra_health(self) -> dict[str, float]:
        return {"gaps": float(self._gaps)}

    def _watch(self, stamp: Stamp) -> None:
        now_ns = stamp.host_ns if stamp.device_ticks is None else stamp.device_ticks * 1000
        if self._before_ns is not None and now_ns - self._before_ns > GAP_PERIODS * 1e9 / self.config.fps:
            self._gaps += 1
        self._before_ns = now_ns
        if stamp.device_ticks is not None and self._clock_fit is not None:
            self._clock_fit.add(stamp.device_ticks, stamp.host_ns)


def apply(config: WebcamConfig, capture: Capture, where: str) -> None:
    """Set a camera as configured and read every setting back. Raises SettingsRefused.

    The order matters: the format bounds the sizes that there are, and the size bounds the rates."""
    if len(config.fourcc) != 4 or not config.fourcc.isascii():
        raise SettingsRefused("a format of four letters, such as MJPG or YUYV", repr(config.fourcc))
    asked: list[tuple[Setting, float]] = [
        (Setting.FOURCC, float(int.from_bytes(config.fourcc.encode("ascii"), "little"))),  # as V4L2 numbers it
        (Setting.WIDTH, float(config.width)),
        (Setting.HEIGHT, float(config.height)),
        (Setting.FPS, config.fps),
        (Setting.AUTOFOCUS, float(config.autofocus)),
    ]
    if config.exposure_s is not None:
        asked.append((Setting.AUTO_EXPOSURE, MANUAL_EXPOSURE))
        asked.append((Setting.EXPOSURE, float(round(config.exposure_s / EXPOSURE_UNIT_S))))
    if config.gain is not None:
        asked.append((Setting.GAIN, config.gain))
    if config.white_balance_k is not None:
        asked.append((Setting.AUTO_WHITE_BALANCE, 0.0))
        asked.append((Setting.WHITE_BALANCE, config.white_balance_k))
    if config.focus is not None:
        asked.append((Setting.FOCUS, config.focus))
    for setting, value in asked:
        capture.set(setting, value)
    wrong = []
    for setting, value in asked:
        came = capture.get(setting)
        if setting is Setting.AUTOFOCUS and not value and came is None:
            continue  # a camera without autofocus has it off
        tolerance = FPS_TOLERANCE * value if setting is Setting.FPS else 0.5
        if came is None or not abs(came - value) <= tolerance:
            wrong.append((setting, value, came))
    if wrong:
        expected = ", ".join(_to_text(setting, value) for setting, value, _ in wrong)
        seen = ", ".join(_to_text(setting, came) for setting, _, came in wrong)
        raise SettingsRefused(expected, seen, f"v4l2-ctl -d {where} --list-formats-ext --list-ctrls", where)


def _to_text(setting: Setting, value: float | None) -> str:
    name = setting.name.lower().replace("_", " ")
    if value is None:
        return f"no {name}"
    if setting is Setting.FOURCC:
        return f"{name} {int(value).to_bytes(4, 'little').decode('latin-1')!r}"
    return f"{name} {value:g}"


def discover(sysfs: Path = Path("/sys"), dev: Path = Path("/dev")) -> list[FoundDevice]:
    """Every V4L2 camera, by its stable name where there is one.

    A camera's further nodes (metadata, which give no images) are left out. sysfs, dev: where those folders are"""
    nodes = sysfs / "class" / "video4linux"
    found = []
    for node in sorted(nodes.glob("video*"), key=lambda path: (len(path.name), path.name)) if nodes.is_dir() else []:
        if sysfs_text(node / "index") not in ("", "0"):
            continue
        device = dev / node.name
        port = stable_name(str(device), dev / "v4l" / "by-id")
        name = sysfs_text(node / "name")
        usb, interface = None, node / "device"
        if interface.exists():  # it names an interface, a folder below the USB device's
            folder = interface.resolve()
            usb = usb_device(folder) or usb_device(folder.parent)
        notes = [] if port == str(device) else [str(device)]
        if usb is not None:
            notes.append(f"usb {usb.vendor:04x}:{usb.product:04x}")
        serial, revision = (usb.serial, usb.revision) if usb is not None else ("", "")
        found.append(FoundDevice("webcam", port, name, serial, revision, ", ".join(notes)))
    return found
