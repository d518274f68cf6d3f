"""Ways through free air, one velocity after the other, each control period supervised."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.robot.placement import TURNED_RAD, best_joints, follow, towards
from deformscope.robot.robot import JointRates, Robot, TipVelocity
from deformscope.robot.supervisor import Action
from deformscope_drivers.jaco.kinematics import FloatArray, pose_error

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
) -> None:
    """Straight to where the tip's centre (3,) [m] is here and the stick along -normal, both in the surface frame.

    passing: it goes on from there, so that near is enough. Raises NotThere when it takes too long, RobotStopped,
    InputError when the robot has to back off.
    """
    goal = robot.placement.T_surface_base @ robot.placement.T_base_ee(center_m, normal)
    goal = goal @ robot.placement.T_ee_center
    near_m, near_rad = (PASSED_M, PASSED_RAD) if passing else (REACHED_M, REACHED_RAD)
    error = _error(robot, goal)
    way_s = max(float(np.linalg.norm(error[:3])) / speed_m_s, float(np.linalg.norm(error[3:])) / ANGULAR_RAD_S)
    for _ in range(round(100 * (SLACK * way_s + 2.0))):
        error = _error(robot, goal)
        if np.linalg.norm(error[:3]) < near_m and np.linalg.norm(error[3:]) < near_rad:
            if not passing:
                robot.cycle()
            return
        step(robot, TipVelocity(_capped(error[:3], speed_m_s), _capped(error[3:], ANGULAR_RAD_S)))
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
    robot: Robot, center_m: FloatArray, normal: FloatArray, *, height_m: float, deepest_m: FloatArray, speed_m_s: float
) -> None:
    """To a place above the surface: up to height_m, across no lower, and down to it; the first time joint by joint.

    height_m: z of the tip's centre while it crosses; deepest_m: (3,) where a straight way goes on to from there [m,
    surface frame]. Raises NotThere, before it moves, where a way leads near a joint's limit or a singularity.
    """
    here = robot.placement.T_surface_center(robot.pose.T_base_ee)
    goal = robot.placement.T_base_ee(center_m, normal)
    turn = pose_error(robot.pose.T_base_ee, goal)[3:]
    high_m = max(height_m, float(center_m[2]))
    over = np.array([center_m[0], center_m[1], high_m])
    if np.linalg.norm(turn) > TURNED_RAD:
        joints_deg = best_joints(
            robot.arm.chain, [robot.placement.T_base_ee(place_m, normal) for place_m in (over, center_m, deepest_m)]
        )
        if joints_deg is None:
            raise NotThere(
                f"the tip at {np.round(over, 4)} m", "no joint angles for it", "a place that the arm reaches"
            )
        move_joints(robot, joints_deg)
    else:
        up = np.array([here[0, 3], here[1, 3], high_m + PASSED_M])
        _require_clear(robot, np.array([here[:3, 3], up, over, center_m, deepest_m]), normal)
        if here[2, 3] < high_m:
            move_tip(robot, up, -here[:3, 2], speed_m_s, passing=True)
        if high_m > float(center_m[2]) + REACHED_M:
            move_tip(robot, over, normal, speed_m_s, passing=True)
    move_tip(robot, center_m, normal, speed_m_s)


def _require_clear(robot: Robot, centers_m: FloatArray, normal: FloatArray) -> None:
    """That the arm can follow straight ways from place to place (n, 3) [m, surface frame] as it stands."""
    here, there = -robot.placement.T_surface_center(robot.pose.T_base_ee)[:3, 2], normal
    normals = np.array([here, here, *[there] * (len(centers_m) - 2)])
    led = follow(
        robot.arm.chain,
        robot.placement,
        centers_m[1:],
        normals[1:],
        start_deg=robot.pose.joints_deg,
        meanwhile=robot.keep_up,
    )
    if not led.all():
        where = np.round(centers_m[1:][~led][0], 3)
        came = f"a way to {where} m that leads near a joint's limit or a singularity"
        raise NotThere("a way that the arm can follow straight", came, "another place, or move arm or surface")


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


def _capped(error: FloatArray, fastest: float) -> FloatArray:
    """A velocity that ends softly."""
    wanted = GAIN_PER_S * error
    size = float(np.linalg.norm(wanted))
    return wanted if size <= fastest else wanted * (fastest / size)
