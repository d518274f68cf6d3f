"""Approximate volume of arm and stick: it hides the surface from a camera, and is removed from its points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from deformscope.capsule import Capsule
from deformscope.robot.description import AS_CAPSULES, RobotDescription
from deformscope.robot.placement import Placement
from deformscope_drivers.arm.kinematics import FloatArray

LINK_RADIUS_M = 0.045
"""Radius of the capsules that represent the arm's links [m]: that of the arm in the simulated laboratory. With a larger
radius, more of the surface around the arm is removed from the image, and the arm stays farther from the table and
itself. With a smaller one, parts of a thicker arm count as surface and may collide."""


def link_capsules(T_base_links: FloatArray, T: FloatArray) -> list[Capsule]:
    """Capsules of the links only, from the arm's foot, in another frame. T_base_links: (k, 4, 4) poses of the arm's
    joints and, last, of its end; T: (4, 4) base to that frame [m]"""
    joints_m = [T[:3, 3], *(T @ T_base_links)[:, :3, 3]]
    return [Capsule(a, b, LINK_RADIUS_M) for a, b in pairwise(joints_m)]


def arm_shape(
    placement: Placement,
    T_base_links: FloatArray,
    center_m: FloatArray,
    *,
    description: RobotDescription = AS_CAPSULES,
    link_margin_m: float = 0.0,
    stick_margin_m: float = 0.0,
) -> tuple[Capsule, ...]:
    """The links, the stick, the ball at its tip and the cables, in the surface frame [m].

    T_base_links: (k, 4, 4) poses of the arm's joints and, last, of its end (`Chain.forward`); of the end only if a
    person holds it; center_m: (3,) measured centre of its tip, which a push moves away from that of the chain
    description: description of the robot; links that are solids in it are left out
    link_margin_m, stick_margin_m: margins around the links, and around stick, ball and cables"""
    frames = T_base_links if len(T_base_links) == 1 else (np.eye(4), *T_base_links)
    joints_m = [(placement.T_surface_base @ frame)[:3, 3] for frame in frames]
    links = [Capsule(a, b, LINK_RADIUS_M + link_margin_m) for a, b in pairwise(joints_m)]
    stick = Capsule(joints_m[-1], center_m, placement.tool.stick_radius_m + stick_margin_m)
    ball = Capsule(center_m, center_m, placement.tool.radius_m + stick_margin_m)
    cables = description.cable_capsules(placement, T_base_links, stick_margin_m)
    return (*(() if description.whole else links), stick, ball, *cables)
