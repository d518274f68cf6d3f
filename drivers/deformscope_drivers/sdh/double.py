"""A simulated SDH hand that speaks the real one's bytes: a state machine fed bytes and time.

`firmware` carries out commands, `motion` moves the axes; here are its line and its bytes. Assumed: an empty line has no
answer, and numbers have two decimals."""

import math
from collections import deque
from collections.abc import Sequence
from enum import Enum
from typing import Final

from deformscope_drivers.doubles import Line
from deformscope_drivers.sdh.codes import BINARY_COMMANDS, BINARY_SINCE
from deformscope_drivers.sdh.firmware import FORMAT, INDEX, UNKNOWN, Firmware, Refusal
from deformscope_drivers.sdh.motion import Compliance, Motion
from deformscope_drivers.sdh.protocol import CommandDecoder, ErrorReply, Event, Received, Skipped, encode_reply

RS232_BYTES_PER_S: Final = 11_520.0

_REASONS: Final = {"name": UNKNOWN, "axis": INDEX}  # why a line was refused -> error code; else FORMAT


class Port(Enum):
    """Port of the hand: whether binary messages have a checksum, and the pace."""

    RS232 = "rs232"
    CAN = "can"
    TCP = "tcp"


class SdhDouble:
    """A simulated SDH hand.

    firmware: determines its features: binary from 0.0.2.15 on, `con` and `rvel` from 0.0.2.6, `vlim` from 0.0.2.1,
    `alim` from 0.0.2.7; before 0.0.3.1 it adds debug lines, and answers `m` without duration
    state_lag_s: time after a command during which it reports the old axis states (IPA's driver waits for 0.5 s)"""

    def __init__(
        self,
        port: Port = Port.RS232,
        *,
        firmware: str = "0.0.3.2",
        serial_number: str = "0142",
        name: str = "SDH2",
        state_lag_s: float = 0.1,
        paced: bool = True,
    ) -> None:
        self.port = port
        self.commands = 0
        self.silent = False  # receives and sends nothing, and goes on as it is
        texts = {"ver_date": "2010-11-12", "id": name, "sn": serial_number, "soc": "1.0.0.1", "soc_date": "2009-03-03"}
        self._firmware = Firmware(firmware, texts, state_lag_s)
        self._checksummed = port is Port.RS232
        rate = RS232_BYTES_PER_S if paced and port is Port.RS232 else None
        self._ns_per_byte = 0.0 if rate is None else 1e9 / rate
        self._line = Line(rate)
        self.power_up(0)

    @property
    def motion(self) -> Motion:
        """The axes at the last moment to which the double was advanced."""
        return self._firmware.motion

    def power_up(self, now_ns: int) -> None:
        """Switch the hand on: its angles are unchanged, axes off, settings at their defaults."""
        self._firmware.power_up(now_ns)
        self._decoder = CommandDecoder(checksummed=self._checksummed)
        self._line.clear()
        self._arrived_ns = now_ns
        self._waiting: deque[tuple[int, Received]] = deque()  # commands that the hand has, and when each had come

    # What a laboratory does to the hand.

    def place(self, position_deg: Sequence[float]) -> None:
        """Put the axes, (7,), somewhere, at rest."""
        for axis, angle in zip(self.motion.axes, position_deg, strict=True):
            axis.position_deg = angle

    def obstruct(self, axis: int, low_deg: float = -math.inf, high_deg: float = math.inf) -> None:
        """Something blocks an axis, beyond these angles; without any, it is taken away."""
        self.motion.axes[axis].obstacle_low_deg = low_deg
        self.motion.axes[axis].obstacle_high_deg = high_deg

    def press(self, compliance: Compliance | None) -> None:
        """The fingers press something soft from now on; None = nothing."""
        self.motion.compliance = compliance

    def refuse_next(self, code: int) -> None:
        """Answer the next command with this error code."""
        self._firmware.refusals.append(code)

    def say(self, data: bytes, now_ns: int) -> None:
        """Send something without a request: a debug line, noise."""
        self._line.send(data, now_ns)

    def position_deg(self, now_ns: int) -> tuple[float, ...]:
        """The angles of the axes, (7,), at that moment; for the double's caller, not parallel to a wire's thread."""
        self._run(now_ns)
        return tuple(axis.position_deg for axis in self.motion.axes)

    # The wire's side.

    def receive(self, data: bytes, now_ns: int) -> None:
        """Bytes from the host; on RS-232 they take their time."""
        if self.silent:
            return
        self._arrived_ns = max(now_ns, self._arrived_ns) + round(len(data) * self._ns_per_byte)
        for event in self._decoder.feed(data):
            if not isinstance(event, Skipped):
                self._waiting.append((self._arrived_ns, event))
        self._run(now_ns)

    def due(self, now_ns: int) -> bytes:
        self._run(now_ns)
        return self._line.due(now_ns)

    def next_ns(self, now_ns: int) -> int | None:
        moments = [self._line.next_ns()]
        if self._waiting:
            moments.append(self._waiting[0][0])
        return min((moment for moment in moments if moment is not None), default=None)

    def _run(self, now_ns: int) -> None:
        """Everything up to now: the commands that have come by then."""
        while self._waiting and self._waiting[0][0] <= now_ns:
            at_ns, received = self._waiting.popleft()
            self._firmware.motion.advance(at_ns)
            self._answer(received, at_ns)
        self._firmware.motion.advance(now_ns)

    def _answer(self, received: Received, now_ns: int) -> None:
        command = received.command
        if received.binary and self._firmware.release < BINARY_SINCE:
            return
        if command is None:
            if received.reason != "empty":
                self._send(ErrorReply(_REASONS.get(received.reason, FORMAT)), False, now_ns)
            return
        self.commands += 1
        try:
            if received.binary and command.name not in BINARY_COMMANDS:
                raise Refusal(UNKNOWN)
            for event in self._firmware.do(command, now_ns):
                self._send(event, received.binary, now_ns)
        except Refusal as refusal:
            self._send(ErrorReply(refusal.code, command.name if received.binary else None), received.binary, now_ns)

    def _send(self, event: Event, binary: bool, now_ns: int) -> None:
        self._line.send(encode_reply(event, binary_checksum=self._checksummed if binary else None), now_ns)
