"""Schunk's SDH hand: `with Sdh(SdhConfig(port="/dev/ttyUSB0")) as hand: hand.move([0, -20, 20, -20, 20, -20, 20])`.

Nothing moves without a call of a method here. The hand has no watchdog: after the loss of the host a motion continues.
A move goes to its targets, a velocity to the ends of the axes.

The link to the hand: opening, requests and answers, and repeated readings."""

import contextlib
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

import numpy as np

from deformscope_drivers import errors
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import ROUND_S, StreamDevice
from deformscope_drivers.errors import CommandRefused, DeviceError, LinkLost, OutOfLimits, SettingsRefused, Stale
from deformscope_drivers.framing import NOISE, Skipped
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.sdh import codes, protocol
from deformscope_drivers.sdh.config import ByAxis, Limits, SdhConfig, within
from deformscope_drivers.sdh.measurer import HandMeasurer
from deformscope_drivers.sdh.results import HandIdentity, HandReading, MoveResult, Outcome
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


SETTLE_S = 0.5
"""Time after a command in which an idle axis may not have started yet: IPA's driver waits as long."""
MARGIN_S = 1.0
LONGEST_MOTION_S = 15.0  # where old firmware does not report it: the whole range at 12 deg/s
COMMAND_TIMEOUT_S = 10.0
ECHO_TOLERANCE = 0.06
STILL: ByAxis = (0.0,) * codes.AXIS_COUNT


class CurrentMode(StrEnum):
    """Purpose of a limit of the motor currents."""

    MOVE = "ilim"
    GRIP = "igrip"
    HOLD = "ihold"


@dataclass(frozen=True, slots=True)
class _Started:
    """A motion in progress. targets_deg: targets of each moving axis"""

    sent_ns: int
    duration_s: float | None
    targets_deg: Mapping[int, float]
    connection: int
    stops: int


