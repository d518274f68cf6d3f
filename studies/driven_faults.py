"""Arms that are driven to forbidden poses, and programs that are killed: whether the arm stops in time.

`fault_study` injects faults of devices in the midst of a touch; here the commands of the arm are themselves wrong."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deformscope.lab.faults import Injected
from deformscope.lab.touch_lab import TouchLab
from deformscope.rig.rig_file import Tool
from deformscope.robot.checks import Check, Preflight
from deformscope.robot.clearance import ArmClearance
from deformscope.robot.placement import Placement, best_joints
from deformscope.robot.robot import Command, JointRates, Robot, RobotStopped, TipVelocity
from deformscope.robot.setup import T_BASE_SURFACE
from deformscope.robot.supervisor import Fault, Limits
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.kinematics import Chain, FloatArray, cross, least_singular
from deformscope_drivers.clock import monotonic_ns
from deformscope_drivers.jaco.chains import CHAINS, J2N6S300
from deformscope_drivers.kuka import KukaDouble, UdpWire
from deformscope_drivers.kuka.messages import decode_sen
from deformscope_drivers.kuka.port import free_port
from studies.fault_study import (
    ACCELERATION_DEG_S2,
    ENDED_WITHIN_S,
    GRAVITY_LEFT,
    TORQUE_NOISE_NM,
    ArmCycle,
    FaultRun,
    Standstill,
    after_stop,
    run_fault,
)
from studies.springy_foam import SpringyFoam

CLEAR_M = 0.08, 0.03
"""A pose that is drawn keeps so far from the table and from itself."""
TIP_M_S, TURN_DEG_S = 0.08, 32.0
"""No drawn motion is faster at the tip: the supervisor would stop it for that."""
LONGEST_S, AFTER_S = 30.0, 0.5
KILLED_WITHIN_S = 0.1
KILLED_VALID_S = 60.0


class Driven(StrEnum):
    """To where an arm is driven."""

    JOINT_LIMIT = "joint driven to its limit"
    TABLE = "elbow driven into the table"
    ITSELF = "arm driven into itself"
    SINGULAR = "tip driven to a singular pose"


NOTICED_AS = {
    Driven.JOINT_LIMIT: (Fault.JOINT_LIMIT,),
    Driven.TABLE: (Fault.TABLE,),
    Driven.ITSELF: (Fault.ITSELF,),
    Driven.SINGULAR: (Fault.SINGULAR, Fault.JOINT_LIMIT, Fault.TABLE, Fault.ITSELF),
}


@dataclass(frozen=True, slots=True)
class DrivenRun:
    """seed: seed of everything; rogue: not by the robot's own commands but past them, as another program would

    left: least distance to its target: deg to the joint's limit, m to table or itself, smallest singular value
    ended_s, moved_later, standstill: as in `fault_study.FaultRun`"""

    seed: int
    driven: Driven
    rogue: bool
    noticed: Fault
    left: float
    ended_s: float
    moved_later: bool
    standstill: Standstill

    @property
    def in_time(self) -> bool:
        """Stopped for the driven motion, before its target, and permanently."""
        stopped = self.noticed in NOTICED_AS[self.driven] and self.ended_s <= ENDED_WITHIN_S + 1e-9
        return stopped and self.left > 0.0 and not self.moved_later


@dataclass(frozen=True, slots=True)
class _Drive:
    """A pose to begin from, the motion, and the remaining distance to its target, of joint angles (n,)."""

    model: str
    start_deg: FloatArray
    command: Command
    left: Callable[[FloatArray], float]
    rogue: bool = False


def run_driven(seed: int, driven: Driven) -> DrivenRun:
    """Drive an arm there from a pose that the seed draws, until it is stopped."""
    random = np.random.default_rng([seed, 0xD1, list(Driven).index(driven)])
    placement = Placement(T_BASE_SURFACE, Tool())
    drive = _drive(driven, placement, random)
    foam = SpringyFoam(1e4, (0.0, 0.0, -5.0), (0.0, 0.0, 1.0), placement.tool)
    lab = TouchLab(foam, tool=placement.tool, arm_model=drive.model, start_deg=drive.start_deg, seed=seed)
    lab.arm_double.accelerate(ACCELERATION_DEG_S2)
    lab.arm_double.blur_torques(TORQUE_NOISE_NM, GRAVITY_LEFT)
    cycles: list[ArmCycle] = []
    with lab:
        robot = Robot(lab.arm, lab.force, placement, Limits(), clock=lab.clock, wait_until=lab.wait_until)
        robot.let_move(Preflight((Check("pose", True, "drawn", "drawn"),)))
        robot.cycle()
        lab.on_cycle = lambda: cycles.append(ArmCycle.of(lab))
        end_ns = lab.clock() + round(1e9 * LONGEST_S)
        if drive.rogue and isinstance(drive.command, JointRates):
            robot.arm.set_velocity(JointVelocity(tuple(drive.command.rates_deg_s)), LONGEST_S)
        try:
            while lab.clock() < end_ns:
                robot.cycle(None if drive.rogue else drive.command)
        except RobotStopped as stopped:
            lab.wait_until(lab.clock() + round(1e9 * AFTER_S))
            ended_s, later, still = after_stop(cycles, stopped.verdict.time_ns, lab)
            left = min(drive.left(one.joints_deg) for one in cycles)
            return DrivenRun(seed, driven, drive.rogue, stopped.verdict.fault, left, ended_s, later, still)
    nothing = Standstill()
    return DrivenRun(seed, driven, drive.rogue, Fault.NONE, float("nan"), float("nan"), True, nothing)


def _drive(driven: Driven, placement: Placement, random: np.random.Generator) -> _Drive:
    if driven is Driven.SINGULAR:
        return _outwards(placement, random)
    while True:
        model = str(random.choice(list(CHAINS)))
        found = _to_limit(model, placement, random) if driven is Driven.JOINT_LIMIT else None
        if driven is not Driven.JOINT_LIMIT:
            found = _to_meet(driven, model, placement, random)
        if found is not None:
            return found


def _clear_pose(chain: Chain, placement: Placement, random: np.random.Generator) -> tuple[FloatArray, ArmClearance]:
    low, high = (
        np.where(np.isfinite(end), end, limit) for end, limit in ((chain.lower_deg, 0), (chain.upper_deg, 360))
    )
    while True:
        joints_deg = random.uniform(low + 20.0, high - 20.0)
        links = chain.forward(joints_deg)
        clearance = ArmClearance(placement, links)
        tip_m = placement.T_surface_center(links[-1])[2, 3]
        if clearance.over_table_m(links) > CLEAR_M[0] and clearance.to_itself_m(links) > CLEAR_M[1] and tip_m > 0.1:
            return joints_deg, clearance


def _to_limit(model: str, placement: Placement, random: np.random.Generator) -> _Drive | None:
    """A joint that begins up to 10 deg before its margin, driven by whoever does not keep to it."""
    chain = CHAINS[model]
    joints_deg, clearance = _clear_pose(chain, placement, random)
    joint = int(random.choice(np.flatnonzero(np.isfinite(chain.upper_deg))))
    up, rogue = bool(random.integers(2)), bool(random.integers(2))
    before_deg = Limits().joint_margin_deg + random.uniform(1.0, 4.0 if rogue else 10.0)
    joints_deg[joint] = chain.upper_deg[joint] - before_deg if up else chain.lower_deg[joint] + before_deg
    for turned_deg in (0.0, before_deg):  # nothing else is in the way
        there_deg = joints_deg.copy()
        there_deg[joint] += turned_deg if up else -turned_deg
        links = chain.forward(there_deg)
        if clearance.over_table_m(links) < CLEAR_M[0] / 2 or clearance.to_itself_m(links) < CLEAR_M[1] / 2:
            return None
    rates = _rates(chain, placement, joints_deg, joint, 1.0 if up else -1.0, random)
    return _Drive(model, joints_deg, JointRates(rates), lambda deg: float(chain.to_limits_deg(deg)[joint]), rogue)


def _to_meet(driven: Driven, model: str, placement: Placement, random: np.random.Generator) -> _Drive | None:
    """A joint that leads elbow or wrist into the table, or the arm into itself, in the next degrees."""
    chain = CHAINS[model]
    joints_deg, clearance = _clear_pose(chain, placement, random)
    joint, way = int(random.integers(1, chain.joint_count - 1)), float(random.choice([-1.0, 1.0]))
    steps = np.arange(0.0, 90.0, 1.0)
    poses = np.tile(joints_deg, (len(steps), 1))
    poses[:, joint] += way * steps
    within = np.asarray((chain.lower_deg + 6.0 < poses).all(axis=1) & (poses < chain.upper_deg - 6.0).all(axis=1))
    links = chain.forward(poses)
    table = np.array([clearance.over_table_m(one) for one in links])
    itself = np.array([clearance.to_itself_m(one) for one in links])
    gap: FloatArray
    other: FloatArray
    gap, other = (table, itself) if driven is Driven.TABLE else (itself, table)
    if not np.any(gap < 0.0):
        return None
    met = int(np.argmax(gap < 0.0))
    if met < 5 or not within[: met + 1].all() or other[: met + 1].min() < 0.03:
        return None
    start_deg = poses[max(0, met - int(random.integers(8, 25)))]
    rates = _rates(chain, placement, start_deg, joint, way, random)
    measure = clearance.over_table_m if driven is Driven.TABLE else clearance.to_itself_m
    return _Drive(model, start_deg, JointRates(rates), lambda deg: measure(chain.forward(deg)))


def _rates(
    chain: Chain, placement: Placement, joints_deg: FloatArray, joint: int, way: float, random: np.random.Generator
) -> FloatArray:
    """(n,) of one joint alone, as fast as the driver lets it at most [deg/s]."""
    links = chain.forward(joints_deg)
    center_m = (links[-1] @ placement.T_ee_center)[:3, 3]
    lever_m = float(np.linalg.norm(cross(links[joint, :3, 2], center_m - links[joint, :3, 3])))
    most = min(20.0, TURN_DEG_S, float(np.degrees(TIP_M_S / max(lever_m, 1e-6))))
    rates = np.zeros(chain.joint_count)
    rates[joint] = way * most * random.uniform(0.3, 1.0)
    return rates


def _outwards(placement: Placement, random: np.random.Generator) -> _Drive:
    """The tip straight away from the arm's foot, more or less, until the arm is stretched out."""
    while True:
        place_m = np.array([random.uniform(0.1, 0.5), random.uniform(0.1, 0.3), random.uniform(0.12, 0.25)])
        start_deg = best_joints(J2N6S300, [placement.T_base_ee(place_m, (0.0, 0.0, 1.0))])
        if start_deg is not None:
            break
    away = place_m - placement.T_surface_base[:3, 3]
    direction = np.array([away[0], away[1], 0.0]) / np.hypot(away[0], away[1])
    direction = direction + np.append(random.normal(0.0, 0.3, 2), random.uniform(0.0, 0.5))
    velocity = TipVelocity(random.uniform(0.02, 0.05) * direction / np.linalg.norm(direction))
    return _Drive("j2n6s300", start_deg, velocity, lambda deg: float(least_singular(J2N6S300.jacobian(deg))))


