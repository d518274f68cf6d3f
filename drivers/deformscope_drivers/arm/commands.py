"""The possible velocities of an arm, checked before anything is sent."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.kinematics import Chain, FloatArray
from deformscope_drivers.errors import OutOfLimits

Vector3 = tuple[float, float, float]
JOINT_MARGIN_DEG, NEGLIGIBLE_DEG_S = 5.0, 0.01
"""Least distance of a joint from its range's end [deg]; slower than this [deg/s] it is at rest: 1e-4 deg in 10 ms."""
DAMPED_BELOW = 0.03
"""Smallest singular value of the Jacobian [m/rad; rad/rad] that is inverted in full. Least singular value below which
motions are damped. Above it, joints at 20 deg/s (the driver's standard limit) move the arm's end by at least 0.03 *
0.35 rad/s = 10 mm/s, the speed of a touch, in every direction. Below it, the weakest direction is damped. Below it the
weakest direction is slower than any touch, and damped."""
OFF_COURSE = 0.1
"""Share of a velocity that damping may lose or turn away: a straight line may lead through a singularity if it does not
need the weak direction."""


class SpeedLimits(Protocol):
    """Speed limits of an arm's commands; its configuration has them.

    linear_limit_m_s, angular_limit_rad_s: largest speeds of the end effector; joint_limit_deg_s: joint
    limit of any joint, whose own limit holds besides; command_deadline_s: default duration of a velocity"""

    @property
    def linear_limit_m_s(self) -> float: ...

    @property
    def angular_limit_rad_s(self) -> float: ...

    @property
    def joint_limit_deg_s(self) -> float: ...

    @property
    def command_deadline_s(self) -> float: ...


@dataclass(frozen=True, slots=True)
class CartesianVelocity:
    """Velocity of the end effector as the arm takes it, in two frames.

    linear_m_s: (3,) velocity in the base frame; angular_rad_s: (3,) about the axes of the end effector's own frame,
    which turn with it (Kinova's staff, kinova-ros issues 154 and 192; ViSP's driver agrees). `in_base` converts."""

    linear_m_s: Vector3
    angular_rad_s: Vector3 = (0.0, 0.0, 0.0)

    @classmethod
    def in_base(
        cls, linear_m_s: npt.ArrayLike, angular_rad_s: npt.ArrayLike, T_base_end_effector: npt.ArrayLike
    ) -> "CartesianVelocity":
        """The same for a velocity (3,) and an angular velocity (3,) that are both in the base frame.
        T_base_end_effector: (4, 4) present pose of the end effector: convert again when it turns"""
        rotation = np.asarray(T_base_end_effector, dtype=float)[:3, :3]
        x, y, z = (float(value) for value in np.asarray(linear_m_s, dtype=float))
        about_x, about_y, about_z = (float(value) for value in rotation.T @ np.asarray(angular_rad_s, dtype=float))
        return cls((x, y, z), (about_x, about_y, about_z))


@dataclass(frozen=True, slots=True)
class JointVelocity:
    """rates_deg_s: (n,) a rate for each joint [deg/s]."""

    rates_deg_s: tuple[float, ...]


Velocity = CartesianVelocity | JointVelocity


def check_velocity(velocity: Velocity, chain: Chain, limits: SpeedLimits, where: str) -> None:
    """Raise OutOfLimits unless every number is finite and no speed is above the configured limit."""
    if isinstance(velocity, JointVelocity):
        rates = finite("joint rates", velocity.rates_deg_s, chain.joint_count, where)
        for joint, (rate, limit) in enumerate(zip(rates, joint_limits_deg_s(chain, limits), strict=True), 1):
            _at_most(f"rate of joint {joint}", abs(rate), float(limit), "deg/s", "joint_limit_deg_s", where)
        return
    linear = finite("linear velocity", velocity.linear_m_s, 3, where)
    angular = finite("angular velocity", velocity.angular_rad_s, 3, where)
    _at_most("linear speed", math.hypot(*linear), limits.linear_limit_m_s, "m/s", "linear_limit_m_s", where)
    _at_most("angular speed", math.hypot(*angular), limits.angular_limit_rad_s, "rad/s", "angular_limit_rad_s", where)


def joint_limits_deg_s(chain: Chain, limits: SpeedLimits) -> FloatArray:
    """(n,) the greatest rate of each joint that a command may ask for [deg/s]: as configured, never beyond its own."""
    return np.minimum(chain.velocity_deg_s, limits.joint_limit_deg_s)


def by_joints(
    velocity: Velocity, chain: Chain, limits: SpeedLimits, joints_deg: Sequence[float]
) -> JointVelocity | str:
    """The joint rates of a velocity at these joint angles (n,) [deg], or why there are none.

    No arm is sent Cartesian velocities: their behaviour near limits and singularities is not published. Therefore this
    function has the guards. No joint exceeds its limit (all are slowed by the same factor), or comes within
    JOINT_MARGIN_DEG of the end of its range. If damping near a singularity would move the hand off its path, there is
    no motion. Self-collision is not checked."""
    if isinstance(velocity, JointVelocity):
        return velocity
    if not all(map(math.isfinite, joints_deg)):
        return "the joint angles that the arm reports are not numbers"
    joints, links = np.asarray(joints_deg), chain.forward(joints_deg)
    jacobian = kinematics.jacobian_of(links)
    twist = np.concatenate([velocity.linear_m_s, links[-1, :3, :3] @ velocity.angular_rad_s])
    rates_rad_s = kinematics.damped_joint_rates(jacobian, twist, DAMPED_BELOW)
    lost = float(kinematics.off_course(jacobian, rates_rad_s, twist))
    if lost > OFF_COURSE:
        return f"the hand would have left its path by {100 * lost:.0f} %: a singularity is near"
    rates_deg_s = np.degrees(rates_rad_s)
    way_deg = np.where(rates_deg_s > 0, chain.upper_deg - joints, joints - chain.lower_deg)
    near = (way_deg < JOINT_MARGIN_DEG) & (np.abs(rates_deg_s) > NEGLIGIBLE_DEG_S)
    if near.any():
        joint = int(np.argmax(near))
        return f"joint {joint + 1} at {joints[joint]:.1f} deg was within {JOINT_MARGIN_DEG:g} deg of its limit"
    fastest = max(1.0, float(np.max(np.abs(rates_deg_s) / joint_limits_deg_s(chain, limits))))
    return JointVelocity(tuple(float(rate) for rate in rates_deg_s / fastest))


def linear_velocity_of(velocity: Velocity, chain: Chain, joints_deg: Sequence[float]) -> Vector3:
    """Velocity of the end effector in the base frame (3,) [m/s] that a command means at these joint angles."""
    if isinstance(velocity, CartesianVelocity):
        return velocity.linear_m_s
    x, y, z = (chain.jacobian(joints_deg) @ np.radians(velocity.rates_deg_s))[:3]
    return float(x), float(y), float(z)


def finite(what: str, values: Sequence[float], count: int, where: str) -> tuple[float, ...]:
    """The values as floats; raises OutOfLimits unless there are that many and all are finite."""
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise OutOfLimits(f"{count} finite {what}", f"{numbers}", "", where)
    return numbers


def _at_most(what: str, value: float, limit: float, unit: str, setting: str, where: str) -> None:
    if value > limit * (1 + 1e-9):
        raise OutOfLimits(f"{what} up to {limit:g} {unit}", f"{value:.4g}", f"slower, or a higher {setting}", where)
