"""Random layouts of arm and table: how far joints stay inside their ranges as an arm touches there, and how it slows
down before singularities.

Each seed draws an arm, the table's pose relative to it, and a stick; then some touches, as `explore` makes them: a
table of checks, paths to above each place, the touch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.errors import InputError
from deformscope.lab.arm_contact import ARM_STIFFNESS_N_M
from deformscope.lab.arms import arm_in_lab
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import check
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.supervisor import Fault, Limits, SafetyDecision
from deformscope.robot.touch import TouchEnding, TouchPlan, run_touch
from deformscope_drivers.arm.kinematics import (
    Chain,
    FloatArray,
    jacobian_of,
    least_singular,
    rotation_from_rpy,
    transform,
)
from deformscope_drivers.arms import chains
from deformscope_drivers.jaco import JacoConfig, JacoDouble
from deformscope_drivers.jaco.chains import CHAINS as JACO
from deformscope_drivers.kuka import KukaConfig, KukaDouble
from deformscope_drivers.memory import SimulatedClock
from studies.fault_study import ACCELERATION_DEG_S2
from studies.springy_foam import SpringyFoam

SIZE_M, TOP_M = (0.6, 0.4), 0.05
MODULUS_PA = 60e3
TOUCHES = 3
LOOK_EVERY = 5
"""Control periods between two checks of the distance to a singularity."""
SINGULAR_BELOW = 0.006
"""Smallest singular value that counts as a singularity [m/rad; rad/rad]: between two checks 1 deg apart it changes by
about this much where it goes through zero."""
WALK_DEG = np.arange(0.0, 16.0)
NEAR_DEG = (5.0, 10.0, 15.0)
"""Ends of the distances to a singularity by which shares are counted."""


@dataclass(frozen=True, slots=True)
class LayoutRun:
    """seed: seed of everything; arm: its model; refused: why it may not begin there, empty where it began

    endings: how each touch ended; faults: faults of those that were stopped; refused_touches: not begun, for lack of a
    path
    margin_deg: least of a joint to the end of its range in any of the arm's cycles, from when the robot might move
    near: (deg to a singularity along the motion, by a walk in steps of 1 deg, and sent share of the requested
    velocity), near of periods in which an arm leads its tip and has a singularity within the walk
    far: how many looks have none, and their mean share"""

    seed: int
    arm: str
    refused: str = ""
    endings: tuple[TouchEnding, ...] = ()
    faults: tuple[Fault, ...] = ()
    refused_touches: int = 0
    margin_deg: float = float("inf")
    near: tuple[tuple[float, float], ...] = ()
    far: tuple[int, float] = (0, 0.0)


def run_layout(seed: int) -> LayoutRun:
    """Three touches at random places of the table that a seed draws."""
    random = np.random.default_rng([seed, 0x1A])
    model = str(random.choice(list(chains())))
    tool = Tool(length_m=float(random.uniform(0.08, 0.2)))
    placement = Placement(_table(random), tool)
    places_m = np.append(random.uniform(0.1, 0.9, (TOUCHES, 2)) * SIZE_M, np.full((TOUCHES, 1), TOP_M), axis=1)
    plans = [TouchPlan(place_m, np.array([0.0, 0.0, 1.0]), travel_height_m=TOP_M + 0.07) for place_m in places_m]
    clock = SimulatedClock(1_000_000_000)
    driver, config = (
        ("jaco", JacoConfig(state_hz=100.0, model=model)) if model in JACO else ("kuka", KukaConfig(model=model))
    )
    try:
        arm = arm_in_lab(driver, config, placement, [places_m[0] + (0.0, 0.0, 0.1)], clock, seed)
    except InputError:
        return LayoutRun(seed, model, "no joint angles for its first place")
    if isinstance(arm.body, JacoDouble):
        arm.body.accelerate(ACCELERATION_DEG_S2)
    foam = SpringyFoam(MODULUS_PA, (0.0, 0.0, TOP_M), (0.0, 0.0, 1.0), tool)
    lab = TouchLab(foam, clock, tool=tool, T_base_surface=placement.T_base_surface, arm=arm, seed=seed)
    with lab:
        limits = Limits(low_m=(-2.0, -2.0, -2.0), high_m=(2.0, 2.0, 2.0))
        robot = Robot(lab.arm, lab.force, placement, limits, clock=clock, wait_until=lab.wait_until)
        robot.compliance_m_per_n = 1.0 / ARM_STIFFNESS_N_M
        try:
            preflight = check(robot, plans[:1], calibrated={})
        except RobotStopped as stopped:
            return LayoutRun(seed, model, str(stopped.verdict.fault))
        if not preflight.passed:
            return LayoutRun(seed, model, ", ".join(one.name for one in preflight.checks if not one.passed))
        robot.let_move(preflight)
        looks = _Looks(robot)
        robot.watch = looks
        margins_deg: list[float] = []
        body = arm.body
        assert isinstance(body, JacoDouble | KukaDouble)
        lab.on_cycle = lambda: margins_deg.append(float(robot.arm.chain.to_limits_deg(body.joints_deg).min()))
        endings, faults, refused = _touches(robot, plans)
        return LayoutRun(seed, model, "", endings, faults, refused, min(margins_deg), looks.near, looks.far)


def _table(random: np.random.Generator) -> FloatArray:
    """(4, 4) a table whose middle is 0.3 to 0.7 m from the arm's foot, 0.2 m lower to 0.2 m higher, turned."""
    away_m, azimuth = random.uniform(0.3, 0.7), random.uniform(0.0, 2.0 * np.pi)
    turned = rotation_from_rpy(0.0, 0.0, float(random.uniform(0.0, 2.0 * np.pi)))
    middle = np.array([away_m * np.cos(azimuth), away_m * np.sin(azimuth), random.uniform(-0.2, 0.2)])
    return transform(turned, middle - turned @ (0.5 * SIZE_M[0], 0.5 * SIZE_M[1], 0.0))


