"""The vendor's functions over a simulated arm: what `Library` is to a real Jaco, `JacoDouble` is to this one.

The double has no thread: time passes on the given clock, and each call first simulates the cycles since the last.

A simulated arm in cycles of 10 ms: the effect of the points that its controller receives.

As in the protocol reference, the arm has a FIFO of 2000 trajectory points. One velocity point is used in each cycle:
points sent faster accumulate, and the arm continues to move after the sender has stopped. Cartesian velocities are
ignored without a report after motion by joints, and all Cartesian motion until the arm was homed (kinova-ros issues 62,
148, 269). There are joint ranges and speeds, and fingers that open. Control must be started; its first start after a
cold boot may be ignored. If the real arm's behaviour is not published, the simplest one is modelled and marked. Joints
follow at once unless they have greatest accelerations: there is no inertia."""

import contextlib
import ctypes
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.jaco import structures
from deformscope_drivers.jaco.chains import CHAINS
from deformscope_drivers.jaco.errors import OK
from deformscope_drivers.jaco.structures import PositionType
from deformscope_drivers.jaco.zones import boxes_of

CYCLE_S = 0.01
FIFO_SIZE = 2000
FINGER_SPEED = 5000.0  # units/s; not published
HOME_SPEED_DEG_S = 20.0
AT_HOME_DEG = 0.5


