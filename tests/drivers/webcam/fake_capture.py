"""A camera that exists in memory alone, in OpenCV's place: what is set, what comes, and what goes wrong."""

from __future__ import annotations

import threading
import time

import numpy as np

from deformscope_drivers.errors import LinkLost, NotConnected
from deformscope_drivers.webcam.device import Setting


class FakeCamera:
    """modes: sizes and rates it has, by format; controls: what else can be set, and what it is set to"""

    def __init__(self, rate_hz: float = 200.0) -> None:
        self.modes = {"MJPG": [(640, 480, 30.0), (64, 48, 30.0)], "YUYV": [(64, 48, 15.0)]}
        self.controls = {Setting.AUTOFOCUS: 1.0, Setting.AUTO_EXPOSURE: 3.0, Setting.EXPOSURE: 166.0}
        self.controls |= {Setting.AUTO_WHITE_BALANCE: 1.0, Setting.WHITE_BALANCE: 4000.0, Setting.GAIN: 0.0}
        self.stubborn: dict[Setting, float] = {}  # settings that stay what they are
        self.period_s = 1.0 / rate_hz
        self.plugged = True
        self.paused = False
        self.frozen = False
        self.undecodable = False
        self.timestamps = True
        self.shape: tuple[int, ...] | None = None
        self.asked: list[Setting] = []
        self.opened = self.closed = 0
        self.paths: list[str] = []

    def open(self, path: str) -> FakeCapture:
        self.paths.append(path)
        if not self.plugged:
            raise NotConnected("a camera that is there", "none", where=path)
        self.opened += 1
        return FakeCapture(self, path)


class FakeCapture:
    def __init__(self, camera: FakeCamera, path: str) -> None:
        self.camera, self.path = camera, path
        self.fourcc, self.size, self.fps = "YUYV", (64, 48), 15.0
        self._wanted_width = 0
        self._grabbed = 0
        self._next_s = time.monotonic()
        self._taken_us = 0
        self._pause = threading.Event()

    def set(self, setting: Setting, value: float) -> None:
        self.camera.asked.append(setting)
        if setting in self.camera.stubborn:
            return
        modes = self.camera.modes
        if setting is Setting.FOURCC:
            fourcc = int(value).to_bytes(4, "little").decode()
            if fourcc in modes:
                self.fourcc = fourcc
                self.size, self.fps = modes[fourcc][0][:2], modes[fourcc][0][2]
        elif setting is Setting.WIDTH:
            self._wanted_width = int(value)
        elif setting is Setting.HEIGHT:
            for width, height, fps in modes[self.fourcc]:
                if (width, height) == (self._wanted_width, int(value)):
                    self.size, self.fps = (width, height), fps
        elif setting is Setting.FPS:
            if value in [fps for width, height, fps in modes[self.fourcc] if (width, height) == self.size]:
                self.fps = value
        elif setting in self.camera.controls:
            self.camera.controls[setting] = value

    def get(self, setting: Setting) -> float | None:
        now = {
            Setting.FOURCC: float(int.from_bytes(self.fourcc.encode(), "little")),
            Setting.WIDTH: float(self.size[0]),
            Setting.HEIGHT: float(self.size[1]),
            Setting.FPS: self.fps,
        }
        return self.camera.stubborn.get(setting, now.get(setting, self.camera.controls.get(setting)))

    def wait(self, timeout_s: float) -> bool:
        until_s = time.monotonic() + timeout_s
        while True:
            if not self.camera.plugged:
                raise LinkLost("an image", "an error (unplugged)", where=self.path)
            now_s = time.monotonic()
            if now_s >= self._next_s and not self.camera.paused:
                self._next_s = max(self._next_s + self.camera.period_s, now_s)
                self._grabbed += 1
                self._taken_us = round(now_s * 1e6)
                return True
            if now_s >= until_s:
                return False
            self._pause.wait(min(max(self._next_s - now_s, 0.001), 0.005))

    def timestamp_us(self) -> int | None:
        return self._taken_us if self.camera.timestamps else None

    def retrieve(self):
        if self.camera.undecodable:
            return None
        shape = self.camera.shape or (self.size[1], self.size[0], 3)
        return np.full(shape, 7 if self.camera.frozen else self._grabbed % 251, np.uint8)

    def close(self) -> None:
        self.camera.closed += 1
