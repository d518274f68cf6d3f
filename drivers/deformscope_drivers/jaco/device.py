"""The arm as a device: its state to read, its motion to command, and a cycle of 10 ms that keeps both honest.

The arm takes one velocity point each 10 ms, queues faster ones, and has no watchdog. The arm executes the points in its
FIFO even if their sender has ended. Therefore the device's thread sends one point in each slot of an absolute schedule
and never in advance. A velocity lasts only as long as its sender renews it:

- not refreshed in time: the next slot sends zero, the one after erases the FIFO
- cycle delayed by more than the deadline, workspace about to be left, or link lost: the FIFO is erased as soon as the
  arm is connected. Further commands are refused until `acknowledge_stop`
- closed, an exception, Ctrl-C, the interpreter's end: erased before the library is closed

A process that is killed outright (SIGKILL) can erase nothing. The arm then carries out the waiting points: one or two
velocity points, that is 20 ms of motion. An arm on its way home goes on.

The arm is brought up, and released again, in the order that the vendor's own driver keeps."""

import contextlib
import socket
import struct
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from deformscope_drivers.arm.device import CALL_MS, Arm, JointVelocity, Velocity, by_joints, linear_velocity_of
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.arm.kinematics import Chain, pose_error, rotation_from_euler_xyz, transform
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import RECONNECT, Reconnect
from deformscope_drivers.errors import (
    DeviceError,
    LinkLost,
    MotionStopped,
    NotConnected,
    OutOfLimits,
    SettingsRefused,
    Stale,
)
from deformscope_drivers.health import Identity, Link
from deformscope_drivers.jaco.chains import CHAINS, urdf_path
from deformscope_drivers.jaco.config import EthernetAddresses, JacoConfig
from deformscope_drivers.jaco.errors import NoDeviceFound, NotHomed, NotReached, VendorError
from deformscope_drivers.jaco.library import Functions, Library, api_version, call, devices, read
from deformscope_drivers.jaco.reading import JacoState, StateReader
from deformscope_drivers.jaco.structures import (
    AngularPosition,
    CartesianPosition,
    DeviceType,
    EthernetCommConfig,
    GeneralInformations,
    KinovaDevice,
    PositionType,
    TrajectoryPoint,
    actuator_values,
    cartesian_values,
    velocity_point,
)
from deformscope_drivers.jaco.zones import set_zones
from deformscope_drivers.memory import SimulatedClock
from deformscope_drivers.pacing import Pacer, SlotPacer

PERIOD_NS = 10_000_000
FIFO_AHEAD = 2  # points that may wait in the arm before a slot is left out: its clock is not this computer's
REFUSED_IN_A_ROW = 10
COMMAND_TIMEOUT_S = 6.0  # the vendor's library waits up to 5 s for a packet
LOOK_AHEAD_S = 0.1
STATE_AGE_S = 0.5
STILL_DEG_S, STILL_S = 1.0, 0.5
HOME_PAUSE_S = 1.0
"""Time from stopping the control to starting it before `MoveHome`, as in kinova-ros' `KinovaComm::homeArm`."""
PAUSE_S = 0.05  # between stopping the control and starting it again
CONFIGURATION_GAP_S = 0.1  # between two writes to the arm's configuration
SEARCH_FIRST_S = 0.5  # before an arm that was not found is sought again; then twice as long each time
GRAVITY_MANUAL = 0
POSE_MM, POSE_DEG = 5.0, 2.0
"""Models and tools differ by centimetres; what an arm that is led by its joystick moves within a call is less."""

_MODELS = {
    DeviceType.JACO2_6DOF: "j2n6s300",
    DeviceType.JACO2_6DOF_ASSISTIVE: "j2n6s300",
    DeviceType.SPHERICAL_6DOF: "j2s6s300",
    DeviceType.SPHERICAL_7DOF: "j2s7s300",
}


@dataclass(frozen=True, slots=True)
class JacoIdentity:
    """The arm that was opened, and its library and connection.

    library_version: the vendor's library's; firmware: version in the device list; chain: its kinematics"""

    serial: str
    model: str
    firmware: tuple[int, int, int]
    library_version: tuple[int, int, int]
    chain: Chain


