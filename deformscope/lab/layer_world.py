"""A scene in closed form: quick enough for the host's clock, where finite elements would be waited for.

For trying robots and rigs, not for studies: it is the law that `stages.contact` fits, so that an estimate agrees better
than it would with foam.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from deformscope.lab.scenes import Scene
from deformscope.stages.poke.contact import layer_modulus
from deformscope_drivers.jaco.kinematics import FloatArray

BLUR_M = 0.012
"""A touch feels the foam around it about this far."""
SPOTS = 16
RIGID_N_PER_M = 2e6


class LayerWorld:
    """A ball on a scene's layers (Dimitriadis et al. 2002), each place with the mean log modulus around it.

    pressed: (3,) where the ball is and how deep: x, y, depth [m]
    """

    def __init__(self, scene: Scene, radius_m: float) -> None:
        self.scene = scene
        self._radius_m = radius_m
        angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(SPOTS)
        self._around_m = (
            BLUR_M
            * np.sqrt((np.arange(SPOTS) + 0.5) / SPOTS)[:, None]
            * np.column_stack([np.cos(angle), np.sin(angle)])
        )
        self.pressed: FloatArray = np.zeros(3)

    def press(self, center_m: FloatArray) -> FloatArray:
        """Force (3,) [N] on a ball whose middle (3,) [m] is here, surface frame."""
        scene, center = self.scene, np.asarray(center_m, dtype=np.float64)
        normal = scene.normal(center[:2])
        foot = np.append(center[:2], scene.foam_height_m(center[:2]))
        depth = self._radius_m - float((center - foot) @ normal)
        beside = bool(((center[:2] < 0.0) | (center[:2] > scene.size_m)).any())
        table_n = RIGID_N_PER_M * max(0.0, self._radius_m - float(center[2]))
        if depth <= 0.0 or beside:
            self.pressed = np.array([*center[:2], 0.0])
            return np.array([0.0, 0.0, table_n])
        modulus = float(np.exp(np.log(scene.modulus_pa(center[:2] + self._around_m)).mean()))
        thickness = float(foot[2])
        newtons = modulus / layer_modulus(
            depth, 1.0, radius_m=self._radius_m, thickness_m=thickness, poisson=scene.poisson
        )
        self.pressed = np.array([*center[:2], depth])
        return np.asarray(newtons * normal + np.array([0.0, 0.0, table_n]))

    def displaced_m(self, places_m: npt.NDArray[np.floating]) -> FloatArray:
        """(n, 3) how the surface at places (n, 2) has moved [m], as a half-space below Hertz's pressure would (Johnson
        1985, eq. 3.42)."""
        middle, depth = self.pressed[:2], float(self.pressed[2])
        moved = np.zeros((len(places_m), 3))
        if depth > 0.0:
            contact = np.sqrt(self._radius_m * depth)
            share = np.linalg.norm(places_m - middle, axis=1) / contact
            inside, out = share <= 1.0, np.maximum(share, 1.0)
            around = ((2.0 - out**2) * np.arcsin(1.0 / out) + np.sqrt(out**2 - 1.0)) / np.pi
            moved[:, 2] = -depth * np.where(inside, 1.0 - 0.5 * share**2, around)
        return moved
