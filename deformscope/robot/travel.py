"""Paths through free air, as a sequence of velocities; the supervisor checks every control period."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray
from deformscope.errors import InputError
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.latch import Action
from deformscope.robot.placement import TURNED_RAD, Placement, best_joints, follow, towards
from deformscope.robot.robot import JointRates, Robot, TipVelocity
from deformscope.robot.supervisor import Limits
from deformscope_drivers.arm.kinematics import Chain, FloatArray, pose_error

ANGULAR_RAD_S = 0.3
"""Greatest angular speed of the arm's end during travel: 17 deg/s, below half of `Limits.turn_deg_s` (40 deg/s), the
limit of velocities. Faster, a late state of the arm stops it; slower, ways that turn the tool take longer."""
JOINT_DEG_S = 15.0
"""Greatest rate of travel joint by joint: below the driver's standard limit of 20 deg/s, so that no joint is slowed and
all arrive together. Slower, the first way takes longer: half a turn takes 12 s."""
PATIENCE = 200
"""Number of control periods without progress, after which joints count as unable to reach their target."""
GAIN_PER_S = 4.0
"""Share of the remaining distance that is commanded a second: the last of a way takes some 1/4 s for each factor e.
A larger one overshoots where an arm follows late (share times delay must stay far below 1, and is 0.04 for a control
period); a smaller one makes every path end more slowly."""
REACHED_M, REACHED_RAD, REACHED_DEG = 3e-4, 3e-3, 0.1
"""Within these a pose counts as reached. With a smaller distance than an arm's small steps it never arrives, and the
path fails (`SLACK`, `PATIENCE`). With a larger one, the touch begins away from its plan; 0.3 mm is well below a
camera's 2 mm uncertainty."""
PASSED_M, PASSED_RAD = 3e-3, 0.05
"""Within these a point in between counts as passed. Wider cuts corners, which is why ways lead higher by this
(`find_way`); closer, the arm slows down at each of them."""
SAG_M = 0.01
"""Joint by joint the tip may go this far below the height at which it crosses, because such a path is not straight.
With a larger value, it may hit objects on the surface; with a smaller one, more places are left out because no path
leads there."""
SLACK = 3.0
"""Time limit of a path as a multiple of its planned time, plus two seconds."""


class NotThere(InputError):
    """The arm cannot reach, or did not reach, its target."""


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
    """Move straight to the pose with the tip's centre (3,) [m] here and the stick along -normal, surface frame.

    passing: the tip continues from there, so that it need not arrive exactly; near_m: otherwise it arrives within this
    distance; braking_per_s: see `TouchPlan`. Raises NotThere when late, RobotStopped, InputError on backing off."""
    goal = robot.placement.T_surface_base @ robot.placement.T_base_ee(center_m, normal)
    goal = goal @ robot.placement.T_ee_center
    move_to(robot, goal, speed_m_s, passing=passing, near_m=near_m, braking_per_s=braking_per_s)


def move_to(
    robot: Robot,
    goal: npt.NDArray[np.floating],
    speed_m_s: float,
    *,
    passing: bool = False,
    near_m: float = REACHED_M,
    braking_per_s: float | None = None,
) -> None:
    """Move as `move_tip`, to a pose (4, 4) of the tip in the surface frame [m]."""
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
    raise NotThere(f"the tip at {np.round(goal[:3, 3], 4)} m", left, "a place that the arm reaches")


