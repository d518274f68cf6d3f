"""What an arm can be asked to do, checked before anything is sent, and the trajectory points that say it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope_drivers.errors import OutOfLimits
from deformscope_drivers.jaco import kinematics
from deformscope_drivers.jaco.config import JacoConfig
from deformscope_drivers.jaco.kinematics import Chain, FloatArray
from deformscope_drivers.jaco.structures import (
    FINGER_CLOSED,
    FINGER_COUNT,
    AngularInfo,
    CartesianInfo,
    FingersPosition,
    HandMode,
    PositionType,
    TrajectoryPoint,
)

Vector3 = tuple[float, float, float]
JOINT_MARGIN_DEG, NEGLIGIBLE_DEG_S = 5.0, 0.01
DAMPED_BELOW, OFF_COURSE = 0.03, 0.1
"""Smallest singular value [m/rad; rad/rad] that is inverted in full; share of a velocity that damping may take."""


@dataclass(frozen=True, slots=True)
class CartesianVelocity:
    """Velocity of the end effector as the arm takes it, in two frames.

    linear_m_s: (3,) in the base frame; angular_rad_s: (3,) about the axes of the end effector's own frame, which turn
    with it (Kinova's staff, kinova-ros issues 154 and 192; ViSP's driver agrees). `in_base` converts.
    """

    linear_m_s: Vector3
    angular_rad_s: Vector3 = (0.0, 0.0, 0.0)

    @classmethod
    def in_base(
        cls, linear_m_s: npt.ArrayLike, angular_rad_s: npt.ArrayLike, T_base_end_effector: npt.ArrayLike
    ) -> CartesianVelocity:
        """The same for a velocity (3,) and an angular velocity (3,) that are both in the base frame.

        T_base_end_effector: (4, 4) where the end effector is now: convert again as it turns
        """
        rotation = np.asarray(T_base_end_effector, dtype=float)[:3, :3]
        x, y, z = (float(value) for value in np.asarray(linear_m_s, dtype=float))
        about_x, about_y, about_z = (float(value) for value in rotation.T @ np.asarray(angular_rad_s, dtype=float))
        return cls((x, y, z), (about_x, about_y, about_z))


@dataclass(frozen=True, slots=True)
class JointVelocity:
    """rates_deg_s: (n,) a rate for each joint [deg/s]."""

    rates_deg_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CartesianTarget:
    """Pose of the end effector in the base frame: position_m (3,), theta_rad (3,) about x, the new y, the new z."""

    position_m: Vector3
    theta_rad: Vector3


@dataclass(frozen=True, slots=True)
class JointTarget:
    """joints_deg: (n,) an angle for each joint [deg]."""

    joints_deg: tuple[float, ...]


Velocity = CartesianVelocity | JointVelocity
Target = CartesianTarget | JointTarget


def check_velocity(velocity: Velocity, chain: Chain, config: JacoConfig, where: str) -> None:
    """Raise OutOfLimits unless every number is finite and no speed is above the configured limit."""
    if isinstance(velocity, JointVelocity):
        rates = finite("joint rates", velocity.rates_deg_s, chain.joint_count, where)
        for joint, (rate, limit) in enumerate(zip(rates, joint_limits_deg_s(chain, config), strict=True), 1):
            _at_most(f"rate of joint {joint}", abs(rate), float(limit), "deg/s", "joint_limit_deg_s", where)
        return
    linear = finite("linear velocity", velocity.linear_m_s, 3, where)
    angular = finite("angular velocity", velocity.angular_rad_s, 3, where)
    _at_most("linear speed", math.hypot(*linear), config.linear_limit_m_s, "m/s", "linear_limit_m_s", where)
    _at_most("angular speed", math.hypot(*angular), config.angular_limit_rad_s, "rad/s", "angular_limit_rad_s", where)


def joint_limits_deg_s(chain: Chain, config: JacoConfig) -> FloatArray:
    """(n,) the greatest rate of each joint that a command may ask for [deg/s]: as configured, never beyond its own."""
    return np.minimum(chain.velocity_deg_s, config.joint_limit_deg_s)


def check_target(target: Target, chain: Chain, config: JacoConfig, start_deg: Sequence[float], where: str) -> None:
    """Raise OutOfLimits unless the target is finite, within the joints' ranges and the workspace, and reachable."""
    if isinstance(target, JointTarget):
        joints = finite("joint angles", target.joints_deg, chain.joint_count, where)
        if not chain.within_limits(joints):
            ranges = [f"{low:g}..{high:g}" for low, high in zip(chain.lower_deg, chain.upper_deg, strict=True)]
            raise OutOfLimits(f"joints within {', '.join(ranges)} deg", f"{joints}", "", where)
        x, y, z = chain.end_effector(joints)[:3, 3]
        position = (float(x), float(y), float(z))
    else:
        x, y, z = finite("position", target.position_m, 3, where)
        thetas = finite("rotation", target.theta_rad, 3, where)
        position = (x, y, z)
        pose = kinematics.transform(kinematics.rotation_from_euler_xyz(*thetas), position)
        found = chain.inverse(pose, start_deg, position_tolerance_m=1e-3, rotation_tolerance_rad=1e-2)
        if not found.converged:
            raise OutOfLimits(
                "a pose that the joints can reach",
                f"one that stays {found.position_error_m * 1e3:.3g} mm and {found.rotation_error_rad:.3g} rad away",
                "a pose nearer to the base, or another rotation of the hand",
                where,
            )
    if config.workspace is not None and not config.workspace.contains(position):
        raise OutOfLimits(
            f"a position between {config.workspace.low_m} and {config.workspace.high_m} m",
            f"{tuple(round(value, 4) for value in position)}",
            "a target within the workspace, or a larger workspace in the configuration",
            where,
        )


