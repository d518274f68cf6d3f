"""A scene in closed form: quick enough for the host's clock, where finite elements would cause delays.

For trying robots and rigs, not for studies: linear elasticity on an axis, without finite elements' shapes of a contact.
"""

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.lab.scenes import Scene
from deformscope_drivers.arm.kinematics import FloatArray

BLUR_M = 0.012
"""Radius of the foam around a touch that affects it."""
SPOTS = 16
RIGID_N_PER_M = 2e6
NEWTON_STEPS, LEAST_SLOPE = 6, 0.1
"""From above and below the steps converge to the last bit of a force in four; the slope is bounded above 0 in a layer
so thin that the law ends."""


class LayerWorld:
    """A ball on a scene's layers; each place has the mean log modulus of its surroundings.

    A half-space below Hertz's ball (Johnson 1985, eq. 4.22) sinks by its own depth's displacement. The displacement at
    the depth of the table, which does not move, is subtracted (Steinbrenner 1934; on the axis of a point load, Johnson
    1985, eq. 3.18).

    pressed: (3,) place and depth of the ball: x, y, depth [m]"""

    def __init__(self, scene: Scene, radius_m: float) -> None:
        if any(piece.relaxes or piece.keeps or piece.plateau_exponent for piece in scene.pieces):
            raise InputError(
                "foam that neither creeps nor yields, on the host's clock", scene.name, f"explore lab:{scene.name}"
            )
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
        """Force (3,) [N] on a ball with this middle (3,) [m], surface frame."""
        scene, center = self.scene, np.asarray(center_m, dtype=np.float64)
        normal = scene.normal(center[:2])
        foot = np.append(center[:2], scene.foam_height_m(center[:2]))
        depth = self._radius_m - float((center - foot) @ normal)
        outside = bool(((center[:2] < 0.0) | (center[:2] > scene.size_m)).any())
        table_n = RIGID_N_PER_M * max(0.0, self._radius_m - float(center[2]))
        if depth <= 0.0 or outside:
            self.pressed = np.array([*center[:2], 0.0])
            return np.array([0.0, 0.0, table_n])
        modulus = float(np.exp(np.log(scene.modulus_pa(center[:2] + self._around_m)).mean()))
        # force over Young's modulus [N/Pa] at a depth: with a = how deep Hertz's ball would be, depth = a - held
        # a^(3/2)
        thickness_m = float(foot[2])
        poisson = self.scene.poisson
        hertz = 4.0 / 3.0 / (1.0 - poisson**2) * np.sqrt(self._radius_m)
        held = hertz * (1.0 + poisson) * (3.0 - 2.0 * poisson) / (2.0 * np.pi * thickness_m)
        alone_m = depth
        for _ in range(NEWTON_STEPS):
            off_m = alone_m - held * alone_m**1.5 - depth
            alone_m -= off_m / max(1.0 - 1.5 * held * np.sqrt(alone_m), LEAST_SLOPE)
        newtons = modulus * float(hertz * alone_m**1.5)
        self.pressed = np.array([*center[:2], depth])
        return np.asarray(newtons * normal + np.array([0.0, 0.0, table_n]))

    def displaced_m(self, places_m: npt.NDArray[np.floating]) -> FloatArray:
        """(n, 3) displacement of the surface at places (n, 2) [m], that of a half-space below Hertz's pressure (Johnson
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
