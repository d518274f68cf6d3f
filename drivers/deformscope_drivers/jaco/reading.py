"""Reading the arm's state call by call, in the time that the commands leave.

Over USB the vendor's library opens, claims, transfers and closes for each packet. A call takes 2.8 ms and more
(kinova-ros issues 281, 372), a slot has 10. Therefore a state needs one call, for the joint angles, from which the pose
follows. Other readings take turns in the remaining time, or replace the angles after too long without any."""

import ctypes
from collections import deque
from dataclasses import dataclass
from typing import cast

from deformscope_drivers.arm.device import ArmState
from deformscope_drivers.arm.kinematics import Chain, euler_xyz_from_rotation
from deformscope_drivers.clock import Clock, Stamp
from deformscope_drivers.jaco import structures
from deformscope_drivers.jaco.library import Functions, read


@dataclass(frozen=True, slots=True, kw_only=True)
class JacoState(ArmState):
    """The state of a Jaco at one time; a six-joint arm has six values, never a meaningless seventh.

    Rates are from the angles of the last 40 ms, the pose is from the angles. wrench: force and torque at the end
    effector. The joints' torque sensors drift, so that it is some newtons without contact; its direction was not
    verified on an arm; fingers: (3,) from 0 open to 1 closed
    sweep_s: by how much wrench, torques, currents and fifo_count may be older than the angles; currents_a: (n,)
    supply_v, supply_a: its main supply; temperatures_deg_c: (n,) temperatures of the joints; homed: whether it was at
    home since it was switched on; these are read once a second"""

    sweep_s: float
    currents_a: tuple[float, ...]
    supply_v: float
    supply_a: float
    temperatures_deg_c: tuple[float, ...]
    homed: bool


SELDOM_NS = 1_000_000_000
SLACK_NS = 1_000_000
SMOOTHING = 0.2
TURN_NS = 50_000_000
"""If there is no time for other calls, one of them replaces the reading of angles this often."""
RATES_OVER_NS = 40_000_000
"""Time over which angles give rates: over one slot, an error of 0.01 deg would be one of 1 deg/s."""

_ANGLES = "GetAngularPosition"
_IN_TURN: dict[str, type[ctypes.Structure]] = {
    "GetGlobalTrajectoryInfo": structures.TrajectoryFIFO,
    "GetAngularForceGravityFree": structures.AngularPosition,
    "GetCartesianForce": structures.CartesianPosition,
    "GetAngularCurrent": structures.AngularPosition,
}
_SELDOM: dict[str, type[ctypes.Structure]] = {
    "GetSensorsInfo": structures.SensorsInfo,
    "GetQuickStatus": structures.QuickStatus,
}
_KINDS: dict[str, type[ctypes.Structure]] = {_ANGLES: structures.AngularPosition, **_IN_TURN, **_SELDOM}


