"""An arm as a device: the interface that the robot, its travel, its preflight and an exploration use.

A velocity holds only as long as its sender renews it. Each driver brings its arm to rest then, which the contract tests
check (`tests/drivers/arm`).

The possible velocities of an arm, checked before anything is sent."""

import atexit
import math
import threading
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Device, Reconnect
from deformscope_drivers.errors import DeviceError, LinkLost, MotionStopped, NotMovedByCommands, NotStopped, OutOfLimits
from deformscope_drivers.health import Description, Link

Vector3 = tuple[float, float, float]
JOINT_MARGIN_DEG, NEGLIGIBLE_DEG_S = 5.0, 0.01
"""Least distance of a joint from its range's end [deg]; slower than this [deg/s] it is at rest: 1e-4 deg in 10 ms."""
DAMPED_BELOW = 0.03
"""Smallest singular value of the Jacobian [m/rad; rad/rad] that is inverted in full. Above it, joints at 20 deg/s (the
driver's standard limit) move the arm's end by at least 0.03 * 0.35 rad/s = 10 mm/s, the speed of a touch, in every
direction. Below it the weakest direction is slower than any touch, and damped."""
OFF_COURSE = 0.1
"""Share of a velocity that damping may lose or turn away: a straight line may lead through a singularity if it does not
need the weak direction."""


class SpeedLimits(Protocol):
    """Speed limits of an arm's commands; its configuration has them.

    linear_limit_m_s, angular_limit_rad_s: largest speeds of the end effector; joint_limit_deg_s: joint
    limit of any joint, whose own limit holds besides; command_deadline_s: default duration of a velocity"""

    @property
    def linear_limit_m_s(self) -> float: ...

    @property
    def angular_limit_rad_s(self) -> float: ...

    @property
    def joint_limit_deg_s(self) -> float: ...

    @property
    def command_deadline_s(self) -> float: ...


@dataclass(frozen=True, slots=True)
class CartesianVelocity:
    """Velocity of the end effector as the arm takes it, in two frames.

    linear_m_s: (3,) velocity in the base frame; angular_rad_s: (3,) about the axes of the end effector's own frame,
    which turn with it (Kinova's staff, kinova-ros issues 154 and 192; ViSP's driver agrees). `in_base` converts."""

    linear_m_s: Vector3
    angular_rad_s: Vector3 = (0.0, 0.0, 0.0)

    @classmethod
    def in_base(
        cls, linear_m_s: npt.ArrayLike, angular_rad_s: npt.ArrayLike, T_base_end_effector: npt.ArrayLike
    ) -> "CartesianVelocity":
        """The same for a velocity (3,) and an angular velocity (3,) that are both in the base frame.
        T_base_end_effector: (4, 4) present pose of the end effector: convert again when it turns"""
        rotation = np.asarray(T_base_end_effector, dtype=float)[:3, :3]
        x, y, z = (float(value) for value in np.asarray(linear_m_s, dtype=float))
        about_x, about_y, about_z = (float(value) for value in rotation.T @ np.asarray(angular_rad_s, dtype=float))
        return cls((x, y, z), (about_x, about_y, about_z))


@dataclass(frozen=True, slots=True)
class JointVelocity:
    """rates_deg_s: (n,) a rate for each joint [deg/s]."""

    rates_deg_s: tuple[float, ...]


Velocity = CartesianVelocity | JointVelocity


def check_velocity(velocity: Velocity, chain: Chain, limits: SpeedLimits, where: str) -> None:
    """Raise OutOfLimits unless every number is finite and no speed is above the configured limit."""
    if isinstance(velocity, JointVelocity):
        rates = finite("joint rates", velocity.rates_deg_s, chain.joint_count, where)
        for joint, (rate, limit) in enumerate(zip(rates, joint_limits_deg_s(chain, limits), strict=True), 1):
            _at_most(f"rate of joint {joint}", abs(rate), float(limit), "deg/s", "joint_limit_deg_s", where)
        return
    linear = finite("linear velocity", velocity.linear_m_s, 3, where)
    angular = finite("angular velocity", velocity.angular_rad_s, 3, where)
    _at_most("linear speed", math.hypot(*linear), limits.linear_limit_m_s, "m/s", "linear_limit_m_s", where)
    _at_most("angular speed", math.hypot(*angular), limits.angular_limit_rad_s, "rad/s", "angular_limit_rad_s", where)


def joint_limits_deg_s(chain: Chain, limits: SpeedLimits) -> FloatArray:
    """(n,) the greatest rate of each joint that a command may ask for [deg/s]: as configured, never beyond its own."""
    return np.minimum(chain.velocity_deg_s, limits.joint_limit_deg_s)