def bring_up(functions: Functions, config: JacoConfig, pause: Callable[[float], None]) -> JacoIdentity:
    """Initialise the library, choose the arm, and take control of it; nothing moves without a command to the fingers.
    pause: function that waits for this number of seconds. Raises the named exception of any error."""
    version = api_version(functions)
    device = _find(functions, config, pause)
    call(functions, "SetActiveDevice", device)
    read(functions, "GetGeneralInformations", GeneralInformations)
    identity = _identify(device, version, config, functions.where)
    # after a cold boot the arm may ignore the first start; erase what an earlier program may have left
    call(functions, "StartControlAPI")
    call(functions, "StopControlAPI")
    call(functions, "EraseAllTrajectories")
    pause(PAUSE_S)
    call(functions, "StartControlAPI")
    call(functions, "SetGravityType", GRAVITY_MANUAL)
    pause(CONFIGURATION_GAP_S)
    call(functions, "SetTorqueSafetyFactor", 1.0)
    if config.protection_zones is not None:
        pause(CONFIGURATION_GAP_S)
        set_zones(functions, config.protection_zones, lambda: pause(CONFIGURATION_GAP_S))
    zero = TrajectoryPoint()
    zero.Position.Type = PositionType.CARTESIAN_VELOCITY
    call(functions, "SendBasicTrajectory", zero)
    if config.initialize_fingers:
        call(functions, "InitFingers")
    return identity


def check_pose(functions: Functions, chain: Chain) -> None:
    """Raise SettingsRefused unless the arm reports its hand where its model's kinematics have it.

    Everything else takes the hand's pose from the joint angles. An arm of another model than it reports, or one with a
    stored tool offset, would move and touch at wrong places."""
    angles = read(functions, "GetAngularPosition", AngularPosition)
    pose = cartesian_values(read(functions, "GetCartesianPosition", CartesianPosition).Coordinates)
    later = read(functions, "GetAngularPosition", AngularPosition)  # it may be moved by its joystick meanwhile
    both = [actuator_values(one.Actuators, chain.joint_count) for one in (angles, later)]
    ours = chain.end_effector(np.mean(both, axis=0))
    theirs = transform(rotation_from_euler_xyz(*pose[3:]), pose[:3])
    error = pose_error(ours, theirs)
    off_mm, off_deg = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
    if not (off_mm <= POSE_MM and off_deg <= POSE_DEG):
        within = f"within {POSE_MM:g} mm and {POSE_DEG:g} deg of the pose of a {chain.name} at these angles"
        came = f"one that the arm reports {off_mm:.1f} mm and {off_deg:.1f} deg away"
        advice = (
            "another `model`; or set the tool offset that is stored in the arm to zero (SetEndEffectorOffset, Kinova's "
            "Development Center): the tool belongs into the rig file"
        )
        raise SettingsRefused(f"the arm's hand {within}", came, advice, functions.where)


def let_go(functions: Functions) -> DeviceError | None:
    """Stop the arm and release it, continuing after any failure; returns why its trajectories could not be erased, or
    nothing."""
    not_erased = _try(functions, "EraseAllTrajectories")
    if not_erased is not None:
        not_erased = _try(functions, "EraseAllTrajectories")
    for name in ("StopForceControl", "StopControlAPI", "CloseAPI"):
        _try(functions, name)
    return not_erased


def _try(functions: Functions, name: str) -> DeviceError | None:
    try:
        call(functions, name)
    except DeviceError as error:
        return error
    return None


def _find(functions: Functions, config: JacoConfig, pause: Callable[[float], None]) -> KinovaDevice:
    """The arm that is meant. One that is not found is sought again: after a crash the first search often fails."""
    wait_s = SEARCH_FIRST_S
    for attempt in range(1, config.open_attempts + 1):
        try:
            if config.connection == "ethernet":
                call(functions, "InitEthernetAPI", ethernet_structure(config.ethernet))
            else:
                call(functions, "InitAPI")
            functions.function("RefresDevicesList")()  # whether there is an arm shows in the list itself
            return _choose(devices(functions), config.serial, functions.where)
        except NoDeviceFound:
            with contextlib.suppress(DeviceError):
                call(functions, "CloseAPI")
            if attempt == config.open_attempts:
                raise
            pause(wait_s)
            wait_s *= 2
    raise AssertionError("open_attempts is at least 1")


def ethernet_structure(addresses: EthernetAddresses) -> EthernetCommConfig:
    """The vendor's structure: addresses in network byte order within a native integer, times in milliseconds."""
    local, mask, robot = (
        struct.unpack("=I", socket.inet_aton(address))[0]
        for address in (addresses.local_ip, addresses.subnet_mask, addresses.robot_ip)
    )
    return EthernetCommConfig(
        localIpAddress=local,
        subnetMask=mask,
        robotIpAddress=robot,
        localCmdport=addresses.local_command_port,
        localBcastPort=addresses.local_broadcast_port,
        robotPort=addresses.robot_port,
        rxTimeOutInMs=round(addresses.receive_timeout_s * 1000),
    )


