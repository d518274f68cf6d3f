"""Places that an arm reaches, each sought for itself: what a route through them is held to."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope.robot.placement import TOLERANCES, Placement, longest_m
from deformscope_drivers.arm.kinematics import Chain, FloatArray, least_singular


@dataclass(frozen=True, slots=True)
class Reach:
    """Whether the arm reaches places.

    reached: (n,) inverse kinematics converged there, every joint PLAN_MARGIN_DEG inside its range; least_singular: (n,)
    smallest singular value of the Jacobian, 0 where not reached"""

    reached: npt.NDArray[np.bool_]
    least_singular: FloatArray


def reach(
    chain: Chain,
    placement: Placement,
    centers_m: FloatArray,
    normals: npt.ArrayLike = (0.0, 0.0, 1.0),
    *,
    start_deg: npt.ArrayLike | None = None,
    starts: int = 10,
) -> Reach:
    """Which tip centres (n, 3) [m, surface frame] the arm reaches with the stick along -normal, one or (n, 3).

    start_deg: (m,) joint angles that the search begins with for each place: where the arm comes from (default: home)"""
    directions = np.broadcast_to(np.asarray(normals, dtype=float), (len(centers_m), 3))
    least: list[float | None] = []
    for T_base_ee in placement.T_base_ee(centers_m, directions):
        found = None
        if float(np.linalg.norm(T_base_ee[:3, 3])) <= longest_m(chain):  # else many searches for nothing
            found = chain.inverse(T_base_ee, start_deg, starts=starts, **TOLERANCES)
        least.append(float(least_singular(chain.jacobian(found.joints_deg))) if found and found.converged else None)
    reached = np.array([one is not None for one in least], dtype=bool)
    return Reach(reached, np.array([one or 0.0 for one in least]))
