"""Access to a camera: OpenCV over Video4Linux (V4L2), behind an interface as small as a test's fake can be.

OpenCV waits for an image without end, or 10 s, unless a timeout is set: `waitAny` waits for its given time. Only the
first image after opening is waited for inside OpenCV; `OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT` bounds that [s], and is set
to 2 unless the user has set it. The kernel's own calls (opening, setting) cannot be bounded from here.
Sources: OpenCV's documentation and its cap_v4l.cpp; V4L2's documents for the units of controls."""

from __future__ import annotations

import os
from enum import Enum
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deformscope_drivers.errors import LinkLost, NotConnected

SELECT_TIMEOUT = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
SELECT_TIMEOUT_S = 2


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
