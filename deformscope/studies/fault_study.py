"""Faults at random moments of simulated touches: when each is noticed, and when the arm stands.

Each run has its own foam, tip, tilt, moment and fault, all drawn from its seed, and goes through the real drivers.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.lab.arm_contact import ARM_CYCLE_NS
from deformscope.lab.faults import ARM, CAMERA, FORCE, Injected, inject
from deformscope.lab.springy_foam import SpringyFoam
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.placement import Placement, best_joints, reach
from deformscope.robot.preflight import check
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import Robot
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope.robot.supervisor import Action, Fault, Limits, SafetyVerdict
from deformscope.robot.touch import TouchPlan, run_touch
from deformscope_drivers.arm.errors import NotStopped
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.depth_camera.synthetic import View
from deformscope_drivers.jaco.chains import J2N6S300

BOX_LOW_M, BOX_HIGH_M = (-0.40, -0.65, 0.02), (0.40, -0.08, 0.40)
"""In the arm's base frame: the air over the table."""
FOAM_TOP_M = 0.08
VIEW_SHAPE = (12, 16)
AFTER_S = 0.3
GREATEST_TILT_DEG = 20.0
MODULI_PA = (10e3, 1e9)


ALLOWED_S = {
    **dict.fromkeys(FORCE, 0.05),
    **dict.fromkeys(ARM, 0.1),
    Injected.ARM_TURNS: 0.4,
    **dict.fromkeys(CAMERA, 2 / 30),
}
"""Within which each must be noticed: a camera's two frame periods count from when its pictures matter, an arm that
turns by itself from when it moves: at 20 deg/s, held against, it has then turned by the 5 deg that are allowed."""
STANDS_WITHIN_S = 2 * ARM_CYCLE_NS / 1e9


@dataclass(frozen=True, slots=True)
class FaultRun:
    """seed: of everything; noticed_s: after the fault was injected, or began to matter; nan = never

    stands_s: after it was noticed, until a cycle in which the arm does not move; moved_later: a stopped arm has moved
    again; moving: it moved when the fault came; max_force_n: greatest true contact force
    """

    seed: int
    injected: Injected
    noticed: Fault
    noticed_s: float
    stands_s: float
    moved_later: bool
    moving: bool
    max_force_n: float

    @property
    def in_time(self) -> bool:
        """Noticed and stopped within what is allowed, for good."""
        noticed = -1e-9 <= self.noticed_s <= ALLOWED_S[self.injected] + 1e-9
        return noticed and self.stands_s <= STANDS_WITHIN_S + 1e-9 and not self.moved_later


@dataclass(frozen=True, slots=True)
class FaultScene:
    """What one seed draws: the lab, its robot and a touch."""

    lab: TouchLab
    robot: Robot
    plan: TouchPlan


def make_scene(
    seed: int, *, modulus_pa: float | None = None, tip: str | None = None, tilt_deg: float | None = None
) -> FaultScene:
    """A foam, a tip and a tilt drawn from the seed (or as given), and an arm that stands above it."""
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
            if least.min() > 0.04:
                break
    foam = SpringyFoam(drawn_pa if modulus_pa is None else modulus_pa, point_m, normal, tool)
    pictures = np.random.default_rng([seed, 0xCA])
    lab = TouchLab(
        foam,
        tool=tool,
        view=lambda _: View(pictures.normal(0.8, 0.002, VIEW_SHAPE)),
        start_deg=start_deg,
        seed=seed,
    )
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
    joints: list[tuple[int, FloatArray]] = []
    state = {"at_ns": -1, "matters_ns": -1, "moving": 0, "noticed_ns": -1}
    verdicts: list[SafetyVerdict] = []

    def strike() -> None:
        state["at_ns"] = lab.clock()
        state["moving"] = int(robot.commanded[-1][1] > 0) if robot.commanded else 0
        if robot.camera_needed if injected in CAMERA else injected is not Injected.ARM_TURNS:
            state["matters_ns"] = lab.clock()
        inject(lab, injected, random)

    def watcher(seen: RobotObservation, verdict: SafetyVerdict) -> None:
        if injected in CAMERA and robot.camera_needed and state["at_ns"] < 0 and not lab.scheduled:
            lab.schedule(lab.clock() + round(random.uniform(0.0, 0.3) * 1e9), strike)
        if injected is Injected.ARM_TURNS and state["at_ns"] >= 0 and (state["matters_ns"] < 0 or not robot.moving):
            state["matters_ns"] = lab.clock()
        if verdict.action is not Action.GO_ON and not verdicts:
            verdicts.append(verdict)

    robot.watch = watcher
    lab.on_cycle = lambda: joints.append((lab.clock(), lab.arm_double.joints_deg))
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
    return _judge(seed, injected, state, verdicts, joints, lab)


def _judge(
    seed: int,
    injected: Injected,
    state: dict[str, int],
    verdicts: list[SafetyVerdict],
    joints: list[tuple[int, FloatArray]],
    lab: TouchLab,
) -> FaultRun:
    moving, force_n = bool(state["moving"]), lab.contact.max_force_n
    if not verdicts:
        return FaultRun(seed, injected, Fault.NONE, math.nan, math.nan, False, moving, force_n)
    noticed_ns = verdicts[0].time_ns
    stands_ns, moved_later = -1, False
    for (_, before), (now_ns, after) in itertools.pairwise(joints):
        if now_ns <= noticed_ns:
            continue
        if np.array_equal(before, after):
            stands_ns = now_ns if stands_ns < 0 else stands_ns
        elif stands_ns >= 0 and verdicts[0].action is Action.STOP:
            moved_later = True
    # The cycle in which it does not move began one cycle before it was seen not to have moved.
    stands_s = math.nan if stands_ns < 0 else max(0, stands_ns - ARM_CYCLE_NS - noticed_ns) / 1e9
    since_ns = state["matters_ns"] if state["matters_ns"] >= 0 else noticed_ns + 1_000_000_000
    noticed_s = (noticed_ns - since_ns) / 1e9
    return FaultRun(seed, injected, verdicts[0].fault, noticed_s, stands_s, moved_later, moving, force_n)


def run_faults(seeds: Sequence[int]) -> list[FaultRun]:
    """One run a seed, the faults in turn."""
    kinds = list(Injected)
    return [run_fault(seed, kinds[seed % len(kinds)]) for seed in seeds]


def table(runs: Sequence[FaultRun]) -> str:
    """The runs as text, a line for each fault: how many, noticed and standing after how long, how many in time."""
    lines = [
        f"{'fault':36}{'runs':>5}{'moving':>8}{'noticed [ms]: median, max, limit':>36}{'stands, max':>13}{'in time':>9}"
    ]
    for injected in Injected:
        some = [run for run in runs if run.injected is injected]
        if not some:
            continue
        noticed_ms = [1e3 * run.noticed_s for run in some]
        stands_ms = max(1e3 * run.stands_s for run in some)
        figures = f"{np.median(noticed_ms):.0f}, {max(noticed_ms):.0f}, {1e3 * ALLOWED_S[injected]:.0f}"
        good = sum(run.in_time for run in some)
        moving = sum(run.moving for run in some)
        lines.append(f"{injected:36}{len(some):5}{moving:8}{figures:>36}{stands_ms:13.0f}{good:9}")
    return "\n".join(lines)
