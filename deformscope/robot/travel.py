"""Ways through free air, one velocity after the other, each control period supervised."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray
from deformscope.errors import InputError
from deformscope.robot.placement import TURNED_RAD, best_joints, follow, towards
from deformscope.robot.robot import JointRates, Robot, TipVelocity
from deformscope.robot.supervisor import Action
from deformscope_drivers.arm.kinematics import FloatArray, pose_error

ANGULAR_RAD_S = 0.3
"""Greatest turn of the end while travelling. Chosen."""
JOINT_DEG_S = 15.0
"""Greatest rate while travelling joint by joint: below the driver's standard limit of 20 deg/s. Chosen."""
PATIENCE = 200
"""Control periods without coming nearer, after which joints count as not coming where they are sent."""
GAIN_PER_S = 4.0
"""Share of the remaining distance that is commanded a second. Chosen."""
REACHED_M, REACHED_RAD, REACHED_DEG = 3e-4, 3e-3, 0.1
"""Within these a pose counts as reached. Chosen."""
PASSED_M, PASSED_RAD = 3e-3, 0.05
"""Within these a point in between counts as passed. Chosen."""
SAG_M = 0.01
"""Joint by joint the tip may sink by so much below the height at which it crosses. Chosen."""
SLACK = 3.0
"""A way may take so many times longer than its length says, and two seconds, before it counts as not possible."""


class NotThere(InputError):
    """The arm did not come to where it was sent."""


def move_tip(
    robot: Robot,
    center_m: npt.ArrayLike,
    normal: npt.ArrayLike,
    speed_m_s: float,
    *,
    passing: bool = False,
    near_m: float = REACHED_M,
    braking_per_s: float | None = None,
) -> None:
    """Straight to where the tip's centre (3,) [m] is here and the stick along -normal, both in the surface frame.

    passing: it goes on from there, so that near is enough; near_m: else so near; braking_per_s: as of `TouchPlan`
    Raises NotThere when it takes too long, RobotStopped, InputError when the robot has to back off.
    """
    goal = robot.placement.T_surface_base @ robot.placement.T_base_ee(center_m, normal)
    goal = goal @ robot.placement.T_ee_center
    near_m, near_rad = (PASSED_M, PASSED_RAD) if passing else (near_m, REACHED_RAD)
    error = _error(robot, goal)
    way_s = max(float(np.linalg.norm(error[:3])) / speed_m_s, float(np.linalg.norm(error[3:])) / ANGULAR_RAD_S)
    for _ in range(round(100 * (SLACK * way_s + 2.0))):
        error = _error(robot, goal)
        if np.linalg.norm(error[:3]) < near_m and np.linalg.norm(error[3:]) < near_rad:
            if not passing:
                robot.cycle()
            return
        step(robot, TipVelocity(capped(error[:3], speed_m_s, braking_per_s), capped(error[3:], ANGULAR_RAD_S)))
    robot.cycle()
    left = f"{np.linalg.norm(error[:3]) * 1e3:.1f} mm and {np.linalg.norm(error[3:]):.3f} rad away"
    raise NotThere(f"the tip at {np.round(np.asarray(center_m), 4)} m", left, "a place that the arm reaches")


def move_joints(robot: Robot, joints_deg: npt.ArrayLike) -> None:
    """To joint angles (n,), all arriving together; where from and by what way is not looked at: only through free air.

    Raises as `move_tip` does.
    """
    endless = ~np.isfinite(robot.arm.chain.upper_deg)
    turn = towards(robot.pose.joints_deg, joints_deg, endless)
    nearest, patience = math.inf, PATIENCE
    while patience > 0:
        turn = towards(robot.pose.joints_deg, joints_deg, endless)
        farthest = float(np.max(np.abs(turn)))
        if farthest < REACHED_DEG:
            robot.cycle()
            return
        # slower where tip or tool would be too fast: the robot sees to it
        nearest, patience = (farthest, PATIENCE) if farthest < nearest - REACHED_DEG else (nearest, patience - 1)
        step(robot, JointRates(turn / farthest * min(JOINT_DEG_S, GAIN_PER_S * farthest)))
    robot.cycle()
    raise NotThere("the joints where they were sent", f"{np.max(np.abs(turn)):.1f} deg away", "a free way")


