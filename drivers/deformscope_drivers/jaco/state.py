"""The status that the arm reports."""

from __future__ import annotations

from dataclasses import dataclass

from deformscope_drivers.arm.state import ArmState


@dataclass(frozen=True, slots=True, kw_only=True)
class JacoState(ArmState):
    """The state of a Jaco at one time; a six-joint arm has six values, never a meaningless seventh.

    Rates are from the angles of the last 40 ms, the pose is from the angles. wrench: force and torque at the end
    effector. The joints' torque sensors drift, so that it is some newtons without contact; its direction was not
    verified on an arm; fingers: (3,) from 0 open to 6800 closed
    sweep_s: by how much wrench, torques, currents and fifo_count may be older than the angles; currents_a: (n,)
    supply_v, supply_a: its main supply; temperatures_deg_c: (n,) temperatures of the joints; homed: whether it was at
    home since it was switched on; these are read once a second"""

    sweep_s: float
    currents_a: tuple[float, ...]
    supply_v: float
    supply_a: float
    temperatures_deg_c: tuple[float, ...]
    homed: bool
