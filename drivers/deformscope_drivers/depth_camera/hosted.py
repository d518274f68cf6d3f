"""A depth camera that a vendor's library reads in a separate process: a hang or crash there is a lost link here."""

from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deformscope_drivers.clock import ClockFit, Stamp
from deformscope_drivers.device import Device, EndOfReadings, Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected
from deformscope_drivers.frame_message import FrameMessage
from deformscope_drivers.health import Identity
from deformscope_drivers.hosted import HostedProcess, ProcessEnded
from deformscope_drivers.images import QUEUE_IMAGES, DepthImage, Intrinsics, fingerprint

OPEN_TIMEOUT_S = 20.0
END_TIMEOUT_S = 2.0
WRONG_SIZE = "size"
US_NS = 1000.0


class HostedCamera(Device[DepthImage]):
    """The process is restarted for each link. Frames lost are counted by the camera's own counter.

    serve: function that runs in that process, with a channel and `_settings`; silence_s: time without a picture after
    which the camera counts as lost. A subclass gives `_settings`, the parameters of the process, and `_projection`, and
    may override the other hooks."""

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    def __init__(
        self,
        name: str,
        serve: Callable[..., None],
        silence_s: float,
        *,
        reconnect: Reconnect | None,
        stuck_after_s: float | None,
    ) -> None:
        super().__init__(name, reconnect=reconnect, stuck_after_s=stuck_after_s)
        self._serve = serve
        self._silence_s = silence_s
        self._hosted = HostedProcess("the process that reads the camera", name, END_TIMEOUT_S)
        self._reported: dict[str, Any] = {}
        self.intrinsics: Intrinsics | None = None  # of the depth pictures, as the opened camera reports them
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
    def process_id(self) -> int | None:
        """Identifier of the process that reads the camera; None where there is none."""
        return self._hosted.process_id

    def identity(self) -> Identity:
        """Identity that the camera reported while connecting."""
        return Identity(self.model, self.serial, str(self._reported.get("firmware", "")))

    # What a kind of camera fills in ----------------------------------------------------------------------------------

    @abstractmethod
    def _settings(self) -> tuple[Any, ...]:
        """Arguments of `serve`, after the channel. Raises NotConnected."""

    @abstractmethod
    def _projection(self) -> Intrinsics | None:
        """Intrinsics of the depth pictures, which the process reported at opening; None where it reports no lens."""

    def _rate_hz(self) -> float | None:
        """Expected pictures per second [Hz], as `_expect` takes it: 0 = unknown, None = no pictures without request."""
        return float(self._reported["fps"])

    def _fitted_clock(self) -> ClockFit | None:
        """A fresh fit of the camera's clock; None where it has none."""
        return ClockFit(US_NS)

    def _ticks(self, frame: FrameMessage) -> int | None:
        """The camera's time of a frame [us], which never jumps back; None where it has none."""
        return frame.timestamp_us

    def _arrived_ns(self, frame: FrameMessage) -> int:
        """When a frame counts as arrived, on the host's monotonic clock [ns]."""
        return frame.host_ns

    # A device --------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        try:
            self._hosted.start(self._serve, *self._settings())
            report: dict[str, Any] | None = self._hosted.opened(OPEN_TIMEOUT_S, self._closing)
        except ProcessEnded as error:
            status = self._hosted.exit_status(END_TIMEOUT_S)
            came = f"the end of the process that reads it (exit status {status})"
            raise NotConnected("a depth camera", came, "another file or library", self.name) from error
        if report is None:
            raise NotConnected("a depth camera", f"none within {OPEN_TIMEOUT_S:g} s", "reconnect it", self.name)
        self._reported = report
        self.intrinsics = self._projection()
        self._heard_ns = self._clock()
        self._last_index = None
        self._notes.clear()
        self._clock_fit = self._fitted_clock()
        self._expect(self._rate_hz())

    def _receive(self, timeout_s: float) -> Iterable[DepthImage]:
        message = self._hosted.receive(timeout_s)
        if message is None:
            silence_s = (self._clock() - self._heard_ns) / 1e9
            if silence_s > self._silence_s:
                raise LinkLost("a picture", f"none for {silence_s:.3g} s", "check the camera", self.name)
            return []
        match message:
            case ("note", note):
                if note not in self._notes:
                    self._notes.append(note)
                return []
            case ("failed", error):
                raise LinkLost("pictures", str(error), where=self.name)
            case ("end",):
                raise EndOfReadings(f"the end of {Path(self.name).name}")
        self._heard_ns = self._clock()
        return self._picture(message[1])

    def _disconnect(self) -> None:
        self._hosted.end(END_TIMEOUT_S)

    def _fingerprint(self, reading: DepthImage) -> Hashable:
        return fingerprint(reading.depth)

    # Within ----------------------------------------------------------------------------------------------------------

    def _picture(self, frame: FrameMessage) -> Iterable[DepthImage]:
        # what is missing before a frame, by the camera's counter, which begins again where it was reset
        index, last, self._last_index = frame.index, self._last_index, frame.index
        if last is not None and index > (last := self._before(index, last)) + 1:
            self._count_lost(index - last - 1)
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
        return [DepthImage(stamp, depth, float(self._reported["unit_m"]), color, self.intrinsics)]

    def _before(self, index: int, last: int) -> int:
        """The index that the last frame would have, had the counter not begun again."""
        return last if index > last else index - 1
