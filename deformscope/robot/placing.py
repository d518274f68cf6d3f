"""Placing a hand at a container: random grasps, and of these one that the arm reaches on a free path.

Frames: the table's frame (z = 0 on it, upwards) is the surface frame of `Placement`. Its tip is the middle between the
pads in the hand's orientation (`hand_tool`)."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.rig.rig_file import Tool, Workspace
from deformscope.rig.sections import CalibrationAge, SqueezeSection
from deformscope.robot.checks import Check
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.description import link_capsules
from deformscope.robot.placement import WAY_M, Placement, best_joints, lead, towards
from deformscope.robot.robot import Robot
from deformscope.robot.squeeze_plan import PALM_M, GripShape, RandomGrasp, hand_capsules
from deformscope.robot.supervisor import Limits
from deformscope.robot.travel import NotThere, in_box, move_joints, move_to
from deformscope.solid import Capsule, moved, outside_m
from deformscope_drivers.arm.kinematics import Chain, pose_error, transform
from deformscope_drivers.sdh.kinematics import fingertips

SOFT_N, HARD_N = 1.5, 5.0
"""Force on a finger's arrays during the arm's motion from which the arm backs away, and stops [N]: the path is free of
contact. Noise of arrays in the air comes to a tenth of the lower one; a higher one topples light containers."""
TABLE_M, AROUND_M, BESIDE_M = 0.008, 0.015, 0.003
"""Clearance between hand and table, between robot and container on the path, and between open fingers and container
around the grasp [m]. To each, four standard deviations of the container's place are added. A larger one refuses usable
grasps; a smaller one hits a container that is some millimetres from its measured place."""
FREE_M = 0.03
"""Distance between fingertips and container at which the slow approach begins [m]."""
OVER_M = 0.15
"""If the direct way is not free, one is sought over a place this far above the beginning of the approach [m]."""
TRIES = 40
"""Most grasps that are drawn: if one of ten is within reach, a drawing fails once in 70 times."""
STAYED_M, STAYED_RAD, STAYED_DEG = 0.005, 0.035, 0.5
"""Largest distance of the hand from its placement, largest turn (half a centimetre at the fingertips), and largest
distance of each joint from the start of a planned path. A larger one permits other paths than the checked ones; with a
smaller one a settling arm counts as moved."""
BEGINS_AT_IT = "as the arm begins too near the container"
STEP_DEG = 2.0
"""Spacing of the checked joint angles on a path: 2 cm of an arm half a metre long."""


def _counted(refused: Sequence[str]) -> list[str]:
    return [f"{count} {why}" for why, count in Counter(filter(None, refused)).items()]


@dataclass(frozen=True, slots=True, eq=False)
class PlacingSetup:
    """The arm that places a hand. chain: its joints; placement: arm, table and hand; workspace: its limits"""

    chain: Chain
    placement: Placement
    workspace: Workspace
    ages: dict[str, CalibrationAge]

    def limits(self, squeeze: SqueezeSection, camera_hz: float) -> Limits:
        """The limits of exploring, with the lower forces of a hand that must not touch anything."""
        limits = Limits.of(self.workspace, camera_hz)
        silent_s = squeeze.tactile_silent_s
        return replace(
            limits,
            soft_force_n=min(SOFT_N, limits.soft_force_n),
            hard_force_n=min(HARD_N, limits.hard_force_n),
            force_silent_s=silent_s,
            force_frozen_s=silent_s,
            axes_rest=True,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """A container on the table. T_table_container: (4, 4); size_m: (3,); doubt_m: uncertainty; round: a cylinder"""

    T_table_container: FloatArray
    size_m: FloatArray
    doubt_m: float
    round: bool = False

    def distance_m(self, capsules: Sequence[Capsule]) -> FloatArray:
        """(n,) from capsules of the table's frame to the container, below 0 = within."""
        shares = np.linspace(0.0, 1.0, 9)[:, None]
        points = np.stack([one.start_m + shares * (one.end_m - one.start_m) for one in capsules])
        own = (points - self.T_table_container[:3, 3]) @ self.T_table_container[:3, :3]
        apart = outside_m(own, 0.5 * self.size_m, round=self.round).min(axis=1)
        return np.asarray(apart - [one.radius_m for one in capsules])


@dataclass(frozen=True, slots=True, eq=False)
class GraspPlan:
    """A grasp that is reached. before_m, there_m: (4, 4) poses of the tip at the approach's ends, table's frame

    start_deg: (n,) joint angles from which it was planned; joints_deg: (k, n) successive joint angles, the last at the
    beginning of the approach; tried: all grasps that were drawn; refused: for each, why it is refused, empty = this
    one; path_m: (m, 3) path of the tip, table's frame"""

    grasp: RandomGrasp
    before_m: FloatArray
    there_m: FloatArray
    start_deg: FloatArray
    joints_deg: FloatArray
    tried: tuple[RandomGrasp, ...]
    refused: tuple[str, ...]
    path_m: FloatArray