def move_joints(robot: Robot, joints_deg: npt.ArrayLike) -> None:
    """Move to joint angles (n,), all arriving together. Start and path are not checked: use it only in free air.

    Raises the errors of `move_tip`."""
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
    raise NotThere("joints at their commanded angles", f"{np.max(np.abs(turn)):.1f} deg away", "a free way")


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
    """Move to a place above the surface: up to height_m, across at this height or above, and down.

    The path is straight if the arm can follow it. The first time, and where a straight path leads near a joint's limit
    or a singularity, joint by joint: other joint angles for the same pose are then sought.
    height_m: z of the tip's centre while it crosses; deepest_m: (3,) end of a following straight path [m, surface
    frame]; passing_m: distance from the place that is near enough; braking_per_s: as in `TouchPlan`. Raises NotThere if
    neither is possible: before it moves, or high above its start."""
    way = find_way(
        robot.arm.chain,
        robot.placement,
        robot.supervisor.limits,
        robot.pose.joints_deg,
        center_m,
        normal,
        height_m=height_m,
        deepest_m=deepest_m,
        clearance=robot.clearance,
        meanwhile=robot.keep_up,
    )
    straight = way.joints_deg is None
    if way.up_m is not None:
        stick = -robot.placement.T_surface_center(robot.pose.T_base_ee)[:3, 2]
        move_tip(robot, way.up_m, stick, speed_m_s, passing=straight, braking_per_s=braking_per_s)
    if way.joints_deg is not None:
        move_joints(robot, way.joints_deg)
    elif way.over_m[2] > float(center_m[2]) + REACHED_M:
        move_tip(robot, way.over_m, normal, speed_m_s, passing=True, braking_per_s=braking_per_s)
    move_tip(robot, center_m, normal, speed_m_s, near_m=max(REACHED_M, passing_m), braking_per_s=braking_per_s)


@dataclass(frozen=True, slots=True, eq=False)
class TravelWay:
    """Path of `to_above`. up_m: (3,) place above its start, None = it does not go up first; over_m: (3,) place above
    the target [m, surface frame]; joints_deg: (n,) angles to turn to from there, None = straight across"""

    up_m: FloatArray | None
    over_m: FloatArray
    joints_deg: FloatArray | None


def find_way(
    chain: Chain,
    placement: Placement,
    limits: Limits,
    start_deg: npt.ArrayLike,
    center_m: FloatArray,
    normal: FloatArray,
    *,
    height_m: float,
    deepest_m: FloatArray,
    clearance: ArmClearance | None = None,
    meanwhile: Callable[[], None] = lambda: None,
) -> TravelWay:
    """The path of `to_above`, from joint angles (n,), within the supervisor's limits. Raises NotThere without."""
    T_base_ee = chain.end_effector(np.asarray(start_deg))
    here, goal = placement.T_surface_center(T_base_ee), placement.T_base_ee(center_m, normal)
    stick = -here[:3, 2]
    high_m = max(height_m, float(center_m[2]))
    over = np.array([center_m[0], center_m[1], high_m])
    up = np.array([here[0, 3], here[1, 3], high_m + PASSED_M])
    followed = follow(
        chain,
        placement,
        np.array([up, over, center_m, deepest_m]),
        np.array([stick, normal, normal, normal]),
        start_deg=start_deg,
        meanwhile=meanwhile,
    )
    up_free = bool(followed[0] and in_box(placement, limits, up[None])[0])
    turned = np.linalg.norm(pose_error(T_base_ee, goal)[3:]) > TURNED_RAD
    as_touches = (
        stick[2] > 0.5
        and float(np.linalg.norm(pose_error(T_base_ee, placement.T_base_ee(here[:3, 3], stick))[3:])) < TURNED_RAD
    )  # as touches leave it
    up_m = up if here[2, 3] < high_m else None
    straight, places = up_free and followed.all() and (not turned or as_touches), (over, center_m, deepest_m)
    joints_deg = None
    if turned or not straight:
        joints_deg = best_joints(chain, [placement.T_base_ee(one, normal) for one in places])
    if not straight and (joints_deg is None or not (turned or up_free)):
        raise _no_way((up, *places)[int(followed.argmin())], NEAR_LIMITS)
    outside = ~in_box(placement, limits, np.array(places))
    if outside.any():
        raise _no_way(places[int(outside.argmax())], "outside the box of [workspace]")
    if joints_deg is None:
        return TravelWay(up_m, over, None)
    first = bool(turned and not as_touches)  # from wherever it was left
    lowest_m, turn_deg = min(float(here[2, 3]), high_m) if first else high_m, np.asarray(start_deg, dtype=float)
    if up_m is not None and not first:
        turn_deg = chain.inverse_near(placement.T_base_ee(up_m, stick)[None], turn_deg[None])[0][0]
    why = _forbidden(chain, placement, limits, clearance, turn_deg, joints_deg, lowest_m - SAG_M)
    if why and not straight:
        raise _no_way(over, why)
    return TravelWay(None if first else up_m, over, None if why else joints_deg)


