"""A video file, or a folder of images, in a camera's place."""

import contextlib
import math
import re
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.clock import Clock, ClockFit, Stamp, monotonic_ns
from deformscope_drivers.device import Device, EndOfReadings
from deformscope_drivers.errors import NotConnected
from deformscope_drivers.images import QUEUE_IMAGES, ColorImage
from deformscope_drivers.pacing import Pacer

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