class NoGrasp(NotThere):
    """The arm reaches none of the grasps. tried, refused: as in `GraspPlan`"""

    def __init__(self, tried: Sequence[RandomGrasp], refused: Sequence[str]) -> None:
        came = f"none of {len(tried)}: {'; '.join(_counted(refused))}"
        super().__init__("a grasp that the arm reaches", came, "the container elsewhere")
        self.tried, self.refused = tuple(tried), tuple(refused)


def hand_tool(T_arm_hand: FloatArray, grip: GripShape) -> Tool:
    """The hand as a tool of the arm's placement."""
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
) -> GraspPlan:
    """The first grasp that the arm reaches on a path free of container, table and itself. Raises NoGrasp."""
    ways = _Ways(setup, limits, grip, np.asarray(start_deg, dtype=float), obstacle)
    if ways.apart_m(setup.chain.forward(ways.start_deg)) < AROUND_M + obstacle.doubt_m:
        raise NoGrasp(drawn[:1], [BEGINS_AT_IT])
    refused: list[str] = []
    for grasp in drawn:
        found = ways.to(grasp)
        refused.append(found if isinstance(found, str) else "")
        if not isinstance(found, str):
            return replace(found, tried=tuple(drawn[: len(refused)]), refused=tuple(refused))
    raise NoGrasp(drawn, refused)


def carry(robot: Robot, plan: GraspPlan, phase: Callable[[str], None]) -> None:
    """Turn the joints to the beginning of the approach, and approach slowly. Raises as `travel.move_tip` does."""
    workspace_m_s = robot.supervisor.limits.speed_m_s / 2.0
    phase("travel")
    for joints_deg in plan.joints_deg:
        move_joints(robot, joints_deg)
    move_to(robot, plan.before_m, workspace_m_s)
    phase("approach")
    move_to(robot, plan.there_m, min(APPROACH_M_S, workspace_m_s))


def withdraw(robot: Robot, plan: GraspPlan, phase: Callable[[str], None]) -> None:
    """Move slowly back to the beginning of the approach. Raises the errors of `carry`."""
    phase("retreat")
    move_to(robot, plan.before_m, min(APPROACH_M_S, robot.supervisor.limits.speed_m_s / 2.0))


APPROACH_M_S = 0.02
"""Speed limit within `FREE_M` of the container, as for a tip in the last 3 cm: arrays that report 11 times a second
then advance 2 mm between two frames. With a lower speed, an approach of 12 cm takes longer than 6 s; with a higher one,
a container that is hit topples."""


def strayed(robot: Robot, plan: GraspPlan) -> str:
    """Distance of the hand from its placement; empty within the limits."""
    error = pose_error(
        np.asarray(robot.placement.T_surface_center(robot.pose.T_base_ee)), np.asarray(plan.there_m, np.float64)
    )
    off_m, turned_rad = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    if off_m <= STAYED_M and turned_rad <= STAYED_RAD:
        return ""
    return f"{1e3 * off_m:.0f} mm and {np.degrees(turned_rad):.0f} deg from the hand's first pose"


def plan_checks(plan: GraspPlan, robot: Robot) -> tuple[Check, Check]:
    """Rows of the preflight: the path was checked, and begins at the arm's pose."""
    turned = towards(robot.pose.joints_deg, plan.start_deg, ~np.isfinite(robot.arm.chain.upper_deg))
    off_deg = float(np.abs(turned).max())
    wanted = f"joints within {STAYED_DEG:g} deg of the path's start"
    begins = Check("place: start", off_deg <= STAYED_DEG, wanted, f"{off_deg:.1f} deg")
    turns = f"a way of {len(plan.joints_deg)} turn{'s' * (len(plan.joints_deg) != 1)}, then straight"
    way = "; ".join([turns, *_counted(plan.refused)])
    return Check("place: way", True, "one that is free of container, table and arm", way), begins


