"""A plane of foam in closed form: what motion and safety are tried on where no finite elements are needed."""

import math

import numpy as np
import numpy.typing as npt

from deformscope.rig.rig_file import Tool
from deformscope_drivers.arm.kinematics import FloatArray

POISSON = 0.3


class SpringyFoam:
    """An elastic half-space, frictionless (Johnson 1985, 3.4, 4.2): the force on a sphere is `4/3 E* sqrt(R) d^1.5`, on
    a flat punch `2 E* a d`. Far stiffer than an arm it stands for a rigid block."""

    def __init__(self, modulus_pa: float, point_m: npt.ArrayLike, normal: npt.ArrayLike, tool: Tool) -> None:
        """point_m, normal: (3,) a point of the undeformed surface and its normal, in the surface frame"""
        self._point_m = np.asarray(point_m, dtype=float)
        normal = np.asarray(normal, dtype=float)
        self._normal: FloatArray = normal / np.linalg.norm(normal)
        self._tool = tool
        self._plane_modulus_pa = modulus_pa / (1.0 - POISSON**2)

    def press(self, center_m: FloatArray) -> FloatArray:
        """Force (3,) [N] on the tip whose centre (3,) [m] is here."""
        radius_m, round_tip = self._tool.radius_m, self._tool.tip == "sphere"
        height_m = float((center_m - self._point_m) @ self._normal)
        depth_m = max(0.0, (radius_m if round_tip else 0.0) - height_m)
        if round_tip:
            force_n = 4.0 / 3.0 * self._plane_modulus_pa * math.sqrt(radius_m) * depth_m**1.5
        else:
            force_n = 2.0 * self._plane_modulus_pa * radius_m * depth_m
        return np.asarray(force_n * self._normal)
