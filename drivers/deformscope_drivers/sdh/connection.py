"""The link to the hand: opening, requests and answers, and repeated readings."""

from collections.abc import Hashable, Iterable
from typing import TypeVar

from deformscope_drivers import errors
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import ROUND_S, StreamDevice
from deformscope_drivers.framing import NOISE, Skipped
from deformscope_drivers.health import Identity
from deformscope_drivers.sdh import codes, protocol
from deformscope_drivers.sdh.config import ByAxis, Limits, SdhConfig
from deformscope_drivers.sdh.measurer import HandMeasurer
from deformscope_drivers.sdh.results import HandIdentity, HandReading
from deformscope_drivers.transport import Transport

OPEN_QUIET_S = 0.1
OPEN_DROP_BYTES = 1024
VERSION_TIMEOUT_S = 1.0
TRIES = 3
RESYNC_QUIET_S = 0.03
_GARBLED = frozenset((10, 33))  # the hand got our bytes with a wrong checksum: worth another try

ReplyT = TypeVar("ReplyT", protocol.Reading, protocol.ValueReply, protocol.TextReply)


class SdhConnection(StreamDevice[HandReading]):
    """Asks the hand, one command at a time, in the device's thread; `device.Sdh` adds what a user asks of a hand."""

    def __init__(self, config: SdhConfig, *, transport: Transport | None = None, clock: Clock = monotonic_ns) -> None:
        self.config = config
        self._about: HandIdentity | None = None
        self._release: codes.Release = ()
        self._connections = 0
        self._retries = 0
        self._period_ns = round(1e9 / config.rate_hz)
        self._next_poll_ns = self._next_temperature_ns = 0
        super().__init__(transport or config.transport(), reconnect=config.reconnect, clock=clock)
        self._measurer = HandMeasurer(self.name)

    @property
    def about(self) -> HandIdentity:
        """The hand's identity when it was opened."""
        if self._about is None:
            raise errors.NotConnected("a hand that was opened", "one that was not", "open() it", self.name)
        return self._about

    def identity(self) -> Identity:
        if self._about is None:
            return Identity(model="SDH")
        return Identity(self._about.name, self._about.serial_number, self._about.firmware)

    @property
    def limits(self) -> Limits:
        """Limits of the axes; before the hand was opened, Schunk's defaults."""
        return Limits() if self._about is None else self._about.limits

    # What the base class asks for ------------------------------------------------------------------------------------

    def _make_decoder(self) -> protocol.Decoder:
        return protocol.Decoder(checksummed=self.config.checksummed())

    def _measure(self, event: protocol.Event, host_ns: int) -> Iterable[HandReading]:
        return []  # a reading is made of three answers: see _poll

    def _fingerprint(self, reading: HandReading) -> Hashable:
        return None  # a hand at rest reports the same again and again

    def _extra_health(self) -> dict[str, float]:
        return {"retries": self._retries}

    def _start(self) -> None:
        """Begin like Schunk's library: end a half command, discard waiting data, ask for the release."""
        self._release = ()
        self._send(protocol.END_OF_COMMAND)
        dropped = self._transport.drain(OPEN_QUIET_S, OPEN_QUIET_S, OPEN_DROP_BYTES)
        self._record_raw(dropped, self._clock())
        firmware = self._text("ver", VERSION_TIMEOUT_S)
        self._release = codes.release(firmware)
        if not self._release:
            raise errors.ProtocolViolation(
                "a firmware release such as 0.0.2.10", repr(firmware), "a newer cable", self.name
            )
        binary = self._release >= codes.BINARY_SINCE and self.config.protocol != "ascii"
        if self.config.protocol == "binary" and not binary:
            advice = 'protocol = "ascii"'
            raise errors.SettingsRefused("firmware 0.0.2.15 or later for binary", firmware, advice, self.name)
        speeds: ByAxis = codes.VELOCITY_MAX_OLD_DEG_S
        accelerations = Limits().acceleration_max_deg_s2
        if self._release >= codes.VELOCITY_LIMITS_SINCE:
            speeds = self._values("vlim")
        if self._release >= codes.ACCELERATION_LIMITS_SINCE:
            accelerations = self._values("alim")
        self._about = HandIdentity(
            firmware=firmware,
            firmware_date=self._text_if_known("ver_date"),
            name=self._text_if_known("id"),
            serial_number=self._text_if_known("sn"),
            binary=binary,
            limits=Limits(velocity_max_deg_s=speeds, acceleration_max_deg_s2=accelerations),
        )
        self._next_poll_ns = self._next_temperature_ns = self._clock()
        self._connections += 1

    def _receive(self, timeout_s: float) -> Iterable[HandReading]:
        try:
            return self._round(timeout_s)
        except errors.NoReply as error:
            raise errors.LinkLost("answers from the hand", "none", "check its supply and cable", self.name) from error

    def _round(self, timeout_s: float) -> Iterable[HandReading]:
        """Wait for the time of the next reading, and take it. An answer that makes no reading is counted as refused."""
        wait_ns = self._next_poll_ns - self._clock()
        if wait_ns > 0:
            self._overhear(min(wait_ns / 1e9, timeout_s))
            if self._clock() < self._next_poll_ns:
                return []
        now_ns = self._clock()
        self._next_poll_ns += self._period_ns
        if self._next_poll_ns < now_ns:  # too slow for the rate: go on from here, never catch up
            self._next_poll_ns = now_ns
        try:
            reading = self._poll()
            return [] if reading is None else [reading]
        except errors.CommandRefused as error:
            self._count_refused(f"error {error.code} ({error.name})")
        except errors.ProtocolViolation:
            self._count_refused("state")
        return []

    # Readings --------------------------------------------------------------------------------------------------------

    def _poll(self) -> HandReading | None:
        """The angles come last: an axis that was idle before is where it stays, and the stamp is the newest."""
        if self._clock() >= self._next_temperature_ns:
            self._next_temperature_ns = self._clock() + round(self.config.temperature_period_s * 1e9)
            self._measured("temp")
        self._measured("state")
        self._measured(*self._velocity_query())
        return self._measured("pos")

    def _velocity_query(self) -> tuple[str, ByAxis]:
        """The command that the hand answers with the axes' velocities, and its values."""
        return "vel", ()

    def _measured(self, quantity: str, targets: ByAxis = ()) -> HandReading | None:
        answer = self._exchange(protocol.Command(quantity, targets), protocol.Reading)
        return self._measurer.measure(answer, self._heard_ns)

    # Asking ----------------------------------------------------------------------------------------------------------

    def _text(self, name: str, timeout_s: float | None = None) -> str:
        return self._exchange(protocol.Command(name), protocol.TextReply, timeout_s).text

    def _text_if_known(self, name: str) -> str:
        try:
            return self._text(name)
        except errors.CommandRefused:
            return ""

    def _values(self, name: str, *values: float) -> ByAxis:
        return self._exchange(protocol.Command(name, values), protocol.ValueReply).values

    def _exchange(self, command: protocol.Command, kind: type[ReplyT], timeout_s: float | None = None) -> ReplyT:
        """Send a command and take its answer; again, after the line fell silent, when none comes or it is garbled.

        Runs in the device's thread. Raises CommandRefused with the hand's error code, NoReply, LinkLost."""
        timeout_s = self.config.reply_timeout_s if timeout_s is None else timeout_s
        in_binary = (
            command.name in codes.BINARY_COMMANDS
            and command.axis is None
            and self._about is not None
            and self._about.binary
            and self._release >= codes.BINARY_SINCE
        )
        data = protocol.encode(command, binary_checksum=self.config.checksummed() if in_binary else None)
        refusal: protocol.ErrorReply | None = None
        for attempt in range(TRIES):
            if attempt:
                self._retries += 1
                self._resync()
            self._overhear(0.0)
            self._send(data)
            reply = self._answer(command, kind, timeout_s)
            if reply is not None and not isinstance(reply, protocol.ErrorReply):
                return reply
            refusal = reply
            if refusal is not None and refusal.code not in _GARBLED:
                break
        doing = command.name + (f"={','.join(f'{value:g}' for value in command.values)}" if command.values else "")
        if refusal is not None:
            raise errors.CommandRefused(
                refusal.code, codes.error_name(refusal.code), doing, codes.error_advice(refusal.code), self.name
            )
        expected = f"an answer to {doing} within {TRIES} x {timeout_s:g} s"
        raise errors.NoReply(expected, "none", "check supply, cable and baud rate", self.name)

    def _answer(
        self, command: protocol.Command, kind: type[ReplyT], timeout_s: float
    ) -> ReplyT | protocol.ErrorReply | None:
        until_ns = self._clock() + round(timeout_s * 1e9)
        while (left_ns := until_ns - self._clock()) > 0:
            found: ReplyT | protocol.ErrorReply | None = None
            for event, _ in self._listen(min(left_ns / 1e9, ROUND_S)):
                if found is None and isinstance(event, kind | protocol.ErrorReply) and _is_about(event, command):
                    found = event
                elif not isinstance(event, protocol.DebugLine):
                    self._count_refused("unasked")
            if found is not None:
                return found
        return None

    def _overhear(self, timeout_s: float) -> None:
        """Take unrequested data: debug lines, and late answers."""
        for event, _ in self._listen(timeout_s):
            if not isinstance(event, protocol.DebugLine):
                self._count_refused("unasked")

    def _resync(self) -> None:
        """Wait for the line to fall silent, and discard its data: a binary answer has no start mark."""
        late = self._transport.drain(RESYNC_QUIET_S, RESYNC_QUIET_S, OPEN_DROP_BYTES)
        if late:
            self._record_raw(late, self._clock())
            self._count_skipped(Skipped(len(late), NOISE))
        for event in self._decoder.finish():
            if isinstance(event, Skipped):
                self._count_skipped(event)


def _is_about(event: protocol.Event, command: protocol.Command) -> bool:
    match event:
        case protocol.ErrorReply(name=name):
            return name in (None, command.name)  # a line `E<n>` does not say to what
        case protocol.TextReply(name=name):
            return name == command.name
        case protocol.Reading(quantity=name, axis=axis) | protocol.ValueReply(name=name, axis=axis):
            return (name, axis) == (command.name, command.axis)
    return False