@dataclass(frozen=True, eq=False)
class _Ways:
    """Paths from an arm's pose to grasps. start_deg: (n,) joint angles"""

    setup: PlacingSetup
    limits: Limits
    grip: GripShape
    start_deg: FloatArray
    obstacle: Obstacle

    def to(self, grasp: RandomGrasp) -> str | GraspPlan:
        """The path to a grasp, or the reason against it."""
        chain, placement, grip, obstacle = self.setup.chain, self.setup.placement, self.grip, self.obstacle
        there = obstacle.T_table_container @ np.linalg.inv(grasp.T_hand_container) @ self._T_hand_center
        # the hand's z axis leads to the container: back along it until the fingertips are free
        ahead_m = float(fingertips(grip.open_deg)[:, 2].max()) - grip.middle_m[2]
        half_m = 0.5 * float(np.abs(obstacle.T_table_container[:3, :3].T @ there[:3, 2]) @ obstacle.size_m)
        back_m = ahead_m + half_m + FREE_M
        if self._low_m(there) < TABLE_M:
            return "into the table"
        if obstacle.distance_m(self._hand(there)).min() < BESIDE_M + obstacle.doubt_m:
            return "open hand not clear of the container"
        shares = np.linspace(-1.0, 0.0, 1 + int(np.ceil(back_m / WAY_M)))
        tips = [there @ transform(np.eye(3), (0.0, 0.0, float(share) * back_m)) for share in shares]
        ends = np.array([placement.T_base_surface @ tip @ np.linalg.inv(placement.T_ee_center) for tip in tips])
        last_deg = best_joints(chain, [*ends[:: max(1, len(ends) // 4)], ends[-1]])
        if last_deg is None:
            return "out of reach"
        led, _ = lead(chain, [ends], last_deg[None], np.array([True]))
        if not led[0]:
            return "near a joint's limit or a singularity"
        centers_m = np.array([tip[:3, 3] for tip in tips])
        if not in_box(placement, self.limits, centers_m).all():
            return "outside the box of [workspace]"
        joints = [last_deg]
        for end in ends:
            joints.append(chain.inverse_near(end[None], joints[-1][None])[0][0])
        if why := self._forbidden(np.array(joints), BESIDE_M):
            return f"approach {why}"
        over = ends[0].copy()
        over[:3, 3] += OVER_M * placement.T_base_surface[:3, 2]
        high_deg, high = chain.inverse_near(over[None], last_deg[None])
        for route in (last_deg[None], *([np.stack([high_deg[0], last_deg])] if high[0] else [])):
            turned = self._turned(route)
            why = self._forbidden(turned, AROUND_M)
            if not why:
                path = placement.T_surface_center(chain.forward(turned)[:, -1])[:, :3, 3]
                path = np.concatenate([path, centers_m])
                return GraspPlan(grasp, tips[0], there, self.start_deg, route, (), (), path)
        return f"way {why}"

    @cached_property
    def _T_hand_center(self) -> FloatArray:
        return transform(np.eye(3), self.grip.middle_m)

    @cached_property
    def _of_center(self) -> list[Capsule]:
        return moved(hand_capsules(np.array(self.grip.open_deg)), np.linalg.inv(self._T_hand_center))

    def _hand(self, T_table_center: FloatArray) -> list[Capsule]:
        """Capsules of the open hand, with the middle between its pads at that place."""
        return moved(self._of_center, T_table_center)

    def _low_m(self, T_table_center: FloatArray) -> float:
        """Height of the hand's lowest point."""
        return min(float(min(one.start_m[2], one.end_m[2])) - one.radius_m for one in self._hand(T_table_center))

    def apart_m(self, T_base_links: FloatArray) -> float:
        """Between container and arm, the hand among it. T_base_links: (n + 1, 4, 4)"""
        placement = self.setup.placement
        arm = link_capsules(np.asarray(T_base_links, np.float64), placement.T_surface_base)
        hand = self._hand(placement.T_surface_center(T_base_links[-1]))
        return float(self.obstacle.distance_m([*arm, *hand]).min())

    def _turned(self, route_deg: FloatArray) -> FloatArray:
        """(k, n) joint angles on the way over some (m, n), all joints turning evenly between two."""
        at, found = self.start_deg, [self.start_deg[None]]
        for goal_deg in route_deg:
            turn = towards(at.tolist(), goal_deg, ~np.isfinite(self.setup.chain.upper_deg))
            steps = 1 + int(np.ceil(np.abs(turn).max() / STEP_DEG))
            found.append(at + np.linspace(0.0, 1.0, steps + 1)[1:, None] * turn)
            at = at + turn
        return np.concatenate(found)

    def _forbidden(self, joints_deg: FloatArray, around_m: float) -> str:
        """Why the arm must not be at some of joint angles (k, n); empty = it may. around_m: of the container"""
        chain, placement, limits = self.setup.chain, self.setup.placement, self.limits
        clearance, frames = ArmClearance(placement, chain.forward(chain.home_deg)), chain.forward(joints_deg)
        tips = placement.T_surface_center(frames[:, -1])
        for links, tip in zip(frames, tips, strict=True):
            if self._low_m(tip) < TABLE_M:
                return "leads the hand into the table"
            if clearance.over_table_m(links) < limits.table_m:
                return "leads the arm near the table"
            if clearance.to_itself_m(links) < limits.itself_m or clearance.in_box_m(links, limits.arm_box) < 0:
                return "leads the arm near itself, or out of its box"
            if self.apart_m(links) < around_m + self.obstacle.doubt_m:
                return "leads to the container"
        inside = in_box(placement, limits, tips[:, :3, 3])  # it may come in from outside
        return "" if inside[int(inside.argmax()) :].all() and inside[-1] else "leaves the box of [workspace]"
