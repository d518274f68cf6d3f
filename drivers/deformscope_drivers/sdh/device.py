"""Schunk's SDH hand: `with Sdh(SdhConfig(port="/dev/ttyUSB0")) as hand: hand.move([0, -20, 20, -20, 20, -20, 20])`.

Nothing moves without a call of a method here. The hand has no watchdog: after the loss of the host a motion continues.
A move goes to its targets, a velocity to the ends of the axes."""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import ROUND_S
from deformscope_drivers.errors import CommandRefused, DeviceError, LinkLost, OutOfLimits, SettingsRefused, Stale
from deformscope_drivers.health import Link
from deformscope_drivers.sdh import codes, protocol
from deformscope_drivers.sdh.config import ByAxis, SdhConfig, within
from deformscope_drivers.sdh.connection import SdhConnection
from deformscope_drivers.sdh.results import HandReading, MoveResult, Outcome
from deformscope_drivers.transport import Transport

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
