"""From a velocity of the arm's end to joint rates: damped inverse of the Jacobian, guards at limits and singularities.

The arm receives joint rates, not its own Cartesian velocities: those use rotation in the end effector's frame, and that
mode's behaviour near singularities and joint limits is not published. Therefore this module has these guards."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from deformscope.robot.supervisor import Fault
from deformscope_drivers.arm.device import DAMPED_BELOW, NEGLIGIBLE_DEG_S, OFF_COURSE
from deformscope_drivers.arm.kinematics import (
    Chain,
    FloatArray,
    damped_joint_rates,
    jacobian_of,
    least_singular,
    off_course,
    rotation_vector,
    twist_size,
)

SLOW_DEG = 10.0
"""Distance before its margin at which a joint slows down, linearly to zero (Faverjon and Tournassoud 1987)."""
LEAST_SHARE = 0.05
"""Least share of a velocity: if a joint's margin leaves less, the joint blocks the motion."""
SINGULAR_DEG, SINGULAR_SHARE = 15.0, 1.0 / 3.0
"""If the fastest joint would reach a singularity within this angle, as the smallest singular value falls, all joints
slow down in proportion, to this share at least. So a path through it continues, and ends in time (`travel.SLACK`)."""
AHEAD_DEG: FloatArray = np.array([0.0, 1.0, 3.0, 6.0, 9.0, 12.0, 15.0])
"""Angle over which the smallest singular value is extrapolated, up to SINGULAR_DEG: it may fall faster later than now.
Steps ahead in which a fall is looked for: with fewer it is noticed late; each step costs a forward kinematics in every
control period."""
OFF_COURSE_M_S = 1e-3
"""Absolute part of a velocity that may be lost or turned away, besides the share `OFF_COURSE`. Corrections at rest are
slow; such a motion leads the tip less than 0.01 mm astray in a control period."""
AWAY_DEG, AWAY_DEG_S = 40.0, 15.0
"""The null space of a seventh joint turns joints away from limits that are nearer than this, the faster the nearer. It
does not turn towards the middle of the ranges, where a stretched elbow and wrist are singular."""
HOLD_PER_S = 2.0
"""Share of an orientation's error that is corrected in a second while the orientation is held."""
FOLLOW_PER_S = 1.0
"""If a controller turns the arm by measured orientation, the commanded rotation follows the measured one at this share
of the difference per second. Therefore errors of points that the arm skipped do not add up."""


@dataclass(frozen=True, slots=True)
class JointMotion:
    """Joint rates for a velocity, and whether they may be sent.

    rates_deg_s: (n,) [deg/s]; share: share of the velocity that is left where a joint would be too fast or is near its
    limit; fault, reason: why they must not be sent; NONE if they may"""

    rates_deg_s: FloatArray
    share: float = 1.0
    fault: Fault = Fault.NONE
    reason: str = ""


def rates_for_twist(
    chain: Chain, joints_deg: npt.ArrayLike, twist: FloatArray, limits_deg_s: FloatArray, margin_deg: float
) -> JointMotion:
    """Joint rates for a twist (6,) of the arm's end [m/s, rad/s], both parts in the base frame.

    joints_deg: (n,) present angles of the arm; limits_deg_s: (n,) greatest rates; margin_deg: no joint comes nearer to
    the end of its range. If a joint would be too fast, all are slowed by the same factor: the direction stays."""
    joints = np.asarray(joints_deg, dtype=float)
    jacobian = jacobian_of(chain.forward(joints))
    away = None
    if chain.joint_count > 6:  # one joint to spare: away from limits that are near
        low = np.clip(1.0 - (joints - chain.lower_deg) / AWAY_DEG, 0.0, 1.0)
        high = np.clip(1.0 - (chain.upper_deg - joints) / AWAY_DEG, 0.0, 1.0)
        away = np.radians(AWAY_DEG_S * (low - high))
    rates = damped_joint_rates(jacobian, twist, DAMPED_BELOW, away)
    lost = off_course(jacobian, rates, twist)
    if lost > OFF_COURSE and lost * twist_size(twist) > OFF_COURSE_M_S:
        least = f"smallest singular value {least_singular(jacobian):.3f}, damped below {DAMPED_BELOW:g}"
        why = f"the tip would leave its way by {100 * lost:.0f} %, limit {100 * OFF_COURSE:.0f} %"
        return _blocked(chain, Fault.SINGULAR, f"{why} ({least})")
    near = min(1.0, max(SINGULAR_SHARE, to_singularity_deg(chain, joints, jacobian, rates) / SINGULAR_DEG))
    motion = within_limits(chain, joints, near * np.degrees(rates), limits_deg_s, margin_deg)
    return dataclasses.replace(motion, share=near * motion.share)


