"""The robot that the laboratory's camera sees: a URDF of meshes, with a gripper, a stick and a cable.

Like a real robot it differs from its description: its fingers are closed by a few degrees more or less. Its cable hangs
and sways, while the description has lines with a radius."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from deformscope.rig.sections import CableSection, ShapeSection
from deformscope.robot.description import Removal, RobotDescription, arm_shape, describe
from deformscope.robot.placement import Placement
from deformscope.solid import Capsule, PosedSolid
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.jaco.chains import J2N6S300

FOLDER = Path(__file__).parent / "robots"
URDF = "j2n6s300-stick.urdf"
CLOSED = 0.62
"""How far the fingers are closed on the stick's neck."""
CLOSED_OFF = 0.03
"""Deviation of the fingers' closing: 2.6 degrees."""
CABLE_M = (
    (0.010, -0.004, 0.062),
    (0.048, -0.018, 0.052),
    (0.095, -0.036, 0.000),
    (0.090, -0.032, -0.070),
    (0.038, -0.010, -0.120),
)
"""From the force sensor before the ball up to the palm, in the frame of the arm's end [m]."""
CABLE_RADIUS_M = 0.003
SAG_M, SWAY_M = 0.004, 0.004
"""How far its middle hangs below these places, and deviations of where it sways to, along each axis."""
CABLE_PIECES = 20


def described_robot(removal: Removal | None = None) -> RobotDescription:
    """The [shape] that a careful user would write for this robot: the cable's radius includes sag and sway."""
    cable = CableSection(CABLE_M, CABLE_RADIUS_M + SAG_M + 2.0 * SWAY_M)
    return describe(ShapeSection(removal, URDF, closed=CLOSED, cables=(cable,)), J2N6S300, FOLDER)


class RobotBody:
    """One robot. closed: how far its fingers truly are"""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng([seed, 0xB0D])
        self.closed = float(np.clip(CLOSED + CLOSED_OFF * self._random.standard_normal(), 0.0, 1.0))
        section = ShapeSection(urdf=URDF, closed=self.closed)
        self._truth: RobotDescription = describe(section, J2N6S300, FOLDER)

    def seen(
        self, placement: Placement, T_base_links: FloatArray, center_m: FloatArray
    ) -> tuple[tuple[Capsule, ...], tuple[PosedSolid, ...]]:
        """What a camera sees of the robot, surface frame: first stick, ball and cable, then all other parts.

        T_base_links: (k, 4, 4) poses of joints and end; center_m: (3,) measured centre of the tip, which a push moves
        away from that of the chain"""
        stick = arm_shape(placement, T_base_links, center_m, description=self._truth)
        # capsules along the cable, which hangs between its ends and sways differently in each picture.
        # T_base_links: (k, 4, 4) [m]
        T = placement.T_surface_base @ T_base_links[-1]
        along = np.linspace(0.0, 1.0, CABLE_PIECES + 1)
        knots = np.linspace(0.0, 1.0, len(CABLE_M))
        way = make_interp_spline(knots, np.array(CABLE_M) @ T[:3, :3].T + T[:3, 3])(along)
        sway = np.clip(self._random.standard_normal(3), -2.0, 2.0) * SWAY_M
        way += np.sin(np.pi * along)[:, None] * (sway - (0.0, 0.0, SAG_M))
        return (*stick, *tuple(Capsule(a, b, CABLE_RADIUS_M) for a, b in pairwise(way))), self._truth.solids(
            placement, T_base_links
        )