class Sdh(SdhConnection):
    """The hand. Readings (`HandReading`) come at `config.rate_hz`, with the three reads of every device.

    After a lost link is restored the hand is stopped, a call that waits for a motion raises LinkLost, and
    `health().extra["stopped_after_reconnect"]` counts it. transport, clock: for a hand in memory"""

    def __init__(self, config: SdhConfig, *, transport: Transport | None = None, clock: Clock = monotonic_ns) -> None:
        super().__init__(config, transport=transport, clock=clock)
        self._controller: codes.Controller | None = None
        self._profile: codes.VelocityProfile | None = None
        self._drive_until_ns: int | None = None
        self._driven: ByAxis = STILL
        self._stops = 0
        self._stopped_after_reconnect = 0
        self._switched_on = False

    # Poses -----------------------------------------------------------------------------------------------------------

    def move(
        self,
        targets_deg: Sequence[float] | Mapping[int, float],
        *,
        velocity_deg_s: Sequence[float] | float = 40.0,
        acceleration_deg_s2: Sequence[float] | float = 100.0,
        profile: codes.VelocityProfile = codes.VelocityProfile.SIN_SQUARE,
        wait: bool = True,
        timeout_s: float | None = None,
    ) -> MoveResult:
        """Move to angles, all axes starting and ending together; the slowest one gives the time.

        targets_deg: (7,), or by axis, the others staying where they are; velocity_deg_s, acceleration_deg_s2: (7,) or
        one for all (the sin² profile has no acceleration); timeout_s: time after which the hand is stopped, as by
        Ctrl-C; None = the duration that the hand reports, plus 1 s. The firmware then switches all axes on. A blocked
        axis raises nothing; `result.outcome` reports it, because contact is a hand's purpose. Raises OutOfLimits
        (nothing was sent), CommandRefused, LinkLost, NoReply."""
        speeds = self.limits.speeds(velocity_deg_s, self.name)
        accelerations = self.limits.accelerations(acceleration_deg_s2, self.name)
        targets = self._targets(targets_deg)

        def start() -> _Started:
            self._take_up(codes.Controller.POSE, codes.VelocityProfile(profile))
            full = self._filled(targets)
            self._set("p", full)
            self._set("v", speeds)
            self._set("a", accelerations)
            planned = () if self._release >= codes.DURATION_REPLIES_SINCE else self._values("get_duration")
            self._switched_on = True
            sent_ns = self._clock()
            reported = self._values("m") or planned
            return _Started(sent_ns, reported[0] if reported else None, targets, self._connections, self._stops)

        return self._run_motion(start, wait, timeout_s)

    def stop(self) -> None:
        """Stop what moves, at once; the axes stay on."""
        self._do(self._stop_now, COMMAND_TIMEOUT_S)

    # Velocities ------------------------------------------------------------------------------------------------------

    def drive(
        self,
        velocity_deg_s: Sequence[float],
        *,
        keep_s: float = 0.2,
        acceleration_deg_s2: Sequence[float] | float | None = None,
    ) -> None:
        """Turn the axes at velocities with sign, (7,), for `keep_s` from now; call again in time to continue.

        Without a further call in time, the driver's thread sets all velocities to 0. acceleration_deg_s2: ramp, given
        once; None = as before, without a ramp at first. Firmware 0.0.2.6 and later. The hand itself would continue for
        ever."""
        velocities = self.limits.velocities(velocity_deg_s, self.name)
        ramp = None if acceleration_deg_s2 is None else self.limits.accelerations(acceleration_deg_s2, self.name)
        within("time to keep a velocity", "s", keep_s, 0.0, 2.0, self.name)

        def start() -> None:
            if self._release < codes.CONTROLLERS_SINCE:
                raise SettingsRefused("firmware 0.0.2.6 or later for velocities", self.about.firmware, where=self.name)
            with_ramp = ramp is not None or self._controller is codes.Controller.VELOCITY_ACCELERATION
            wanted = codes.Controller.VELOCITY_ACCELERATION if with_ramp else codes.Controller.VELOCITY
            if self._controller is not wanted:
                self._take_up(wanted, None)
                self._switched_on = True
                self._set("power", (1.0,) * codes.AXIS_COUNT)
            if ramp is not None:
                self._set("a", ramp)
            self._set("v", velocities)
            self._driven = velocities
            self._drive_until_ns = self._clock() + round(keep_s * 1e9)

        self._do(start, COMMAND_TIMEOUT_S)

    # Settings --------------------------------------------------------------------------------------------------------

    def power(self, on: bool | Sequence[bool]) -> None:
        """Switch axes on, so that they hold their angles, or off: one value for all, or (7,).

        Raises SettingsRefused when the hand reports another value than was set."""
        wanted = (on,) * codes.AXIS_COUNT if isinstance(on, bool) else tuple(on)
        if len(wanted) != codes.AXIS_COUNT:
            raise OutOfLimits(f"{codes.AXIS_COUNT} values, one per axis", f"{len(wanted)}", where=self.name)

        def switch() -> None:
            self._controller = None  # the next motion takes it up again, and with it the axes
            self._switched_on = self._switched_on or any(wanted)
            self._set("power", tuple(float(bool(value)) for value in wanted))

        self._do(switch, COMMAND_TIMEOUT_S)

    def powered(self) -> tuple[bool, ...]:
        """Which axes are on."""
        return tuple(value != 0.0 for value in self._do(lambda: self._values("power"), COMMAND_TIMEOUT_S))

    def current_limits_a(self, mode: CurrentMode = CurrentMode.MOVE) -> ByAxis:
        """The limits of the motor currents, (7,) [A]. The hand does not report the currents that flow."""
        return self._do(lambda: self._values(CurrentMode(mode)), COMMAND_TIMEOUT_S)

    def set_current_limits(self, limit_a: Sequence[float] | float, mode: CurrentMode = CurrentMode.MOVE) -> None:
        """Limit the motor currents: one value for all, or (7,) [A], 0 to 1."""
        limits_a = self.limits.currents(limit_a, self.name)
        self._do(lambda: self._set(CurrentMode(mode), limits_a), COMMAND_TIMEOUT_S)

    # Within: the caller's thread -------------------------------------------------------------------------------------

    def _targets(self, targets_deg: Sequence[float] | Mapping[int, float]) -> dict[int, float]:
        if not isinstance(targets_deg, Mapping):
            return dict(enumerate(self.limits.positions(targets_deg, self.name)))
        if not targets_deg or any(axis not in range(codes.AXIS_COUNT) for axis in targets_deg):
            raise OutOfLimits(f"axes of 0 to {codes.AXIS_COUNT - 1}", f"{sorted(targets_deg)}", where=self.name)
        low = self.limits.position_min_deg
        self.limits.positions([targets_deg.get(axis, low[axis]) for axis in range(codes.AXIS_COUNT)], self.name)
        return {axis: float(target) for axis, target in targets_deg.items()}

    def _run_motion(self, start: Callable[[], _Started], wait: bool, timeout_s: float | None) -> MoveResult:
        started = self._do(start, COMMAND_TIMEOUT_S + LONGEST_MOTION_S)
        if not wait:
            return MoveResult(Outcome.STARTED, started.duration_s)
        if timeout_s is None:
            planned_s = LONGEST_MOTION_S if started.duration_s is None else started.duration_s
            timeout_s = planned_s + MARGIN_S + 2 / self.config.rate_hz
        try:
            return self._wait(started, timeout_s)
        except KeyboardInterrupt:  # Ctrl-C stops the hand, whatever becomes of the program
            with contextlib.suppress(DeviceError):
                self.stop()
            raise

    def _wait(self, started: _Started, timeout_s: float) -> MoveResult:
        """Read until the axes are still. An idle axis counts once one was seen to move, or after a while."""
        until_ns = self._clock() + round(timeout_s * 1e9)
        seen_moving = timed_out = False
        last: HandReading | None = None
        while True:
            left_s = (until_ns - self._clock()) / 1e9
            if left_s <= 0 and not timed_out:
                timed_out = True
                self.stop()
                until_ns = self._clock() + round((SETTLE_S + MARGIN_S) * 1e9)
                continue
            if left_s <= 0 and last is not None:
                return self._result(started, last, timed_out)
            if left_s <= 0:
                raise Stale("readings of a hand that was stopped", "none", "switch it off", self.name)
            reading = self._next_of(started, left_s)
            if reading is None:
                continue
            last = reading
            moving = any(state in codes.MOVING for state in reading.state)
            seen_moving |= moving
            believed = seen_moving or reading.stamp.host_ns - started.sent_ns >= SETTLE_S * 1e9
            if believed and not moving:
                return self._result(started, reading, timed_out)

    def _next_of(self, started: _Started, timeout_s: float) -> HandReading | None:
        """The next reading that began after the motion did; None when there is none in time."""
        try:
            reading = self.next(min(timeout_s, ROUND_S))
        except Stale:
            reading = None
        if self.link is not Link.CONNECTED or self._connections != started.connection:
            advice = "check its pose; it is stopped once the link is back"
            raise LinkLost("the end of a motion", "a lost link", advice, self.name)
        return None if reading is None or reading.stamp.host_ns < started.sent_ns else reading

    def _result(self, started: _Started, reading: HandReading, timed_out: bool) -> MoveResult:
        elapsed_s = (reading.stamp.host_ns - started.sent_ns) / 1e9
        axes = sorted(started.targets_deg)
        blocked = tuple(axis for axis in axes if reading.state[axis] in codes.BLOCKED)
        limited = tuple(axis for axis in axes if reading.state[axis] is codes.AxisState.LIMITS_REACHED)
        disabled = tuple(axis for axis in axes if reading.state[axis] is codes.AxisState.DISABLED)
        error_deg = max(abs(float(reading.position_deg[axis]) - started.targets_deg[axis]) for axis in axes)
        arrived = error_deg <= codes.POSITION_EPSILON_DEG
        if timed_out:
            outcome = Outcome.TIMED_OUT
        elif self._stops != started.stops and not arrived:
            outcome = Outcome.STOPPED
        elif arrived:
            outcome = Outcome.REACHED
        elif blocked:
            outcome = Outcome.BLOCKED
        elif limited:
            outcome = Outcome.LIMITED
        else:
            outcome = Outcome.MISSED
        return MoveResult(outcome, started.duration_s, elapsed_s, blocked, limited, disabled, error_deg, reading)

    # Within: the device's thread -------------------------------------------------------------------------------------

    def _start(self) -> None:
        again = self.link is Link.LOST
        super()._start()
        self._expect(self.config.rate_hz)
        self._controller = self._profile = None
        self._drive_until_ns = None
        if again:
            if self._release >= codes.CONTROLLERS_SINCE and self._values("con") != (float(codes.Controller.POSE),):
                self._set("v", STILL)
            self._values("stop")
            self._stops += 1
            self._stopped_after_reconnect += 1

    def _stop(self) -> None:
        """On closing: motions end, and axes that were switched on are switched off."""
        if not self._switched_on:
            return
        self._switched_on = False
        with contextlib.suppress(CommandRefused):
            self._stop_now()
        if not self.config.leave_powered:
            self._values("power", *STILL)

    def _extra_health(self) -> dict[str, float]:
        return {**super()._extra_health(), "stopped_after_reconnect": self._stopped_after_reconnect}

    def _round(self, timeout_s: float) -> Iterable[HandReading]:
        """No reading is waited for beyond the end of a velocity's duration."""
        if self._drive_until_ns is None:
            return super()._round(timeout_s)
        left_ns = self._drive_until_ns - self._clock()
        if left_ns > 0:
            return super()._round(min(timeout_s, left_ns / 1e9))
        try:
            self._halt()
        except (CommandRefused, SettingsRefused):
            self._values("stop")
        return []

    def _velocity_query(self) -> tuple[str, ByAxis]:
        """While velocities are driven they are sent again each time, which also answers with the actual ones."""
        return super()._velocity_query() if self._drive_until_ns is None else ("tvav", self._driven)

    def _stop_now(self) -> None:
        self._halt()
        self._values("stop")
        self._stops += 1

    def _halt(self) -> None:
        """End velocities that `drive` set: all are set to 0."""
        if self._drive_until_ns is not None:
            self._drive_until_ns = None
            self._set("v", STILL)

    def _take_up(self, controller: codes.Controller, profile: codes.VelocityProfile | None) -> None:
        """Choose how targets are followed, where that is not so yet."""
        if controller is codes.Controller.POSE:
            self._halt()
        if self._controller is not controller:
            if self._release >= codes.CONTROLLERS_SINCE:
                self._set("con", (float(controller),))
            self._controller = controller
        if profile is not None and self._profile is not profile:
            self._set("vp", (float(profile),))
            self._profile = profile

    def _filled(self, targets: Mapping[int, float]) -> ByAxis:
        """Targets of all axes; those without one stay where they are, within the range (readings go 0.5 deg beyond)."""
        if len(targets) == codes.AXIS_COUNT:
            return tuple(targets[axis] for axis in range(codes.AXIS_COUNT))
        limits = self.limits
        now_deg = self._exchange(protocol.Command("pos"), protocol.Reading).values
        actual = np.clip(now_deg, limits.position_min_deg, limits.position_max_deg)
        return tuple(targets.get(axis, float(actual[axis])) for axis in range(codes.AXIS_COUNT))

    def _set(self, name: str, values: ByAxis) -> None:
        """Set, and see that it is so. The precision of the hand's repeated values is not documented."""
        reported = self._values(name, *values)
        agrees = len(reported) == len(values) and all(
            abs(is_ - wanted) <= ECHO_TOLERANCE + 1e-3 * abs(wanted)
            for is_, wanted in zip(reported, values, strict=True)
        )
        if not agrees:
            came = ", ".join(f"{value:g}" for value in reported) or "nothing"
            asked = ", ".join(f"{value:g}" for value in values)
            raise SettingsRefused(f"{name} = {asked}", came, "wait until the hand is at rest", self.name)