def _touches(robot: Robot, plans: Sequence[TouchPlan]) -> tuple[tuple[TouchEnding, ...], tuple[Fault, ...], int]:
    """The end of each, until one was stopped; the faults of those; number of touches without a path."""
    endings: list[TouchEnding] = []
    faults: list[Fault] = []
    refused = 0
    for plan in plans:
        record = run_touch(robot, plan)
        endings.append(record.ending)
        refused += record.ending is TouchEnding.NOT_REACHED
        if record.fault is not Fault.NONE:
            faults.append(record.fault)
            break
    return tuple(endings), tuple(faults), refused


class _Looks:
    """Watches how far a singularity is, and what share of its velocity the robot sends."""

    def __init__(self, robot: Robot) -> None:
        self._looks: list[tuple[float, float]] = []
        self._robot, self._periods = robot, 0
        self._before: FloatArray | None = None

    def __call__(self, seen: RobotObservation, verdict: SafetyDecision) -> None:
        self._periods += 1
        joints_deg = np.array(self._robot.pose.joints_deg)
        before, self._before = self._before, joints_deg
        if self._periods % LOOK_EVERY or before is None or not self._robot.moving or np.isnan(self._robot.share):
            return
        turned_deg = joints_deg - before
        fastest = float(np.abs(turned_deg).max())
        if fastest > 1e-3:
            walked = walk_to_singularity_deg(self._robot.arm.chain, joints_deg, turned_deg / fastest)
            self._looks.append((walked, self._robot.share))

    @property
    def near(self) -> tuple[tuple[float, float], ...]:
        """As in `LayoutRun`."""
        return tuple(look for look in self._looks if np.isfinite(look[0]))

    @property
    def far(self) -> tuple[int, float]:
        """As in `LayoutRun`."""
        shares = [share for walked, share in self._looks if not np.isfinite(walked)]
        return len(shares), float(np.mean(shares)) if shares else 0.0


def walk_to_singularity_deg(chain: Chain, joints_deg: FloatArray, direction: FloatArray) -> float:
    """Angle of the fastest joint along joint rates (n,), the fastest 1, until the arm is singular, in steps of 1 deg;
    inf beyond the last step."""
    least = least_singular(jacobian_of(chain.forward(joints_deg + WALK_DEG[:, None] * direction)))
    there = np.flatnonzero(least < SINGULAR_BELOW)
    return float(WALK_DEG[there[0]]) if len(there) else float("inf")


def shares_by_distance(runs: Sequence[LayoutRun]) -> dict[float, tuple[int, float]]:
    """How many looks, and their mean share, by the end of each stretch of NEAR_DEG, and of those farther away (inf)."""
    near = np.array([one for run in runs for one in run.near]).reshape(-1, 2)
    found: dict[float, tuple[int, float]] = {}
    low = -1.0
    for high in NEAR_DEG:
        shares = near[(near[:, 0] > low) & (near[:, 0] <= high), 1]
        found[high] = len(shares), float(shares.mean()) if len(shares) else np.nan
        low = high
    far = np.array([run.far for run in runs]).reshape(-1, 2)
    looks = float(far[:, 0].sum())
    found[float("inf")] = int(looks), float(far[:, 0] @ far[:, 1] / looks) if looks else np.nan
    return found
