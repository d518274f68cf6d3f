"""Whether lengths are plausible: metres of a body that a robot handles, in one unit and one frame.

A fit does not show a user's mistakes: shapes are the same in millimetres, and converge as well."""

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import rigid_positions

LARGEST_M, LARGE_M = 5.0, 1.0
"""No body that is handled is larger than the first [m]; one larger than the second is worth a note."""

FARTHEST = 1.0
"""Largest motion of particles beyond a rigid one (root mean square), as a share of the body's size."""

THICKEST = 10.0
"""Largest thickness of the material below a surface, over the surface's width."""


def size_of(points: FloatArray) -> float:
    """Longest side of the box around points (n, d), in their unit."""
    return float(np.ptp(points, axis=0).max())


def check_metres(rest: FloatArray, noise: FloatArray | None = None) -> None:
    """Refuses positions at rest (K, d) and noise (K,) that cannot be metres."""
    size = size_of(rest)
    if size > LARGEST_M:
        wanted, came = f"positions in metres, of a body of at most {LARGEST_M:g} m", f"rest positions over {size:.4g} m"
        hint = "divide by 1000 if they are millimetres, by 100 if centimetres; pixels are for images and --px-per-cm"
        raise InputError(wanted, came, hint)
    if noise is not None and float(noise.max(initial=0.0)) > size:
        came = f"{noise.max():.4g} m for a body of {size:.4g} m"
        raise InputError("noise in metres, smaller than the body", came, "metres")


def check_same_unit(rest: FloatArray, deformed: FloatArray, known: BoolArray) -> None:
    """Refuses deformed positions (K, d), known where `known` (K,), in another unit than rest (K, d)."""
    moved = deformed[known] - rigid_positions(rest, deformed, known)[known]
    size, far = size_of(rest), float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
    if far > FARTHEST * size:
        came = f"particles that move {far:.4g} m beyond a rigid motion, of a body of {size:.4g} m"
        hint = "one unit, and one order of the particles, in both"
        raise InputError("deformed positions in the unit of rest", came, hint)


def size_note(rest: FloatArray) -> str | None:
    """Remark on positions at rest (K, d) that are metres, if they are, of an unusually large body."""
    size = size_of(rest)
    if size <= LARGE_M:
        return None
    return f"note: positions are taken as metres, so this body is {size:.3g} m large; are they?"


def check_poke(surface: FloatArray, thickness: float, depth: float, tip: float) -> None:
    """Refuses a poke [m] that does not fit the material: as deep as it is thick, or with a tip wider than all of it.
    surface: (n, d) points; thickness: thickness along the poke; depth: depth of the poke; tip: tip's smallest side"""
    size = size_of(surface)
    if thickness > THICKEST * size:
        wanted = f"a thickness in metres, of a surface of {size:.3g} m"
        raise InputError(wanted, f"{thickness:g} m", "--thickness-m 0.05 for 5 cm")
    if tip >= size:
        wanted = f"a tip in metres, smaller than the surface of {size:.3g} m"
        raise InputError(wanted, f"{tip:g} m", "size=0.02x0.02 for 2 cm")
    if depth >= thickness:
        wanted = f"a poke less deep than the {1e3 * thickness:.3g} mm of material under it"
        raise InputError(wanted, f"{1e3 * depth:.4g} mm", "depths are in metres: depth=0.003 for 3 mm")
