"""What a force sensor in a simulated tip feels between two looks at the world."""

import numpy as np
import numpy.typing as npt
import pytest

from deformscope.lab.arm_contact import ARM_CYCLE_NS, ArmContact
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement
from deformscope_drivers.arm.kinematics import FloatArray


class _Moved:
    """An arm whose end is where it is put."""

    def __init__(self) -> None:
        self.T_base_end_effector: FloatArray = np.eye(4)

    def push(self, wrench: npt.ArrayLike) -> None: ...


class _Spring:
    """Of 1000 N/m along z, above which nothing is."""

    def press(self, center_m: FloatArray) -> FloatArray:
        return np.array([0.0, 0.0, max(-1e3 * float(center_m[2]), 0.0)])


@pytest.mark.parametrize("goes_on", [False, True])
def test_a_force_goes_on_as_it_went_where_it_is_asked_to(goes_on: bool) -> None:
    arm, now_ns = _Moved(), [0]
    placement = Placement(np.eye(4), Tool())
    contact = ArmContact(_Spring(), arm, placement, lambda: now_ns[0], arm_stiffness_n_m=np.inf, goes_on=goes_on)
    center_m = placement.T_surface_center(np.eye(4))[2, 3]
    for cycle, deep_m in enumerate((0.001, 0.002)):
        now_ns[0] = cycle * ARM_CYCLE_NS
        arm.T_base_end_effector = np.eye(4)
        arm.T_base_end_effector[2, 3] = -center_m - deep_m
        contact.feel()
    at_once, later = (float(np.linalg.norm(contact.load(1e-9 * (ARM_CYCLE_NS + ns)))) for ns in (0, ARM_CYCLE_NS // 2))
    assert at_once == pytest.approx(2.0)
    assert later == pytest.approx(2.5 if goes_on else 2.0)