def by_joints(
    velocity: Velocity, chain: Chain, limits: SpeedLimits, joints_deg: Sequence[float]
) -> JointVelocity | str:
    """The joint rates of a velocity at these joint angles (n,) [deg], or why there are none.

    No arm is sent Cartesian velocities: their behaviour near limits and singularities is not published. Therefore this
    function has the guards. No joint exceeds its limit (all are slowed by the same factor), or comes within
    JOINT_MARGIN_DEG of the end of its range. If damping near a singularity would move the hand off its path, there is
    no motion. Self-collision is not checked."""
    if isinstance(velocity, JointVelocity):
        return velocity
    if not all(map(math.isfinite, joints_deg)):
        return "the joint angles that the arm reports are not numbers"
    joints, links = np.asarray(joints_deg), chain.forward(joints_deg)
    jacobian = kinematics.jacobian_of(links)
    twist = np.concatenate([velocity.linear_m_s, links[-1, :3, :3] @ velocity.angular_rad_s])
    rates_rad_s = kinematics.damped_joint_rates(jacobian, twist, DAMPED_BELOW)
    lost = float(kinematics.off_course(jacobian, rates_rad_s, twist))
    if lost > OFF_COURSE:
        return f"the hand would have left its path by {100 * lost:.0f} %: a singularity is near"
    rates_deg_s = np.degrees(rates_rad_s)
    way_deg = np.where(rates_deg_s > 0, chain.upper_deg - joints, joints - chain.lower_deg)
    near = (way_deg < JOINT_MARGIN_DEG) & (np.abs(rates_deg_s) > NEGLIGIBLE_DEG_S)
    if near.any():
        joint = int(np.argmax(near))
        return f"joint {joint + 1} at {joints[joint]:.1f} deg was within {JOINT_MARGIN_DEG:g} deg of its limit"
    fastest = max(1.0, float(np.max(np.abs(rates_deg_s) / joint_limits_deg_s(chain, limits))))
    return JointVelocity(tuple(float(rate) for rate in rates_deg_s / fastest))


def linear_velocity_of(velocity: Velocity, chain: Chain, joints_deg: Sequence[float]) -> Vector3:
    """Velocity of the end effector in the base frame (3,) [m/s] that a command means at these joint angles."""
    if isinstance(velocity, CartesianVelocity):
        return velocity.linear_m_s
    x, y, z = (chain.jacobian(joints_deg) @ np.radians(velocity.rates_deg_s))[:3]
    return float(x), float(y), float(z)


def finite(what: str, values: Sequence[float], count: int, where: str) -> tuple[float, ...]:
    """The values as floats; raises OutOfLimits unless there are that many and all are finite."""
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise OutOfLimits(f"{count} finite {what}", f"{numbers}", "", where)
    return numbers


def _at_most(what: str, value: float, limit: float, unit: str, setting: str, where: str) -> None:
    if value > limit * (1 + 1e-9):
        raise OutOfLimits(f"{what} up to {limit:g} {unit}", f"{value:.4g}", f"slower, or a higher {setting}", where)


# The state that an arm reports

UNKNOWN = (float("nan"),) * 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmState:
    """The state of an arm of n joints at one time; n = 0 for one that a person places.

    stamp: when the joint angles had been read
    joints_deg: (n,) joint angles as the arm counts them, beyond 360 for joints that turn without end
    rates_deg_s: (n,) joint rates; torques_nm: (n,) joint torques without those of gravity, empty where not known
    position_m: (3,) position of the end effector in the base frame
    theta_rad: (3,) its rotation about x, the new y, the new z; wrench: (6,) force [N] and torque [Nm] at the end
    effector as the arm estimates them, in the base frame; nan = not known
    fingers: fingers of a gripper, 0 open to 1 closed; fifo_count: points that wait in the arm
    currents: (n,) currents of the joints' motors, in the units of the arm's controller, empty where not known"""

    stamp: Stamp
    joints_deg: tuple[float, ...]
    rates_deg_s: tuple[float, ...]
    position_m: tuple[float, float, float]
    theta_rad: tuple[float, float, float]
    torques_nm: tuple[float, ...] = ()
    wrench: tuple[float, float, float, float, float, float] = UNKNOWN
    fingers: tuple[float, ...] = ()
    fifo_count: int = 0
    currents: tuple[float, ...] = ()

    @property
    def T_base_end_effector(self) -> FloatArray:
        """Pose of the end effector, (4, 4) [m]."""
        return kinematics.transform(kinematics.rotation_from_euler_xyz(*self.theta_rad), self.position_m)


LONGEST_S = 60.0
"""Longest duration of a velocity; a longer motion sets it again."""
CALL_MS = "call_ms"
"""In `Health.extra`: duration of a call to the arm [ms], for arms that answer calls."""

StateT = TypeVar("StateT", bound=ArmState)


@dataclass(frozen=True, slots=True)
class Streamed:
    """A velocity that is sent in every cycle until it expires. since_ns: when the arm began to move, with this velocity
    or one that it replaced"""

    velocity: Velocity
    expires_ns: int
    since_ns: int