class SimulatedArm:
    """The arm's state, and `cycle` that carries it 10 ms on.

    wrench: (6,) what pushes the end effector [N, Nm] in the base frame; torque_bias_nm: (n,) what the joints' torque
    sensors show too much; cycles: number of cycles so far. All attributes may be set between cycles.
    lag: the next rates, one for each cycle, by which the arm follows its commands late
    acceleration_deg_s2: largest acceleration of each joint at the start and end of a motion
    link_push: a link, from 0, and the force on its far end (3,) [N] in the base frame, None = nothing pushes one
    closed: boxes (3,), (3,) in the base frame [m] that the hand does not enter by Cartesian motions; motions by joints
    may enter
    gravity_left, torque_noise_nm: share of gravity's torques that its model leaves in those without gravity; deviation
    homed: it was at home since it was switched on; cartesian: it executes Cartesian velocities"""

    def __init__(self, chain: Chain, start_deg: npt.ArrayLike | None, cold_boot: bool) -> None:
        """start_deg: (n,) first angles of the arm (default: home); cold_boot: the first `start_control` is ignored"""
        self.chain = chain
        self.joints_deg: FloatArray = chain.clip(chain.home_deg if start_deg is None else start_deg)
        self.rates_deg_s: FloatArray = np.zeros(chain.joint_count)
        self.links: FloatArray = chain.forward(self.joints_deg)
        self.fingers: FloatArray = np.zeros(structures.FINGER_COUNT)
        self.fingers_ready = False
        self.fifo: deque[structures.TrajectoryPoint] = deque()
        self.wrench: FloatArray = np.zeros(6)
        self.torque_bias_nm: FloatArray = np.zeros(chain.joint_count)
        self.control = False
        self.lag: deque[FloatArray] = deque()
        self.acceleration_deg_s2 = np.inf
        self.link_push: tuple[int, FloatArray] | None = None
        self.closed: tuple[tuple[FloatArray, FloatArray], ...] = ()
        self.gravity_left = self.torque_noise_nm = 0.0
        self._random = np.random.default_rng(0x70)
        self.homed = self.cartesian = not cold_boot
        self._cold = cold_boot
        self._homing = False
        self._opening = False
        self.cycles = 0

    # Commands ------------------------------------------------------------------------------------------------------

    def start_control(self) -> None:
        """Take points from here on; a cold arm ignores this once."""
        self.control = self.control or not self._cold
        self._cold = False

    def stop_control(self) -> None:
        """Accept no more points; waiting ones remain."""
        self.control = False
        self._homing = self._opening = False

    def queue(self, point: structures.TrajectoryPoint) -> bool:
        """Append a point to the FIFO; False if it is full. Without control the point is ignored."""
        if not self.control:
            return True
        if len(self.fifo) >= FIFO_SIZE:
            return False
        self._homing = self._opening = False
        self.fifo.append(point)
        return True

    def erase(self) -> None:
        """Forget all points, and stop."""
        self.fifo.clear()
        self._homing = self._opening = False

    def go_home(self) -> None:
        """Set out for the home pose, joint by joint."""
        self.erase()
        self._homing = True

    def open_fingers(self) -> None:
        """Open all fingers, after which they are referenced."""
        self._opening = True

    def power_up(self, cold_boot: bool) -> None:
        """Start as after switching on: nothing is left to do, control is off, the joints stay where they are."""
        self.erase()
        self.control = self.fingers_ready = self.homed = self.cartesian = False
        self._cold = cold_boot

    @property
    def retract(self) -> structures.RetractType:
        """The state that the arm reports of its home pose: not initialized, on its way, at home, or elsewhere."""
        if self._homing:
            return structures.RetractType.NORMAL_TO_READY
        if not self.homed:
            return structures.RetractType.NOT_INITIALIZED
        at_home = bool(np.abs(self.joints_deg - self.chain.home_deg).max() < AT_HOME_DEG)
        return structures.RetractType.READY_STANDBY if at_home else structures.RetractType.NORMAL_STANDBY

    # The cycle -------------------------------------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether the next cycle would change nothing."""
        busy = self.control and (self.fifo or self._homing or self._opening)
        return not busy and not np.any(self.rates_deg_s) and not any(map(np.any, self.lag))

    def cycle(self) -> None:
        """10 ms of the arm's own loop."""
        rates = np.zeros(self.chain.joint_count)
        if self.control:
            if self._homing:
                left_deg = self.chain.home_deg - self.joints_deg
                rates = np.clip(left_deg / CYCLE_S, -HOME_SPEED_DEG_S, HOME_SPEED_DEG_S)
                self._homing = bool(np.any(rates))
                if not self._homing:
                    self.homed = self.cartesian = True
            elif self.fifo:
                rates = self._follow(self.fifo.popleft())
            if self._opening:
                self.fingers = np.maximum(self.fingers - FINGER_SPEED * CYCLE_S, 0.0)
                self._opening = bool(np.any(self.fingers))
                self.fingers_ready = not self._opening
        if self.lag:
            self.lag.append(rates)
            rates = self.lag.popleft()
        if np.isfinite(self.acceleration_deg_s2):
            most = self.acceleration_deg_s2 * CYCLE_S
            rates = self.rates_deg_s + np.clip(rates - self.rates_deg_s, -most, most)
        self._turn(rates)

    def _follow(self, point: structures.TrajectoryPoint) -> FloatArray:
        """Joint rates (n,) [deg/s] that a point asks for."""
        position = point.Position
        rates = np.zeros(self.chain.joint_count)
        kind = position.Type
        if kind == structures.PositionType.ANGULAR_VELOCITY:
            self.cartesian = False  # until it goes home: kinova-ros issue 269
            asked = np.array(structures.actuator_values(position.Actuators, self.chain.joint_count))
            rates = np.clip(asked, -self.chain.velocity_deg_s, self.chain.velocity_deg_s)
        elif kind == structures.PositionType.CARTESIAN_VELOCITY and self.cartesian:  # else ignored, without a word
            twist = np.array(structures.cartesian_values(position.CartesianPosition))
            twist[3:] = self.links[-1, :3, :3] @ twist[3:]  # a point's rotation is in the end effector's frame
            rates = self._outside_zones(self._rates_of(twist))
        return rates

    def _rates_of(self, twist: FloatArray) -> FloatArray:
        """Joint rates (n,) [deg/s] of a twist (6,) [m/s, rad/s] in the base frame, slowed alike where one is too fast.

        How the arm itself behaves near singularities is not public; here the pseudo-inverse is damped."""
        if not np.any(twist):
            return np.zeros(self.chain.joint_count)
        rates = np.degrees(kinematics.damped_joint_rates(kinematics.jacobian_of(self.links), twist))
        fastest = float(np.max(np.abs(rates) / self.chain.velocity_deg_s))
        return rates / max(1.0, fastest)

    def _outside_zones(self, rates_deg_s: FloatArray) -> FloatArray:
        """The same, or none where they would bring the hand into a zone."""
        if self.closed:
            hand_m = self.chain.end_effector(self.joints_deg + rates_deg_s * CYCLE_S)[:3, 3]
            if any(np.all((low_m < hand_m) & (hand_m < high_m)) for low_m, high_m in self.closed):
                return np.zeros(self.chain.joint_count)
        return rates_deg_s

    def _turn(self, rates_deg_s: FloatArray) -> None:
        """Turn the joints for one cycle; a joint at the end of its range stops there."""
        if not np.any(rates_deg_s):
            self.rates_deg_s = rates_deg_s
            return
        before = self.joints_deg
        self.joints_deg = self.chain.clip(before + rates_deg_s * CYCLE_S)
        self.rates_deg_s = (self.joints_deg - before) / CYCLE_S
        self.links = self.chain.forward(self.joints_deg)

    # What its sensors show -------------------------------------------------------------------------------------------

    def external_torque_nm(self) -> FloatArray:
        """Torques of the joints' sensors without gravity, (n,) [Nm]."""
        torque: FloatArray = np.array(self.torque_bias_nm)
        if np.any(self.wrench):
            torque += kinematics.jacobian_of(self.links).T @ self.wrench
        if self.link_push is not None:
            link, force_n = self.link_push
            levers_m = self.links[link + 1, :3, 3] - self.links[: link + 1, :3, 3]
            torque[: link + 1] += np.cross(self.links[: link + 1, :3, 2], levers_m) @ force_n
        if self.gravity_left:
            torque += self.gravity_left * self.chain.gravity_torque_nm(self.links)
        if self.torque_noise_nm:
            torque += self._random.normal(0.0, self.torque_noise_nm, len(torque))
        return torque

    def torque_nm(self) -> FloatArray:
        """Readings of the joints' sensors, gravity included, (n,) [Nm]."""
        return self.external_torque_nm() + self.chain.gravity_torque_nm(self.links)

    def measured_wrench(self) -> FloatArray:
        """The arm's wrench from its joints' sensors, (6,) [N, Nm]: their bias appears as a push.

        The arm's sign is not verified: here the force is that of the world on the end effector."""
        if not np.any(self.torque_bias_nm):
            return self.wrench
        ghost: FloatArray = np.linalg.pinv(kinematics.jacobian_of(self.links).T, rcond=1e-2) @ self.torque_bias_nm
        return self.wrench + ghost

    def shown_rates_deg_s(self) -> FloatArray:
        """The firmware's output for the joints' rates (n,) [deg/s]: half of them, 181 to 360 for negative ones
        (kinova-ros `kinova_comm.cpp`, getJointVelocities; `kinova_arm.cpp`), and not near zero at rest (issue 366)."""
        noise = 1.5 * np.sin(7.3 * np.arange(self.chain.joint_count) + 0.41 * self.cycles)
        return np.asarray((0.5 * self.rates_deg_s + noise) % 360.0)

    def currents_a(self) -> FloatArray:
        """About 0.1 A a joint at rest and 1 A for each 20 Nm, (n,) [A]: plausible, not measured."""
        return 0.1 + np.abs(self.torque_nm()) / 20.0


