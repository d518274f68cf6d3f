"""Where frames come from: a video, a folder, images in order, a recording, or a sample, as one lazy stream."""

import contextlib
import itertools
import math
import mmap
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from deformscope.arrays import ImageArray
from deformscope.errors import InputError
from deformscope.file_io import ending_of, nearest_file, read_file, resolve
from deformscope.files.video_check import VideoCheck
from deformscope.frames import ColorFrame
from deformscope.images import decode_image, frame_pages, is_animated, to_rgb
from deformscope_drivers.clock import Stamp

DEFAULT_FPS = 30.0
FAILED_READS = 8
"""Number of successive failed reads that end a video: single frames may be damaged."""
IMAGE_SUFFIXES = frozenset(
    {".avif", ".bmp", ".dib", ".gif", ".jp2", ".jpe", ".jpeg", ".jpg", ".pbm"}
    | {".pgm", ".png", ".pnm", ".ppm", ".ras", ".sr", ".tif", ".tiff", ".webp"}
)
OTHER_SUFFIXES = frozenset({".arw", ".cr2", ".cr3", ".dng", ".heic", ".heif", ".hif", ".nef", ".orf", ".raf", ".rw2"})
"""Endings of cameras' images that cannot be read: a folder is not read without them."""
ANIMATED_SUFFIXES = frozenset({".apng", ".gif", ".png"})
RECORDING_SUFFIX = ".rrd"
TURNS = tuple(itertools.product(range(4), (False, True)))
"""Quarter turns and mirrorings of an image: what an Exif orientation can say."""


