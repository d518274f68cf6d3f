"""The simulated sensor: its only inputs are bytes and time."""

import numpy as np

from deformscope_drivers.doubles import Line
from deformscope_drivers.interface import FloatArray, Scene
from deformscope_ft300.protocol import BAUDRATE, PER_COUNT, RATE_HZ, START, STARTED, Packet

PERIOD_NS = round(1e9 / RATE_HZ)
OFFSET = (1.5, -0.8, -6.0, 0.02, 0.05, -0.01)
"""What it shows without a load [N, N m]."""
NOISE = (0.1, 0.1, 0.1, 0.005, 0.005, 0.003)
"""Standard deviation of a reading [N, N m], by the data sheet."""


class Ft300Double:
    """A sensor that streams once it is asked to, as its line carries it."""

    def __init__(self, scene: Scene | None = None) -> None:
        self._scene: Scene = scene if scene is not None else lambda time_s: (0.0,) * 6
        self._line = Line(BAUDRATE / 10)
        self.power_up(0)

    def power_up(self, now_ns: int) -> None:
        """Start as after switching on: it does not stream."""
        self._random = np.random.default_rng(0)
        self._heard = b""
        self.streams = False
        self._next_ns = now_ns
        self._line.clear()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes that the host sent, in pieces of any size."""
        self._heard = (self._heard + data)[-64:]
        if self.streams and b"\xff" * 50 in self._heard:
            self.streams, self._heard = False, b""
        if START in self._heard:
            self._heard = b""
            if not self.streams:
                self.streams, self._next_ns = True, now_ns + PERIOD_NS
                self._line.send(STARTED, now_ns)

    def due(self, now_ns: int) -> bytes:
        """Bytes that have left the device by now and were not handed out before."""
        while self.streams and self._next_ns <= now_ns:
            self._line.send(Packet(tuple(self._counts(self._next_ns).tolist())).encode(), self._next_ns)
            self._next_ns += PERIOD_NS
        return self._line.due(now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        """When bytes are due next; None while it does not stream."""
        times = [self._line.next_ns(), self._next_ns if self.streams else None]
        return min((time for time in times if time is not None), default=None)

    def _counts(self, now_ns: int) -> "FloatArray":
        load = np.asarray(self._scene(now_ns * 1e-9), float) + OFFSET + self._random.normal(0.0, NOISE)
        return np.clip(np.rint(load / PER_COUNT), -32768, 32767).astype(int)
