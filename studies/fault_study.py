"""Faults at random moments of simulated touches: when each is detected, and when the arm is at rest.

Each run has its own foam, tip, tilt, moment and fault, all drawn from its seed, and goes through the real drivers."""

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.lab.arm_contact import ARM_CYCLE_NS
from deformscope.lab.faults import ARM, CAMERA, FORCE, Injected, inject
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.latch import Action
from deformscope.robot.placement import Placement, best_joints, follow
from deformscope.robot.preflight import check
from deformscope.robot.readings import PERIOD_NS, RobotObservation
from deformscope.robot.robot import Robot
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope.robot.supervisor import Fault, Limits, SafetyDecision
from deformscope.robot.touch import TouchPlan, run_touch
from deformscope_drivers.arm.kinematics import FloatArray, rotation_vector
from deformscope_drivers.depth_camera.synthetic import View
from deformscope_drivers.errors import NotStopped
from deformscope_drivers.jaco.chains import J2N6S300
from studies.reach import reach
from studies.springy_foam import SpringyFoam

BOX_LOW_M, BOX_HIGH_M = (-0.40, -0.65, 0.02), (0.40, -0.08, 0.40)
"""In the arm's base frame: the air over the table."""
FOAM_TOP_M = 0.08
VIEW_SHAPE = (12, 16)
AFTER_S = 0.5
ACCELERATION_DEG_S2 = 200.0
"""Largest acceleration of a Jaco's joints, as Kinova's staff read it in the base's firmware (kinova-ros issue 380)."""
TORQUE_NOISE_NM, GRAVITY_LEFT = 0.15, 0.1
"""Noise of its joint torques without gravity: deviation, and the share of gravity's that is left in them. Chosen; real
ones show 1 to 3 N at the hand where nothing touches (kinova-ros issues 366, 411)."""
GREATEST_TILT_DEG = 20.0
MODULI_PA = (10e3, 1e9)


ALLOWED_S = {**dict.fromkeys(FORCE, 0.05), **dict.fromkeys(ARM, 0.1), **dict.fromkeys(CAMERA, 2 / 30)}
"""Time limits of detection. A camera's two frame periods count from when its pictures matter; an arm that turns on its
own, or whose angles are frozen, counts from its first motion."""
AS_IT_MOVES = (Injected.ARM_TURNS, Injected.ARM_FROZEN)
UNSEEN_M = 0.002
"""An arm whose angles are frozen and that hardly moves may be detected later, but before its tip has moved by this
undetected: a fifth of a tip's radius. Its force is seen all the while."""
TURNED_DEG = 6.0
"""An arm that turns on its own is detected by its angle, not by time: by the 5 deg from the command that the supervisor
allows, and by its rotation in 30 ms."""
ENDED_WITHIN_S = 2 * ARM_CYCLE_NS / 1e9


@dataclass(frozen=True, slots=True)
class Standstill:
    """From when a fault was noticed until no joint turned. nan = it never stood

    seconds; tip_m: way of the tip's centre; turned_deg: turn of the joint that turned most"""

    seconds: float = math.nan
    tip_m: float = math.nan
    turned_deg: float = math.nan


@dataclass(frozen=True, slots=True)
class ArmCycle:
    """One of a simulated arm's cycles, as it ends: joints_deg, rates_deg_s (n,), and points that wait in it"""

    time_ns: int
    joints_deg: FloatArray
    rates_deg_s: FloatArray
    waiting: int

    @classmethod
    def of(cls, lab: TouchLab) -> "ArmCycle":
        """Now."""
        double = lab.arm_double
        return cls(lab.clock(), double.joints_deg, double.rates_deg_s, double.fifo_count)


@dataclass(frozen=True, slots=True)
class FaultRun:
    """seed: seed of everything; noticed_s: after the fault was injected, or began to matter; nan = never

    ended_s: after it was noticed, until nothing waited in the arm that would move it; moved_later: a stopped arm was
    moved again; moving: it moved when the fault came; max_force_n: greatest true contact force
    standstill: from when it was stopped until it stood; unseen_m: way of the tip from the fault until it was noticed;
    turned_deg: rotation of the arm's end relative to the command; both are true values"""

    seed: int
    injected: Injected
    noticed: Fault
    noticed_s: float
    ended_s: float
    moved_later: bool
    moving: bool
    max_force_n: float
    standstill: Standstill
    unseen_m: float = math.nan
    turned_deg: float = math.nan

    @property
    def in_time(self) -> bool:
        """Noticed and stopped within what is allowed, for good."""
        noticed = -1e-9 <= self.noticed_s <= ALLOWED_S[self.injected] + 1e-9
        if self.injected in AS_IT_MOVES and self.noticed_s >= -1e-9:
            frozen = self.injected is Injected.ARM_FROZEN
            noticed = noticed or self.unseen_m <= UNSEEN_M if frozen else self.turned_deg <= TURNED_DEG
        return noticed and self.ended_s <= ENDED_WITHIN_S + 1e-9 and not self.moved_later