class Source:
    """A stream of frames, read once and lazily: `with open_source(...) as source: for frame in source: ...`.

    name: the source's name, for a progress line; count: expected number of frames, None if only reading shows it (the
    count of a video is that of its container); problems: after reading, its missing or damaged parts; timed: when the
    frames were taken is known, else assumed; counted: counts the frames where `count` is only expected"""

    def __init__(
        self,
        name: str,
        frames: Callable[[], Iterator[ColorFrame]],
        count: int | None,
        problems: Callable[[], list[str]] = list,
        timed: bool = True,
        counted: Callable[[], int] | None = None,
    ) -> None:
        self.name = name
        self._counted = counted
        self.timed = timed
        self.count = count
        self.problems = problems
        self._open = frames
        self._frames: Iterator[ColorFrame] | None = None
        self._ahead: list[ColorFrame] = []

    def __enter__(self) -> "Source":
        """Open it and read the first two frames, so that unusable input is refused before any work."""
        self._frames = self._open()
        try:
            self._ahead = list(itertools.islice(self._frames, 2))
            if len(self._ahead) < 2:
                came = "one frame" if self._ahead else "no frame"
                raise InputError("at least two frames", came, "a longer source or a smaller --stride", self.name)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[ColorFrame]:
        while self._ahead:
            yield self._ahead.pop(0)
        if self._frames is not None:
            yield from self._frames

    def thin(self, most: int) -> int:
        """Give at most this number of frames, evenly spread, including the last one; at least two. Once it was
        entered. Returns the number of frames that there are, or that are expected if it is not above `most`."""
        if self._counted is not None and (self.count or 0) > most:
            self.count = self._counted()
        if (there := self.count or 0) <= most or self._frames is None:
            return there
        kept = np.unique(np.linspace(0, there - 1, max(most, 2)).round().astype(int)).tolist()
        every = itertools.chain(self._ahead, self._frames)
        chosen = (frame for place, frame in enumerate(every) if place in kept)
        self.count = len(kept)
        self._frames = (replace(frame, index=index) for index, frame in enumerate(chosen))
        self._ahead = [next(self._frames)]
        return there

    def end_at(self, frame: int) -> None:
        """Give the frames up to this one alone, counted from 0. Once it was entered; before `thin`. Raises InputError
        where there are not so many, as far as that is known."""
        self.count = self._counted() if self._counted is not None else self.count
        if frame < 1 or (self.count is not None and frame >= self.count):
            last = "the last one" if self.count is None else f"{self.count - 1}"
            raise InputError(f"--force-frame from 1 to {last}", str(frame), where=self.name)
        self._frames = itertools.islice(self._frames or (), frame - 1)
        self.count, self._counted = frame + 1, None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of its images [px], until the first was taken."""
        height, width = self._ahead[0].image.shape[:2]
        return int(height), int(width)

    @property
    def began_ns(self) -> int:
        """When its first frame came; for use before that frame is taken."""
        return self._ahead[0].stamp.host_ns

    def close(self) -> None:
        frames, self._frames = self._frames, None
        if frames is not None:
            getattr(frames, "close", lambda: None)()


def open_source(
    paths: Sequence[str | Path],
    *,
    stride: int = 1,
    fps: float | None = None,
    mask: Path | None = None,
    camera: str | None = None,
    timed: bool = False,
) -> Source:
    """A source of frames from the user's names.

    paths: one video, folder, recording or `sample:NAME`, or two or more image files in their order
    stride: use every n-th frame; a frame's index counts the used ones
    fps: frames a second of the source before `stride`; default: the times in a video or a recording, else 30
    mask: an image that is not used as a frame if it is among them
    camera: the camera to use, if a recording has several
    timed: the result depends on time: frames without their times are refused"""
    if stride < 1:
        raise InputError("a stride of 1 or more", str(stride))
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise InputError("a positive frame rate", str(fps))
    if not paths:
        raise InputError("a source of frames", "none", "a video, a folder of frames, or image files")
    if camera is not None and (len(paths) > 1 or ending_of(paths[0]) != RECORDING_SUFFIX):
        raise InputError("a recording (.rrd) with --camera", str(paths[0]), "leave out --camera")
    if len(paths) > 1:
        return _images([_image_path(path) for path in paths], f"{len(paths)} images", stride, fps, mask, timed)

    path = resolve(paths[0])
    if not path.exists():
        expected = "a video, a folder of frames, or image files"
        raise InputError(expected, "nothing there", nearest_file(path), path)
    if path.is_dir():
        return _images(images_in(path), str(path), stride, fps, mask, timed)
    suffix = path.suffix.lower()
    if suffix == RECORDING_SUFFIX:
        return _recording(path, stride, fps, camera, timed)
    if suffix in ANIMATED_SUFFIXES and is_animated(read_file(path, "an image")):
        return _video(path, stride, fps, timed)
    if suffix in IMAGE_SUFFIXES | OTHER_SUFFIXES:
        if len(_pages(path)) > 1:
            return _images([path], str(path), stride, fps, mask, timed)
        raise InputError("at least two frames", "one image", "name all images in order, or their folder", path)
    return _video(path, stride, fps, timed)


def images_in(folder: Path) -> list[Path]:
    """The image files of a folder in natural order (img2 before img10); hidden and other files are left out. Raises
    InputError for images that cannot be read."""
    every = sorted((one for one in folder.iterdir() if not one.name.startswith(".") and one.is_file()), key=natural_key)
    if unread := [one for one in every if one.suffix.lower() in OTHER_SUFFIXES]:
        raise _unread(unread[0])
    return [one for one in every if one.suffix.lower() in IMAGE_SUFFIXES]


def _unread(path: Path) -> InputError:
    return InputError("PNG, TIFF or JPEG images", path.suffix[1:].upper(), f"convert {path.name} to JPEG or PNG", path)


def natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sorts numbers in names by their value; names that differ only in case or leading zeros keep a fixed order."""
    parts = re.split(r"(\d+)", path.name.casefold())
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts if part], path.name