CYCLE_NS = 10_000_000
Floats = ctypes.Array[ctypes.c_float]

_NO_DEVICE, _TIMEOUT, _INVALID, _NOT_INITIALIZED, _NACK = 1015, 1022, 2100, 2101, 9999
_WITHOUT_INIT = frozenset({"GetAPIVersion", "InitAPI", "InitEthernetAPI", "CloseAPI"})
_FINDS_DEVICES = frozenset({"InitAPI", "InitEthernetAPI", "RefresDevicesList", "GetDevices"})
_DEVICE_TYPES = {
    "j2n6s300": structures.DeviceType.JACO2_6DOF,
    "j2s6s300": structures.DeviceType.SPHERICAL_6DOF,
    "j2s7s300": structures.DeviceType.SPHERICAL_7DOF,
}

_JOINT_READINGS: dict[str, Callable[[SimulatedArm], FloatArray]] = {
    "GetAngularVelocity": SimulatedArm.shown_rates_deg_s,
    "GetAngularForce": SimulatedArm.torque_nm,
    "GetAngularForceGravityFree": SimulatedArm.external_torque_nm,
    "GetAngularCurrent": SimulatedArm.currents_a,
}


class JacoDouble:
    """A simulated Jaco: its methods in capitals are the vendor's, the others are for who runs the simulation.

    The vendor's functions are available through `function` alone, which advances time before each call."""

    def __init__(
        self,
        model: str = "j2n6s300",
        clock: Clock = monotonic_ns,
        *,
        start_deg: npt.ArrayLike | None = None,
        serials: Sequence[str] = ("DOUBLE-1",),
        cold_boot: bool = False,
    ) -> None:
        """clock: [ns], never going back; start_deg: (n,) first joint angles (default: home)

        serials: serials of the arms that are plugged in (they share one body); cold_boot: the arm was just switched on:
        it ignores the first StartControlAPI, and was not homed"""
        self.chain = CHAINS[model]
        self.where = f"simulated {model}"
        self._arm = SimulatedArm(self.chain, start_deg, cold_boot)
        self._clock = clock
        self._then_ns = clock()
        self._serials = tuple(serials)
        self._lock = threading.RLock()
        self._codes: dict[str, deque[int]] = {}
        self._tool_m: FloatArray = np.zeros(3)
        self._zones = structures.ZoneList()
        self._initialized = False
        self._unplugged = False

    # For who runs the simulation -------------------------------------------------------------------------------------

    def function(self, name: str) -> Callable[..., int]:
        """The vendor's function of that name, as `Library.function` gives it."""
        method: Callable[..., int | None] = self._function(name)

        def called(*arguments: Any) -> int:
            with self._present():
                code = self._refusal(name)
                if code == OK:
                    found = method(*arguments)
                    return OK if found is None else found  # most cannot fail
                if name == "GetDevices":  # returns a count, and its code by pointer
                    arguments[1].value = code
                    return 0
                return code

        return called

    def _function(self, name: str) -> Callable[..., int | None]:
        if name in _JOINT_READINGS:
            return lambda response: _write_joints(response, _JOINT_READINGS[name](self._arm))
        found: Callable[..., int | None] = getattr(self, name)
        return found

    def inject(self, name: str, code: int, times: int = 1) -> None:
        """Have the next calls of a function return a code instead of doing anything."""
        with self._lock:
            self._codes.setdefault(name, deque()).extend([code] * times)

    def unplug(self) -> None:
        """Pull the cable: calls time out, no arm is found. The arm itself carries out its waiting points."""
        with self._present():
            self._unplugged = True

    def plug(self) -> None:
        """Put the cable back."""
        with self._present():
            self._unplugged = False

    def power_up(self, cold_boot: bool = True) -> None:
        """Switch the arm off and on."""
        with self._present():
            self._arm.power_up(cold_boot)

    def push(self, wrench: npt.ArrayLike) -> None:
        """Push the end effector from here on: (6,) force [N] and torque [Nm] in the base frame, about its origin."""
        pushed = np.asarray(wrench, dtype=float)
        if pushed.shape != (6,) or not np.all(np.isfinite(pushed)):
            raise ValueError(f"expected a finite wrench of 6; came {wrench!r}")
        with self._present():
            self._arm.wrench = pushed.copy()

    def push_link(self, link: int, force_n: npt.ArrayLike | None) -> None:
        """Push the far end of a link (from 0) from now on: force (3,) [N] in the base frame; None = no more."""
        with self._present():
            self._arm.link_push = None if force_n is None else (link, np.array(force_n, dtype=float))

    def accelerate(self, at_most_deg_s2: float) -> None:
        """Let no joint speed up or slow down faster than this, as real ones cannot."""
        with self._present():
            self._arm.acceleration_deg_s2 = at_most_deg_s2

    def put(self, joints_deg: npt.ArrayLike) -> None:
        """Bring the joints to these angles, (n,) [deg], as a person does by the joystick, but immediately."""
        with self._present():
            self._arm.joints_deg = self.chain.clip(joints_deg)
            self._arm.links = self.chain.forward(self._arm.joints_deg)

    def late(self, seconds: float) -> None:
        """Let the arm follow its commands so late, as its inertia and its own control have it do."""
        with self._present():
            cycles = round(seconds * 1e9) // CYCLE_NS
            self._arm.lag = deque(np.zeros(self.chain.joint_count) for _ in range(cycles))

    def store_tool_offset(self, offset_m: npt.ArrayLike) -> None:
        """Let the arm report the pose of a tool, (3,) [m] from its end effector, as after SetEndEffectorOffset. The
        offset stays in the arm, also for other programs."""
        with self._lock:
            self._tool_m = np.array(offset_m, dtype=float)

    def bias(self, torque_nm: npt.ArrayLike) -> None:
        """Let the joints' torque sensors show this much too much, (n,) [Nm]: real ones drift."""
        with self._present():
            self._arm.torque_bias_nm = np.array(torque_nm, dtype=float)

    def blur_torques(self, noise_nm: float, gravity_left: float) -> None:
        """Add noise of this standard deviation [Nm] to the joints' torques without gravity, and this share of
        gravity's, as with a tool that is missing in the arm's settings."""
        with self._present():
            self._arm.torque_noise_nm, self._arm.gravity_left = noise_nm, gravity_left

    @property
    def rates_deg_s(self) -> FloatArray:
        """Present speeds of the joints, (n,) [deg/s]."""
        with self._present():
            return self._arm.rates_deg_s.copy()

    @property
    def joints_deg(self) -> FloatArray:
        """Present angles of the joints, (n,) [deg]."""
        with self._present():
            return self._arm.joints_deg.copy()

    @property
    def T_base_links(self) -> FloatArray:
        """Present poses of every joint's link and, last, of the end effector, (n + 1, 4, 4) [m]."""
        with self._present():
            return np.array(self._arm.links)

    @property
    def T_base_end_effector(self) -> FloatArray:
        """Present pose of the end effector, (4, 4) [m]."""
        with self._present():
            pose: FloatArray = self._arm.links[-1].copy()
            return pose

    @property
    def fingers(self) -> FloatArray:
        """Present positions of the fingers, (3,) from 0 open to 6800 closed."""
        with self._present():
            return self._arm.fingers.copy()

    @property
    def fifo_count(self) -> int:
        """Number of trajectory points in the arm's queue."""
        with self._present():
            return len(self._arm.fifo)

    def _refusal(self, name: str) -> int:
        """The code with which a call is refused, or OK."""
        if codes := self._codes.get(name):
            return codes.popleft()
        if name not in _WITHOUT_INIT and not self._initialized:
            return _NOT_INITIALIZED
        if self._unplugged and name not in _FINDS_DEVICES | {"GetAPIVersion", "CloseAPI"}:
            return _TIMEOUT
        return OK

    @contextlib.contextmanager
    def _present(self) -> Iterator[None]:
        """For one thread at a time, the arm after its 10 ms cycles up to now by the clock."""
        with self._lock:
            due = (self._clock() - self._then_ns) // CYCLE_NS
            self._then_ns += max(0, due) * CYCLE_NS
            self._arm.cycles += max(0, due)
            while due > 0 and not self._arm.at_rest:
                self._arm.cycle()
                due -= 1
            yield

    # The vendor's functions: the library and its devices -------------------------------------------------------------

    def GetAPIVersion(self, version: ctypes.Array[ctypes.c_int]) -> None:
        version[0], version[1], version[2] = 5, 2, 0

    def InitAPI(self) -> int:
        self._initialized = self.RefresDevicesList() == OK
        return OK if self._initialized else _NO_DEVICE

    def InitEthernetAPI(self, config: structures.EthernetCommConfig) -> int:
        return self.InitAPI() if config.robotIpAddress else _INVALID

    def CloseAPI(self) -> None:
        self._initialized = False

    def RefresDevicesList(self) -> int:
        return OK if self._serials and not self._unplugged else _NO_DEVICE

    def GetDevices(self, devices: ctypes.Array[structures.KinovaDevice], status: ctypes.c_int) -> int:
        status.value = self.RefresDevicesList()
        if status.value != OK:
            return 0
        for index, serial in enumerate(self._serials):
            model, kind = self.chain.name.encode(), _DEVICE_TYPES[self.chain.name]
            devices[index] = structures.KinovaDevice(serial.encode(), model, 6, 2, 5, kind, index)
        return len(self._serials)

    def SetActiveDevice(self, device: structures.KinovaDevice) -> int:
        return OK if device.SerialNumber.decode() in self._serials else _NO_DEVICE

    def GetGeneralInformations(self, response: structures.GeneralInformations) -> None:
        response.TimeFromStartup = self._then_ns / 1e9
        response.SupplyVoltage, response.TotalCurrent = 24.0, self._supply_a()
        response.ConnectedActuatorCount = self.chain.joint_count

    # Control and motion ----------------------------------------------------------------------------------------------

    def StartControlAPI(self) -> None:
        self._arm.start_control()

    def StopControlAPI(self) -> None:
        self._arm.stop_control()

    def SendBasicTrajectory(self, point: structures.TrajectoryPoint) -> int:
        if point.Position.Type not in (PositionType.CARTESIAN_VELOCITY, PositionType.ANGULAR_VELOCITY):
            return _INVALID
        # what the arm answers when it is full is not public
        return OK if self._arm.queue(structures.TrajectoryPoint.from_buffer_copy(point)) else _NACK

    def EraseAllTrajectories(self) -> None:
        self._arm.erase()

    def GetGlobalTrajectoryInfo(self, response: structures.TrajectoryFIFO) -> None:
        response.TrajectoryCount = len(self._arm.fifo)
        response.UsedPercentage = 100.0 * len(self._arm.fifo) / FIFO_SIZE
        response.MaxSize = FIFO_SIZE

    def MoveHome(self) -> None:
        """Returns at once; the arm is moving."""
        self._arm.go_home()

    def InitFingers(self) -> None:
        self._arm.open_fingers()

    # Readings --------------------------------------------------------------------------------------------------------

    def GetAngularPosition(self, response: structures.AngularPosition) -> None:
        _write_joints(response, self._arm.joints_deg)
        self._write_fingers(response)

    def GetCartesianPosition(self, response: structures.CartesianPosition) -> None:
        pose = self._arm.links[-1]
        place_m = pose[:3, 3] + pose[:3, :3] @ self._tool_m
        response.Coordinates = structures.CartesianInfo(*place_m, *kinematics.euler_xyz_from_rotation(pose[:3, :3]))
        self._write_fingers(response)

    def GetCartesianForce(self, response: structures.CartesianPosition) -> None:
        response.Coordinates = structures.CartesianInfo(*self._arm.measured_wrench())

    def GetCommandVelocity(self, cartesian: Floats, angular: Floats) -> None:
        rates_deg_s = self._arm.rates_deg_s
        # in the base frame, both: what frame the arm's rotation is in here is not published
        cartesian[:] = (kinematics.jacobian_of(self._arm.links) @ np.radians(rates_deg_s)).tolist()
        angular[: len(rates_deg_s)] = rates_deg_s.tolist()

    def GetForcesInfo(self, response: structures.ForcesInfo) -> None:
        for index, value in enumerate(self._arm.external_torque_nm(), 1):
            setattr(response, f"Actuator{index}", value)
        for name, value in zip(("X", "Y", "Z", "ThetaX", "ThetaY", "ThetaZ"), self._arm.measured_wrench(), strict=True):
            setattr(response, name, value)

    def GetSensorsInfo(self, response: structures.SensorsInfo) -> None:
        response.Voltage, response.Current = 24.0, self._supply_a()
        response.AccelerationX, response.AccelerationY, response.AccelerationZ = 0.0, 0.0, 1.0
        for index in range(1, self.chain.joint_count + 1):
            setattr(response, f"ActuatorTemp{index}", 30.0)
        for index in range(1, structures.FINGER_COUNT + 1):
            setattr(response, f"FingerTemp{index}", 28.0)

    def GetQuickStatus(self, response: structures.QuickStatus) -> None:
        response.Finger1Status = response.Finger2Status = response.Finger3Status = int(self._arm.fingers_ready)
        response.ControlEnableStatus = int(not self._arm.control)
        response.ForceControlStatus = 1
        response.TorqueSensorsStatus = 1
        response.RetractType = self._arm.retract

    # Protection zones ------------------------------------------------------------------------------------------------

    def EraseAllProtectionZones(self) -> None:
        self._zones = structures.ZoneList()
        self._arm.closed = ()

    def SetProtectionZone(self, zones: structures.ZoneList) -> int:
        if not 0 <= zones.NbZones <= structures.ZONES_MAX:
            return _INVALID
        self._zones = structures.ZoneList.from_buffer_copy(zones)
        self._arm.closed = tuple((np.array(box.low_m), np.array(box.high_m)) for box in boxes_of(self._zones))
        return OK

    def GetProtectionZone(self, response: structures.ZoneList) -> None:
        ctypes.memmove(ctypes.byref(response), ctypes.byref(self._zones), ctypes.sizeof(response))

    # Force -----------------------------------------------------------------------------------------------------------

    def StopForceControl(self) -> None:
        """It never began."""

    def SetTorqueSafetyFactor(self, factor: float) -> int:
        return OK if 0.0 <= factor <= 1.0 else _INVALID

    def SetGravityType(self, kind: int) -> int:
        return OK if kind in (0, 1) else _INVALID

    # Within ----------------------------------------------------------------------------------------------------------

    def _supply_a(self) -> float:
        return float(0.7 + np.sum(self._arm.currents_a()))

    def _write_fingers(self, response: structures.AngularPosition | structures.CartesianPosition) -> None:
        response.Fingers.Finger1, response.Fingers.Finger2, response.Fingers.Finger3 = self._arm.fingers


def _write_joints(response: structures.AngularPosition, values: FloatArray) -> None:
    """Write the values (n,) of the joints that the arm has; as with the arm, those that it lacks are not written."""
    struct.pack_into(f"{len(values)}f", response.Actuators, 0, *values.tolist())
