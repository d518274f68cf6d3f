"""Commands of a simulated SDH hand, and its firmware's answers.

Undocumented behaviour is the simplest one, marked "assumed". The firmware's grips, which `stop` does not end, are
refused."""

from collections import deque
from collections.abc import Callable, Sequence

from deformscope_drivers.sdh import codes
from deformscope_drivers.sdh.motion import Axis, Motion
from deformscope_drivers.sdh.protocol import Command, DebugLine, Event, Reading, TextReply, ValueReply

UNKNOWN, FORMAT, RANGE, INDEX, FAILED, FEW, NONE_EXPECTED = 13, 14, 24, 26, 17, 11, 12

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