# A program that is killed ---------------------------------------------------------------------------------------------

_PROGRAM = f"""
import sys, time
from deformscope_drivers.arm import JointVelocity
from deformscope_drivers.arm.hosted import HostedArm
from deformscope_drivers.kuka import Kuka, KukaConfig
arm = HostedArm(Kuka, KukaConfig(address="127.0.0.1", port=int(sys.argv[1]), wait_s=60.0)).open()
while True:
    arm.set_velocity(JointVelocity((float(sys.argv[2]), 0.0, 0.0, 0.0, 0.0, 0.0)), {KILLED_VALID_S})
    time.sleep(0.01)
"""


@dataclass(frozen=True, slots=True)
class KilledRun:
    """moved_s: after the SIGKILL, until the last answer that moved the arm; turned_deg: its joint in that time

    moved_later: it moved in the half second after that"""

    seed: int
    moved_s: float
    turned_deg: float
    moved_later: bool

    @property
    def in_time(self) -> bool:
        return self.moved_s <= KILLED_WITHIN_S and not self.moved_later


class _Noting(KukaDouble):
    """Keeps when the last answer came that moves the arm [ns]."""

    moved_ns = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        super().receive(data, now_ns)
        if any(decode_sen(data).corrections_deg):
            self.moved_ns = now_ns


