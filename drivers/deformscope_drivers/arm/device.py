"""An arm as a device: the interface that the robot, its travel, its preflight and an exploration use.

A velocity holds only as long as its sender renews it. Each driver brings its arm to rest then, which the contract tests
check (`tests/drivers/arm`)."""

import atexit
import threading
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from deformscope_drivers.arm import commands, kinematics
from deformscope_drivers.arm.commands import SpeedLimits, Velocity
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import RECONNECT, Device, Reconnect
from deformscope_drivers.errors import DeviceError, LinkLost, MotionStopped, NotMovedByCommands, NotStopped, OutOfLimits
from deformscope_drivers.health import Description, Link

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
        return commands.joint_limits_deg_s(self.chain, self.speed_limits)

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
        commands.check_velocity(velocity, self.chain, self.speed_limits, self.name)
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