def to_singularity_deg(chain: Chain, joints_deg: FloatArray, jacobian: FloatArray, rates: FloatArray) -> float:
    """Angle of the fastest of joint rates (n,) until the smallest singular value is 0 [deg]. The value is extrapolated
    from the next degree or from one of AHEAD_DEG, whichever is sooner.

    joints_deg: (n,); jacobian: (6, n) there. inf if the distance does not fall"""
    fastest = float(np.abs(rates).max())
    if fastest <= 0.0:
        return math.inf
    ahead = chain.forward(joints_deg + AHEAD_DEG[1:, None] * (rates / fastest))
    least = least_singular(np.concatenate([jacobian[None], jacobian_of(ahead)]))
    width_deg, falls = np.diff(AHEAD_DEG), -np.diff(least)
    zero_deg = AHEAD_DEG[:-1] + np.divide(width_deg * least[:-1], falls, out=np.full(6, np.inf), where=falls > 1e-9)
    shortly = zero_deg <= AHEAD_DEG[1:] + width_deg
    shortly[0] = True
    return float(zero_deg[shortly].min())


def within_limits(
    chain: Chain, joints_deg: npt.ArrayLike, rates_deg_s: FloatArray, limits_deg_s: FloatArray, margin_deg: float
) -> JointMotion:
    """Joint rates (n,) [deg/s], slowed by one factor so that none is above its limit, which falls to 0 near a joint's
    end.

    joints_deg: (n,); limits_deg_s: (n,); margin_deg: distance from the end of a range at which the rate is 0"""
    joints = np.asarray(joints_deg, dtype=float)
    way_deg = np.where(rates_deg_s > 0, chain.upper_deg - joints, joints - chain.lower_deg)
    near = np.minimum(np.maximum((way_deg - margin_deg) / SLOW_DEG, 0.0), 1.0)  # np.clip takes five times as long
    size = np.abs(rates_deg_s)
    moves = size > NEGLIGIBLE_DEG_S
    rates = np.where(moves | (near > 0), rates_deg_s, 0.0)
    shares = np.divide(limits_deg_s, size, out=np.full(chain.joint_count, np.inf), where=moves)
    share = float(min(1.0, shares.min()))
    allowed = np.divide(limits_deg_s * near, size * share, out=np.full(chain.joint_count, np.inf), where=moves)
    worst = int(np.argmin(allowed))
    if allowed[worst] < LEAST_SHARE:
        end = chain.upper_deg[worst] if rates_deg_s[worst] > 0 else chain.lower_deg[worst]
        where = f"joint {worst + 1} at {joints[worst]:.1f} deg, on its way to its limit at {end:g} deg"
        return _blocked(chain, Fault.JOINT_LIMIT, f"{where}, margin {margin_deg:g} deg")
    share *= min(1.0, float(allowed[worst]))
    return JointMotion(rates * share, share)


class CommandedRotation:
    """The rotation of the arm's end in the base frame as it was commanded, to be compared with the measured one.

    rotation: (3, 3), None until the first reading of the arm"""

    def __init__(self) -> None:
        self.rotation: FloatArray | None = None

    def advance(self, angular_rad_s: FloatArray, seconds: float, measured: FloatArray | None, *, follows: bool) -> None:
        """Turn the commanded rotation by the angular velocity (3,) that was sent [rad/s, base frame], over `seconds`.

        measured: (3, 3) newest rotation of the arm's end, None = no new one; the first becomes the commanded rotation
        follows: the caller steers by the measured rotation: the commanded one slowly follows it (FOLLOW_PER_S)"""
        if self.rotation is None:
            self.rotation = measured
            return
        turn = angular_rad_s * seconds
        if follows and measured is not None:
            turn = turn + FOLLOW_PER_S * seconds * rotation_vector(measured @ self.rotation.T)
        if np.any(turn):
            self.rotation = Rotation.from_rotvec(turn).as_matrix() @ self.rotation

    def back_rad_s(self, measured: FloatArray) -> FloatArray:
        """(3,) angular velocity, base frame [rad/s], from a measured rotation (3, 3) back to the commanded one."""
        if self.rotation is None:
            return np.zeros(3)
        return HOLD_PER_S * rotation_vector(self.rotation @ measured.T)


def _blocked(chain: Chain, fault: Fault, reason: str) -> JointMotion:
    return JointMotion(np.zeros(chain.joint_count), 0.0, fault, reason)
