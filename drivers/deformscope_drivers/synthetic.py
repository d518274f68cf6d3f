"""Cameras that take their pictures from a program: what the synthetic colour and depth cameras share."""

import dataclasses
import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar, cast

import numpy as np

from deformscope_drivers.clock import Clock, ClockFit, Stamp
from deformscope_drivers.device import Device, Measurement, Reconnect
from deformscope_drivers.errors import LinkLost, NotConnected
from deformscope_drivers.images import QUEUE_IMAGES
from deformscope_drivers.pacing import Pacer

BUFFERS = 4
"""Pictures that wait in the camera's driver without a reader, as with V4L2; older ones are lost."""
PUSHED = 64
"""Views that wait to be taken; more than are taken in time are lost."""

MeasurementT = TypeVar("MeasurementT", bound=Measurement)
ViewT = TypeVar("ViewT")


@dataclass(frozen=True, slots=True)
class SyntheticConfig:
    """rate_hz: pictures a second of a scene; seed: seed of everything that is random
    silence_s: time without a picture after which the link counts as lost; stuck_after_s: time of the same picture,
    after which it counts as stuck; None = never"""

    name: str
    rate_hz: float = 30.0
    seed: int = 0
    silence_s: float | None = None
    stuck_after_s: float | None = None


class SyntheticSource(Device[MeasurementT], Generic[MeasurementT, ViewT]):
    """A camera on a program's scene: `scene(time_s)` is called at `rate_hz`, or views come through `push`.

    scene: the visible scene at a time since opening [s]; None = only pushed pictures A picture's device_ticks are the
    camera's own time since opening [us]. Everything that is random comes from `seed`. It runs in real time with a
    thread, or on a simulated clock with open(own_thread=False) and poll()."""

    queue_readings: ClassVar[int] = QUEUE_IMAGES

    def __init__(
        self,
        scene: Callable[[float], ViewT] | None,
        config: SyntheticConfig,
        *,
        reconnect: Reconnect | None,
        clock: Clock,
    ) -> None:
        super().__init__(config.name, reconnect=reconnect, stuck_after_s=config.stuck_after_s, clock=clock)
        self._scene = scene
        self._period_ns = round(1e9 / config.rate_hz)
        self._silence_ns = None if config.silence_s is None else round(config.silence_s * 1e9)
        self._random = np.random.default_rng(config.seed)
        self._pacer = Pacer(clock)
        self._lock = threading.Lock()
        self._pushed: deque[ViewT] = deque()
        self._plugged = True
        self._silent = False
        self._frozen = False
        self._to_drop = 0
        self._held: MeasurementT | None = None
        self._started_ns = self._heard_ns = 0
        self._next_index = 0

    @abstractmethod
    def _take(self, view: ViewT, stamp: Stamp) -> MeasurementT:
        """The camera's picture of a view, with what the camera adds to it."""

    # For the program that fills it -----------------------------------------------------------------------------------

    def push(self, view: ViewT) -> None:
        """Show the camera a view, of which it gives one picture. Views of a camera that is not open are ignored."""
        with self._lock:
            if len(self._pushed) == PUSHED:
                self._pushed.popleft()
                self._count_lost(1)
            self._pushed.append(view)
        self._pacer.wake()

    # Faults ----------------------------------------------------------------------------------------------------------

    def unplug(self) -> None:
        """Pull the cable out."""
        self._plugged = False
        self._pacer.wake()

    def plug(self) -> None:
        """Put it back in."""
        self._plugged = True

    def stop(self) -> None:
        """Send no more pictures; the link stays open."""
        self._silent = True

    def resume(self) -> None:
        """Send again."""
        self._silent = False

    def freeze(self, frozen: bool = True) -> None:
        """Send the same picture again and again, as a camera that has died behind a link that lives."""
        self._frozen = frozen

    def drop(self, count: int) -> None:
        """Lose the next pictures in transit."""
        self._to_drop = count

    # A device --------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        if not self._plugged:
            raise NotConnected("a camera that is there", "none", where=self.name)
        with self._lock:
            self._pushed.clear()
        self._held = None
        self._next_index = 0
        self._started_ns = self._heard_ns = self._clock()
        self._clock_fit = ClockFit(1000.0)
        self._expect(None if self._scene is None else 1e9 / self._period_ns)

    def _receive(self, timeout_s: float) -> Iterable[MeasurementT]:
        moment_ns = self._started_ns + self._next_index * self._period_ns
        until_ns = self._clock() + round(timeout_s * 1e9)
        with self._lock:
            waiting = bool(self._pushed)
        if not waiting:
            self._pacer.wait_until(until_ns if self._scene is None else min(moment_ns, until_ns), timeout_s)
        if not self._plugged:
            raise LinkLost("pictures", "the end of the cable (unplugged?)", where=self.name)
        now_ns = self._clock()
        with self._lock:
            views = list(self._pushed)
            self._pushed.clear()
        found = [self._picture(view, now_ns) for view in views] + self._of_scene(now_ns)
        sent = [reading for reading in found if reading is not None and not self._silent]
        if sent:
            self._heard_ns = now_ns
        elif self._silence_ns is not None and now_ns - self._heard_ns > self._silence_ns:
            raise LinkLost("a picture", f"none for {(now_ns - self._heard_ns) / 1e9:.3g} s", where=self.name)
        return sent

    def _disconnect(self) -> None:
        pass

    def _wake(self) -> None:
        self._pacer.wake()

    def _of_scene(self, now_ns: int) -> list[MeasurementT | None]:
        if self._scene is None:
            return []
        count = (now_ns - self._started_ns) // self._period_ns + 1 - self._next_index
        if count > BUFFERS:
            self._count_lost(count - BUFFERS)
            self._next_index += count - BUFFERS
        found = []
        for _ in range(min(count, BUFFERS)):
            exposed_ns = self._next_index * self._period_ns
            self._next_index += 1
            found.append(self._picture(self._scene(exposed_ns / 1e9), now_ns, exposed_ns))
        return found

    def _picture(self, view: ViewT, now_ns: int, exposed_ns: int | None = None) -> MeasurementT | None:
        camera_ns = now_ns - self._started_ns if exposed_ns is None else exposed_ns
        stamp = Stamp(now_ns, camera_ns // 1000)
        if self._to_drop > 0:
            self._to_drop -= 1
            self._count_lost(1)
            return None
        if self._frozen and self._held is not None:
            reading: MeasurementT = dataclasses.replace(cast(Any, self._held), stamp=stamp)  # it is a dataclass
        else:
            self._held = reading = self._take(view, stamp)
        if self._clock_fit is not None and stamp.device_ticks is not None:
            self._clock_fit.add(stamp.device_ticks, stamp.host_ns)
        return reading
