"""A depth camera that a vendor's library reads in a process of its own: a hang or crash there is a lost link here."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import time
from abc import abstractmethod
from collections.abc import Hashable, Iterable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deformscope_drivers import errors
from deformscope_drivers.camera_process.command import process_command, process_environment
from deformscope_drivers.camera_process.messages import (
    END,
    FAILED,
    FRAME,
    NOTE,
    OPENED,
    FrameMessage,
    unpack_frame,
    unpack_words,
)
from deformscope_drivers.clock import ClockFit, Stamp
from deformscope_drivers.depth_camera.image import DepthImage, Intrinsics
from deformscope_drivers.device import Device, EndOfReadings, Reconnect
from deformscope_drivers.errors import DeviceError, LinkLost, NotConnected
from deformscope_drivers.health import Identity
from deformscope_drivers.images import QUEUE_IMAGES, fingerprint

OPEN_TIMEOUT_S = 20.0
END_TIMEOUT_S = 2.0
WRONG_SIZE = "size"
US_NS = 1000.0


class CameraBeside(Device[DepthImage]):
    """The process is started anew for each link. Frames lost are counted by the camera's own counter.

    module: what is run there; silence_s: no picture for this long means a lost camera
    A subclass gives `_arguments`, what the process is to open, and `_projection`, and has its say in the other hooks.
    """

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    def __init__(
        self, name: str, module: str, silence_s: float, *, reconnect: Reconnect | None, stuck_after_s: float | None
    ) -> None:
        super().__init__(name, reconnect=reconnect, stuck_after_s=stuck_after_s)
        self._module = module
        self._silence_s = silence_s
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._reported: dict[str, Any] = {}
        self._intrinsics: Intrinsics | None = None
        self._heard_ns = 0
        self._last_index: int | None = None
        self._notes: list[str] = []

    @property
    def model(self) -> str:
        """The camera's maker and name, once it was opened."""
        return str(self._reported.get("name", ""))

    @property
    def serial(self) -> str:
        """The camera's serial number, once it was opened; empty where it reports none."""
        return str(self._reported.get("serial", ""))

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Of the depth pictures as the camera reports them, once it was opened; None where it reports none."""
        return self._intrinsics

    def identity(self) -> Identity:
        """As the camera reported it while connecting."""
        return Identity(self.model, self.serial, str(self._reported.get("firmware", "")))

    # What a kind of camera fills in ----------------------------------------------------------------------------------

    @abstractmethod
    def _arguments(self) -> tuple[str, ...]:
        """Arguments of the process, after the number of its end of the socket. Raises NotConnected."""

    @abstractmethod
    def _projection(self) -> Intrinsics | None:
        """Of the pictures, by what was reported."""

    def _rate_hz(self) -> float | None:
        """As for `_expect`."""
        return float(self._reported["fps"])

    def _fitted_clock(self) -> ClockFit | None:
        """A fresh fit of the camera's clock; None where it has none."""
        return ClockFit(US_NS)

    def _ticks(self, frame: FrameMessage) -> int | None:
        """The camera's time of a frame [us], which never jumps back; None where it has none."""
        return frame.timestamp_us

    def _arrived_ns(self, frame: FrameMessage) -> int:
        """When a frame arrived on the host's clock [ns]."""
        return frame.host_ns

    # A device --------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        self._start_process(self._arguments())
        self._reported = self._await_opened()
        self._intrinsics = self._projection()
        self._heard_ns = self._clock()
        self._last_index = None
        self._notes.clear()
        self._clock_fit = self._fitted_clock()
        self._expect(self._rate_hz())

    def _receive(self, timeout_s: float) -> Iterable[DepthImage]:
        message = self._message(timeout_s)
        if message is None:
            silence_s = (self._clock() - self._heard_ns) / 1e9
            if silence_s > self._silence_s:
                raise LinkLost("a picture", f"none for {silence_s:.3g} s", "look at the camera", self.name)
            return []
        kind = message[:1]
        if kind == NOTE:
            if (words := _words(message)) not in self._notes:
                self._notes.append(words)
            return []
        self._heard_ns = self._clock()
        if kind == END:
            raise EndOfReadings(f"the end of {Path(self.name).name}")
        if kind == FAILED:
            raise LinkLost("pictures", _words(message), where=self.name)
        return self._picture(unpack_frame(message)) if kind == FRAME else []

    def _disconnect(self) -> None:
        connection, self._connection = self._connection, None
        process, self._process = self._process, None
        if connection is not None:
            connection.close()
        if process is not None:
            try:
                process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _fingerprint(self, reading: DepthImage) -> Hashable:
        return fingerprint(reading.depth)

    # Within ----------------------------------------------------------------------------------------------------------

    def _start_process(self, arguments: tuple[str, ...]) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._connection = Connection(ours.detach())
            self._process = subprocess.Popen(
                process_command(self._module, str(theirs.fileno()), *arguments),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=process_environment(),
            )

    def _await_opened(self) -> dict[str, Any]:
        until = time.monotonic() + OPEN_TIMEOUT_S
        while time.monotonic() < until and not self._closing.is_set():
            try:
                message = self._message(0.05)
            except LinkLost as error:
                status = None if self._process is None else self._process.returncode
                came = f"the end of the process that reads it (exit status {status})"
                raise NotConnected("a depth camera", came, "another file or library", self.name) from error
            if message is None:
                continue
            if message[:1] == OPENED:
                return unpack_words(message)
            if message[:1] == FAILED:
                kind: type[DeviceError] = getattr(errors, str(unpack_words(message)["kind"]))
                raise kind.in_words(_words(message))
        raise NotConnected("a depth camera", f"none within {OPEN_TIMEOUT_S:g} s", "plug it in anew", self.name)

    def _message(self, timeout_s: float) -> bytes | None:
        """The next message of the process; None when none came in time. Raises LinkLost when it has ended."""
        if self._connection is None or self._process is None:
            raise NotConnected("an open camera", "one that is closed", where=self.name)
        try:
            return self._connection.recv_bytes() if self._connection.poll(timeout_s) else None
        except (EOFError, OSError) as error:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT_S)
            came = f"its end (exit status {self._process.returncode})"
            raise LinkLost("the process that reads the camera", came, "", self.name) from error

    def _picture(self, frame: FrameMessage) -> Iterable[DepthImage]:
        self._count(frame.index)
        if (frame.width, frame.height) != (self._reported["width"], self._reported["height"]):
            self._count_refused(WRONG_SIZE)
            return []
        stamp = Stamp(self._arrived_ns(frame), self._ticks(frame))
        if self._clock_fit is not None and stamp.device_ticks is not None:
            self._clock_fit.add(stamp.device_ticks, stamp.host_ns)
        depth = np.frombuffer(frame.depth, np.uint16).reshape(frame.height, frame.width)
        color = None
        if frame.color:
            color = np.frombuffer(frame.color, np.uint8).reshape(frame.color_height, frame.color_width, 3)
        return [DepthImage(stamp, depth, float(self._reported["unit_m"]), color, self._intrinsics)]

    def _count(self, index: int) -> None:
        """Count what is missing before a frame, by the camera's counter, which begins again where it was reset."""
        last, self._last_index = self._last_index, index
        if last is not None and index > (last := self._before(index, last)) + 1:
            self._count_lost(index - last - 1)

    def _before(self, index: int, last: int) -> int:
        """The index that the last frame would have, had the counter not begun again."""
        return last if index > last else index - 1


def _words(message: bytes) -> str:
    return str(unpack_words(message).get("words", ""))
