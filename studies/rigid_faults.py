"""A rigid surface under an arm whose force sensor is wrong: refused before contact, or how hard it was pressed."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.lab.arms import arm_in_lab
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.checks import Preflight
from deformscope.robot.finger import press_by_finger
from deformscope.robot.force_alone import ForceAlone
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import check
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.supervisor import Limits
from deformscope.robot.touch import STILL_FORCE, Phase, TouchPlan, run_touch
from deformscope_drivers.arm.kinematics import rotation_from_rpy, transform
from deformscope_drivers.jaco import JacoConfig, JacoDouble
from deformscope_drivers.kuka import KukaConfig, KukaDouble
from deformscope_drivers.memory import SimulatedClock
from studies.fault_study import ACCELERATION_DEG_S2, GRAVITY_LEFT, TORQUE_NOISE_NM
from studies.springy_foam import SpringyFoam

RIGID_PA, TOP_M, HIGHER_M = 1e9, 0.08, 0.045
GAIN = 0.2
UP = np.array([0.0, 0.0, 1.0])
T_BASE_SURFACE = transform(rotation_from_rpy(0.0, 0.0, np.pi / 2), (0.75, -0.3, 0.0))


class SensorFault(StrEnum):
    """Fault of the force sensor, or error of the camera's measurement."""

    RIGHT = "nothing is wrong"
    DEAD = "the sensor measures nothing"
    SMALL = "its forces are 1000 times too small"
    SCALE = "it has the scale of another model"
    SATURATED = "it saturates at 2 N"
    REVERSED = "its sign is reversed"
    EXCHANGED = "its axes are exchanged"
    FROZEN = "it freezes after the tare"
    STUCK = "its axis along the stick freezes after the tare"
    HIGHER = "the surface is 45 mm higher than the camera measured"
    DIES = "the sensor measures nothing any more after the tare"
    CLIPPED = "it saturates at 4 N"


FELT: dict[SensorFault, Callable[[FloatArray], FloatArray]] = {
    SensorFault.DEAD: lambda load_n: 0.0 * load_n,
    SensorFault.SMALL: lambda load_n: 1e-3 * load_n,
    SensorFault.SCALE: lambda load_n: GAIN * load_n,
    SensorFault.SATURATED: lambda load_n: np.clip(load_n, -2.0, 2.0),
    SensorFault.CLIPPED: lambda load_n: np.clip(load_n, -4.0, 4.0),
    SensorFault.REVERSED: lambda load_n: -load_n,
    SensorFault.EXCHANGED: lambda load_n: np.roll(load_n, 1),
}
"""(3,) its output for a load (3,) [N]."""
ARMS = ("kuka", "kuka with motor currents", "jaco")
STIFFNESSES_N_M = (5e3, 2e4, 1e5)
"""Stiffnesses of arm, sensor and stick in series."""
PHASES = (Phase.APPROACH, Phase.PRESS, Phase.DWELL, Phase.RETREAT)
STRIKING = (SensorFault.DEAD, SensorFault.FROZEN, SensorFault.CLIPPED, SensorFault.SCALE, SensorFault.REVERSED)
CASES: tuple[tuple[str, SensorFault, float, Phase | None], ...] = (
    *(
        (arm, fault, n_m, None)
        for arm, fault, n_m in itertools.product(ARMS, SensorFault, STIFFNESSES_N_M)
        if fault is not SensorFault.CLIPPED and (arm != "jaco" or n_m < 1e5)  # which is an arm of 5 N/mm
    ),
    *((arm, SensorFault.CLIPPED, n_m, None) for arm in ARMS[:2] for n_m in STIFFNESSES_N_M),
    *itertools.product(ARMS[:2], STRIKING, STIFFNESSES_N_M, PHASES),
)
"""Arm, fault, stiffness in series, and the phase of the touch in which the fault strikes; None = from the start, or as
the fault says."""


@dataclass(frozen=True, slots=True)
class RigidRun:
    """arm, fault, stiffness_n_m, phase: one of CASES; refused: by which checks, and why; ended: how the touch did
    max_force_n: greatest true force; unavoidable_n: what nothing could show, see `_unavoidable_n`"""

    seed: int
    arm: str
    fault: SensorFault
    stiffness_n_m: float
    refused: str
    ended: str
    max_force_n: float
    unavoidable_n: float
    phase: Phase | None = None

    @property
    def in_time(self) -> bool:
        """Nothing was touched, or with no more than the hard stop, or than what could not be avoided."""
        return self.max_force_n <= max(Limits().hard_force_n, self.unavoidable_n)


