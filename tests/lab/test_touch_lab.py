"""The laboratory's contact is where the arm's give and the foam's are in balance, and its faults are what they say."""

import numpy as np
import pytest
from scipy.optimize import brentq

from deformscope.lab.arm_contact import ARM_STIFFNESS_N_M
from deformscope.lab.scenes import SIZE_M
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement
from deformscope.robot.setup import T_BASE_SURFACE
from studies.springy_foam import SpringyFoam

POINT_M = np.array([0.3, 0.2, 0.1])


def test_the_arm_stands_beside_the_table() -> None:
    x_m, y_m, z_m = Placement(T_BASE_SURFACE).T_surface_base[:3, 3]
    assert (x_m, z_m) == pytest.approx((SIZE_M[0] / 2, 0.0))
    assert y_m == pytest.approx(SIZE_M[1] + 0.15)
    assert np.hypot(x_m, y_m) == pytest.approx(0.63, abs=0.005)  # to the far corners


@pytest.mark.parametrize("modulus_pa", [10e3, 100e3, 1e7, 1e11])
@pytest.mark.parametrize("tip", ["sphere", "flat"])
def test_the_arm_gives_as_much_as_its_stiffness_says(modulus_pa: float, tip: str) -> None:
    tool = Tool(tip=tip)
    foam = SpringyFoam(modulus_pa, POINT_M, (0.0, 0.0, 1.0), tool)
    lab = TouchLab(foam, tool=tool)
    offset_m = lab.placement.center_offset_m
    for depth_m in (0.0, 0.0002, 0.001, 0.0005, 0.0):
        center_m = POINT_M + np.array([0.0, 0.0, offset_m - depth_m])
        force_n = lab.contact._contact(center_m)

        def gap(give_m: float, center_m: np.ndarray = center_m) -> float:
            return float(foam.press(center_m + np.array([0.0, 0.0, give_m]))[2]) - ARM_STIFFNESS_N_M * give_m

        give_m = brentq(gap, 0.0, 0.01, xtol=1e-15) if depth_m else 0.0
        assert force_n[2] == pytest.approx(ARM_STIFFNESS_N_M * give_m, abs=5e-3)


def test_a_foam_of_hertz() -> None:
    foam = SpringyFoam(100e3, POINT_M, (0.0, 0.0, 1.0), Tool(radius_m=0.01))
    # 4/3 * 100e3 / 0.91 * sqrt(0.01) * 0.004 ** 1.5
    assert foam.press(POINT_M + np.array([0.0, 0.0, 0.006])) == pytest.approx([0.0, 0.0, 3.7067], rel=1e-4)
    assert foam.press(POINT_M + np.array([0.0, 0.0, 0.0101])) == pytest.approx([0.0, 0.0, 0.0])
