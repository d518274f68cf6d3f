"""A rigid surface under an arm whose force sensor is wrong: refused before contact, or how hard it was pressed.

An arm without joint torques (a KUKA) has nothing but that sensor; one with them (a Jaco) notices the contact anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.lab.arms import arm_in_lab
from deformscope.lab.springy_foam import SpringyFoam
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.finger import press_by_finger
from deformscope.robot.force_alone import ForceAlone
from deformscope.robot.placement import Placement
from deformscope.robot.preflight import check
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.supervisor import Limits
from deformscope.robot.touch import Phase, TouchPlan, run_touch
from deformscope.studies.fault_study import ACCELERATION_DEG_S2, GRAVITY_LEFT, TORQUE_NOISE_NM
from deformscope_drivers.arm.kinematics import rotation_from_rpy, transform
from deformscope_drivers.jaco import JacoConfig, JacoDouble
from deformscope_drivers.kuka import KukaConfig, KukaDouble
from deformscope_drivers.memory import SimulatedClock

STIFFNESSES_N_M = (5e3, 2e4, 1e5)
"""Of arm, sensor and stick in series."""
RIGID_PA = 1e9
TOP_M, HIGHER_M = 0.08, 0.045
BOX_M = (-2.0, -2.0, -2.0), (2.0, 2.0, 2.0)
T_BASE_SURFACE = transform(rotation_from_rpy(0.0, 0.0, np.pi / 2), (0.75, -0.3, 0.0))


class SensorFault(StrEnum):
    """What is wrong with the force sensor, or with what the camera saw."""

    RIGHT = "nothing is wrong"
    DEAD = "the sensor feels nothing"
    SMALL = "its forces are 1000 times too small"
    SCALE = "it has the scale of another model"
    SATURATED = "it saturates at 2 N"
    REVERSED = "its sign is reversed"
    EXCHANGED = "its axes are exchanged"
    FROZEN = "it freezes after the tare"
    STUCK = "its axis along the stick freezes after the tare"
    HIGHER = "the surface is 45 mm higher than the camera saw"
    DIES = "it feels nothing any more after the tare"


_FELT: dict[SensorFault, Callable[[FloatArray], FloatArray]] = {
    SensorFault.DEAD: lambda force_n: 0.0 * force_n,
    SensorFault.SMALL: lambda force_n: 1e-3 * force_n,
    SensorFault.SCALE: lambda force_n: 0.2 * force_n,  # a sensor of 40 N, read as one of 8 N would be
    SensorFault.SATURATED: lambda force_n: np.clip(force_n, -2.0, 2.0),
    SensorFault.REVERSED: lambda force_n: -force_n,
    SensorFault.EXCHANGED: lambda force_n: np.roll(force_n, 1),
}
"""(3,) [N] what it makes of a load (3,)."""


@dataclass(frozen=True, slots=True)
class RigidRun:
    """stiffness_n_m: in series; refused: the checks that kept the arm from moving; ended: how the touch did, and why
    max_force_n: greatest true force; unavoidable_n: that the arm cannot avoid, as the checks say
    """

    seed: int
    fault: SensorFault
    stiffness_n_m: float
    refused: str
    ended: str
    max_force_n: float
    unavoidable_n: float

    @property
    def in_time(self) -> bool:
        """Nothing was touched, or with no more than the hard stop, or than what could not be avoided."""
        return self.max_force_n <= max(Limits().hard_force_n, self.unavoidable_n)


def run_rigid(
    seed: int, fault: SensorFault, stiffness_n_m: float, *, driver: str = "kuka", currents: bool = False
) -> RigidRun:
    """One session with one touch. driver: of the arm; currents: its controller sends those of its motors"""
    random = np.random.default_rng([seed, 0x61])
    tool = Tool(R_tip_force=tuple(map(tuple, np.eye(3).tolist())))
    placement = Placement(T_BASE_SURFACE, tool)
    point_m = np.array([*random.uniform((0.2, 0.1), (0.4, 0.25)), TOP_M])
    plan = TouchPlan(point_m, np.array([0.0, 0.0, 1.0]), travel_height_m=TOP_M + 0.1)
    clock = SimulatedClock(1_000_000_000)
    config = KukaConfig() if driver == "kuka" else JacoConfig(state_hz=100.0)
    arm = arm_in_lab(driver, config, placement, [np.array([*point_m[:2], TOP_M + 0.12]), point_m], clock, seed)
    if isinstance(arm.body, JacoDouble):
        arm.body.accelerate(ACCELERATION_DEG_S2)
        arm.body.blur_torques(TORQUE_NOISE_NM, GRAVITY_LEFT)
    if isinstance(arm.body, KukaDouble):
        arm.body.sends_currents = currents
    top_m = TOP_M + HIGHER_M * (fault is SensorFault.HIGHER)
    state = {"fault": fault}

    def felt(force_n: FloatArray, time_s: float) -> FloatArray:
        return _FELT.get(state["fault"], lambda load_n: load_n)(force_n)

    lab = TouchLab(
        SpringyFoam(RIGID_PA, (0.0, 0.0, top_m), (0.0, 0.0, 1.0), tool),
        clock,
        tool=tool,
        T_base_surface=T_BASE_SURFACE,
        arm_stiffness_n_m=stiffness_n_m,
        as_felt=felt,
        arm=arm,
        seed=seed,
    )

    def press(force_n: FloatArray) -> None:
        lab.contact.finger_n = force_n

    def phase_began(phase: Phase, time_ns: int) -> None:
        if phase is Phase.APPROACH and fault is SensorFault.FROZEN:
            lab.wire.frozen = True
        elif phase is Phase.APPROACH and fault is SensorFault.STUCK:
            lab.wire.frozen, lab.wire.stuck = True, (2,)
        elif phase is Phase.APPROACH and fault is SensorFault.DIES:
            state["fault"] = SensorFault.DEAD

    with lab:
        limits = Limits(low_m=BOX_M[0], high_m=BOX_M[1])
        robot = Robot(
            lab.arm,
            lab.force,
            placement,
            limits,
            clock=clock,
            wait_until=lab.wait_until,
            compliance_m_per_n=1.0 / stiffness_n_m,
        )
        refused, ended, unavoidable_n = "", "", 0.0
        try:
            preflight = check(robot, [plan], calibrated={})
            if preflight.passed and robot.force_alone:
                preflight = preflight.and_(press_by_finger(robot, press))
            refused = ", ".join(f"{one.name}: {one.came}" for one in preflight.checks if not one.passed)
            if not refused:
                robot.let_move(preflight)
                record = run_touch(robot, plan, on_phase=phase_began)
                ended = f"{record.ending} {record.fault} {record.reason}"
        except RobotStopped as stopped:
            refused = f"{stopped.verdict.fault}: {stopped.verdict.reason}"
        if robot.force_alone:
            unavoidable_n = ForceAlone.of(robot).unfelt_n * (fault is SensorFault.DIES)
        return RigidRun(seed, fault, stiffness_n_m, refused, ended, lab.contact.max_force_n, unavoidable_n)