def _image_path(path: str | Path) -> Path:
    resolved = resolve(path)
    if resolved.is_dir() or (resolved.exists() and resolved.suffix.lower() not in IMAGE_SUFFIXES | OTHER_SUFFIXES):
        what = "a folder" if resolved.is_dir() else f"a {resolved.suffix or 'nameless'} file"
        raise InputError("image files where several sources are named", what, "one video or folder alone", resolved)
    if not resolved.exists():
        raise InputError("an image file", "nothing there", nearest_file(resolved), resolved)
    return resolved


def _images(paths: list[Path], name: str, stride: int, fps: float | None, mask: Path | None, timed: bool) -> Source:
    masked = None if mask is None else Path(mask).expanduser().resolve()
    frames = [(path, page) for path in paths if path.resolve() != masked for page in _pages(path)]
    if not frames:
        came = "the mask alone" if paths else "none"
        raise InputError("a folder with images, one a frame", came, "a folder with PNG, TIFF or JPEG files", name)
    kept = frames[::stride]
    if len(kept) < 2:
        came = f"{len(frames)} image{'s' * (len(frames) > 1)}" + (f" and a stride of {stride}" if stride > 1 else "")
        raise InputError("at least two frames", came, "more images, or a smaller --stride", name)
    if timed and fps is None:
        raise InputError("--fps with images that do not say when they were taken", "none", "--fps 30", name)
    period_ns = 1e9 / (fps or DEFAULT_FPS)

    def read() -> Iterator[ColorFrame]:
        for index, image in enumerate(alike(_upright(kept))):
            yield ColorFrame(Stamp(round(index * stride * period_ns)), index, image)

    return Source(name, read, len(kept), timed=fps is not None)


def _pages(path: Path) -> list[int]:
    """The pages of an image file that are frames. Raises InputError for an animation."""
    if path.suffix.lower() in OTHER_SUFFIXES:
        raise _unread(path)
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as encoded:
            if is_animated(encoded):
                hint = "an animated GIF alone, or each of its frames as an image"
                raise InputError("images of one frame", "an animation", hint, path)
            return frame_pages(encoded, path)
    except (OSError, ValueError):  # empty, which its decoder says
        return [0]


def _upright(frames: Iterable[tuple[Path, int]]) -> Iterator[tuple[ImageArray, str]]:
    """Images as the camera's sensor gave them, each turned as the first says: a phone that looks down changes its
    mind about what is up."""
    last, encoded, turn = Path(), b"", None
    for path, page in frames:
        if path != last:
            last, encoded = path, read_file(path, "an image")
        image = decode_image(encoded, path, page, turned=False)
        if turn is None:
            said = decode_image(encoded, path, page)
            turn = next(one for one in TURNS if np.array_equal(_turned(image, *one), said))
        yield _turned(image, *turn), str(path) if page == 0 else f"{path}, page {page + 1}"


def _turned(image: ImageArray, quarters: int, mirrored: bool) -> ImageArray:
    turned: ImageArray = np.ascontiguousarray(  # type: ignore[assignment]
        np.rot90(image[:, ::-1] if mirrored else image, quarters)
    )
    return turned


def alike(images: Iterable[tuple[ImageArray, str]]) -> Iterator[ImageArray]:
    """Images (h, w) or (h, w, channels) of one size, depth and channel count, each with its name; refuses the first
    that differs. Grey images may be saved as RGB."""
    first: tuple[ImageArray, str] | None = None
    for image, name in images:
        first = first or (image, name)
        if image.ndim == 3 and first[0].ndim == 2 and (image == image[..., :1]).all():
            image = np.ascontiguousarray(image[..., 0])  # type: ignore[assignment]
        elif image.ndim == 2 and first[0].ndim == 3 and (first[0] == first[0][..., :1]).all():
            image = np.repeat(image[..., None], 3, axis=2)  # type: ignore[assignment]
        if (image.shape, image.dtype) != (first[0].shape, first[0].dtype):
            came = f"{_shape(image)} after {_shape(first[0])} in {Path(first[1]).name}"
            raise InputError("frames of one size, depth and channel count", came, "leave the odd image out", name)
        yield image


