"""What the arm says of itself."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope_drivers.clock import Stamp
from deformscope_drivers.jaco import kinematics
from deformscope_drivers.jaco.kinematics import FloatArray


@dataclass(frozen=True, slots=True)
class JacoState:
    """One look at the arm; n joints (a six-joint arm has six values, never a seventh that means nothing).

    stamp: when the joint angles had been read; sweep_s: how much older wrench, torques, currents and fifo_count may be
    joints_deg: (n,) joint angles as the arm counts them, beyond 360 for joints that turn without end
    rates_deg_s: (n,) joint rates, from the angles of the last 40 ms
    torques_nm: (n,) joint torques without those of gravity; currents_a: (n,)
    position_m: (3,) of the end effector in the base frame, from the angles
    theta_rad: (3,) its rotation about x, the new y, the new z
    wrench: (6,) force [N] and torque [Nm] at the end effector, in the base frame: the joints' torque sensors drift, so
    that some newtons are shown where nothing touches; its direction was never verified on an arm
    fingers: (3,) from 0 open to 6800 closed; fifo_count: trajectory points that wait in the arm
    supply_v, supply_a: its main supply; temperatures_deg_c: (n,) of the joints; homed: whether it was at home since it
    was switched on; these are read once a second
    """

    stamp: Stamp
    sweep_s: float
    joints_deg: tuple[float, ...]
    rates_deg_s: tuple[float, ...]
    torques_nm: tuple[float, ...]
    currents_a: tuple[float, ...]
    position_m: tuple[float, float, float]
    theta_rad: tuple[float, float, float]
    wrench: tuple[float, float, float, float, float, float]
    fingers: tuple[float, float, float]
    fifo_count: int
    supply_v: float
    supply_a: float
    temperatures_deg_c: tuple[float, ...]
    homed: bool

    @property
    def T_base_end_effector(self) -> FloatArray:
        """Pose of the end effector, (4, 4) [m]."""
        return kinematics.transform(kinematics.rotation_from_euler_xyz(*self.theta_rad), self.position_m)