@dataclass(frozen=True, slots=True)
class FaultScene:
    """Random quantities of one seed: the lab, its robot and a touch."""

    lab: TouchLab
    robot: Robot
    plan: TouchPlan


def make_scene(
    seed: int, *, modulus_pa: float | None = None, tip: str | None = None, tilt_deg: float | None = None
) -> FaultScene:
    """A foam, a tip and a tilt drawn from the seed (or as given), and an arm at rest above it."""
    random = np.random.default_rng([seed, 0xF0])
    low, high = map(math.log, MODULI_PA)
    drawn_pa, drawn_tip = math.exp(random.uniform(low, high)), str(random.choice(["sphere", "flat"]))
    tool = Tool(tip=drawn_tip if tip is None else tip)
    placement = Placement(T_BASE_SURFACE, tool)
    while True:  # not every place is within reach at every tilt
        drawn_deg, azimuth = random.uniform(0.0, GREATEST_TILT_DEG), random.uniform(0.0, 2 * math.pi)
        angle = math.radians(drawn_deg if tilt_deg is None else tilt_deg)
        normal = np.array([math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)])
        point_m = np.array([random.uniform(0.1, 0.5), random.uniform(0.1, 0.3), FOAM_TOP_M])
        believed_m = point_m + random.normal(0.0, 0.002) * normal
        plan = TouchPlan(believed_m, normal, travel_height_m=FOAM_TOP_M + 0.07)
        crossing_m, above_m, deepest_m = plan.places_m(placement.center_offset_m)
        places_m = np.array([crossing_m + np.array([0.0, 0.0, 0.005]), above_m, deepest_m])
        start_deg = best_joints(J2N6S300, [placement.T_base_ee(place_m, normal) for place_m in places_m])
        if start_deg is not None:
            least = reach(J2N6S300, placement, places_m, normal, start_deg=start_deg).least_singular
            route = places_m[[0, 1, 2, 0]]
            if least.min() > 0.04 and follow(J2N6S300, placement, route, normal, start_deg=start_deg).all():
                break
    foam = SpringyFoam(drawn_pa if modulus_pa is None else modulus_pa, point_m, normal, tool)
    pictures = np.random.default_rng([seed, 0xCA])
    lab = TouchLab(
        foam, tool=tool, view=lambda _: View(pictures.normal(0.8, 0.002, VIEW_SHAPE)), start_deg=start_deg, seed=seed
    )
    lab.arm_double.accelerate(ACCELERATION_DEG_S2)
    lab.arm_double.blur_torques(TORQUE_NOISE_NM, GRAVITY_LEFT)
    lab.open()
    limits = Limits(low_m=BOX_LOW_M, high_m=BOX_HIGH_M)
    robot = Robot(lab.arm, lab.force, placement, limits, camera=lab.camera, clock=lab.clock, wait_until=lab.wait_until)
    robot.let_move(check(robot, [plan], calibrated={"force sensor": True, "tool": True}))
    return FaultScene(lab, robot, plan)


def run_fault(seed: int, injected: Injected) -> FaultRun:
    """One touch in which this goes wrong at a random moment."""
    random = np.random.default_rng([seed, 0xFA])
    scene = make_scene(seed)
    lab, robot = scene.lab, scene.robot
    cycles: list[ArmCycle] = []
    state = {"at_ns": -1, "matters_ns": -1, "moving": 0}
    verdicts: list[SafetyDecision] = []
    turned_deg: list[float] = []

    def strike() -> None:
        state["at_ns"] = lab.clock()
        state["moving"] = int(robot.commanded[-1] > 0) if robot.commanded else 0
        if robot.camera_needed if injected in CAMERA else injected not in AS_IT_MOVES:
            state["matters_ns"] = lab.clock()
        inject(lab, injected, random)

    def watcher(seen: RobotObservation, verdict: SafetyDecision) -> None:
        if injected in CAMERA and robot.camera_needed and state["at_ns"] < 0 and not lab.scheduled:
            lab.schedule(lab.clock() + round(random.uniform(0.0, 0.3) * 1e9), strike)
        if injected in AS_IT_MOVES and state["at_ns"] >= 0 > state["matters_ns"] and robot.moving:
            state["matters_ns"] = max(state["at_ns"], lab.clock() - PERIOD_NS)  # sent as this period began
        if verdict.action is not (verdicts[-1].action if verdicts else Action.GO_ON):
            verdicts.append(verdict)
            turned_deg.append(turned_aside_deg(robot, lab))

    robot.watch = watcher
    lab.on_cycle = lambda: cycles.append(ArmCycle.of(lab))
    if injected not in CAMERA:
        lab.schedule(lab.clock() + round(random.uniform(0.05, 6.5) * 1e9), strike)
    try:
        run_touch(robot, scene.plan)
        lab.wait_until(lab.clock() + round(AFTER_S * 1e9))
    finally:
        with contextlib.suppress(
            NotStopped
        ):  # the arm's cable is out: its driver says at closing that it could not be stopped
            lab.close()
    return _judge(seed, injected, state, verdicts, turned_deg, cycles, lab)


