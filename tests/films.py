"""Videos whose frames have any times."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np


def pictures(count: int, size: tuple[int, int] = (48, 64)) -> Iterator[np.ndarray]:
    scene = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (*size, 3)).astype(np.float32), (0, 0), 2.0)
    for index in range(count):
        yield np.roll(cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8), index, axis=1)


def film(path: Path, times_ms: Sequence[int], fourcc: str = "vp09", images: Iterable[np.ndarray] | None = None) -> Path:
    """A video with these times: encoded at an even rate, then its packets are put at their times. images: BGR (48, 64)
    by default"""
    even, code = path.with_name(f"even-{path.name}"), cv2.VideoWriter.fourcc(*fourcc)
    shown = list(pictures(len(times_ms)) if images is None else images)
    size = shown[0].shape[1::-1]
    writer = cv2.VideoWriter(str(even), cv2.CAP_FFMPEG, code, 30.0, size)
    for picture in shown:
        writer.write(picture)
    writer.release()
    packets = cv2.VideoCapture(str(even), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    out = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 1000.0, size, raw)
    assert out.isOpened()
    for index, time in enumerate(times_ms):
        read, packet = packets.read()
        assert read
        out.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, packets.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME))
        out.set(cv2.VIDEOWRITER_PROP_PTS, time)
        out.set(cv2.VIDEOWRITER_PROP_DTS_DELAY, index - time)
        out.write(packet)
    out.release()
    even.unlink()
    return path