def _shape(image: ImageArray) -> str:
    height, width = image.shape[:2]
    return f"{width}x{height} {'grey' if image.ndim == 2 else 'RGB'} of {8 * image.dtype.itemsize} bits"


def _video(path: Path, stride: int, fps: float | None, timed: bool) -> Source:
    with _capture(path) as probe:
        own_fps = probe.get(cv2.CAP_PROP_FPS)
        claimed = probe.get(cv2.CAP_PROP_FRAME_COUNT)
        times_ms = [probe.get(cv2.CAP_PROP_POS_MSEC) for _ in range(2) if probe.grab()]
    known = math.isfinite(own_fps) and 0 < own_fps < 1e6
    rate = own_fps if known else DEFAULT_FPS
    count = math.ceil(claimed / stride) if math.isfinite(claimed) and 0 < claimed < 1e9 else None

    check = VideoCheck(path, claimed, own_fps)

    def read() -> Iterator[ColorFrame]:
        with _capture(path) as capture:
            taken = failed = ns = 0
            first_s = last_s = 0.0
            while failed < FAILED_READS:
                done, image = capture.read() if taken % stride == 0 else (capture.grab(), None)
                if not done:
                    failed += 1
                    check.fail()
                    continue
                failed = 0
                time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                check.read(time_s)
                if not taken:
                    first_s = time_s
                elif fps is None and not time_s > last_s:
                    if timed:
                        came = f"{time_s:.4g} s of frame {taken + 1} after {last_s:.4g} s"
                        raise InputError("a video whose frames' times rise", came, "--fps RATE, if it is even", path)
                    first_s = time_s - ns / 1e9 - 1.0 / rate  # a usual step behind the last
                ns = round((time_s - first_s) * 1e9 if fps is None else taken * 1e9 / fps)
                last_s = time_s
                if image is not None:
                    yield ColorFrame(Stamp(ns), taken // stride, to_rgb(image))  # type: ignore[arg-type]
                taken += 1

    def counted() -> int:
        """A container may list frames that its edits hide, or count those of an even rate."""
        with _capture(path) as capture:
            taken = failed = 0
            while failed < FAILED_READS:
                done = capture.grab()
                taken, failed = taken + done, 0 if done else failed + 1
        return math.ceil(taken / stride)

    rising = len(times_ms) < 2 or times_ms[1] > times_ms[0]
    return Source(str(path), read, count, check.problems, timed=fps is not None or rising, counted=counted)


@contextlib.contextmanager
def _capture(path: Path) -> Iterator[cv2.VideoCapture]:
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened():
            came = "an empty file" if path.stat().st_size == 0 else "a damaged file, or one of another kind"
            raise InputError("a video that FFmpeg can read", came, "convert it to MP4, or to a folder of PNG", path)
        yield capture
    finally:
        capture.release()


def _recording(path: Path, stride: int, fps: float | None, camera: str | None, timed: bool) -> Source:
    from deformscope.recording.reader import Replay

    replay = Replay(path)
    name = replay.camera(camera)
    known = replay.settings.get("timed", True) or fps is not None
    if timed and not known:
        raise InputError("--fps with images that did not say when they were taken", "none", "--fps 30", path)

    def read() -> Iterator[ColorFrame]:
        began_ns = None
        for index, frame in enumerate(itertools.islice(replay.frames(camera=name), 0, None, stride)):
            began_ns = frame.stamp.host_ns if began_ns is None else began_ns
            stamp = frame.stamp if fps is None else Stamp(began_ns + round(index * stride * 1e9 / fps))
            yield ColorFrame(stamp, index, frame.image)

    count = math.ceil(replay.color_counts[name] / stride)
    return Source(str(path), read, count, lambda: replay.source_problems, timed=bool(known))
