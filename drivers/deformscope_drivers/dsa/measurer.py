"""Tactile readings out of the controller's packets: packets and their arrival in, readings and refusals out.

Both the device and the replay of a recording's bytes use it: it has neither port nor thread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope_drivers.clock import ClockFit, Stamp, Unwrap
from deformscope_drivers.dsa import messages
from deformscope_drivers.dsa.protocol import Decoder
from deformscope_drivers.dsa.timestamps import TimestampGate, TimestampStatus

TICK_NS = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class TactileReading:
    """One frame of all pads.

    stamp: arrival, and the controller's time in `device_ticks` [ms], without its 32-bit wrap
    texels: (n,) uint16 counts, 0 to 4095, read-only: all matrices in the controller's order, each row by row
    pads: the same, (rows, columns) for each matrix"""

    stamp: Stamp
    texels: messages.TexelArray
    pads: tuple[messages.TexelArray, ...]


class TactileMeasurer:
    """For each link: `connect`, `describe` when the controller has reported its matrices, `begin_stream` whenever
    frames are requested.

    clock_fit: the controller's clock against the host's; repeated: frames that were sent twice; restarts: number of
    restarts of its clock"""

    def __init__(self) -> None:
        self.repeated = self.restarts = 0
        self._gate = TimestampGate()
        self.connect()
        self.begin_stream()

    def connect(self) -> Decoder:
        """A fresh decoder, for a fresh link; the matrices are not known on it yet."""
        self._shapes: list[tuple[int, int]] = []
        self._decoder = Decoder()
        return self._decoder

    def describe(self, shapes: Sequence[tuple[int, int]]) -> None:
        """shapes: (rows, columns) shapes of each matrix"""
        self._shapes = list(shapes)
        self._decoder.cells = sum(rows * columns for rows, columns in shapes)

    def begin_stream(self) -> None:
        """Whatever the time of the next frame, it is new."""
        self._gate.restart()
        self._restart_clock()

    def measure(
        self, event: messages.Reading | messages.Reply, host_ns: int
    ) -> TactileReading | TimestampStatus | None:
        """The reading in a packet; REPEATED or JUMPED if its time refuses it; None for no frame, or one from before the
        matrices were known. host_ns: when it arrived [ns]"""
        if not isinstance(event, messages.Reading) or not self._shapes:
            return None
        verdict = self._gate.check(event.timestamp_ms)
        if verdict is TimestampStatus.REPEATED:
            self.repeated += 1
            return verdict
        if verdict is TimestampStatus.JUMPED:
            return verdict
        if verdict is TimestampStatus.RESTARTED:
            self.restarts += 1
            self._restart_clock()
        ticks = self._unwrap(event.timestamp_ms, host_ns)
        self.clock_fit.add(ticks, host_ns)
        ends = np.cumsum([rows * columns for rows, columns in self._shapes])[:-1]
        parts = np.split(event.texels, ends)
        return TactileReading(
            Stamp(host_ns, ticks),
            event.texels,
            tuple(part.reshape(shape) for part, shape in zip(parts, self._shapes, strict=True)),
        )

    def _restart_clock(self) -> None:
        self._unwrap = Unwrap(1 << 32, TICK_NS)
        self.clock_fit = ClockFit(TICK_NS)
