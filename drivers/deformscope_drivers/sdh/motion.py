"""Motion of a simulated hand: seven axes with profiles, velocity control, limits, obstacles, and motors that warm up.

Known from Schunk's library and its trace of old firmware: all axes of a pose move start and end together. The sin²
profile takes twice the distance over the set velocity (8.31 deg at 40 deg/s have T=0.42s, 42 points: the hand's cycle
is 10 ms). Assumed: the ramp profile is a trapezoid; `stop` slows down by the set acceleration; "CW" is the direction
of growing angles; the temperatures' time and size. Also assumed: an axis in soft contact continues at its set speed
within its current limit, and reports `blocked` while it hardly moves; gears hold."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Protocol

from deformscope_drivers.sdh import codes

CYCLE_NS: Final = 10_000_000
_CYCLE_S: Final = CYCLE_NS / 1e9

AMBIENT_C: Final = 24.0
_WARMING_K_PER_A2: Final = 30.0
_WARMING_TIME_S: Final = 600.0
_ELECTRONICS_K: Final = (14.0, 8.0)  # FPGA and board above the air
_HARDLY_DEG_S: Final = 0.2
_SHORT_DEG: Final = 1e-9


class Compliance(Protocol):
    """Something soft that the fingers press, in contrast to an obstacle."""

    def reach_deg(
        self, position_deg: Sequence[float], wanted_deg: Sequence[float], current_a: Sequence[float], step_s: float
    ) -> Sequence[float]:
        """(7,) angles that the axes reach within a cycle, between their present and their desired angles, with motor
        currents of at most `current_a`. Called in each cycle, also when no axis moves."""


def ramp_duration_s(distance_deg: float, velocity_deg_s: float, acceleration_deg_s2: float) -> float:
    """Duration of a move that speeds up, continues at the velocity if it reaches it, and slows down."""
    distance = abs(distance_deg)
    if distance <= velocity_deg_s**2 / acceleration_deg_s2:
        return 2 * math.sqrt(distance / acceleration_deg_s2)
    return distance / velocity_deg_s + velocity_deg_s / acceleration_deg_s2


def _ramp_part(time_part: float, ramp: float) -> float:
    """The part of the distance at a part of the time, where the first and last `ramp` of the time change the speed."""
    if time_part > 0.5:
        return 1 - _ramp_part(1 - time_part, ramp)
    top = 1 / (1 - ramp)
    return top * time_part**2 / (2 * ramp) if time_part < ramp else top * (time_part - ramp / 2)


class _Mode(Enum):
    HOLD = "hold"
    POSE = "pose"
    SPEED = "speed"
    STOPPING = "stopping"
    PRESSING = "pressing"


@dataclass(slots=True)
class Axis:
    """One axis. Angles [deg], speeds [deg/s], accelerations [deg/s²], currents [A]."""

    low_deg: float
    high_deg: float
    velocity_max_deg_s: float
    acceleration_max_deg_s2: float
    move_current_a: float
    hold_current_a: float
    grip_current_a: float
    position_deg: float = 0.0
    velocity_deg_s: float = 0.0
    reference_deg_s: float = 0.0
    target_deg: float = 0.0
    target_velocity_deg_s: float = codes.DEFAULT_VELOCITY_DEG_S
    target_acceleration_deg_s2: float = codes.DEFAULT_ACCELERATION_DEG_S2
    powered: bool = False
    temperature_c: float = AMBIENT_C
    obstacle_low_deg: float = -math.inf
    obstacle_high_deg: float = math.inf
    state: codes.AxisState = codes.AxisState.DISABLED
    mode: _Mode = field(default=_Mode.HOLD)
    from_deg: float = 0.0
    to_deg: float = 0.0
    ramp_part: float | None = None  # of a pose move with ramp profile

    def advance_to(self, wanted_deg: float) -> codes.AxisState | None:
        """Move there, as far as obstacles and the range allow; the obstacles."""
        low = max(self.low_deg, self.obstacle_low_deg)
        high = min(self.high_deg, self.obstacle_high_deg)
        blocked = None
        if wanted_deg > self.position_deg and wanted_deg > high:
            wanted_deg = max(self.position_deg, high)
            blocked = (
                codes.AxisState.CW_BLOCKED if self.obstacle_high_deg < self.high_deg else codes.AxisState.LIMITS_REACHED
            )
        elif wanted_deg < self.position_deg and wanted_deg < low:
            wanted_deg = min(self.position_deg, low)
            blocked = (
                codes.AxisState.CCW_BLOCKED if self.obstacle_low_deg > self.low_deg else codes.AxisState.LIMITS_REACHED
            )
        self.position_deg = wanted_deg
        return blocked

    def halt(self, state: codes.AxisState) -> None:
        self.mode, self.state = _Mode.HOLD, state
        self.velocity_deg_s = self.reference_deg_s = 0.0

    def current_a(self) -> float:
        """The motor's current: an assumption that only warms it."""
        if not self.powered:
            return 0.0
        if self.state in (codes.AxisState.CW_BLOCKED, codes.AxisState.CCW_BLOCKED):
            return self.move_current_a
        return self.hold_current_a if self.mode is _Mode.HOLD else max(self.hold_current_a, self.move_current_a / 2)