def run_rigid(seed: int) -> RigidRun:
    """One session with one touch: all cases in turn, at places that the seed draws."""
    (kind, fault, stiffness_n_m, when), random = CASES[seed % len(CASES)], np.random.default_rng([seed, 0x61])
    placement, clock = Placement(T_BASE_SURFACE, Tool()), SimulatedClock(1_000_000_000)
    point_m = np.array([*random.uniform((0.2, 0.1), (0.4, 0.25)), TOP_M])
    plan = TouchPlan(point_m, UP, travel_height_m=TOP_M + 0.1)
    driver, config = ("jaco", JacoConfig(state_hz=100.0)) if kind == "jaco" else ("kuka", KukaConfig())
    arm = arm_in_lab(driver, config, placement, [point_m + 0.12 * UP, point_m], clock, seed)
    if isinstance(arm.body, JacoDouble):
        arm.body.accelerate(ACCELERATION_DEG_S2)
        arm.body.blur_torques(TORQUE_NOISE_NM, GRAVITY_LEFT)
    elif isinstance(arm.body, KukaDouble):
        arm.body.sends_currents = kind != "kuka"
    wrong = {"felt": FELT.get(fault, np.array) if when is None else np.array}
    lab = TouchLab(
        SpringyFoam(RIGID_PA, (TOP_M + HIGHER_M * (fault is SensorFault.HIGHER)) * UP, UP, placement.tool),
        clock,
        T_base_surface=T_BASE_SURFACE,
        arm_stiffness_n_m=stiffness_n_m,
        sensed=lambda load_n, time_s: wrong["felt"](load_n),
        arm=arm,
        seed=seed,
    )

    def strike(phase: Phase, time_ns: int) -> None:
        if phase is not (when or Phase.APPROACH):
            return
        lab.wire.frozen = fault in (SensorFault.FROZEN, SensorFault.STUCK)
        lab.wire.stuck = (2,) if fault is SensorFault.STUCK else (0, 1, 2)
        if when is not None or fault is SensorFault.DIES:
            wrong["felt"] = FELT.get(SensorFault.DEAD if fault is SensorFault.DIES else fault, np.array)

    with lab:
        limits = Limits(low_m=(-2.0, -2.0, -2.0), high_m=(2.0, 2.0, 2.0))
        robot = Robot(lab.arm, lab.force, placement, limits, clock=clock, wait_until=lab.wait_until)
        robot.compliance_m_per_n = 1.0 / stiffness_n_m
        preflight, ended = check(robot, [plan], calibrated={}), ""
        try:
            if robot.force_alone:
                preflight = Preflight((*preflight.checks, press_by_finger(robot, lab.push_tip)))
            if preflight.passed:
                robot.let_move(preflight)
                record = run_touch(robot, plan, on_phase=strike)
                ended = f"{record.ending}: {record.reason}"
        except RobotStopped as stopped:
            ended = str(stopped)
        refused = "; ".join(f"{one.name}: {one.came}" for one in preflight.checks if not one.passed)
        refused = refused or (
            "" if robot.may_move else ended
        )  # its currents may feel the finger that its sensor does not
        unavoidable_n = _unavoidable_n(CASES[seed % len(CASES)], robot, plan)
        return RigidRun(seed, kind, fault, stiffness_n_m, refused, ended, lab.contact.max_force_n, unavoidable_n, when)


def _unavoidable_n(case: tuple[str, SensorFault, float, Phase | None], robot: Robot, plan: TouchPlan) -> float:
    """The force that nothing could show [N]: of a sensor that dies before contact, where no motor current shows it; of
    a gain that falls before or with the contact, which looks like a softer thing."""
    kind, fault, _, when = case
    if kind == "kuka" and (fault is SensorFault.DIES or (fault, when) == (SensorFault.DEAD, Phase.APPROACH)):
        return ForceAlone.of(robot).undetected_n
    if fault is SensorFault.SCALE and when in (Phase.APPROACH, Phase.PRESS):
        return (1.0 + STILL_FORCE) * plan.set_force_n / GAIN
    return 0.0
