"""A simulated SDH hand that speaks the real one's bytes: a state machine fed bytes and time.

`motion` moves the axes; here are its line and its bytes, its commands and its firmware's answers. Assumed: an empty
line has no answer, and numbers have two decimals.

Undocumented behaviour is the simplest one, marked "assumed". The firmware's grips, which `stop` does not end, are
refused."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Final

from deformscope_drivers.doubles import Line
from deformscope_drivers.sdh import codes
from deformscope_drivers.sdh.codes import BINARY_COMMANDS, BINARY_SINCE
from deformscope_drivers.sdh.motion import Axis, Compliance, Motion
from deformscope_drivers.sdh.protocol import (
    Command,
    CommandDecoder,
    DebugLine,
    ErrorReply,
    Event,
    Reading,
    Received,
    Skipped,
    TextReply,
    ValueReply,
    encode_reply,
)

RS232_BYTES_PER_S: Final = 11_520.0

UNKNOWN, FORMAT, RANGE, INDEX, FAILED, FEW, NONE_EXPECTED = 13, 14, 24, 26, 17, 11, 12
_REASONS: Final = {"name": UNKNOWN, "axis": INDEX}  # why a line was refused -> error code; else FORMAT

SETTINGS = {
    **dict.fromkeys(("p", "tpap"), "target_deg"),
    **dict.fromkeys(("v", "tvav"), "target_velocity_deg_s"),
    "a": "target_acceleration_deg_s2",
    "ilim": "move_current_a",
    "igrip": "grip_current_a",
    "ihold": "hold_current_a",
    "power": "powered",
}
"""Values of an `Axis` that a command sets or reports."""


class Refusal(Exception):
    """The command is answered with an error code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Firmware:
    """The commands of one release, on a hand that moves."""

    def __init__(self, version: str, texts: dict[str, str], state_lag_s: float) -> None:
        self.release = codes.release(version)
        self._texts = {"ver": version, **texts}
        self._state_lag_ns = round(state_lag_s * 1e9)
        self.motion = Motion()
        self.power_up(0)

    def power_up(self, now_ns: int) -> None:
        """Switch on: angles, surroundings and temperatures are unchanged, axes off, settings at their defaults."""
        before, self.motion = self.motion, Motion(now_ns)
        self.motion.compliance = before.compliance
        for axis, old in zip(self.motion.axes, before.axes, strict=True):
            axis.position_deg, axis.temperature_c = old.position_deg, old.temperature_c
            axis.obstacle_low_deg, axis.obstacle_high_deg = old.obstacle_low_deg, old.obstacle_high_deg
        self.refusals: deque[int] = deque()
        self._lag_until_ns = 0
        self._reported_states = tuple(axis.state for axis in self.motion.axes)
        self._integers = dict.fromkeys(codes.INTEGER_COMMANDS, 0)

    def do(self, command: Command, now_ns: int) -> list[Event]:
        """The answer to a command, its debug lines first. Raises Refusal."""
        if self.refusals:
            raise Refusal(self.refusals.popleft())
        name, values = command.name, command.values
        if name in codes.TEXT_COMMANDS:
            return [TextReply(name, self._texts[name])]
        if name in ("vel", "rvel", "pos", "state", "temp"):
            if values:
                raise Refusal(NONE_EXPECTED)
            return [self._measured(command, now_ns)]
        match name:
            case _ if name in SETTINGS:
                return [self._setting(command, now_ns)]
            case "vlim" | "alim":
                return [self._limit(command)]
            case "m" | "get_duration":
                return self._move(name, now_ns)
            case "stop":
                self._keep_reporting(now_ns, lag=False)
                self.motion.stop()
                return [ValueReply("stop")]  # assumed
            case "con":
                return [self._controller(values, now_ns)]
            case "vp" | "user_errors" | "terminal" | "debug":
                return [self._integer(name, values)]
        raise Refusal(UNKNOWN)  # also commands that the driver does not send: `grip`, `ref`, `pid`, `demo`...

    def _axes(self, command: Command) -> list[tuple[int, Axis]]:
        axes = list(enumerate(self.motion.axes))
        return axes if command.axis is None else [axes[command.axis]]

    def _measured(self, command: Command, now_ns: int) -> Reading:
        name = command.name
        if name == "rvel" and self.release < codes.CONTROLLERS_SINCE:
            raise Refusal(UNKNOWN)
        axes = self.motion.axes
        measured: dict[str, Callable[[], tuple[float, ...]]] = {
            "pos": lambda: tuple(axis.position_deg for axis in axes),
            "tpap": lambda: tuple(axis.position_deg for axis in axes),
            "vel": lambda: tuple(axis.velocity_deg_s for axis in axes),
            "tvav": lambda: tuple(axis.velocity_deg_s for axis in axes),
            "rvel": lambda: tuple(axis.reference_deg_s for axis in axes),
            "state": lambda: tuple(float(state) for state in self._states(now_ns)),
            "temp": lambda: (*(axis.temperature_c for axis in axes), *self.motion.temperatures_electronics_c),
        }
        values = measured[name]()
        return Reading(name, values if command.axis is None else (values[command.axis],), command.axis)

    def _states(self, now_ns: int) -> tuple[codes.AxisState, ...]:
        if now_ns < self._lag_until_ns:
            return self._reported_states
        return tuple(axis.state for axis in self.motion.axes)

    def _keep_reporting(self, now_ns: int, *, lag: bool = True) -> None:
        """Before a command takes effect: for a while the states from before it are still reported."""
        if lag and now_ns < self._lag_until_ns:
            return
        self._reported_states = self._states(now_ns)
        self._lag_until_ns = now_ns + self._state_lag_ns if lag else now_ns

    def _setting(self, command: Command, now_ns: int) -> Event:
        name, values, axes = command.name, command.values, self._axes(command)
        if values:
            if len(values) < len(axes):
                raise Refusal(FEW)
            if len(values) > len(axes):
                raise Refusal(FORMAT)
            for (_, axis), value in zip(axes, values, strict=True):
                self._check_setting(name, axis, value)
            for (index, axis), value in zip(axes, values, strict=True):
                if name != "power":
                    setattr(axis, SETTINGS[name], value)
                else:
                    self.motion.power(index, bool(value))
            if name in ("v", "tvav") and self.motion.controller is not codes.Controller.POSE:
                self._keep_reporting(now_ns)
                self.motion.follow_velocities()
        if name in codes.MEASURED_COUNT:
            return self._measured(command, now_ns)
        return ValueReply(name, tuple(float(getattr(axis, SETTINGS[name])) for _, axis in axes), command.axis)

    def _check_setting(self, name: str, axis: Axis, value: float) -> None:
        lowest = 0.0 if self.motion.controller is codes.Controller.POSE else -axis.velocity_max_deg_s
        match name:
            case "p" | "tpap":
                good = axis.low_deg <= value <= axis.high_deg
            case "v" | "tvav":
                good = lowest <= value <= axis.velocity_max_deg_s
            case "a":
                good = 0.0 < value <= axis.acceleration_max_deg_s2
            case "power":
                good = value in (0.0, 1.0)
            case _:
                good = 0.0 <= value <= codes.CURRENT_MAX_A
        if not good:
            raise Refusal(RANGE)

    def _limit(self, command: Command) -> Event:
        if command.values:
            raise Refusal(NONE_EXPECTED)
        since = codes.VELOCITY_LIMITS_SINCE if command.name == "vlim" else codes.ACCELERATION_LIMITS_SINCE
        if self.release < since:
            raise Refusal(UNKNOWN)
        values = (
            axis.velocity_max_deg_s if command.name == "vlim" else axis.acceleration_max_deg_s2
            for _, axis in self._axes(command)
        )
        return ValueReply(command.name, tuple(values), command.axis)

    @property
    def _reports_duration(self) -> bool:
        return self.release >= codes.DURATION_REPLIES_SINCE

    def _plan_line(self, targets_deg: Sequence[float | None], duration_s: float) -> str:
        distance = max(
            (0.0 if target is None else abs(target - axis.position_deg))
            for axis, target in zip(self.motion.axes, targets_deg, strict=True)
        )
        points = max(1, round(duration_s * 100))
        return f"max distance={distance:.2f}, T={duration_s:.2f}s, num_points: {points}"

    def _move(self, name: str, now_ns: int) -> list[Event]:
        if self.motion.controller is not codes.Controller.POSE:
            raise Refusal(FAILED)  # assumed
        targets = [axis.target_deg for axis in self.motion.axes]
        velocities = [axis.target_velocity_deg_s for axis in self.motion.axes]
        duration_s = self.motion.duration_s(targets, velocities)
        plan = self._plan_line(targets, duration_s)
        if name == "get_duration":
            return [*(() if self._reports_duration else (DebugLine(plan),)), ValueReply(name, (duration_s,))]
        self._keep_reporting(now_ns)
        for index in range(codes.AXIS_COUNT):
            self.motion.power(index, True)
        self.motion.start(targets, velocities)
        if self._reports_duration:
            return [ValueReply(name, (duration_s,))]
        return [DebugLine("Enabling all axis"), DebugLine(plan), ValueReply(name)]

    def _controller(self, values: tuple[float, ...], now_ns: int) -> Event:
        if self.release < codes.CONTROLLERS_SINCE:
            raise Refusal(UNKNOWN)
        if values:
            (number,) = _exactly(values, 1)
            if number not in tuple(codes.Controller):
                raise Refusal(RANGE)
            self._keep_reporting(now_ns, lag=False)
            self.motion.set_controller(codes.Controller(int(number)))
        return ValueReply("con", (float(self.motion.controller),))

    def _integer(self, name: str, values: tuple[float, ...]) -> Event:
        if values:
            (number,) = _exactly(values, 1)
            if not float(number).is_integer() or (name == "vp" and number not in tuple(codes.VelocityProfile)):
                raise Refusal(RANGE)
            self._integers[name] = int(number)
            if name == "vp":
                self.motion.profile = codes.VelocityProfile(int(number))
        return ValueReply(name, (float(self._integers[name]),))


def _exactly(values: tuple[float, ...], count: int) -> tuple[float, ...]:
    if len(values) != count:
        raise Refusal(FEW if len(values) < count else FORMAT)
    return values


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
