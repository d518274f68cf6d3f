"""The state that an arm reports."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.clock import Stamp

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
    fingers: fingers of a gripper, as its driver says; fifo_count: points that wait in the arm
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
