"""KUKA's six-axis arms as chains of joints.

Lengths, ranges and speeds are facts of the published description (ros-industrial kuka_experimental, kuka_kr6_support,
BSD-3). Angles are those of the controller: at (0, -90, 90, 0, 90, 0) upper arm upright, forearm level, flange down."""

from __future__ import annotations

import numpy as np

from deformscope_drivers.arm.kinematics import Chain, Joint

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
_PI = float(np.pi)


def kuka_chain(
    name: str,
    lengths_m: tuple[float, float, float, float, float, float],
    ranges_deg: tuple[tuple[float, float], ...],
    speeds_deg_s: tuple[float, ...],
) -> Chain:
    """lengths_m: height of the second axis, its distance from the first, upper arm, offset and length of the forearm,
    flange from the wrist [m]; ranges_deg, speeds_deg_s: ranges and speeds of each axis

    The description's axes are -z, y, y, -x, y, -x of frames parallel at angle 0; here each is its frame's z."""
    high, out, upper, offset, forearm, flange = lengths_m
    frames = (
        ((0.0, 0.0, high), (_PI, 0.0, 0.0)),
        ((out, 0.0, 0.0), (_PI / 2, 0.0, 0.0)),
        ((upper, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, -offset, 0.0), (_PI / 2, 0.0, -_PI / 2)),
        ((0.0, 0.0, -forearm), (-_PI / 2, _PI / 2, 0.0)),
        ((flange, 0.0, 0.0), (_PI / 2, 0.0, -_PI / 2)),
    )
    joints = tuple(
        Joint(xyz_m, rpy_rad, low_deg, high_deg, speed_deg_s, 0.0, 0.0)
        for (xyz_m, rpy_rad), (low_deg, high_deg), speed_deg_s in zip(frames, ranges_deg, speeds_deg_s, strict=True)
    )
    return Chain(name, joints, (0.0, 0.0, 0.0), (_PI, 0.0, _PI), HOME_DEG)


_AGILUS_DEG = ((-170.0, 170.0), (-190.0, 45.0), (-120.0, 156.0), (-185.0, 185.0), (-120.0, 120.0), (-350.0, 350.0))
_AGILUS_DEG_S = (360.0, 300.0, 360.0, 381.0, 388.0, 615.0)

KR6R700 = kuka_chain("kr6r700sixx", (0.4, 0.025, 0.315, 0.035, 0.365, 0.08), _AGILUS_DEG, _AGILUS_DEG_S)
KR6R900 = kuka_chain("kr6r900sixx", (0.4, 0.025, 0.455, 0.035, 0.42, 0.08), _AGILUS_DEG, _AGILUS_DEG_S)
CHAINS = {chain.name: chain for chain in (KR6R700, KR6R900)}