def _judge(
    seed: int,
    injected: Injected,
    state: dict[str, int],
    verdicts: list[SafetyDecision],
    turned_deg: list[float],
    cycles: list[ArmCycle],
    lab: TouchLab,
) -> FaultRun:
    """verdicts: the first, and a stop after it where it was backed away first; turned_deg: at each"""
    moving, force_n = bool(state["moving"]), lab.contact.max_force_n
    if not verdicts:
        return FaultRun(seed, injected, Fault.NONE, math.nan, math.nan, False, moving, force_n, Standstill())
    noticed_ns = verdicts[0].time_ns
    ended_s, moved_later, still = after_stop(cycles, noticed_ns, lab)
    if verdicts[0].action is not Action.STOP:  # it stands for a moment, and then backs away
        moved_later, still = False, Standstill()
        if verdicts[-1].action is Action.STOP:
            ended_s, moved_later, still = after_stop(cycles, verdicts[-1].time_ns, lab)
    since_ns = state["matters_ns"] if state["matters_ns"] >= 0 else noticed_ns + 1_000_000_000
    noticed_s = (noticed_ns - since_ns) / 1e9
    unseen_m = _way_m([one for one in cycles if state["at_ns"] <= one.time_ns <= noticed_ns], lab)
    return FaultRun(
        seed,
        injected,
        verdicts[0].fault,
        noticed_s,
        ended_s,
        moved_later,
        moving,
        force_n,
        still,
        unseen_m,
        turned_deg[0],
    )


def turned_aside_deg(robot: Robot, lab: TouchLab) -> float:
    """True rotation of the arm's end relative to the command; nan before any command."""
    commanded = robot.rotation.rotation
    if commanded is None:
        return math.nan
    return math.degrees(np.linalg.norm(rotation_vector(lab.arm_double.T_base_links[-1][:3, :3] @ commanded.T)))


def _way_m(cycles: Sequence[ArmCycle], lab: TouchLab) -> float:
    """Way of the tip's centre over some cycles."""
    if not cycles:
        return 0.0
    links = lab.arm_double.chain.forward(np.array([one.joints_deg for one in cycles]))
    tips_m = lab.placement.T_surface_center(links[:, -1])[:, :3, 3]
    return float(np.linalg.norm(np.diff(tips_m, axis=0), axis=1).sum())


def after_stop(cycles: Sequence[ArmCycle], noticed_ns: int, lab: TouchLab) -> tuple[float, bool, Standstill]:
    """After a fault was noticed: how long until nothing waited in the arm [s], whether anything moved it later, and its
    way to standstill."""
    after = [one for one in cycles if one.time_ns > noticed_ns]
    ended_ns = next((one.time_ns for one in after if one.waiting == 0), -1)
    # what is seen to be empty at the end of a cycle was so at its begin, unless a point was carried out in it
    ended_s = math.nan if ended_ns < 0 else max(0, ended_ns - ARM_CYCLE_NS - noticed_ns) / 1e9
    stands = next((one for one in after if one.time_ns >= ended_ns and not np.any(one.rates_deg_s)), None)
    if stands is None:
        return ended_s, True, Standstill()
    later = any(one.waiting or np.any(one.rates_deg_s) for one in after if one.time_ns > stands.time_ns)
    way = [*[one for one in cycles if one.time_ns <= noticed_ns][-1:], *after]
    way = way[: 1 + sum(one.time_ns <= stands.time_ns for one in after)]
    seconds = max(0, stands.time_ns - ARM_CYCLE_NS - noticed_ns) / 1e9
    turned_deg = float(np.abs(way[-1].joints_deg - way[0].joints_deg).max())
    return ended_s, later, Standstill(seconds, _way_m(way, lab), turned_deg)