def _choose(found: list[KinovaDevice], serial: str | None, where: str) -> KinovaDevice:
    serials = [_text(device.SerialNumber) for device in found]
    if not found:
        raise NoDeviceFound("GetDevices", where)
    if serial is None:
        if len(found) > 1:
            raise NotConnected(
                "one arm, or the serial number of the one to use", f"arms {', '.join(serials)}", "give `serial`", where
            )
        return found[0]
    if serial not in serials:
        raise NotConnected(f"the arm {serial}", f"arms {', '.join(serials)}", "check the serial number", where)
    return found[serials.index(serial)]


def _identify(device: KinovaDevice, version: tuple[int, int, int], config: JacoConfig, where: str) -> JacoIdentity:
    said = _MODELS.get(DeviceType(device.DeviceType)) if device.DeviceType in DeviceType.__members__.values() else None
    model = config.model or said
    if model is None:
        expected = f"an arm whose geometry is known ({', '.join(sorted(CHAINS))})"
        advice = "give `model` if it is one of them nevertheless"
        raise SettingsRefused(expected, f"one of type {device.DeviceType}", advice, where)
    if said is not None and said != model:
        raise SettingsRefused(f"a {model}", f"an arm that reports {said} as its model", "correct `model`", where)
    return JacoIdentity(
        serial=_text(device.SerialNumber),
        model=model,
        firmware=(device.VersionMajor, device.VersionMinor, device.VersionRelease),
        library_version=version,
        chain=CHAINS[model],
    )


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("ascii", "replace").strip()


def open_jaco(config: JacoConfig) -> Arm[Any]:
    """The device, not yet opened: in a separate process unless the configuration disables that."""
    return HostedArm(Jaco, config) if config.own_process else Jaco(config)


