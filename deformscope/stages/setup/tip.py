"""Position of the tip at the arm's end, by turning the arm about it: a pivot.

The ball at the tip stays in one place (a cone, a ring, a hole's rim) while the arm's end is turned about it. Each pose
gives R p + t = q with the tip p in the frame of the arm's end and the place q in the base frame: linear in both."""

from dataclasses import dataclass

import numpy as np
import scipy

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.transform import ErrorPrior, TransformEstimate, judged, rigid

PIVOTED = ErrorPrior(0.0007)
"""Deviation of the ball from its place by the arm's poses [m]: its play, and the arm's repeatability."""
FEWEST = 4
LEAST_SPREAD = 0.12
"""Smallest spread of the rotations, in the direction that they determine least: 0.17 = tilts of 10 degrees each way
about two axes."""
DOUBT_SHARE = 0.6
"""Prior standard deviation of the angle between the two possible directions of a stick: the interval then is that
angle."""
SLID_M = 0.006
"""Scatter of the ball above which it has moved."""


@dataclass(frozen=True, slots=True, eq=False)
class TipEstimate:
    """The tip's centre at the arm's end.

    T_ee_center: the tip's centre to the arm's end. Its z axis runs from the arm's end through the tip, its x axis as
    close as possible to the end's (`calibrate force` finds the turn of the force sensor about the stick)
    pivot_m: (3,) place of the ball, base frame [m]; pivot_sd_m: its scatter; off_m: (n,) offset of each pose"""

    T_ee_center: TransformEstimate
    pivot_m: FloatArray
    pivot_sd_m: float
    off_m: FloatArray


def spread(rotations: FloatArray) -> float:
    """Spread of rotations (n, 3, 3): deviation of R p over them for the unit vector p for which it is least."""
    centred = rotations - rotations.mean(axis=0)
    return float(np.linalg.svd(centred.reshape(-1, 3), compute_uv=False)[-1] / np.sqrt(len(rotations)))


def pivot(T_base_ee: FloatArray) -> TipEstimate:
    """The tip about which the arm's end (n, 4, 4) was turned.

    A pivot does not determine the stick's direction: it is assumed to run from the arm's end to the tip. Its interval
    reaches to the end's own z axis on either side, the direction of a stick that is mounted off the middle. Raises
    InputError for poses that are too few or turned too little, and a ball that slid."""
    poses = np.asarray(T_base_ee, np.float64)
    if len(poses) < FEWEST:
        raise InputError(f"{FEWEST} poses or more", str(len(poses)), "tilt the stick about its ball, each way")
    if not np.isfinite(poses).all():
        raise InputError("finite poses", "NaN or infinity")
    turns = poses[:, :3, :3]
    if (reached := spread(turns)) < LEAST_SPREAD:
        came = f"a spread of {np.degrees(reached):.0f} degrees about the least determined axis"
        hint = "tilt the stick by 20 degrees to the left, to the right, towards you and away"
        raise InputError(f"poses turned by {np.degrees(LEAST_SPREAD):.0f} degrees about two axes", came, hint)
    design = np.concatenate([turns, np.broadcast_to(-np.eye(3), turns.shape)], axis=2).reshape(-1, 6)
    inverse = np.linalg.inv(design.T @ design)
    solution = inverse @ (design.T @ -poses[:, :3, 3].ravel())
    left_over = design @ solution + poses[:, :3, 3].ravel()
    found = judged(solution, inverse, left_over, PIVOTED)
    if found.scatter > SLID_M:
        came = f"one that scatters by {1e3 * found.scatter:.1f} mm"
        raise InputError("a ball that stays in its place", came, "a cone or a ring that holds it, and slower motion")
    tip_m = solution[:3]
    length_m = float(np.linalg.norm(tip_m))
    z = tip_m / length_m
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    if np.linalg.norm(x) < 0.1:
        came = f"a tip at {tip_m.round(3).tolist()} m"
        raise InputError("a stick that is not along the x axis of the arm's end", came)
    x /= np.linalg.norm(x)
    doubt_rad = float(np.arccos(np.clip(z[2], -1.0, 1.0)))
    turned = (DOUBT_SHARE * doubt_rad) ** 2 + np.trace(found.covariance[:3, :3]) / length_m**2
    covariance = scipy.linalg.block_diag(found.covariance[:3, :3], turned * np.eye(3))
    estimate = TransformEstimate(rigid(np.column_stack([x, np.cross(z, x), z]), tip_m), covariance, found.dof)
    off_m = np.linalg.norm(left_over.reshape(-1, 3), axis=1)
    return TipEstimate(estimate, solution[3:], found.sd, off_m)
