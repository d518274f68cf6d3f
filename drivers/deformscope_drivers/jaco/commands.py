"""Commands of an arm, checked before anything is sent, and their trajectory points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope_drivers.arm import kinematics
from deformscope_drivers.arm.commands import JointVelocity, Vector3, Velocity, finite
from deformscope_drivers.arm.kinematics import Chain
from deformscope_drivers.errors import OutOfLimits
from deformscope_drivers.jaco import structures
from deformscope_drivers.jaco.config import JacoConfig


@dataclass(frozen=True, slots=True)
class CartesianTarget:
    """Pose of the end effector in the base frame: position_m (3,), theta_rad (3,) about x, the new y, the new z."""

    position_m: Vector3
    theta_rad: Vector3


@dataclass(frozen=True, slots=True)
class JointTarget:
    """joints_deg: (n,) an angle for each joint [deg]."""

    joints_deg: tuple[float, ...]


Target = CartesianTarget | JointTarget


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
            away = f"{found.position_error_m * 1e3:.3g} mm and {found.rotation_error_rad:.3g} rad away"
            advice = "a pose nearer to the base, or another rotation of the hand"
            raise OutOfLimits("a pose that the joints can reach", f"one that stays {away}", advice, where)
    if config.workspace is not None and not config.workspace.contains(position):
        expected = f"a position between {config.workspace.low_m} and {config.workspace.high_m} m"
        advice = "a target within the workspace, or a larger workspace in the configuration"
        raise OutOfLimits(expected, f"{tuple(round(value, 4) for value in position)}", advice, where)


def check_fingers(fingers: Sequence[float], where: str) -> tuple[float, ...]:
    """Raise OutOfLimits unless there are three finite positions from 0 (open) to 6800 (closed)."""
    values = finite("finger positions", fingers, structures.FINGER_COUNT, where)
    if min(values) < 0 or max(values) > structures.FINGER_CLOSED:
        raise OutOfLimits(f"fingers from 0 (open) to {structures.FINGER_CLOSED:g} (closed)", f"{values}", "", where)
    return values


def velocity_point(velocity: Velocity) -> structures.TrajectoryPoint:
    """The point that asks for a velocity during one cycle of the arm (the device sends those of joints alone)."""
    point = structures.TrajectoryPoint()
    if isinstance(velocity, JointVelocity):
        point.Position.Type = structures.PositionType.ANGULAR_VELOCITY
        point.Position.Actuators = structures.AngularInfo(*velocity.rates_deg_s)
    else:
        point.Position.Type = structures.PositionType.CARTESIAN_VELOCITY
        point.Position.CartesianPosition = structures.CartesianInfo(*velocity.linear_m_s, *velocity.angular_rad_s)
    return point


def target_point(target: Target, config: JacoConfig) -> structures.TrajectoryPoint:
    """The point that sends the arm to a target, at the configured speed limits."""
    point = structures.TrajectoryPoint()
    point.LimitationsActive = 1
    if isinstance(target, JointTarget):
        point.Position.Type = structures.PositionType.ANGULAR_POSITION
        point.Position.Actuators = structures.AngularInfo(*target.joints_deg)
        point.Limitations.speedParameter1 = point.Limitations.speedParameter2 = config.joint_limit_deg_s
    else:
        point.Position.Type = structures.PositionType.CARTESIAN_POSITION
        point.Position.CartesianPosition = structures.CartesianInfo(*target.position_m, *target.theta_rad)
        point.Limitations.speedParameter1 = config.linear_limit_m_s
        point.Limitations.speedParameter2 = config.angular_limit_rad_s
    return point


def fingers_point(
    fingers: Sequence[float], joints_deg: Sequence[float], config: JacoConfig
) -> structures.TrajectoryPoint:
    """The point that moves the fingers while the joints are commanded to stay where they are."""
    point = target_point(JointTarget(tuple(joints_deg)), config)
    point.Position.HandMode = structures.HandMode.POSITION
    point.Position.Fingers = structures.FingersPosition(*fingers)
    return point


def rotation_between(theta_rad: Vector3, other_rad: Vector3) -> float:
    """Angle [rad] between two rotations given as the vendor does."""
    one, other = kinematics.rotation_from_euler_xyz(*theta_rad), kinematics.rotation_from_euler_xyz(*other_rad)
    return float(np.linalg.norm(kinematics.rotation_vector(one.T @ other)))