class Jaco(Arm[JacoState]):
    """`with Jaco(JacoConfig(library="/opt/kinova")) as arm:`; with the three reads that every device has.

    Only one thread calls the vendor's library, which does not support several."""

    goes_home = True
    stop_by_hand = "the emergency stop, or the arm's own joystick"

    def __init__(
        self,
        config: JacoConfig | None = None,
        functions: Functions | None = None,
        *,
        reconnect: Reconnect | None = RECONNECT,
        clock: Clock = monotonic_ns,
    ) -> None:
        """functions: a double in place of the vendor's library; clock: the host's, or a simulated laboratory's"""
        self.config = config if config is not None else JacoConfig()
        self._functions = functions if functions is not None else Library(self.config.library, self.config.connection)
        super().__init__(self._functions.where, reconnect=reconnect, clock=clock)
        self._arm: JacoIdentity | None = None
        self._waiting = Pacer(clock)
        self._homing_until_ns: int | None = None
        self._erase_due = False
        self._pacer = SlotPacer(PERIOD_NS)
        self._reader: StateReader | None = None
        self._state: JacoState | None = None
        self._crowded = False
        self._sent = self._expired = self._left_out = self._refused_in_a_row = 0

    # Lifecycle -------------------------------------------------------------------------------------------------------

    def open(self, *, own_thread: bool = True) -> Self:
        """Take control of the arm, at rest. Raises NotConnected, LibraryMissing, or the vendor's code by its name."""
        if not self.is_open:
            self._pacer = SlotPacer(PERIOD_NS)
            self._sent = self._expired = self._left_out = 0
        return super().open(own_thread=own_thread)

    @property
    def chain(self) -> Chain:
        """The arm's kinematics; known once it was opened."""
        if self._arm is None:
            raise NotConnected("an arm that was opened", "one that was not yet", "open() it", self.name)
        return self._arm.chain

    @property
    def urdf(self) -> Path:
        return urdf_path(self.chain.name)

    def identity(self) -> Identity:
        """Model, serial number, and firmware with the version of the vendor's library."""
        arm = self._arm
        if arm is None:
            return Identity()
        firmware, library = (".".join(map(str, version)) for version in (arm.firmware, arm.library_version))
        return Identity(arm.model, arm.serial, f"{firmware} (library {library})")

    def _connect(self) -> None:
        self._arm = bring_up(self._functions, self.config, self._pause)
        self._not_stopped = None  # bringing it up has erased what was left
        check_pose(self._functions, self.chain)
        self._reader = StateReader(self._functions, self.chain, self.config.state_hz, self._clock)
        self._state = self._reader.whole()
        self._expect(self.config.state_hz)
        self._pacer.start(self._clock() + PERIOD_NS)  # the zero point of bringing it up had this slot
        self._refused_in_a_row = 0
        self._crowded = False

    def _disconnect(self) -> None:
        with self._commanded:
            moving = self._erase_due or self._streamed is not None or self._homing_until_ns is not None
            self._streamed = self._homing_until_ns = None
            self._erase_due = False
            if moving and not self._closing.is_set():
                self._stopped = self._stopped or "the link to the arm was lost while it moved"
        not_erased = let_go(self._functions)
        if moving:
            self._not_stopped = not_erased

    def _wake(self) -> None:
        self._waiting.wake()

    def _extra_health(self) -> dict[str, float]:
        median_ms, high_ms, greatest_ms = self._pacer.lateness_ms()
        return {
            "points_sent": self._sent,
            "slots": self._pacer.slots,
            "slots_missed": self._pacer.missed,
            "slots_left_out": self._left_out,
            "commands_expired": self._expired,
            "late_ms_median": median_ms,
            "late_ms_p99": high_ms,
            "late_ms_max": greatest_ms,
            CALL_MS: 0.0 if self._reader is None else self._reader.call_ms,
        }

    # The cycle: run by the device's own thread -----------------------------------------------------------------------

    def _receive(self, timeout_s: float) -> Iterable[JacoState]:
        """One slot: first the commands for the arm, then the queries that fit before the next slot."""
        if not self._waiting.wait_until(self._pacer.due_ns, timeout_s):
            return ()
        now_ns = self._clock()
        late_ns = self._pacer.enter(now_ns)
        assert self._reader is not None
        try:
            self._command(now_ns, late_ns)
            state = self._reader.go_on(self._pacer.due_ns)
        except VendorError as error:  # the link is lost, or the arm refused a call, which may pass
            self._count_refused(f"{error.vendor_code or error.code} {error.symbol}")
            self._refused_in_a_row += 1
            if isinstance(error, LinkLost):
                raise
            if isinstance(error, NotConnected) or self._refused_in_a_row >= REFUSED_IN_A_ROW:
                raise LinkLost("an arm that answers", str(error), error.remedy, self.name) from error
            return ()
        if state is None:
            return ()
        self._refused_in_a_row = 0
        self._state = state
        self._crowded = state.fifo_count > FIFO_AHEAD
        return (state,)

    def _command(self, now_ns: int, late_ns: int) -> None:
        """Send the point of this slot, if there is one; end motions that must stop."""
        with self._commanded:
            streamed, homing_until_ns = self._streamed, self._homing_until_ns
        if streamed is None:
            if homing_until_ns is not None and now_ns > homing_until_ns:
                self._halt("no caller waited any more for the arm to be at home")
            if self._erase_due:
                self._erase()
            return
        late_ns = min(late_ns, now_ns - streamed.since_ns)  # before there was a command nothing came too late
        if late_ns > self.config.command_deadline_s * 1e9:
            self._halt(f"the cycle was {late_ns / 1e6:.0f} ms late")
        elif now_ns > streamed.expires_ns:
            with self._commanded:
                if self._streamed is streamed:
                    self._streamed = None
            self._expired += 1
            self._erase_due = True
            self._send(JointVelocity((0.0,) * self.chain.joint_count))
        elif reason := self._forbids(streamed.velocity, now_ns):
            self._halt(reason)
        elif self._crowded:
            self._crowded = False
            self._left_out += 1
        elif isinstance(sent := self._by_joints(streamed.velocity), str):
            self._halt(sent)
        else:
            self._send(sent)

    def _by_joints(self, velocity: Velocity) -> JointVelocity | str:
        assert self._state is not None
        return by_joints(velocity, self.chain, self.config, self._state.joints_deg)

    def _send(self, velocity: JointVelocity) -> None:
        call(self._functions, "SendBasicTrajectory", velocity_point(velocity))
        self._sent += 1

    def _erase(self) -> None:
        call(self._functions, "EraseAllTrajectories")
        self._erase_due = False

    def _halt(self, reason: str) -> None:
        """Stop the arm, and refuse commands until a person acknowledges it."""
        self._forget_commands(reason)
        self._erase()

    def _forget_commands(self, stopped_because: str = "") -> None:
        """The command is over, and the FIFO is due to be erased; no command can slip in between."""
        with self._commanded:
            self._streamed = self._homing_until_ns = None
            self._stopped = self._stopped or stopped_because
            self._erase_due = True

    def _forbids(self, velocity: Velocity, now_ns: int) -> str:
        """Why a velocity must end: the arm's state is unknown, or it would leave its workspace."""
        state = self._state
        assert state is not None
        age_s = (now_ns - state.stamp.host_ns) / 1e9
        if age_s > STATE_AGE_S:
            return f"the arm's state could not be read for {age_s:.2f} s"
        box = self.config.workspace
        if box is None:
            return ""
        linear_m_s = linear_velocity_of(velocity, self.chain, state.joints_deg)
        for axis, name in enumerate("xyz"):
            here, speed = state.position_m[axis], linear_m_s[axis]
            ahead = here + LOOK_AHEAD_S * speed
            if (speed > 0 and ahead > box.high_m[axis]) or (speed < 0 and ahead < box.low_m[axis]):
                return f"the workspace would have been left along {name} at {here:.3f} m"
        return ""

    def _pause(self, seconds: float) -> None:
        """Wait in the thread that owns the link, by a simulated clock where it runs on one."""
        if isinstance(self._clock, SimulatedClock):
            self._clock.advance_to(self._clock() + round(seconds * 1e9))
        else:
            self._closing.wait(seconds)

    # Motion ----------------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        self._forget_commands()
        self._do(self._erase, COMMAND_TIMEOUT_S)

    def halt(self, reason: str) -> None:
        self._forget_commands(reason or "by command")
        self._do(self._erase, COMMAND_TIMEOUT_S)

    def home(self, timeout_s: float = 60.0) -> JacoState:
        """Send the arm to its own home pose, on its own path and at its own speed. Wait until it is at rest, and
        reports that it is at home. An arm needs this once after it was switched on, by this call or by its joystick's
        home button. The arm's control is first stopped and started again, as in the vendor's driver. Raises NotReached
        after timeout_s; on any exception, Ctrl-C too, the arm is stopped."""
        self._require_moves()
        moving_ns: int | None = None
        until_ns = self._clock() + round(timeout_s * 1e9)
        began = given_up = False

        def set_out() -> None:
            nonlocal began
            with self._commanded:
                self._require_moves()
                if given_up:  # by Ctrl-C, say, before the device's thread came to it
                    return
                if self._streamed is not None or self._homing_until_ns is not None:
                    raise OutOfLimits("an arm at rest", "one that is moving", "stop() first", self.name)
                self._homing_until_ns = until_ns + round(STATE_AGE_S * 1e9)
                began = True
            self._erase()
            call(self._functions, "StopControlAPI")

        def require_under_way() -> None:
            self._require_moves()
            if self._homing_until_ns is None:
                raise MotionStopped("an arm on its way home", "stop()", "send it again", self.name)

        def move_home() -> None:
            require_under_way()
            call(self._functions, "MoveHome")

        try:
            self._do(set_out, COMMAND_TIMEOUT_S)
            try:
                self._pass_time(HOME_PAUSE_S)
            finally:
                self._do(lambda: call(self._functions, "StartControlAPI"), COMMAND_TIMEOUT_S)
            self._do(move_home, COMMAND_TIMEOUT_S)
            while (left_s := (until_ns - self._clock()) / 1e9) > 0:
                state = None
                with contextlib.suppress(Stale):
                    state = self.next(min(left_s, STATE_AGE_S))
                require_under_way()
                if state is None:
                    continue
                if moving_ns is None or max(map(abs, state.rates_deg_s)) > STILL_DEG_S:
                    moving_ns = state.stamp.host_ns
                if state.homed and state.stamp.host_ns - moving_ns >= STILL_S * 1e9:
                    return state
            raise NotReached("home", f"an arm that arrives within {timeout_s:g} s", "a longer timeout_s", self.name)
        finally:
            with self._commanded:
                given_up = True
            if began and self.is_open and self.link is Link.CONNECTED:
                self.stop()

    # Within ----------------------------------------------------------------------------------------------------------

    def _pass_time(self, seconds: float) -> None:
        """Wait in the caller's thread, the cycle going on."""
        if self._own_thread:
            time.sleep(seconds)
            return
        until_ns = self._clock() + round(seconds * 1e9)
        while (left_ns := until_ns - self._clock()) > 0:
            self.poll(left_ns / 1e9)

    @property
    def homed(self) -> bool:
        """Whether the arm says that it was at home since it was switched on; read once a second."""
        return self._state is not None and self._state.homed

    def _require_ready(self) -> None:
        if self.config.require_home and not self.homed:
            advice = "hold its joystick's home button until it rests; or deformscope arm home RIG; or arm.home()"
            raise NotHomed("an arm that was homed after power-on", "one that was not", advice, self.name)
        if self._homing_until_ns is not None:
            raise OutOfLimits("an arm that is not on its way home", "one that is", "stop() first", self.name)
