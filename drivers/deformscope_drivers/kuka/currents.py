"""Parts of a simulated KUKA's motor currents: load and gravity, friction, ripple and noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross, jacobian_of

UNIT_NM = np.array([2.0, 2.0, 1.5, 0.5, 0.5, 0.3])
"""Torque at each axis for one unit of current. Torque for a current of 1; all numbers here are assumed, of the order of
a small six-axis arm."""
MASSES_KG = ((3, 14.0), (5, 5.0), (6, 2.0))
"""Masses at the frames of links."""
COULOMB_NM = np.array([12.0, 15.0, 10.0, 4.0, 3.0, 2.0])
TURNS_DEG_S = 0.02
"""Width of the axis' rate over which friction changes its sign [deg/s]."""
VISCOUS_NM_S_DEG = 0.05
RIPPLE_NM, RIPPLE_DEG = 0.5, 3.6
NOISE_NM = 0.8
_GRAVITY = np.array([0.0, 0.0, -9.81])


def motor_currents(
    chain: Chain, joints_deg: FloatArray, rates_deg_s: FloatArray, wrench: npt.ArrayLike, random: np.random.Generator
) -> FloatArray:
    """(6,) in the units of the controller, of axes at (6,) that turn at (6,), with (6,) on the flange [N, Nm]."""
    links = chain.forward(joints_deg)
    held_nm = -jacobian_of(links).T @ np.asarray(wrench, dtype=float)
    for link, mass_kg in MASSES_KG:
        levers_m = links[link, :3, 3] - links[:link, :3, 3]
        held_nm[:link] -= mass_kg * (cross(links[:link, :3, 2], levers_m) @ _GRAVITY)
    held_nm += COULOMB_NM * np.tanh(rates_deg_s / TURNS_DEG_S) + VISCOUS_NM_S_DEG * rates_deg_s
    held_nm += RIPPLE_NM * np.sin(2 * np.pi * joints_deg / RIPPLE_DEG) + random.normal(0.0, NOISE_NM, 6)
    return np.asarray(held_nm / UNIT_NM)
