"""An arm that a person places: it is where they have confirmed that it is, and reports that until they say otherwise.

Nothing is measured here: `place` takes the values that a person reads from a scale. No command moves the arm."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.device import Arm, ArmState, SpeedLimits, Velocity
from deformscope_drivers.clock import Clock, Stamp, monotonic_ns
from deformscope_drivers.device import Reconnect
from deformscope_drivers.errors import MotionStopped, NotMovedByCommands, OutOfLimits
from deformscope_drivers.health import Identity
from deformscope_drivers.pacing import Pacer

MANUAL = "placed"
"""Model of an arm that a person places: it has no joints that are known."""


@dataclass(frozen=True, slots=True)
class ManualArmConfig:
    """Settings of an arm without an interface.

    start_m: (3,) initial place of the stick's mount, in the frame that `T_arm_surface` relates to the surface;
    theta_rad: its rotation about x, the new y, the new z; default: its z axis, along the stick, points down
    resolution_m: finest step of its scale; no finer one is requested of a person
    state_hz: how often the pose is reported again"""

    start_m: tuple[float, float, float]
    theta_rad: tuple[float, float, float] = (math.pi, 0.0, 0.0)
    resolution_m: float = 1e-4
    state_hz: float = 50.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.start_m, *self.theta_rad))):
            raise ValueError(f"expected a finite start_m and theta_rad; came {self.start_m}, {self.theta_rad}")
        if not 1e-6 <= self.resolution_m <= 1e-3:
            raise ValueError(f"expected resolution_m from 1e-6 to 1e-3; came {self.resolution_m!r}")
        if not 5.0 <= self.state_hz <= 100.0:
            raise ValueError(f"expected state_hz from 5 to 100; came {self.state_hz!r}")


class ManualArm(Arm[ArmState]):
    """`with ManualArm(ManualArmConfig(start_m=(0.3, 0.2, 0.3))) as arm:`, then `arm.place(T_base_end_effector)`."""

    by_hand = True

    def __init__(
        self, config: ManualArmConfig, *, reconnect: Reconnect | None = None, clock: Clock = monotonic_ns
    ) -> None:
        self.config = config
        super().__init__("arm placed by hand", reconnect=reconnect, clock=clock)
        self._waiting = Pacer(clock)
        self._period_ns = round(1e9 / config.state_hz)
        self._next_ns = 0
        self._pose = kinematics.transform(kinematics.rotation_from_euler_xyz(*config.theta_rad), config.start_m)

    @property
    def chain(self) -> kinematics.Chain:
        raise self._no_commands("an arm with known joints")

    @property
    def speed_limits(self) -> SpeedLimits:
        raise self._no_commands("an arm that moves on commands")

    @property
    def T_base_end_effector(self) -> kinematics.FloatArray:
        """(4, 4) where it was placed last [m]."""
        with self._commanded:
            return self._pose.copy()

    def identity(self) -> Identity:
        return Identity(MANUAL)

    def place(self, T_base_end_effector: npt.ArrayLike) -> None:
        """A person has put it there: (4, 4) [m]. Raises OutOfLimits for an invalid pose, MotionStopped after `halt`."""
        self._require_open()
        pose = np.asarray(T_base_end_effector, dtype=float)
        rigid = pose.shape == (4, 4) and np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-6)
        if not (rigid and np.all(np.isfinite(pose))):
            raise OutOfLimits("a rigid pose (4, 4)", f"{pose.tolist()}", "", self.name)
        with self._commanded:
            if self._stopped:
                raise MotionStopped("an arm that may be placed", self._stopped, "acknowledge_stop()", self.name)
            self._pose = pose.copy()

    def set_velocity(self, velocity: Velocity, valid_for_s: float | None = None) -> None:
        """Raises NotMovedByCommands."""
        raise self._no_commands("an arm that moves on commands")

    def stop(self) -> None:
        """Does nothing: the arm does not move without a person. Raises NotConnected if it is not open."""
        self._require_open()

    def halt(self, reason: str) -> None:
        self._require_open()
        with self._commanded:
            self._stopped = self._stopped or reason or "by command"

    # Run by the device's own thread ----------------------------------------------------------------------------------

    def _connect(self) -> None:
        self._expect(self.config.state_hz)
        self._next_ns = self._clock()

    def _disconnect(self) -> None:
        return

    def _wake(self) -> None:
        self._waiting.wake()

    def _receive(self, timeout_s: float) -> Iterable[ArmState]:
        if not self._waiting.wait_until(self._next_ns, timeout_s):
            return ()
        now_ns = self._clock()
        self._next_ns += ((now_ns - self._next_ns) // self._period_ns + 1) * self._period_ns
        with self._commanded:
            pose = self._pose
        x, y, z = (float(value) for value in pose[:3, 3])
        theta_x, theta_y, theta_z = (float(value) for value in kinematics.euler_xyz_from_rotation(pose[:3, :3]))
        return (
            ArmState(
                stamp=Stamp(now_ns),
                joints_deg=(),
                rates_deg_s=(),
                position_m=(x, y, z),
                theta_rad=(theta_x, theta_y, theta_z),
            ),
        )

    def _no_commands(self, wanted: str) -> NotMovedByCommands:
        return NotMovedByCommands(wanted, "one that a person places", "place() it", self.name)


class StandDouble:
    """A simulated stand with a stick. T_base_end_effector: (4, 4) true pose of the stick's mount [m], base frame"""

    def __init__(self, T_base_end_effector: npt.ArrayLike) -> None:
        self.put(T_base_end_effector)

    def put(self, T_base_end_effector: npt.ArrayLike) -> None:
        """A person places the end effector at this pose (4, 4) in the base frame [m]."""
        self.T_base_end_effector: kinematics.FloatArray = np.array(T_base_end_effector, dtype=float)

    @property
    def T_base_links(self) -> kinematics.FloatArray:
        """(1, 4, 4) pose of its end, the only one that is known."""
        return self.T_base_end_effector[None]

    def push(self, wrench: npt.ArrayLike) -> None:
        """Push the arm, which is rigid; compliance is not visible on a scale either."""