class StateReader:
    """Reads one state after the other, at a rate or as often as the link allows."""

    def __init__(self, functions: Functions, chain: Chain, rate_hz: float, clock: Clock) -> None:
        self._functions = functions
        self._chain = chain
        self._period_ns = round(1e9 / rate_hz)
        self._clock = clock
        self._next_ns = clock()
        self._in_turn = deque(_IN_TURN)
        self._left = 0
        self._read: dict[str, ctypes.Structure] = {}
        self._read_ns: dict[str, int] = {}
        self._call_ns: float | None = None
        self._track: deque[tuple[int, tuple[float, ...]]] = deque()

    @property
    def call_ms(self) -> float:
        """Recent duration of a call [ms]."""
        return (self._call_ns or 0.0) / 1e6

    def whole(self) -> JacoState:
        """A state with everything read now, however long that takes."""
        for name in (*_SELDOM, *_IN_TURN):
            self._call(name)
        return self._state()

    def go_on(self, until_ns: int) -> JacoState | None:
        """Make calls while they fit before `until_ns`; the state, where the angles were due by then and could be read.

        Angles that are due are read even where they do not fit: without them the arm is not seen."""
        due = self._next_ns < until_ns
        last_ns = max(time_ns for name, time_ns in self._read_ns.items() if name != _ANGLES)
        if due and self._left and self._clock() - last_ns >= TURN_NS and not self._fit(2, until_ns):
            self._turn()
            return None
        while self._left and self._fit(2 if due else 1, until_ns):
            self._turn()
        return self._state() if due else None

    def _fit(self, calls: int, until_ns: int) -> bool:
        return self._clock() + calls * (self._call_ns or 0.0) + SLACK_NS <= until_ns

    def _turn(self) -> None:
        """The call whose turn it is; one that fails is tried again."""
        now_ns = self._clock()
        seldom = next((name for name in _SELDOM if now_ns - self._read_ns[name] >= SELDOM_NS), None)
        if seldom is not None:
            self._call(seldom)
            return
        self._call(self._in_turn[0])
        self._in_turn.rotate(-1)
        self._left -= 1

    def _call(self, name: str) -> None:
        before_ns = self._clock()
        self._read[name] = read(self._functions, name, _KINDS[name])
        now_ns = self._clock()
        self._read_ns[name] = now_ns
        taken_ns = float(now_ns - before_ns)
        self._call_ns = taken_ns if self._call_ns is None else self._call_ns + SMOOTHING * (taken_ns - self._call_ns)

    def _state(self) -> JacoState:
        """Read the angles; what goes with them is as old as `sweep_s` says."""
        missed = max(0, self._clock() - self._next_ns) // self._period_ns
        self._next_ns += (missed + 1) * self._period_ns
        self._call(_ANGLES)
        self._left = len(_IN_TURN)
        stamp = Stamp(self._read_ns[_ANGLES])
        joints = cast(structures.AngularPosition, self._read[_ANGLES])
        joints_deg = structures.actuator_values(joints.Actuators, self._chain.joint_count)
        pose = self._chain.end_effector(joints_deg)
        x, y, z = (float(value) for value in pose[:3, 3])
        theta_x, theta_y, theta_z = (float(value) for value in euler_xyz_from_rotation(pose[:3, :3]))
        fifo = cast(structures.TrajectoryFIFO, self._read["GetGlobalTrajectoryInfo"])
        sensors = cast(structures.SensorsInfo, self._read["GetSensorsInfo"])
        return JacoState(
            stamp=stamp,
            sweep_s=(stamp.host_ns - min(self._read_ns[name] for name in _IN_TURN)) / 1e9,
            joints_deg=joints_deg,
            rates_deg_s=self._rates_deg_s(stamp.host_ns, joints_deg),
            torques_nm=self._joints("GetAngularForceGravityFree"),
            currents_a=self._joints("GetAngularCurrent"),
            position_m=(x, y, z),
            theta_rad=(theta_x, theta_y, theta_z),
            wrench=structures.cartesian_values(
                cast(structures.CartesianPosition, self._read["GetCartesianForce"]).Coordinates
            ),
            fingers=tuple(one / structures.FINGER_CLOSED for one in structures.finger_values(joints.Fingers)),
            fifo_count=fifo.TrajectoryCount,
            supply_v=sensors.Voltage,
            supply_a=sensors.Current,
            temperatures_deg_c=structures.sensor_temperatures(sensors, self._chain.joint_count),
            homed=cast(structures.QuickStatus, self._read["GetQuickStatus"]).RetractType in structures.HOMED,
        )

    def _rates_deg_s(self, time_ns: int, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """(n,) from the difference of angles: the firmware's own rates are half of the true ones, wrapped, and not near
        zero at rest (`simulation.SimulatedArm.shown_rates_deg_s`)."""
        track = self._track
        track.append((time_ns, joints_deg))
        while len(track) > 2 and time_ns - track[1][0] >= RATES_OVER_NS:
            track.popleft()
        before_ns, before_deg = track[0]
        if time_ns == before_ns:
            return (0.0,) * len(joints_deg)
        span_s = (time_ns - before_ns) / 1e9
        # the short way round, should the arm begin to count anew after a whole turn
        return tuple(
            ((now - before + 180.0) % 360.0 - 180.0) / span_s
            for now, before in zip(joints_deg, before_deg, strict=True)
        )

    def _joints(self, name: str) -> tuple[float, ...]:
        return structures.actuator_values(
            cast(structures.AngularPosition, self._read[name]).Actuators, self._chain.joint_count
        )