def check_fingers(fingers: Sequence[float], where: str) -> tuple[float, ...]:
    """Raise OutOfLimits unless there are three finite positions from 0 (open) to 6800 (closed)."""
    values = finite("finger positions", fingers, FINGER_COUNT, where)
    if min(values) < 0 or max(values) > FINGER_CLOSED:
        raise OutOfLimits(f"fingers from 0 (open) to {FINGER_CLOSED:g} (closed)", f"{values}", "", where)
    return values


def finite(what: str, values: Sequence[float], count: int, where: str) -> tuple[float, ...]:
    """The values as floats; raises OutOfLimits unless there are that many and all are finite."""
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise OutOfLimits(f"{count} finite {what}", f"{numbers}", "", where)
    return numbers


def _at_most(what: str, value: float, limit: float, unit: str, setting: str, where: str) -> None:
    if value > limit * (1 + 1e-9):
        raise OutOfLimits(f"{what} up to {limit:g} {unit}", f"{value:.4g}", f"slower, or a higher {setting}", where)


def velocity_point(velocity: Velocity) -> TrajectoryPoint:
    """The point that asks for a velocity during one cycle of the arm (the device sends those of joints alone)."""
    point = TrajectoryPoint()
    if isinstance(velocity, JointVelocity):
        point.Position.Type = PositionType.ANGULAR_VELOCITY
        point.Position.Actuators = AngularInfo(*velocity.rates_deg_s)
    else:
        point.Position.Type = PositionType.CARTESIAN_VELOCITY
        point.Position.CartesianPosition = CartesianInfo(*velocity.linear_m_s, *velocity.angular_rad_s)
    return point


def by_joints(velocity: Velocity, chain: Chain, config: JacoConfig, joints_deg: Sequence[float]) -> JointVelocity | str:
    """The joint rates that make a velocity at these joint angles (n,) [deg], or why there are none.

    After motion by joints the arm ignores Cartesian velocities of its own without a word (kinova-ros issue 269), so
    none is sent. What the arm's own mode guards is guarded here: no joint is faster than it may be (all are slowed
    alike), none comes within JOINT_MARGIN_DEG of the end of its range, and where damping near a singularity would take
    the hand off its way there is no motion. That the arm does not hit itself is not looked at.
    """
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
        return f"the hand would have left its way by {100 * lost:.0f} %: a singularity is near"
    rates_deg_s = np.degrees(rates_rad_s)
    way_deg = np.where(rates_deg_s > 0, chain.upper_deg - joints, joints - chain.lower_deg)
    near = (way_deg < JOINT_MARGIN_DEG) & (np.abs(rates_deg_s) > NEGLIGIBLE_DEG_S)
    if near.any():
        joint = int(np.argmax(near))
        return f"joint {joint + 1} at {joints[joint]:.1f} deg came within {JOINT_MARGIN_DEG:g} deg of its limit"
    fastest = max(1.0, float(np.max(np.abs(rates_deg_s) / joint_limits_deg_s(chain, config))))
    return JointVelocity(tuple(float(rate) for rate in rates_deg_s / fastest))


def target_point(target: Target, config: JacoConfig) -> TrajectoryPoint:
    """The point that sends the arm to a target, at the configured speed limits."""
    point = TrajectoryPoint()
    point.LimitationsActive = 1
    if isinstance(target, JointTarget):
        point.Position.Type = PositionType.ANGULAR_POSITION
        point.Position.Actuators = AngularInfo(*target.joints_deg)
        point.Limitations.speedParameter1 = point.Limitations.speedParameter2 = config.joint_limit_deg_s
    else:
        point.Position.Type = PositionType.CARTESIAN_POSITION
        point.Position.CartesianPosition = CartesianInfo(*target.position_m, *target.theta_rad)
        point.Limitations.speedParameter1 = config.linear_limit_m_s
        point.Limitations.speedParameter2 = config.angular_limit_rad_s
    return point


def fingers_point(fingers: Sequence[float], joints_deg: Sequence[float], config: JacoConfig) -> TrajectoryPoint:
    """The point that moves the fingers while the joints are commanded to stay where they are."""
    point = target_point(JointTarget(tuple(joints_deg)), config)
    point.Position.HandMode = HandMode.POSITION
    point.Position.Fingers = FingersPosition(*fingers)
    return point


def linear_velocity_of(velocity: Velocity, chain: Chain, joints_deg: Sequence[float]) -> Vector3:
    """Velocity of the end effector in the base frame (3,) [m/s] that a command means at these joint angles."""
    if isinstance(velocity, CartesianVelocity):
        return velocity.linear_m_s
    x, y, z = (chain.jacobian(joints_deg) @ np.radians(velocity.rates_deg_s))[:3]
    return float(x), float(y), float(z)


def rotation_between(theta_rad: Vector3, other_rad: Vector3) -> float:
    """Angle [rad] between two rotations given as the vendor does."""
    one, other = kinematics.rotation_from_euler_xyz(*theta_rad), kinematics.rotation_from_euler_xyz(*other_rad)
    return float(np.linalg.norm(kinematics.rotation_vector(one.T @ other)))
