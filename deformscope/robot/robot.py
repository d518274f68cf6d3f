"""Arm, force sensor and camera as one robot with one control period, watched by the supervisor.

The same code runs on real devices, which have threads, and in a simulated laboratory; only `wait_until` differs."""

import contextlib
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from deformscope.errors import InputError
from deformscope.robot.checks import Preflight
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.latch import Action
from deformscope.robot.motion import CommandedRotation, JointMotion, rates_for_twist, within_limits
from deformscope.robot.placement import Placement
from deformscope.robot.readings import PERIOD_NS, ArmSample, CameraSample, ForceSample, RobotObservation
from deformscope.robot.supervisor import FORCE_FAULTS, Fault, Limits, SafetyDecision, Supervisor
from deformscope_drivers.arm import Arm, ArmState, JointVelocity
from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross
from deformscope_drivers.clock import Clock, monotonic_ns
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.health import Health, Link
from deformscope_drivers.images import DepthImage, fingerprint
from deformscope_drivers.interface import ForceReading

VALID_PERIODS = 4
"""A velocity expires unless it is set again within this number of control periods."""


class ForceSensor(Protocol):
    """Source of the force at the end of an arm (`Optoforce`, `fingertip_force.FingertipForce`). A force sensor, whose
    readings have `stamp`, `force_n` (channels, 3) [N], `counts`, which change from one to the next, and `usable`"""

    @property
    def config(self) -> Any: ...

    @property
    def link(self) -> Link: ...

    @property
    def damaged(self) -> int: ...

    def health(self) -> Health: ...

    def readings(self) -> Any: ...


Watch = Callable[[RobotObservation, SafetyDecision], None]
"""Called with the readings and the verdict of each control period."""


class RobotStopped(Exception):
    """The supervisor has stopped the robot. verdict: why"""

    def __init__(self, verdict: SafetyDecision) -> None:
        super().__init__(f"the robot was stopped: {verdict.fault}: {verdict.reason}")
        self.verdict = verdict


class MotionHeld(Exception):
    """The robot did not execute a motion command and is at rest, without a fault: it accepts further commands."""


@dataclass(frozen=True, slots=True)
class TipVelocity:
    """A velocity of the tip, surface frame. linear_m_s: (3,) velocity of its centre; angular_rad_s: (3,) about its
    centre

    angular_rad_s None = the robot holds the orientation that was commanded last. If given, it is sent unchanged: the
    caller then closes the loop over the measured orientation."""

    linear_m_s: FloatArray
    angular_rad_s: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class JointRates:
    """rates_deg_s: (n,) rates of the joints, in the driver's order and sense [deg/s]"""

    rates_deg_s: FloatArray


Command = TipVelocity | JointRates | None


Waits = Callable[[int], None]
"""Lets time pass until a moment of the clock [ns]."""


def sleep_until(until_ns: int) -> None:
    """Let the host's time pass, for devices with threads of their own."""
    time.sleep(max(0.0, (until_ns - monotonic_ns()) / 1e9))


