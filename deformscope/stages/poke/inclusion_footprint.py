"""Effect of an inclusion below the surface on touches above it: its footprint on apparent stiffness.

    shift = inclusion_shift(contrast_share(10.0), footprint(contact_m, radii_m, depths_m, aside_m))    # of log
    stiffness

A ball of radius R presses with Hertz's pressure on a circle of radius a. The foam below stores the energy density of a
half-space under that pressure (Boussinesq's stresses, Johnson 1985, eq. 3.20, summed over the circle). An inclusion
changes the dent by its share in twice that energy over force times dent (to first order, exactly: reciprocity), times
its response to a uniform strain. Eshelby (1957) gives the response of a ball with the same Poisson's ratio 0.2: h = (c
- 1) / (1 + (c - 1) / 2) of c times the modulus; a rigid one 2, a hole -2.

Therefore inclusion, depth and contact determine its width, and only the constant CALIBRATED is fitted.
Not modelled: the strain is not uniform over the inclusion, and the foam is no half-space."""

from functools import lru_cache
from typing import cast

import numpy as np
import scipy

from deformscope.arrays import FloatArray
from deformscope.errors import InputError

POISSON = 0.2
"""Poisson's ratio of foam; 0 and 0.3 change a share by less than a tenth."""
CALIBRATED = 1.1
"""The finite elements' effect over this one."""
CONTACT_STEP = 0.02
"""Contacts are taken in steps of this in their logarithm."""
NEAREST, FARTHEST, NODES = 0.1, 60.0, 70
"""Range of the energy's grid, in contact radii, and its nodes each way."""
ACROSS = 9
"""Number of points of a lattice across an inclusion."""
MOST_SHARE = 0.85
"""Largest share of a dent that an inclusion can have."""


def contact_radius(dent_m: float, tip_radius_m: float) -> float:
    """Radius of a ball's contact (Hertz 1882) [m]."""
    return float(np.sqrt(dent_m * tip_radius_m))


def contrast_share(times: float) -> float:
    """h of an inclusion by the ratio of its stiffness to its surroundings'; below 0 if it is softer."""
    if not times >= 0.0:
        raise InputError("a ratio of moduli, 0 or more", f"{times}")
    return 2.0 * (1.0 - 2.0 / (times + 1.0))


def inclusion_shift(share: FloatArray | float, footprint: FloatArray) -> FloatArray:
    """(...,) addition to log stiffness at a set force; share: h; footprint: footprint of the same shape"""
    return np.asarray(-np.log1p(-np.minimum(CALIBRATED * share * footprint, MOST_SHARE)))


def footprint(contact_m: float, radii_m: FloatArray, depths_m: FloatArray, aside_m: FloatArray) -> FloatArray:
    """(r, d, s) share of a dent due to the foam in the place of an inclusion, before any contrast.

    contact_m: radius of the contact; radii_m: (r,) radii of inclusions; depths_m: (d,) depths of their uppermost points
    below the surface; aside_m: (s,) horizontal distances from the touch to their middles, all [m]"""
    if not contact_m > 0.0:
        raise InputError("a contact's radius above 0 m", f"{contact_m}")
    log_radius = CONTACT_STEP * round(float(np.log(contact_m)) / CONTACT_STEP)
    return _footprint(log_radius, *(tuple(map(float, some)) for some in (radii_m, depths_m, aside_m)))


@lru_cache(maxsize=64)
def _footprint(
    log_contact: float, radii_m: tuple[float, ...], depths_m: tuple[float, ...], aside_m: tuple[float, ...]
) -> FloatArray:
    contact_m = float(np.exp(log_contact))
    lattice = (np.arange(ACROSS) + 0.5) / ACROSS * 2.0 - 1.0
    spots = np.stack(np.meshgrid(lattice, lattice, lattice), axis=-1).reshape(-1, 3)
    spots = spots[(spots**2).sum(axis=1) < 1.0]
    radius = np.array(radii_m)[:, None, None, None] / contact_m
    depth, aside = np.array(depths_m)[:, None, None] / contact_m, np.array(aside_m)[:, None] / contact_m
    along = np.hypot(aside + radius * spots[:, 0], radius * spots[:, 1])
    down = depth + radius * (1.0 + spots[:, 2])
    density = energy_density(*np.broadcast_arrays(along, down))
    volume = 4.0 / 3.0 * np.pi * radius[..., 0] ** 3
    return cast(FloatArray, volume * density.mean(axis=-1))


def energy_density(along: FloatArray, down: FloatArray) -> FloatArray:
    """(...,) twice the energy for each volume over force times dent, at places aside and down, all in contact radii."""
    places, table = _energy_table()
    found = scipy.interpolate.RegularGridInterpolator((places, places), table)
    spot = np.log(np.clip(np.stack([along, down], axis=-1), NEAREST, FARTHEST))
    return np.asarray(np.exp(found(spot)))


@lru_cache(maxsize=1)
def _energy_table() -> tuple[FloatArray, FloatArray]:
    """Logarithms of places (n,), along and down alike, and of the density there (n, n)."""
    log_place = np.linspace(np.log(NEAREST), np.log(FARTHEST), NODES)
    along, down = np.exp(log_place)[:, None, None], np.exp(log_place)[None, :, None]
    # of a sunflower's points, each of the same force: within s of the middle Hertz's pressure has 1 - (1 - s^2)^1.5
    count = 400
    radius = np.sqrt(1.0 - (1.0 - (np.arange(count) + 0.5) / count) ** (2.0 / 3.0))
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    x, y = along - radius * np.cos(angle), np.broadcast_to(-radius * np.sin(angle), (NODES, 1, count))
    away2 = x**2 + y**2
    far = np.sqrt(away2 + down**2)
    held = 1.0 - 2.0 * POISSON
    outward = held / (far * (far + down)) - 3.0 * down * away2 / far**5
    around = -held * (1.0 / (far * (far + down)) - down / far**3)
    cosine, sine = x / np.sqrt(away2), y / np.sqrt(away2)
    normal = (outward * cosine**2 + around * sine**2, outward * sine**2 + around * cosine**2, -3.0 * down**3 / far**5)
    sheared = -3.0 * np.sqrt(away2) * down**2 / far**5
    shear = ((outward - around) * cosine * sine, sheared * cosine, sheared * sine)
    xx, yy, zz, xy, xz, yz = (one.mean(axis=-1) / (2.0 * np.pi) for one in (*normal, *shear))
    squares = xx**2 + yy**2 + zz**2 + 2.0 * (xy**2 + xz**2 + yz**2)
    twice = (1.0 + POISSON) * squares - POISSON * (xx + yy + zz) ** 2
    dent = 0.75 * (1.0 - POISSON**2)
    return log_place, np.log(twice / dent)