def to_above(
    robot: Robot,
    center_m: FloatArray,
    normal: FloatArray,
    *,
    height_m: float,
    deepest_m: FloatArray,
    speed_m_s: float,
    passing_m: float = 0.0,
    braking_per_s: float | None = None,
) -> None:
    """To a place above the surface: up to height_m, across no lower, and down to it.

    Straight where the arm can follow; joint by joint the first time, and where a straight way leads near a joint's
    limit or a singularity: its other joint angles for the same pose are then sought.
    height_m: z of the tip's centre while it crosses; deepest_m: (3,) where a straight way goes on to from there [m,
    surface frame]; passing_m: so near the place is near enough; braking_per_s: as of `TouchPlan`.
    Raises NotThere where neither is possible: before it moves, or high above where it was.
    """
    here = robot.placement.T_surface_center(robot.pose.T_base_ee)
    goal = robot.placement.T_base_ee(center_m, normal)
    high_m = max(height_m, float(center_m[2]))
    over = np.array([center_m[0], center_m[1], high_m])
    up = np.array([here[0, 3], here[1, 3], high_m + PASSED_M])
    places = [robot.placement.T_base_ee(place_m, normal) for place_m in (over, center_m, deepest_m)]
    if np.linalg.norm(pose_error(robot.pose.T_base_ee, goal)[3:]) > TURNED_RAD:
        joints_deg = best_joints(robot.arm.chain, places)
        if joints_deg is None:
            where = f"the tip at {np.round(over, 4)} m"
            raise NotThere(where, "no joint angles for it", "a place that the arm reaches")
        move_joints(robot, joints_deg)
    else:
        straight = _followed(robot, np.array([here[:3, 3], up, over, center_m, deepest_m]), normal)
        joints_deg = None if straight.all() else best_joints(robot.arm.chain, places)
        if not straight.all() and (joints_deg is None or not straight[0]):
            raise _no_way((up, over, center_m, deepest_m)[int(straight.argmin())])
        if here[2, 3] < high_m:
            move_tip(robot, up, -here[:3, 2], speed_m_s, passing=joints_deg is None, braking_per_s=braking_per_s)
        if joints_deg is not None:
            if lowest_m(robot, joints_deg) < high_m - SAG_M:
                raise _no_way(over)
            move_joints(robot, joints_deg)
        elif high_m > float(center_m[2]) + REACHED_M:
            move_tip(robot, over, normal, speed_m_s, passing=True, braking_per_s=braking_per_s)
    move_tip(robot, center_m, normal, speed_m_s, near_m=max(REACHED_M, passing_m), braking_per_s=braking_per_s)


def lowest_m(robot: Robot, joints_deg: npt.ArrayLike) -> float:
    """Least z of the tip's centre [m, surface frame] while all joints turn evenly to angles (n,)."""
    turn = towards(robot.pose.joints_deg, joints_deg, ~np.isfinite(robot.arm.chain.upper_deg))
    share = np.linspace(0.0, 1.0, 1 + math.ceil(float(np.max(np.abs(turn)))))[:, None]
    poses = robot.arm.chain.forward(np.asarray(robot.pose.joints_deg) + share * turn)[:, -1]
    return float(robot.placement.T_surface_center(poses)[:, 2, 3].min())


def _followed(robot: Robot, centers_m: FloatArray, normal: FloatArray) -> BoolArray:
    """(n - 1,) whether the arm can follow a straight way from place to place (n, 3) [m, surface frame] as it stands."""
    here, there = -robot.placement.T_surface_center(robot.pose.T_base_ee)[:3, 2], normal
    return follow(
        robot.arm.chain,
        robot.placement,
        centers_m[1:],
        np.array([here, here, *[there] * (len(centers_m) - 2)])[1:],
        start_deg=robot.pose.joints_deg,
        meanwhile=robot.keep_up,
    )


def _no_way(to_m: FloatArray) -> NotThere:
    came = f"a way to {np.round(to_m, 3)} m that leads near a joint's limit or a singularity"
    return NotThere("a way that the arm can follow", came, "another place, or move arm or surface")


def step(robot: Robot, command: TipVelocity | JointRates) -> None:
    """One period on the way; a robot that has to back off is not to travel on."""
    if robot.supervisor.verdict.action is Action.GO_ON:  # it may have changed while a way was checked
        robot.cycle(command)
    verdict = robot.supervisor.verdict
    if verdict.action is not Action.GO_ON:
        robot.cycle()
        raise InputError("nothing in the way", f"{verdict.fault}: {verdict.reason}", "look, then acknowledge")


def _error(robot: Robot, goal: FloatArray) -> FloatArray:
    return pose_error(robot.placement.T_surface_center(robot.pose.T_base_ee), goal)


def capped(error: FloatArray, fastest: float, braking_per_s: float | None = None) -> FloatArray:
    """A velocity that ends softly; braking_per_s: as of `TouchPlan`"""
    wanted = (braking_per_s or GAIN_PER_S) * error
    size = float(np.linalg.norm(wanted))
    return wanted if size <= fastest else wanted * (fastest / size)
