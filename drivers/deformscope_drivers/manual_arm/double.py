"""A simulated stand with a stick: a person places it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm.kinematics import FloatArray


class StandDouble:
    """T_base_end_effector: (4, 4) true pose of the stick's mount [m]"""

    def __init__(self, T_base_end_effector: npt.ArrayLike) -> None:
        self._T_base_end_effector: FloatArray = np.array(T_base_end_effector, dtype=float)

    @property
    def T_base_end_effector(self) -> FloatArray:
        """(4, 4) pose of the end effector in the base frame [m]."""
        return self._T_base_end_effector

    def put(self, T_base_end_effector: npt.ArrayLike) -> None:
        """A person places the end effector at this pose (4, 4) in the base frame [m]."""
        self._T_base_end_effector = np.array(T_base_end_effector, dtype=float)

    @property
    def T_base_links(self) -> FloatArray:
        """(1, 4, 4) pose of its end, the only one that is known."""
        return self.T_base_end_effector[None]

    def push(self, wrench: npt.ArrayLike) -> None:
        """Push the arm, which is rigid; compliance is not visible on a scale either."""
