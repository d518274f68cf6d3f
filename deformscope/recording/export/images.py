"""The images of a recording as files, byte for byte as they were recorded, and as videos."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from deformscope.errors import InputError
from deformscope.images import PNG_SIGNATURE, decode_image
from deformscope.recording.export.table_files import IMAGES
from deformscope.recording.reader import Replay
from deformscope.recording.streams import RecordingTables

VIDEO_CODEC, VIDEO_SUFFIX = "vp09", ".mp4"
"""Free of patents, in OpenCV's own wheel, and shown by browsers."""
TICKS_HZ = 90_000
"""Resolution of a video's times."""
Note = Callable[[str, int, int], None]
ImageNames = Mapping[tuple[str, str], str]
"""Name of a folder or a file for images, by device and kind."""


@dataclass(frozen=True, slots=True)
class ExportedImages:
    """Files of one kind. device: the camera; what: image, depth, or color (of a depth camera)"""

    device: str
    what: str
    folder: Path
    count: int


def counted_images(replay: Replay, devices: Collection[str] | None) -> dict[tuple[str, str], int]:
    """Number of images, by device and kind. devices: export only these devices' images; None = all.

    Raises InputError without images."""
    counts = {one: count for one, count in replay.image_counts.items() if devices is None or one[0] in devices}
    if not counts:
        known = sorted({device for device, _ in replay.image_counts})
        came = "none" if devices is None else f"none of {', '.join(map(repr, devices))}"
        hint = f"--camera {' or '.join(known)}" if known else ""
        raise InputError("images in the recording", came, hint, replay.path)
    return counts


def export_images(tables: RecordingTables, folders: Mapping[tuple[str, str], Path], note: Note) -> None:
    """Write the images as `INDEX.jpg` and `INDEX.png`. folders: folders by device and kind; note: called with what is
    done, and of how much."""
    for path in folders.values():
        path.mkdir(parents=True, exist_ok=True)
    devices = {device for device, _ in folders}
    cameras = {entity: one for entity, one in tables.streams.items() if one.device in devices}
    cameras = {entity: one for entity, one in cameras.items() if set(one.schema.names) & set(IMAGES)}
    total, done = sum(one.rows for one in cameras.values()), 0
    for stream, batch in tables.batches(cameras):
        for row in batch.select([n for n in batch.schema.names if n in ("index", *IMAGES)]).to_pylist():
            for what in IMAGES:
                if encoded := row.get(what):
                    suffix = "png" if encoded.startswith(PNG_SIGNATURE) else "jpg"
                    (folders[stream.device, what] / f"{row['index']:06d}.{suffix}").write_bytes(encoded)
            done += 1
            note("images", done, total)


class Videos:
    """A video of each kind of images at their recorded times, which the table of the same name has, too. Distances are
    shown as colours from 0 (violet) to the largest of the first image."""

    def __init__(self, folder: Path, rates_hz: dict[str, float], names: ImageNames) -> None:
        self._folder, self._rates_hz, self._names = folder, rates_hz, names
        self._open: dict[Path, tuple[cv2.VideoWriter, tuple[int, ...], float]] = {}
        self._ticks: dict[Path, list[int]] = {}
        self.counts: Counter[Path] = Counter()

    def write(self, device: str, what: str, encoded: bytes, host_ns: int) -> None:
        """Add an image, with its time."""
        path = self._folder / (self._names[device, what] + VIDEO_SUFFIX)
        image: Any = decode_image(encoded, path)
        if path not in self._open:
            self._open[path] = (self._begin(path, device, image), image.shape[:2], float(image.max()) or 1.0)
        writer, size, most = self._open[path]
        if image.shape[:2] != size:
            raise InputError(f"images of {device} of one size", f"{size} and {image.shape[:2]}", "--to images")
        if what == "depth":
            image = cv2.applyColorMap((255.0 * np.minimum(image / most, 1.0)).astype(np.uint8), cv2.COLORMAP_TURBO)
        elif image.ndim == 2:
            image = np.repeat(
                (image >> 8 if image.dtype == np.uint16 else image).astype(np.uint8)[..., None], 3, axis=2
            )
        else:
            image = image[..., ::-1]
        writer.write(np.ascontiguousarray(image))
        self.counts[path] += 1
        ticks, tick = self._ticks.setdefault(path, []), host_ns * TICKS_HZ // 10**9
        ticks.append(max(tick, ticks[-1] + 1) if ticks else tick)

    def close(self) -> None:
        """Raises InputError if a video is incomplete: OpenCV does not report a full disk."""
        for path, (writer, size, _) in self._open.items():
            writer.release()
            self._retime(path, size)
            if cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) < self.counts[path] - 1:
                raise InputError("a video of all images", "one that is cut off: is the disk full?", where=path.name)

    def _retime(self, path: Path, size: tuple[int, ...]) -> None:
        """Put the frames at their times: OpenCV encodes at an even rate, but takes encoded frames with times."""
        even, code = path.rename(path.with_name(f".even-{path.name}")), cv2.VideoWriter.fourcc(*VIDEO_CODEC)
        frames = cv2.VideoCapture(str(even), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
        raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, float(TICKS_HZ), size[::-1], raw)
        for index, tick in enumerate(self._ticks[path]):
            done, frame = frames.read()
            if not done:  # which `close` reports
                break
            since = tick - self._ticks[path][0]
            writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, frames.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME))
            writer.set(cv2.VIDEOWRITER_PROP_PTS, since)
            writer.set(cv2.VIDEOWRITER_PROP_DTS_DELAY, index - since)  # from its place to its time
            writer.write(frame)
        frames.release()
        writer.release()
        even.unlink()

    def _begin(self, path: Path, device: str, image: Any) -> cv2.VideoWriter:
        height, width = image.shape[:2]
        codec, rate = cv2.VideoWriter.fourcc(*VIDEO_CODEC), self._rates_hz[device] or 1.0
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, rate, (width, height))
        if not writer.isOpened():
            raise InputError(f"OpenCV with {VIDEO_CODEC}", "one without", "--to images", path.name)
        return writer
