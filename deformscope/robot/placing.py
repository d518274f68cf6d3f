"""How an arm brings a hand to a container: grasps drawn at random, of these one that the arm reaches on a free way.

Frames: the table's (z = 0 on it, upwards) is the surface frame of `Placement`, whose tip is the middle between the pads
in the hand's orientation (`hand_tool`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.capsule import Capsule, moved
from deformscope.rig.calibrated import CalibrationAge
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.rig.squeeze_sections import SqueezeSection
from deformscope.robot.checks import Check
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.placement import WAY_M, Placement, best_joints, lead, towards
from deformscope.robot.robot import Robot
from deformscope.robot.shape import LINK_RADIUS_M
from deformscope.robot.squeeze_plan import PALM_M, GripShape, RandomGrasp, hand_capsules
from deformscope.robot.supervisor import Limits
from deformscope.robot.travel import NotThere, in_box, move_joints, move_to
from deformscope_drivers.arm.kinematics import Chain, transform
from deformscope_drivers.sdh.kinematics import fingertips

SOFT_N, HARD_N = 1.5, 5.0
"""Felt by a finger's arrays while the arm moves, it is backed away from, and stopped at [N]: nothing is to be touched
on the way. Noise of arrays in the air comes to a tenth of the lower one; a higher one topples light containers."""
TABLE_M, AROUND_M, BESIDE_M = 0.008, 0.015, 0.003
"""Left between hand and table, between robot and container on the way, and between open fingers and container where
they go around it [m], each beside four deviations of where the container is. More refuses grasps that would do; less
meets what is a few millimetres beside where it was seen."""
FREE_M = 0.03
"""Between the fingertips and the container where the approach begins [m]: slow from there on."""
OVER_M = 0.15
"""A way that is not free is sought over a place so far above where the approach begins [m]."""
TRIES = 40
"""Grasps that are drawn at most: with one of ten within reach a drawing fails once in 70 times."""
STEP_DEG = 2.0
"""Between the joint angles that are looked at on a way: 2 cm of an arm half a metre long."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacingSetup:
    """The arm that places a hand. chain: of its joints; placement: of arm, table and hand; workspace: its limits; ages:
    of what was measured"""

    chain: Chain
    placement: Placement
    workspace: Workspace
    ages: dict[str, CalibrationAge]

    def limits(self, squeeze: SqueezeSection, camera_hz: float) -> Limits:
        """Those of exploring, with the lower forces of a hand that is to touch nothing."""
        limits = Limits.of(self.workspace, camera_hz)
        silent_s = squeeze.tactile_silent_s
        return replace(
            limits,
            soft_force_n=min(SOFT_N, limits.soft_force_n),
            hard_force_n=min(HARD_N, limits.hard_force_n),
            force_silent_s=silent_s,
            force_frozen_s=silent_s,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """A container that stands. T_table_container: (4, 4); size_m: (3,); doubt_m: of its place; round: a cylinder"""

    T_table_container: FloatArray
    size_m: FloatArray
    doubt_m: float
    round: bool = False

    def distance_m(self, capsules: Sequence[Capsule]) -> FloatArray:
        """(n,) from capsules of the table's frame to the container, below 0 = within."""
        shares = np.linspace(0.0, 1.0, 9)[:, None]
        points = np.stack([one.start_m + shares * (one.end_m - one.start_m) for one in capsules])
        own = np.abs((points - self.T_table_container[:3, 3]) @ self.T_table_container[:3, :3])
        if self.round:
            own = np.stack([np.linalg.norm(own[..., :2], axis=-1), own[..., 2]], axis=-1) - 0.5 * self.size_m[1:]
        else:
            own = own - 0.5 * self.size_m
        outside = np.linalg.norm(np.maximum(own, 0.0), axis=-1) + np.minimum(own.max(axis=-1), 0.0)
        return np.asarray(outside.min(axis=1) - [one.radius_m for one in capsules])


@dataclass(frozen=True, slots=True, eq=False)
class GraspPlan:
    """A grasp that is reached. before_m, there_m: (4, 4) of the tip where the approach begins and ends, table's frame

    joints_deg: (k, n) turned to one after the other, the last where the approach begins
    tried: all that were drawn; refused: of each why not, empty = this one; path_m: (m, 3) of the tip, table's frame
    """

    grasp: RandomGrasp
    before_m: FloatArray
    there_m: FloatArray
    joints_deg: FloatArray
    tried: tuple[RandomGrasp, ...]
    refused: tuple[str, ...]
    path_m: FloatArray


class NoGrasp(NotThere):
    """None of the grasps is reached. tried, refused: as of `GraspPlan`"""

    def __init__(self, tried: Sequence[RandomGrasp], refused: Sequence[str]) -> None:
        reasons = "; ".join(f"{refused.count(one)} {one}" for one in dict.fromkeys(refused))
        super().__init__("a grasp that the arm reaches", f"none of {len(tried)}: {reasons}", "the container elsewhere")
        self.tried, self.refused = tuple(tried), tuple(refused)


def hand_tool(T_arm_hand: FloatArray, grip: GripShape) -> Tool:
    """The hand as what the arm's placement calls its tool."""
    tip = T_arm_hand @ transform(np.eye(3), grip.middle_m)
    rows = tuple(tuple(map(float, row)) for row in tip)
    return Tool(tip="flat", T_ee_tip=rows, stick_radius_m=PALM_M)


def choose_grasp(
    setup: PlacingSetup,
    limits: Limits,
    grip: GripShape,
    start_deg: Sequence[float],
    obstacle: Obstacle,
    drawn: Sequence[RandomGrasp],
    meanwhile: Callable[[], None] = lambda: None,
) -> GraspPlan:
    """The first of some grasps that the arm reaches, its way free of container, table and the arm itself. Raises
    NoGrasp."""
    refused: list[str] = []
    for grasp in drawn:
        meanwhile()
        why, plan = _reached(setup, limits, grip, start_deg, obstacle, grasp)
        refused.append(why)
        if plan is not None:
            tried = tuple(drawn[: len(refused)])
            return replace(plan, tried=tried, refused=tuple(refused))
    raise NoGrasp(drawn, refused)


def carry(robot: Robot, plan: GraspPlan, phase: Callable[[str], None]) -> None:
    """Turn the joints to where the approach begins, and approach slowly. Raises as `travel.move_tip` does."""
    workspace_m_s = robot.supervisor.limits.speed_m_s / 2.0
    phase("travel")
    for joints_deg in plan.joints_deg:
        move_joints(robot, joints_deg)
    move_to(robot, plan.before_m, workspace_m_s)
    phase("approach")
    move_to(robot, plan.there_m, min(APPROACH_M_S, workspace_m_s))


def withdraw(robot: Robot, plan: GraspPlan, phase: Callable[[str], None]) -> None:
    """Slowly back to where the approach began. Raises as `carry` does."""
    phase("retreat")
    move_to(robot, plan.before_m, min(APPROACH_M_S, robot.supervisor.limits.speed_m_s / 2.0))


APPROACH_M_S = 0.02
"""Within `FREE_M` of the container, as a tip's in the last 3 cm: arrays that report 11 times a second at worst then see
2 mm between two frames. Slower, an approach of 12 cm takes longer than 6 s; faster, a container that is met topples."""


def plan_check(plan: GraspPlan) -> Check:
    """A row of the preflight: the way was looked at."""
    counts = {one: plan.refused.count(one) for one in plan.refused if one}
    others = "".join(f"; {count} {why}" for why, count in counts.items())
    way = f"a way of {len(plan.joints_deg)} turn{'s' * (len(plan.joints_deg) != 1)}, then straight{others}"
    return Check("place: way", True, "one that is free of container, table and arm", way)


def _reached(
    setup: PlacingSetup,
    limits: Limits,
    grip: GripShape,
    start_deg: Sequence[float],
    obstacle: Obstacle,
    grasp: RandomGrasp,
) -> tuple[str, GraspPlan | None]:
    """Why a grasp is not reached, or how."""
    chain, placement = setup.chain, setup.placement
    middle = transform(np.eye(3), grip.middle_m)
    there = obstacle.T_table_container @ np.linalg.inv(grasp.T_hand_container) @ middle
    hand = hand_capsules(np.array(grip.open_deg))
    # the hand's z axis leads to the container: back along it until the fingertips are free
    ahead_m = float(fingertips(grip.open_deg)[:, 2].max()) - grip.middle_m[2]
    half_m = 0.5 * float(np.abs(obstacle.T_table_container[:3, :3].T @ there[:3, 2]) @ obstacle.size_m)
    back_m = ahead_m + half_m + FREE_M
    before = np.asarray(there @ transform(np.eye(3), (0.0, 0.0, -back_m)), np.float64)
    T_center_hand = np.linalg.inv(middle)
    fingers = obstacle.distance_m(moved(hand, there @ T_center_hand))
    low_m = min(min(one.start_m[2], one.end_m[2]) - one.radius_m for one in moved(hand, there @ T_center_hand))
    if low_m < TABLE_M:
        return "into the table", None
    if fingers.min() < BESIDE_M + obstacle.doubt_m:
        return "open hand not clear of the container", None
    shares = np.linspace(0.0, 1.0, 1 + int(np.ceil(back_m / WAY_M)))
    tips = [before @ transform(np.eye(3), (0.0, 0.0, float(share) * back_m)) for share in shares]
    ends = np.array([placement.T_base_surface @ tip @ np.linalg.inv(placement.T_ee_center) for tip in tips])
    last_deg = best_joints(chain, [*ends[:: max(1, len(ends) // 4)], ends[-1]])
    if last_deg is None:
        return "out of reach", None
    led, _ = lead(chain, [ends], last_deg[None], np.array([True]))
    if not led[0]:
        return "near a joint's limit or a singularity", None
    centers_m = np.array([tip[:3, 3] for tip in tips])
    if not in_box(placement, limits, centers_m).all():
        return "outside the box of [workspace]", None
    way = _Way(setup, limits, hand, T_center_hand, obstacle)
    joints = last_deg
    for end in ends:
        joints = chain.inverse_near(end[None], joints[None])[0][0]
        if why := way.forbidden(joints[None], BESIDE_M):
            return f"approach {why}", None
    over = ends[0].copy()
    over[:3, 3] += OVER_M * placement.T_base_surface[:3, 2]
    high_deg, high = chain.inverse_near(over[None], last_deg[None])
    routes = [last_deg[None], *([np.stack([high_deg[0], last_deg])] if high[0] else [])]
    why = ""
    for route in routes:
        turned = way.turned(start_deg, route)
        why = way.forbidden(turned, AROUND_M)
        if not why:
            path = np.array([placement.T_surface_center(chain.end_effector(one))[:3, 3] for one in turned])
            return "", GraspPlan(grasp, before, there, route, (), (), np.concatenate([path, centers_m]))
    return f"way {why}", None


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """What joint angles of a way are looked at for. hand: capsules in its frame; T_center_hand: (4, 4)"""

    setup: PlacingSetup
    limits: Limits
    hand: Sequence[Capsule]
    T_center_hand: FloatArray
    obstacle: Obstacle

    def turned(self, start_deg: Sequence[float], route_deg: FloatArray) -> FloatArray:
        """(k, n) joint angles on the way over some (m, n), all joints turning evenly between two."""
        at = np.asarray(start_deg, dtype=float)
        found = [at[None]]
        for goal_deg in route_deg:
            turn = towards(at.tolist(), goal_deg, ~np.isfinite(self.setup.chain.upper_deg))
            steps = 1 + int(np.ceil(np.abs(turn).max() / STEP_DEG))
            found.append(at + np.linspace(0.0, 1.0, steps + 1)[1:, None] * turn)
            at = at + turn
        return np.concatenate(found)

    def forbidden(self, joints_deg: FloatArray, around_m: float) -> str:
        """Why the arm must not be at some of joint angles (k, n); empty = it may. around_m: kept from the container"""
        chain, placement, limits = self.setup.chain, self.setup.placement, self.limits
        clearance = ArmClearance(placement, chain.forward(chain.home_deg))
        around_m += self.obstacle.doubt_m
        for links in chain.forward(joints_deg):
            tip = placement.T_surface_center(links[-1])
            hand = moved(self.hand, tip @ self.T_center_hand)
            if min(min(one.start_m[2], one.end_m[2]) - one.radius_m for one in hand) < TABLE_M:
                return "leads the hand into the table"
            if clearance.over_table_m(links) < limits.table_m:
                return "leads the arm near the table"
            if clearance.to_itself_m(links) < limits.itself_m or clearance.in_box_m(links, limits.arm_box) < 0:
                return "leads the arm near itself, or out of its box"
            joints_m = (placement.T_surface_base @ links)[:, :3, 3]
            arm = [Capsule(a, b, LINK_RADIUS_M) for a, b in pairwise(joints_m)]
            if min(self.obstacle.distance_m(hand).min(), self.obstacle.distance_m(arm).min()) < around_m:
                return "leads to the container"
        centers_m = placement.T_surface_center(chain.forward(joints_deg)[:, -1])[:, :3, 3]
        inside = in_box(placement, limits, centers_m)
        return "" if inside[int(inside.argmax()) :].all() and inside[-1] else "leaves the box of [workspace]"