class Arm(Device[StateT]):
    """An arm; a subclass gives `config`, `chain`, `stop`, `halt`, and carries out `_streamed`.

    config: with `state_hz` and, for an arm that takes velocities, what `SpeedLimits` has
    by_hand: a person places it: it has no joints that are known, and takes no velocities
    goes_home: whether the arm has a stored home pose, to which `home` sends it
    stop_by_hand: how a person stops it where its driver could not
    still: opening must not move it, as after its process was lost while the tip may have pressed something"""

    prompt = True
    by_hand: ClassVar[bool] = False
    goes_home: bool = False
    still: bool = False
    stop_by_hand: ClassVar[str] = "the emergency stop"
    config: Any

    def __init__(self, name: str, *, reconnect: Reconnect | None = RECONNECT, clock: Clock = monotonic_ns) -> None:
        super().__init__(name, reconnect=reconnect, clock=clock)
        self._commanded = threading.Lock()
        self._streamed: Streamed | None = None
        self._stopped = ""
        self._not_stopped: DeviceError | None = None

    def open(self, *, own_thread: bool = True) -> Self:
        if not self.is_open:
            self._stopped, self._not_stopped = "", None
        super().open(own_thread=own_thread)
        atexit.register(self.close)  # a program that ends without closing must not leave the arm moving
        return self

    def close(self) -> None:
        """Stop the arm, and close the link. Closing twice is nothing. Raises NotStopped where it was moving and could
        not be stopped."""
        super().close()
        atexit.unregister(self.close)  # not before: one that hangs is to be tried again at the end
        error, self._not_stopped = self._not_stopped, None
        if error is not None:
            raise NotStopped("an arm that is stopped when it closes", str(error), self.stop_by_hand, self.name)

    # What is known of it ---------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def chain(self) -> Chain:
        """Its kinematics, with the joints' ranges and speeds. Raises DeviceError where they are not known."""

    @property
    def speed_limits(self) -> SpeedLimits:
        """Speed limits of its commands, by its configuration."""
        limits: SpeedLimits = self.config
        return limits

    @property
    def state_hz(self) -> float:
        """Rate of its reports, by its configuration."""
        hz: float = self.config.state_hz
        return hz

    @property
    def joint_limits_deg_s(self) -> FloatArray:
        """(n,) the greatest rate of each joint that a command may ask for [deg/s]."""
        return joint_limits_deg_s(self.chain, self.speed_limits)

    @property
    def urdf(self) -> Path | None:
        """The URDF file that describes the arm for viewers, or None."""
        return None

    def describe(self) -> Description:
        return Description(self.state_hz, urdf=self.urdf)

    @property
    def homed(self) -> bool:
        """Whether it is ready to follow commands since it was switched on."""
        return True

    # Motion ----------------------------------------------------------------------------------------------------------

    def set_velocity(self, velocity: Velocity, valid_for_s: float | None = None) -> None:
        """Move at a velocity from the next cycle until it expires. Returns at once.

        velocity: CartesianVelocity, translation in the base frame and rotation in the end effector's, sent as joint
        rates for the joints' angles in each cycle; or JointVelocity [deg/s]
        valid_for_s: after this it expires unless set again (default: the configured deadline). Raises OutOfLimits
        (nothing is sent, the earlier one holds), MotionStopped for a stopped arm, and other errors of its driver."""
        self._require_open()
        check_velocity(velocity, self.chain, self.speed_limits, self.name)
        valid_s = self.speed_limits.command_deadline_s if valid_for_s is None else valid_for_s
        if not 0.0 < valid_s <= LONGEST_S:
            raise OutOfLimits(f"valid_for_s above 0 and up to {LONGEST_S:g}", f"{valid_s!r}", "refresh it", self.name)
        with self._commanded:
            self._require_moves()
            self._require_ready()
            now_ns = self._clock()
            since_ns = now_ns if self._streamed is None else self._streamed.since_ns
            self._streamed = Streamed(velocity, now_ns + round(valid_s * 1e9), since_ns)

    @abstractmethod
    def stop(self) -> None:
        """Stop at once. Raises where that did not reach the arm.

        The next command moves it again, whoever gives it; use `halt` to keep it stopped."""

    @abstractmethod
    def halt(self, reason: str) -> None:
        """Stop at once, and refuse the commands of all threads until `acknowledge_stop`. Raises as `stop` does."""

    def home(self, timeout_s: float = 60.0) -> ArmState:
        """Send the arm to its own home pose and wait until it is there; its state then. Raises NotMovedByCommands where
        `goes_home` is False, MotionStopped where it was stopped on its way; on any exception the arm is stopped."""
        raise NotMovedByCommands(
            "an arm with a home pose of its own", "one without", "bring it there by hand", self.name
        )

    @property
    def stopped_because(self) -> str:
        """Why the arm was stopped and commands are refused; empty where they are not."""
        return self._stopped

    def acknowledge_stop(self) -> None:
        """Take note that the arm was stopped: commands are accepted again."""
        self._stopped = ""

    # For subclasses --------------------------------------------------------------------------------------------------

    def _require_ready(self) -> None:
        """Raises for other states in which this arm takes no velocity."""

    def _require_moves(self) -> None:
        self._require_open()
        if self._stopped:
            raise MotionStopped(
                "an arm that may move", f"one that was stopped: {self._stopped}", "acknowledge_stop()", self.name
            )
        if self.link is not Link.CONNECTED:
            raise LinkLost("an arm that is connected", f"link {self.link}", "wait until it is back", self.name)