def run_killed(seed: int) -> KilledRun:
    """A program that moves an arm in a child process, on the host's clock, is ended by SIGKILL: its velocity would hold
    for a minute."""
    random = np.random.default_rng([seed, 0xD9])
    double, port = _Noting(again_s=0.1), free_port()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    rate = float(random.uniform(2.0, 15.0) * random.choice([-1.0, 1.0]))
    with UdpWire(double, port):
        program = subprocess.Popen([sys.executable, "-c", _PROGRAM, str(port), str(rate)], env=environment)
        try:
            until = time.monotonic() + 60.0
            while not double.moved_ns and time.monotonic() < until:
                time.sleep(0.01)
            time.sleep(random.uniform(0.05, 0.5))
            before_deg = double.joints_deg
            os.kill(program.pid, signal.SIGKILL)
            killed_ns = monotonic_ns()
            time.sleep(AFTER_S)
            moved_ns, turned_deg = double.moved_ns, float(np.abs(double.joints_deg - before_deg).max())
            time.sleep(AFTER_S)
            return KilledRun(seed, max(0, moved_ns - killed_ns) / 1e9, turned_deg, double.moved_ns != moved_ns)
        finally:
            program.kill()
            program.wait()


# All of them ----------------------------------------------------------------------------------------------------------

SIGKILL = "SIGKILL of the program"
KINDS: tuple[str, ...] = (*Injected, *Driven, SIGKILL)
AnyRun = FaultRun | DrivenRun | KilledRun


def run_any(seed: int) -> AnyRun:
    """The fault that a seed stands for, all kinds in turn."""
    kind = KINDS[seed % len(KINDS)]
    if isinstance(kind, Injected):
        return run_fault(seed, kind)
    return run_driven(seed, kind) if isinstance(kind, Driven) else run_killed(seed)


def kind_of(run: AnyRun) -> str:
    """Which of `KINDS` it was."""
    if isinstance(run, FaultRun):
        return run.injected
    return run.driven if isinstance(run, DrivenRun) else SIGKILL