def in_box(placement: Placement, limits: Limits, centers_m: FloatArray) -> BoolArray:
    """(n,) whether the tip's centre may be at places (n, 3) [m, surface frame], moving at half the greatest speed."""
    if limits.low_m is None or limits.high_m is None:
        return np.ones(len(centers_m), dtype=bool)
    base_m = np.array([placement.point_in_base_m(place_m) for place_m in centers_m])
    margin_m = limits.look_ahead_s * 0.5 * limits.speed_m_s
    inside = (base_m >= np.array(limits.low_m) + margin_m) & (base_m <= np.array(limits.high_m) - margin_m)
    return np.asarray(inside.all(axis=1))


def _forbidden(
    chain: Chain,
    placement: Placement,
    limits: Limits,
    clearance: ArmClearance | None,
    start_deg: npt.ArrayLike,
    joints_deg: FloatArray,
    lowest_m: float,
) -> str:
    """Why the joints must not turn evenly from angles (n,) to others; empty where they may."""
    turn = towards(np.asarray(start_deg).tolist(), joints_deg, ~np.isfinite(chain.upper_deg))
    share = np.linspace(0.0, 1.0, 1 + math.ceil(float(np.max(np.abs(turn)))))[:, None]
    frames = chain.forward(np.asarray(start_deg) + share * turn)
    centers_m = placement.T_surface_center(frames[:, -1])[:, :3, 3]
    inside = in_box(placement, limits, centers_m)
    if not inside[int(inside.argmax()) :].all() or not inside[-1]:  # it may come in from outside
        return "whose path leaves the box of [workspace]"
    if centers_m[:, 2].min() < lowest_m:
        return "whose path goes below the surface"
    if clearance is not None:
        table_m = min(map(clearance.over_table_m, frames))
        itself_m = min(map(clearance.to_itself_m, frames))
        box_m = min(clearance.in_box_m(one, limits.arm_box) for one in frames)
        if table_m < limits.table_m or itself_m < limits.itself_m or box_m < 0:
            return "whose path brings the arm near the table or itself, or out of its box"
    return ""


NEAR_LIMITS = "whose path leads near a joint's limit or a singularity"


def _no_way(to_m: FloatArray, why: str) -> NotThere:
    came = f"a place at {np.round(to_m, 3)} m, {why}"
    return NotThere("a path that the arm can follow", came, "another place, or move arm or surface")


def step(robot: Robot, command: TipVelocity | JointRates) -> None:
    """Send one velocity. Raises InputError, at rest, when the supervisor demands that the robot back off."""
    if robot.supervisor.verdict.action is Action.GO_ON:  # it may have changed while a way was checked
        robot.cycle(command)
    verdict = robot.supervisor.verdict
    if verdict.action is not Action.GO_ON:
        robot.cycle()
        raise InputError("nothing in the way", f"{verdict.fault}: {verdict.reason}", "look, then acknowledge")


def _error(robot: Robot, goal: npt.NDArray[np.floating]) -> FloatArray:
    """(6,) translation [m] and rotation vector [rad] from the tip's pose to a goal (4, 4), in the surface frame."""
    return pose_error(robot.placement.T_surface_center(robot.pose.T_base_ee), np.asarray(goal, np.float64))


def capped(error: FloatArray, fastest: float, braking_per_s: float | None = None) -> FloatArray:
    """A velocity (3,) along and in proportion to an error (3,), at most `fastest`. braking_per_s: see `TouchPlan`"""
    wanted = (braking_per_s or GAIN_PER_S) * error
    size = float(np.linalg.norm(wanted))
    return wanted if size <= fastest else wanted * (fastest / size)