class Motion:
    """Seven axes over time. `advance` takes them to a moment; everything else happens at the last such moment."""

    def __init__(self, now_ns: int = 0) -> None:
        self.axes = [
            Axis(
                low_deg=codes.POSITION_MIN_DEG[axis],
                high_deg=codes.POSITION_MAX_DEG[axis],
                velocity_max_deg_s=codes.VELOCITY_MAX_DEG_S[axis],
                acceleration_max_deg_s2=codes.ACCELERATION_MAX_DEG_S2[axis],
                move_current_a=codes.MOVE_CURRENT_A[axis],
                hold_current_a=codes.HOLD_CURRENT_A[axis],
                grip_current_a=codes.MOVE_CURRENT_A[axis],
            )
            for axis in range(codes.AXIS_COUNT)
        ]
        self.controller = codes.Controller.POSE
        self.profile = codes.VelocityProfile.SIN_SQUARE
        self.temperatures_electronics_c = tuple(AMBIENT_C + above for above in _ELECTRONICS_K)
        self.compliance: Compliance | None = None
        self._now_ns = now_ns
        self._start_ns = now_ns
        self._duration_s = 0.0

    @property
    def moving(self) -> bool:
        """Whether any axis moves, or is commanded to."""
        return any(axis.mode is not _Mode.HOLD for axis in self.axes)

    def advance(self, now_ns: int) -> None:
        """Everything that happens until then, in cycles of 10 ms."""
        while self._now_ns + CYCLE_NS <= now_ns:
            if not self.moving and self.compliance is None:
                cycles = (now_ns - self._now_ns) // CYCLE_NS
                self._warm(cycles * _CYCLE_S)
                self._now_ns += cycles * CYCLE_NS
                return
            self._now_ns += CYCLE_NS
            before = [(axis.position_deg, axis.mode) for axis in self.axes]
            for axis in self.axes:
                self._step(axis)
            if self.compliance is not None:
                self._press(self.compliance, before)
            self._warm(_CYCLE_S)

    def duration_s(self, targets_deg: Iterable[float | None], velocities_deg_s: Iterable[float]) -> float:
        """How long a pose move takes, in whole cycles; None = this axis stays."""
        longest = 0.0
        for axis, target, velocity in zip(self.axes, targets_deg, velocities_deg_s, strict=True):
            distance = 0.0 if target is None else target - axis.position_deg
            if not distance or not velocity:
                continue
            if self.profile is codes.VelocityProfile.SIN_SQUARE:
                # Duration of a move whose speed is velocity * sin²(pi t / T)
                duration_s = 2 * abs(distance) / velocity
            else:
                duration_s = ramp_duration_s(distance, velocity, axis.target_acceleration_deg_s2)
            longest = max(longest, duration_s)
        return math.ceil(longest / _CYCLE_S - 1e-6) * _CYCLE_S

    def start(self, targets_deg: Iterable[float | None], velocities_deg_s: Iterable[float]) -> float:
        """Begin a pose move of the axes that have a target; its duration [s]."""
        targets, velocities = list(targets_deg), list(velocities_deg_s)
        duration_s = self.duration_s(targets, velocities)
        self._start_ns, self._duration_s = self._now_ns, duration_s
        for axis, target, velocity in zip(self.axes, targets, velocities, strict=True):
            if target is None and axis.mode is not _Mode.HOLD:
                continue
            axis.halt(codes.AxisState.IDLE if axis.powered else codes.AxisState.DISABLED)
            if target is None:
                continue
            if not axis.powered or not velocity or target == axis.position_deg:
                continue
            axis.mode, axis.state = _Mode.POSE, codes.AxisState.POSITIONING
            axis.from_deg, axis.to_deg = axis.position_deg, target
            axis.ramp_part = None
            if self.profile is codes.VelocityProfile.RAMP:
                own_s = ramp_duration_s(target - axis.position_deg, velocity, axis.target_acceleration_deg_s2)
                distance = abs(target - axis.position_deg)
                top = min(velocity, math.sqrt(distance * axis.target_acceleration_deg_s2))
                axis.ramp_part = top / axis.target_acceleration_deg_s2 / own_s
        return duration_s

    def set_controller(self, controller: codes.Controller) -> None:
        """Sets its defaults too, as firmware from 0.0.2.7 does."""
        self.controller = controller
        pose = controller is codes.Controller.POSE
        for axis in self.axes:
            axis.target_velocity_deg_s = codes.DEFAULT_VELOCITY_DEG_S if pose else 0.0
            axis.target_acceleration_deg_s2 = codes.DEFAULT_ACCELERATION_DEG_S2
            if pose:
                axis.target_deg = 0.0
            if axis.powered:
                axis.halt(codes.AxisState.IDLE)

    def follow_velocities(self) -> None:
        """Under velocity control every powered axis takes up its target velocity at once."""
        if self.controller is codes.Controller.POSE:
            return
        for axis in self.axes:
            if axis.powered and (axis.target_velocity_deg_s or axis.mode is _Mode.SPEED):
                axis.mode = _Mode.SPEED

    def stop(self) -> None:
        """Slow every moving axis down."""
        for axis in self.axes:
            if axis.mode is not _Mode.HOLD:
                axis.mode = _Mode.STOPPING
            elif axis.powered:
                axis.state = codes.AxisState.IDLE
            if self.controller is not codes.Controller.POSE:
                axis.target_velocity_deg_s = 0.0

    def power(self, axis: int, on: bool) -> None:
        """Switch an axis on, holding its place, or off."""
        if on != self.axes[axis].powered:
            self.axes[axis].powered = on
            self.axes[axis].halt(codes.AxisState.IDLE if on else codes.AxisState.DISABLED)

    def _step(self, axis: Axis) -> None:
        before = axis.position_deg
        blocked: codes.AxisState | None = None
        ended = False
        match axis.mode:
            case _Mode.HOLD:
                return
            case _Mode.POSE:
                elapsed_s = (self._now_ns - self._start_ns) / 1e9
                part = min(elapsed_s / self._duration_s, 1.0) if self._duration_s else 1.0
                if axis.ramp_part is None:
                    share = part - math.sin(2 * math.pi * part) / (2 * math.pi)
                else:
                    share = _ramp_part(part, axis.ramp_part)
                ended = part >= 1.0
                blocked = axis.advance_to(
                    axis.to_deg if ended else axis.from_deg + share * (axis.to_deg - axis.from_deg)
                )
                axis.velocity_deg_s = (axis.position_deg - before) / _CYCLE_S
            case _Mode.PRESSING:
                most = axis.target_velocity_deg_s * _CYCLE_S
                left = axis.to_deg - axis.position_deg
                ended = abs(left) <= most
                blocked = axis.advance_to(axis.position_deg + max(-most, min(most, left)))
                axis.velocity_deg_s = (axis.position_deg - before) / _CYCLE_S
            case _Mode.SPEED:
                blocked = self._step_speed(axis)
            case _Mode.STOPPING:
                ended = abs(axis.velocity_deg_s) <= axis.target_acceleration_deg_s2 * _CYCLE_S
                blocked = self._coast(axis, ended)
        if blocked is not None and axis.mode is not _Mode.SPEED:
            axis.halt(blocked)
        elif ended:
            axis.halt(codes.AxisState.IDLE)

    def _press(self, compliance: Compliance, before: list[tuple[float, _Mode]]) -> None:
        """Move the axes back to the balance of their contacts and their currents."""
        wanted = [axis.position_deg for axis in self.axes]
        currents = [axis.move_current_a for axis in self.axes]
        reached = compliance.reach_deg([position for position, _ in before], wanted, currents, _CYCLE_S)
        for axis, (position, mode), want, reach in zip(self.axes, before, wanted, reached, strict=True):
            if abs(want - reach) <= _SHORT_DEG or mode is _Mode.HOLD:
                continue
            axis.position_deg, axis.velocity_deg_s = float(reach), (float(reach) - position) / _CYCLE_S
            axis.reference_deg_s = axis.velocity_deg_s
            blocked = codes.AxisState.CW_BLOCKED if want > reach else codes.AxisState.CCW_BLOCKED
            free = codes.AxisState.SPEED_MODE if mode is _Mode.SPEED else codes.AxisState.POSITIONING
            axis.state = blocked if abs(axis.velocity_deg_s) < _HARDLY_DEG_S else free
            if mode in (_Mode.POSE, _Mode.PRESSING):
                axis.mode = _Mode.PRESSING

    def _step_speed(self, axis: Axis) -> codes.AxisState | None:
        target = axis.target_velocity_deg_s
        change = target - axis.reference_deg_s
        if self.controller is codes.Controller.VELOCITY_ACCELERATION:
            most = axis.target_acceleration_deg_s2 * _CYCLE_S
            change = max(-most, min(most, change))
        mean = (
            axis.reference_deg_s + change / 2 if self.controller is codes.Controller.VELOCITY_ACCELERATION else target
        )
        before = axis.position_deg
        axis.reference_deg_s += change
        blocked = axis.advance_to(axis.position_deg + mean * _CYCLE_S)
        axis.velocity_deg_s = axis.reference_deg_s if blocked is None else (axis.position_deg - before) / _CYCLE_S
        if blocked is not None:
            axis.state, axis.reference_deg_s = blocked, 0.0
        elif axis.reference_deg_s == 0.0 and target == 0.0:
            axis.halt(codes.AxisState.IDLE)
        else:
            axis.state = codes.AxisState.SPEED_MODE
        return blocked

    def _coast(self, axis: Axis, ends: bool) -> codes.AxisState | None:
        velocity, slower = axis.velocity_deg_s, axis.target_acceleration_deg_s2
        if ends:
            axis.velocity_deg_s = 0.0
            return axis.advance_to(axis.position_deg + math.copysign(velocity**2 / (2 * slower), velocity))
        axis.velocity_deg_s = velocity - math.copysign(slower * _CYCLE_S, velocity)
        return axis.advance_to(axis.position_deg + (velocity + axis.velocity_deg_s) / 2 * _CYCLE_S)

    def _warm(self, elapsed_s: float) -> None:
        part = -math.expm1(-elapsed_s / _WARMING_TIME_S)
        for axis in self.axes:
            end_c = AMBIENT_C + _WARMING_K_PER_A2 * axis.current_a() ** 2
            axis.temperature_c += (end_c - axis.temperature_c) * part
