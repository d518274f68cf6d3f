"""Reading the arm's state call by call, in the time that the commands leave.

Over USB the vendor's library opens, claims, transfers and closes for each packet, so one call may take milliseconds.
A sweep of all calls is therefore spread over as many slots as it needs: a call is only made where it will likely end
before the next slot is due.
"""

from __future__ import annotations

import ctypes
from collections import deque
from typing import cast

from deformscope_drivers.clock import Clock, Stamp
from deformscope_drivers.jaco.library import Functions, read
from deformscope_drivers.jaco.state import JacoState
from deformscope_drivers.jaco.structures import (
    AngularPosition,
    CartesianPosition,
    SensorsInfo,
    TrajectoryFIFO,
    actuator_values,
    cartesian_values,
    finger_values,
    sensor_temperatures,
)

SENSORS_EVERY_NS = 1_000_000_000
SLACK_NS = 1_000_000
SMOOTHING = 0.2
RATES_OVER_NS = 40_000_000
"""Angles this far apart give the joints' rates. Over one slot, angles off by 0.01 deg would be rates off by 1 deg/s."""

# what moves fastest comes last, so that it is as fresh as the stamp
_CALLS: tuple[tuple[str, type[ctypes.Structure]], ...] = (
    ("GetGlobalTrajectoryInfo", TrajectoryFIFO),
    ("GetAngularCurrent", AngularPosition),
    ("GetAngularForceGravityFree", AngularPosition),
    ("GetCartesianForce", CartesianPosition),
    ("GetCartesianPosition", CartesianPosition),
    ("GetAngularPosition", AngularPosition),
)


class Sweep:
    """One state after the other, at a rate or as often as the link allows."""

    def __init__(self, functions: Functions, joint_count: int, rate_hz: float, clock: Clock) -> None:
        self._functions = functions
        self._joint_count = joint_count
        self._period_ns = round(1e9 / rate_hz)
        self._clock = clock
        self._next_ns = clock()
        self._sensors_ns: int | None = None
        self._left: deque[tuple[str, type[ctypes.Structure]]] = deque()
        self._read: dict[str, ctypes.Structure] = {}
        self._began_ns = 0
        self._call_ns = 0.0
        self._track: deque[tuple[int, tuple[float, ...]]] = deque()

    def whole(self) -> JacoState:
        """A whole sweep now, however long it takes."""
        self.begin_anew()
        self._begin(self._clock())
        while self._left:
            self._call()
        return self._assemble()

    def go_on(self, until_ns: int) -> JacoState | None:
        """Make calls while they fit before `until_ns`, at least one; the state once its sweep is whole."""
        if not self._left:
            now_ns = self._clock()
            if now_ns < self._next_ns:
                return None
            self._begin(now_ns)
        self._call()
        while self._left:
            if self._clock() + self._call_ns + SLACK_NS > until_ns:
                return None
            self._call()
        return self._assemble()

    def begin_anew(self) -> None:
        """Forget a sweep that is not whole: a call of it failed."""
        self._left.clear()

    def _begin(self, now_ns: int) -> None:
        self._began_ns = now_ns
        missed = max(0, now_ns - self._next_ns) // self._period_ns
        self._next_ns += (missed + 1) * self._period_ns
        self._left.extend(_CALLS)
        if self._sensors_ns is None or now_ns - self._sensors_ns >= SENSORS_EVERY_NS:
            self._sensors_ns = now_ns
            self._left.appendleft(("GetSensorsInfo", SensorsInfo))

    def _call(self) -> None:
        name, kind = self._left[0]
        before_ns = self._clock()
        self._read[name] = read(self._functions, name, kind)
        self._left.popleft()
        self._call_ns += SMOOTHING * (self._clock() - before_ns - self._call_ns)

    def _assemble(self) -> JacoState:
        stamp = Stamp(self._clock())
        joints = cast(AngularPosition, self._read["GetAngularPosition"])
        pose = cast(CartesianPosition, self._read["GetCartesianPosition"])
        x, y, z, *thetas = cartesian_values(pose.Coordinates)
        fifo = cast(TrajectoryFIFO, self._read["GetGlobalTrajectoryInfo"])
        sensors = cast(SensorsInfo, self._read["GetSensorsInfo"])
        joints_deg = actuator_values(joints.Actuators, self._joint_count)
        return JacoState(
            stamp=stamp,
            sweep_s=(stamp.host_ns - self._began_ns) / 1e9,
            joints_deg=joints_deg,
            rates_deg_s=self._rates_deg_s(stamp.host_ns, joints_deg),
            torques_nm=self._joints("GetAngularForceGravityFree"),
            currents_a=self._joints("GetAngularCurrent"),
            position_m=(x, y, z),
            theta_rad=(thetas[0], thetas[1], thetas[2]),
            wrench=cartesian_values(cast(CartesianPosition, self._read["GetCartesianForce"]).Coordinates),
            fingers=finger_values(joints.Fingers),
            fifo_count=fifo.TrajectoryCount,
            supply_v=sensors.Voltage,
            supply_a=sensors.Current,
            temperatures_deg_c=sensor_temperatures(sensors, self._joint_count),
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
        return tuple((now - before) / span_s for now, before in zip(joints_deg, before_deg, strict=True))

    def _joints(self, name: str) -> tuple[float, ...]:
        return actuator_values(cast(AngularPosition, self._read[name]).Actuators, self._joint_count)
