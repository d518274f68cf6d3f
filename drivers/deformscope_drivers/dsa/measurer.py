"""Tactile readings out of the controller's packets: packets and their arrival in, readings and refusals out.

Both the device and the replay of a recording's bytes use it: it has neither port nor thread."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from deformscope_drivers.clock import ClockFit, Stamp, Unwrap
from deformscope_drivers.dsa import messages
from deformscope_drivers.dsa.protocol import Decoder

STEP_MAX_MS = 1000
"""A longer step between two frames is a jump; frames come every 25 to 90 ms, and a true pause costs one frame."""

_WRAP = 1 << 32


class TimestampStatus(Enum):
    """Status of a frame by its time."""

    NEW = "new"
    REPEATED = "repeated"
    JUMPED = "jumped"
    RESTARTED = "restarted"  # new, on a clock that was set anew


class TimestampGate:
    """Feed each frame's time in turn. A jump is refused, unless the next frame continues from it. Then the clock has
    changed (the controller was switched off and on), and frames count as new from that one.

    Without this rule, two flipped bits that the checksum does not detect could shift the clock by weeks."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._suspect: int | None = None

    def restart(self) -> None:
        """Forget what was seen: the next frame is new, whatever its time."""
        self._last = self._suspect = None

    def check(self, timestamp_ms: int) -> TimestampStatus:
        """timestamp_ms: 32 bits, may wrap around."""
        if timestamp_ms == self._last:
            return TimestampStatus.REPEATED
        if self._last is None or _goes_on(self._last, timestamp_ms):
            verdict = TimestampStatus.NEW
        elif self._suspect is not None and _goes_on(self._suspect, timestamp_ms):
            verdict = TimestampStatus.RESTARTED
        else:
            self._suspect = timestamp_ms
            return TimestampStatus.JUMPED
        self._last, self._suspect = timestamp_ms, None
        return verdict


def _goes_on(before: int, after: int) -> bool:
    return 0 < (after - before) % _WRAP <= STEP_MAX_MS


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

    clock_fit: the controller's clock against the host's; repeated: frames sent twice; restarts: its clock's"""

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
