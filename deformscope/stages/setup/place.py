"""Pose of a rectangle: its frame, its sides and the box around it, from its corners touched by a round tip.

The frame's origin is the first corner; x runs to the second, y to the third, z up."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.transform import ErrorPrior, TransformEstimate, fitted, moved, rigid, transform_of

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
"""Corners of the rectangle, in the order of the requests: origin, end of x, end of y, the far one."""
CORNER_NAMES = ("origin", "end of x", "end of y", "far corner")
TOUCHED = ErrorPrior(0.001)
"""Deviation of a corner found by eye and touched by a round tip [m]."""
SHORTEST_M = 0.05
UNLIKELY = 1e-3
"""Least probability of the corners' deviation from a rectangle: corners below it are refused."""
AROUND_M, ABOVE_M = 0.03, 0.3
"""Extent of the tip's box beyond the rectangle, and above it."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaceEstimate:
    """A rectangle in the arm's base frame.

    T_arm_surface: surface frame to base frame; size_m, size_half_m: (2,) its sides and their half widths [m]
    low_m, high_m: (3,) box for the tip's centre around it, base frame [m]
    touch_sd_m: deviation of a touched corner [m]; corner_off_m: (n,) distance of each from its corner of the rectangle
    """

    T_arm_surface: TransformEstimate
    size_m: FloatArray
    size_half_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    touch_sd_m: float
    corner_off_m: FloatArray


def place(
    centers_m: FloatArray,
    corners: npt.ArrayLike,
    tip_radius_m: float,
    up: npt.ArrayLike = (0.0, 0.0, 1.0),
    *,
    tip_sd_m: float = 0.0,
) -> PlaceEstimate:
    """The rectangle whose corners were touched, each once or more often.

    centers_m: (n, 3) the tip's centre at each touch, base frame; corners: (n,) number of the corner in CORNERS
    up: (3,) roughly away from the surface, base frame: against the stick
    tip_sd_m: deviation of the tip's position on the arm, which shifts all corners by the same vector [m]. Raises
    InputError for corners that are no rectangle's, or in one line."""
    touched, which = np.asarray(centers_m, np.float64), np.asarray(corners, int)
    if not np.isfinite(touched).all():
        raise InputError("finite places of the tip", "NaN or infinity")
    if missing := [CORNER_NAMES[one] for one in range(3) if one not in which]:
        raise InputError("the origin, the end of x and the end of y", f"no {' and no '.join(missing)}", "touch it too")
    first, along, across = (touched[which == one].mean(axis=0) for one in range(3))
    x, y = along - first, across - first
    long_m, wide_m = float(np.linalg.norm(x)), float(np.linalg.norm(y))
    sides_m = np.array([long_m, wide_m])
    if min(long_m, wide_m) < SHORTEST_M:
        came = f"{1e3 * min(long_m, wide_m):.0f} mm"
        raise InputError(f"corners {1e3 * SHORTEST_M:g} mm or more apart", came, "touch each corner of its own")
    cosine = float(x @ y) / (long_m * wide_m)
    if abs(cosine) > 0.9:
        raise InputError("three corners of a rectangle", "three in one line", "touch the end of x and the end of y")
    normal = np.cross(x, y)
    normal /= np.linalg.norm(normal)
    if float(normal @ np.asarray(up, np.float64)) <= 0.0:
        came = "x and y the other way round, so that z would point into the surface"
        raise InputError("corners counterclockwise seen from above: origin, x, y", came, "swap the last two")
    x = x / long_m
    start = rigid(np.column_stack([x, np.cross(normal, x), normal]), first - tip_radius_m * normal)
    shares = CORNERS[which]

    def off_m(values: FloatArray) -> FloatArray:
        T = moved(start, values[:6])
        on_it = np.column_stack([shares * (values[6:] + sides_m), np.full(len(shares), tip_radius_m)])
        return np.asarray(on_it @ T[:3, :3].T + T[:3, 3] - touched)

    found = fitted(lambda values: off_m(values).ravel(), np.zeros(8), TOUCHED)
    left_over = off_m(found.value)
    count = left_over.size - 8
    if scipy.stats.f.sf(found.scatter**2 / TOUCHED.sd**2, count, TOUCHED.weight) < UNLIKELY:
        angle_deg = np.degrees(np.arccos(cosine))
        came = f"corners up to {1e3 * np.linalg.norm(left_over, axis=1).max():.0f} mm off one; {angle_deg:.1f} degrees"
        raise InputError("corners of a rectangle", came, "touch the corners again, one by one")
    size_m = found.value[6:] + sides_m
    T = transform_of(found, start)
    T.covariance[:3, :3] += tip_sd_m**2 * np.eye(3)
    sides = [(-AROUND_M, size_m[0] + AROUND_M), (-AROUND_M, size_m[1] + AROUND_M), (0.0, ABOVE_M)]
    room_m = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 3) @ T.T[:3, :3].T + T.T[:3, 3]
    distances = np.linalg.norm(left_over, axis=1)
    return PlaceEstimate(T, size_m, found.half()[6:], room_m.min(axis=0), room_m.max(axis=0), found.sd, distances)