class Robot:
    """Opened devices, their relative poses, and a supervisor; `cycle` is one control period.

    The arm is sent only joint rates (`motion`), computed in each period for its present joint angles.

    commanded: speed of the tip's centre [m/s] of every period
    reason_to_stand: called in each period with motion: a reason against it, empty = none
    rotation: commanded rotation of the arm's end; moving: a velocity was sent in this period
    share: sent part of the tip's last requested velocity: less near joint limits and singularities; nan for joints"""

    def __init__(
        self,
        arm: Arm[Any],
        force: ForceSensor,
        placement: Placement,
        limits: Limits,
        *,
        camera: Device[DepthImage] | None = None,
        clock: Clock = monotonic_ns,
        wait_until: Waits = sleep_until,
        watch: Watch | None = None,
        compliance_m_per_n: float = 0.0,
        doubt_m: float = 0.0,
    ) -> None:
        """watch: called with the readings and the verdict of each period, for a recording; if it fails, the arm halts
        first

        compliance_m_per_n: compliance of arm and stick under a push, 0 = not known; doubt_m: uncertainty of the
        camera's place, where the surface is"""
        self.compliance_m_per_n, self.doubt_m = compliance_m_per_n, doubt_m
        self.arm, self.force, self.camera = arm, force, camera
        self.placement = placement
        self._clock, self._wait_until, self.watch = clock, wait_until, watch
        self._forces = force.readings()
        self._states = arm.readings()
        self._pictures = camera.readings() if camera is not None else None
        self.tare_n: FloatArray = np.zeros(3)
        self.camera_needed = False
        self.reason_to_stand: Callable[[], str] = lambda: ""
        self._may_move = False
        self._judged_ns = array("q")
        self.commanded = array("d")
        self.seen = RobotObservation(clock())
        self._pose: ArmSample | None = None
        self._first_weight_n: FloatArray | None = None
        self._force: ForceSample | None = None
        self._speed_m_s = 0.0
        self._angular_rad_s: FloatArray = np.zeros(3)
        self._follows = self.moving = False
        self.share = 1.0
        self.rotation = CommandedRotation()
        self._turned_ns = clock()
        self._refusal: tuple[Fault, str] | None = None
        self._next_ns = clock()
        chain = self.chain
        self.clearance = None if chain is None else ArmClearance(placement, chain.forward(chain.home_deg))
        self.supervisor = Supervisor(
            limits, clock(), placement.T_ee_center, chain, by_hand=arm.by_hand, clearance=self.clearance
        )

    # What is known ---------------------------------------------------------------------------------------------------

    @property
    def chain(self) -> Chain | None:
        """The arm's joints; None if a person places it."""
        return None if self.arm.by_hand else self.arm.chain

    @property
    def force_alone(self) -> bool:
        """Whether only the force at the tip shows a contact: the arm has reported no joint torques."""
        return not (self.arm.by_hand or self.supervisor.sees_torques)

    @property
    def arm_seen(self) -> bool:
        """Whether the arm has reported its pose."""
        return self._pose is not None

    @property
    def pose(self) -> ArmSample:
        """The newest state of the arm. Raises RuntimeError before the first."""
        if self._pose is None:
            raise RuntimeError("no state of the arm yet: cycle() first")
        return self._pose

    @property
    def center_m(self) -> FloatArray:
        """(3,) present place of the tip's centre in the surface frame [m]."""
        return self.placement.T_surface_center(self.pose.T_base_ee)[:3, 3]

    @property
    def pressed_n(self) -> float | None:
        """Magnitude of the newest force on the tip [N]; None if the sensor is silent, frozen or not usable."""
        sample = self._force
        age_ns = np.inf if sample is None else self._clock() - sample.time_ns
        silent = self.supervisor.verdict.fault in FORCE_FAULTS or age_ns > 1e9 * self.supervisor.limits.force_silent_s
        return None if silent or sample is None else float(np.linalg.norm(sample.force_n))

    def force_on_tip_n(self, sample: ForceSample, pose: ArmSample | None = None) -> FloatArray:
        """(3,) force of the world on the tip, surface frame [N]. pose: the arm's then, None = newest"""
        return self.placement.force_on_tip_n(sample.force_n, (pose or self.pose).T_base_ee)

    # The control period ----------------------------------------------------------------------------------------------

    def cycle(self, command: Command = None) -> RobotObservation:
        """Send a velocity (None = rest), let a control period pass, read the devices, and ask the supervisor.

        Raises MotionHeld if `reason_to_stand` gave a reason: no command was sent, and the arm rested for the period.
        Raises RobotStopped, now and after every later call until the supervisor's `acknowledge`, when the robot must
        stop. The arm is then halted and its waiting points are erased. The caller carries out a back-off."""
        if self.supervisor.verdict.action is Action.STOP:
            raise RobotStopped(self.supervisor.verdict)
        if command is not None and not self._may_move:
            raise InputError("a preflight that passed", "none", "let_move(check(robot, ...))")
        going_on = self.supervisor.verdict.action is Action.GO_ON  # away from a force it may go, whoever watches
        held = self.reason_to_stand() if command is not None and going_on else ""
        self._send(None if held else command)
        now_ns = self._clock()
        # A period that came late is not made up for.
        self._next_ns = max(self._next_ns + PERIOD_NS, now_ns + PERIOD_NS // 2)
        self._wait_until(self._next_ns)
        self.seen = self._look()
        self._turn_on()
        before = self.supervisor.verdict.action
        verdict = self.supervisor.judge(
            self.seen,
            commanded_m_s=self._speed_m_s,
            commanded_rotation=self.rotation.rotation,
            camera_needed=self.camera_needed and self.camera is not None,
        )
        self._judged_ns.append(self.seen.now_ns)
        if self._refusal is not None:  # unless a fault was seen that is the reason of it
            verdict = self.supervisor.stop(*self._refusal, self._clock())
        self._report_to_watch(verdict)
        verdict = self.supervisor.verdict  # whoever watches may have asked to stop
        if verdict.action is Action.STOP:
            self.halt(f"{verdict.fault}: {verdict.reason}")
            raise RobotStopped(verdict)
        if verdict.action is Action.BACK_OFF and before is Action.GO_ON:
            self._speed_m_s = 0.0
            with contextlib.suppress(DeviceError):
                self.arm.stop()
        if held:
            raise MotionHeld(held)
        return self.seen

    def look_on(self) -> SafetyDecision:
        """Judge readings since the last call, as those of an arm at rest; nothing is sent, and the caller stops it."""
        self.seen = self._look()
        self._turn_on()
        return self.supervisor.judge(self.seen, commanded_rotation=self.rotation.rotation)

    def keep_up(self) -> None:
        """Stay at rest for a control period if one is due: for calls from long computations on a host's clock. With a
        simulated robot no time passes meanwhile, so that no control period is due."""
        if self._clock() >= self._next_ns + PERIOD_NS // 2:
            self.cycle()

    def ask_to_stop(self, reason: str) -> None:
        """Stop on a person's request, within this control period or the next one."""
        self.supervisor.stop(Fault.ASKED, reason, self._clock())

    def stand_by(self, duration_s: float) -> None:
        """Rest, stopped or not, so that a recording shows the time after. The verdict is unchanged."""
        end_ns = self._clock() + round(duration_s * 1e9)
        while (now_ns := self._clock()) < end_ns:
            self._wait_until(min(now_ns + PERIOD_NS, end_ns))
            self.seen = self._look()
            self._report_to_watch(self.supervisor.verdict)

    def halt(self, reason: str) -> bool:
        """Erase points that wait in the arm and refuse commands until `arm.acknowledge_stop`. Returns whether the arm
        received it: otherwise at most two velocities wait in the arm, and are erased on reconnection."""
        self._speed_m_s = 0.0
        self.commanded.append(0.0)
        try:
            self.arm.halt(reason)
        except DeviceError:
            return False
        return True

    def stop_for(self, fault: Fault, reason: str) -> None:
        """Halt the arm for a fault that the supervisor does not see. Raises RobotStopped."""
        verdict = self.supervisor.stop(fault, reason, self._clock())
        self.halt(f"{fault}: {reason}")
        raise RobotStopped(verdict)

    def let_move(self, preflight: Preflight) -> None:
        """From now on velocities are sent. Raises InputError, which names the checks, unless all have passed."""
        if not preflight.passed:
            failed = "; ".join(f"{check.name}: {check.came}" for check in preflight.checks if not check.passed)
            raise InputError("a preflight that passed", failed, "remove the cause, and check again")
        self._may_move = True
        del self._judged_ns[:]

    @property
    def may_move(self) -> bool:
        """Whether velocities are sent."""
        return self._may_move

    @property
    def gaps_s(self) -> FloatArray:
        """(n,) times from one judgement of the supervisor to the next since the robot may move [s]."""
        return np.diff(1e-9 * np.array(self._judged_ns, dtype=np.float64))

    def resume(self) -> None:
        """After a person has removed the reason of a stop: judge again; the arm accepts commands after a preflight."""
        self._may_move = False
        self.arm.acknowledge_stop()
        self._listen()
        self._begin_anew()
        self.supervisor.acknowledge(self._clock())

    def start(self) -> None:
        """Start after a pause without control periods: drop waiting items of the queues; ages count from now on."""
        self._listen()
        self._begin_anew()
        self.supervisor.start(self._clock())

    def rest(self) -> None:
        """Close the devices' queues, which would overflow during a computation or a question, until `start`."""
        for queue in (self._forces, self._states, self._pictures):
            if queue is not None:
                queue.close()

    # Within ----------------------------------------------------------------------------------------------------------

    def _report_to_watch(self, verdict: SafetyDecision) -> None:
        """Call `watch`; where it fails, as when a recording cannot be written, halt the arm and raise its error."""
        if self.watch is None:
            return
        try:
            self.watch(self.seen, verdict)
        except BaseException as error:
            self.halt(f"its monitor failed: {type(error).__name__}")
            raise

    def _begin_anew(self) -> None:
        """The next measured rotation of the arm's end becomes the commanded one; no period is overdue."""
        self._next_ns = self._turned_ns = self._clock()
        self.rotation = CommandedRotation()

    def _turn_on(self) -> None:
        """Advance the commanded rotation by the time since the last call, at most as long as a velocity is valid."""
        now_ns = self._clock()
        seconds = min(now_ns - self._turned_ns, VALID_PERIODS * PERIOD_NS) / 1e9
        self._turned_ns = now_ns
        seen = self.seen.arms[-1].T_base_ee[:3, :3] if self.seen.arms else None
        measured = seen if seen is not None and np.all(np.isfinite(seen)) else None
        self.rotation.advance(self._angular_rad_s, seconds, measured, follows=self._follows)

    def _send(self, command: Command) -> None:
        moving, self.moving = self.moving, False
        self._speed_m_s, self._angular_rad_s, self._follows, self._refusal = 0.0, np.zeros(3), False, None
        try:
            if isinstance(command, TipVelocity):
                self._send_tip(command)
            elif isinstance(command, JointRates):
                self._send_joints(command)
            elif moving:
                self.arm.stop()
        except DeviceError as error:
            # What the driver refuses stops the robot too: nobody goes on as if it had been done.
            self._refuse(Fault.REFUSED, str(error))
        self.commanded.append(self._speed_m_s)

    def _refuse(self, fault: Fault, reason: str) -> None:
        """Halt the arm for a command refused by its driver (REFUSED) or unsent (JOINT_LIMIT, SINGULAR)."""
        self._refusal = fault, reason
        self.halt(f"{fault}: {reason}")

    def _send_tip(self, command: TipVelocity) -> None:
        pose, limits = self.pose.T_base_ee, self.arm.speed_limits
        linear = self.placement.to_base(command.linear_m_s)
        turned = np.zeros(3)
        if command.angular_rad_s is not None:
            turned = angular = self.placement.to_base(command.angular_rad_s)
        else:
            angular = self.rotation.back_rad_s(pose[:3, :3])
        # The joints are given the velocity of the arm's end; the tip turns about its own centre.
        linear = linear - cross(angular, pose[:3, :3] @ self.placement.T_ee_center[:3, 3])
        share = min(1.0, _share(linear, limits.linear_limit_m_s), _share(angular, limits.angular_limit_rad_s))
        motion = rates_for_twist(
            self.arm.chain,
            self.pose.joints_deg,
            share * np.concatenate([linear, angular]),
            self.arm.joint_limits_deg_s,
            self.supervisor.limits.joint_margin_deg,
        )
        if self._sent(motion):
            self.share = share = share * motion.share
            self._speed_m_s = share * float(np.linalg.norm(command.linear_m_s))
            self._angular_rad_s, self._follows = share * turned, command.angular_rad_s is not None

    def _send_joints(self, command: JointRates) -> None:
        chain, limits, joints_deg = self.arm.chain, self.supervisor.limits, self.pose.joints_deg
        twist = chain.jacobian(joints_deg) @ np.radians(command.rates_deg_s)
        lever_m = self.pose.T_base_ee[:3, :3] @ self.placement.T_ee_center[:3, 3]
        center_m_s, angular = twist[:3] + cross(twist[3:], lever_m), twist[3:]
        # half of what the supervisor stops at, as tip velocities keep to
        share = min(
            1.0, _share(center_m_s, 0.5 * limits.speed_m_s), _share(angular, 0.5 * np.radians(limits.turn_deg_s))
        )
        motion = within_limits(
            chain,
            joints_deg,
            share * np.asarray(command.rates_deg_s, dtype=float),
            self.arm.joint_limits_deg_s,
            limits.joint_margin_deg,
        )
        if self._sent(motion):
            share *= motion.share
            self.share = float("nan")
            self._speed_m_s = share * float(np.linalg.norm(center_m_s))
            self._angular_rad_s, self._follows = share * angular, True

    def _sent(self, motion: JointMotion) -> bool:
        """Send joint rates; False, and the arm is halted, where they must not be sent."""
        if motion.fault is not Fault.NONE:
            self._refuse(motion.fault, motion.reason)
            return False
        self.arm.set_velocity(JointVelocity(tuple(map(float, motion.rates_deg_s))), VALID_PERIODS * PERIOD_NS / 1e9)
        self.moving = True
        return True

    def _look(self) -> RobotObservation:
        forces: list[ForceReading] = taken(self._forces)
        states: list[ArmState] = taken(self._states)
        pictures: list[DepthImage] = taken(self._pictures) if self._pictures is not None else []
        arms = tuple(map(ArmSample.of, states))
        if arms:
            self._pose = arms[-1]
        free_n = self.tare_n + self._turned_weight_n()
        samples = tuple(ForceSample.of(reading, free_n) for reading in forces)
        if samples:
            self._force = samples[-1]
        return RobotObservation(
            self._clock(),
            samples,
            arms,
            tuple(CameraSample(picture.stamp.host_ns, fingerprint(picture.depth)) for picture in pictures),
            self.force.damaged,
            tuple(
                (name, device.health().reason or str(device.link))
                for name, device in (("arm", self.arm), ("force sensor", self.force), ("camera", self.camera))
                if device is not None and device.link is not Link.CONNECTED
            ),
        )

    def _turned_weight_n(self) -> FloatArray:
        """(3,) change of the tool's weight in the sensor's readings since the arm was first seen, which is in the
        tare [N]."""
        if self._pose is None or self.placement.tool.weight_n is None:
            return np.zeros(3)
        weight_n = self.placement.weight_on_sensor_n(self._pose.T_base_ee)
        if self._first_weight_n is None:
            self._first_weight_n = weight_n
        return weight_n - self._first_weight_n

    def _listen(self) -> None:
        """Open new, empty queues of the devices; a device that has ended gives none, and its link reports that."""
        self.rest()
        with contextlib.suppress(DeviceError):
            self._forces = self.force.readings()
        with contextlib.suppress(DeviceError):
            self._states = self.arm.readings()
        with contextlib.suppress(DeviceError):
            self._pictures = self.camera.readings() if self.camera is not None else None


def taken(queue: Any) -> list[Any]:
    """The items that wait in a device's queue; none of a failed device, whose link reports the failure."""
    try:
        return list(queue.take())
    except DeviceError:
        return []


def _share(vector: FloatArray, most: float) -> float:
    """The factor that brings a vector (3,) to a length; above 1 where it is shorter."""
    return most / max(float(np.linalg.norm(vector)), 1e-12)
