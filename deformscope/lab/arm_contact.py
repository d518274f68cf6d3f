"""An arm that presses on a world: the force at which arm and world, which both yield, are in balance."""

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from deformscope.robot.placement import Placement
from deformscope_drivers.arm.kinematics import FloatArray, cross
from deformscope_drivers.clock import Clock

ARM_CYCLE_NS = 10_000_000
ARM_STIFFNESS_N_M, ARM_DOUBT = 5000.0, 0.1
"""Stiffness of a simulated arm under a push, which its joints do not measure; the share of it that a calibration leaves
unknown."""
SOLVED_N = 2e-3
SOLVED_AT_MOST = 60
FIRST_M = 2e-5


class World(Protocol):
    """A world that can be touched."""

    def press(self, center_m: FloatArray) -> FloatArray:
        """Force (3,) [N] on a tip with this centre (3,) [m], both in the surface frame; zero without contact."""


class PushedArm(Protocol):
    """An arm that can be pushed (`JacoDouble`)."""

    @property
    def T_base_end_effector(self) -> FloatArray:
        """(4, 4) pose of the arm's end [m]."""

    def push(self, wrench: npt.ArrayLike) -> None: ...


class ArmContact:
    """The tip of a simulated arm in a world that can be touched.

    world: the touched world; force_n: (3,) present force on the tip, surface frame [N]; max_force_n: the greatest
    magnitude of that force so far; finger_n: (3,) additional force of a finger on the tip, surface frame [N]; aside:
    (6,) of a collision on the arm's end, base frame [N, N m], which a sensor in the tip does not measure"""

    def __init__(
        self,
        world: World,
        arm: PushedArm,
        placement: Placement,
        clock: Clock,
        *,
        arm_stiffness_n_m: float = ARM_STIFFNESS_N_M,
        goes_on: bool = False,
    ) -> None:
        """arm_stiffness_n_m: stiffness of the arm against a push, which its joints' sensors do not see (inf = rigid)

        goes_on: between two evaluations of the world the force is extrapolated rather than constant: half a cycle less
        behind the place, which an energy lost in a touch would show"""
        self.force_n: FloatArray = np.zeros(3)
        self.max_force_n = 0.0
        self.finger_n: FloatArray = np.zeros(3)
        self.aside: FloatArray = np.zeros(6)
        self.world, self._arm, self._placement, self._clock = world, arm, placement, clock
        self._compliance_m_n = 1.0 / arm_stiffness_n_m
        self._deflection_m = 0.0
        self._slope = -1.0
        self._direction = np.array([0.0, 0.0, 1.0])
        self._load_n: FloatArray = np.zeros(3)
        self._before_n, self._load_ns, self._goes_on = self._load_n, 0, goes_on
        self._hit: tuple[int, int, FloatArray] | None = None

    @property
    def center_m(self) -> FloatArray:
        """(3,) true place of the tip's centre, including the arm's compliance [m, surface frame]."""
        return self._kinematic()[:3, 3] + self._deflection_m * self._direction

    def feel(self) -> None:
        """Compute the contact at the arm's new pose, once in each of its cycles."""
        T = self._kinematic()
        self.force_n = self._contact(T[:3, 3])
        self._before_n, self._load_ns = self._load_n, self._clock()
        self._load_n = -T[:3, :3].T @ (self.force_n + self.finger_n)
        self.max_force_n = max(self.max_force_n, float(np.linalg.norm(self.force_n)))
        pushed = self._placement.to_base(self.force_n + self.finger_n)
        if np.any(pushed):
            end_m = (self._placement.T_surface_base @ self._arm.T_base_end_effector)[:3, 3]
            lever_m = self._placement.to_base(T[:3, 3]) - self._placement.to_base(end_m)
            self._arm.push(np.concatenate([pushed, cross(lever_m, pushed)]) + self.aside)
        else:
            self._arm.push(self.aside)

    def load(self, time_s: float) -> FloatArray:
        """(3,) force on a force sensor in the tip, in the tip's frame [N]."""
        load_n = self._load_n
        if self._goes_on and np.any(load_n) and np.any(self._before_n):
            since = np.clip((time_s * 1e9 - self._load_ns) / ARM_CYCLE_NS, 0.0, 1.0)
            load_n = load_n + since * (load_n - self._before_n)
        if self._hit is not None:
            begin_ns, end_ns, force_n = self._hit
            if begin_ns <= time_s * 1e9 < end_ns:
                return np.asarray(load_n - self._kinematic()[:3, :3].T @ force_n)
        return load_n

    def tool_load_n(self, weight_n: float) -> FloatArray:
        """(3,) what a tool's weight [N] adds to `load`: it pulls where it hangs."""
        return np.asarray(weight_n * self._kinematic()[2, :3])

    def hit(self, force_n: npt.ArrayLike, duration_s: float) -> None:
        """From now on another object pushes the tip with this force (3,) [N] in the surface frame."""
        now_ns = self._clock()
        self._hit = now_ns, now_ns + round(duration_s * 1e9), np.asarray(force_n, dtype=float)

    def _kinematic(self) -> FloatArray:
        """(4, 4) pose of the tip's centre in the surface frame by the arm's joints, without the arm's compliance
        [m]."""
        return self._placement.T_surface_center(self._arm.T_base_end_effector)

    def _contact(self, center_m: FloatArray) -> FloatArray:
        """The force at which the arm's give and the world's are in balance.

        The deflection s along the force's direction solves |press(center + s e)| * compliance = s, whose left side
        falls with s. The secant method starts from the end of the last cycle and takes one or two evaluations of the
        world. It is bracketed for contacts so stiff that it diverges."""
        at_m = self._deflection_m
        force_n = self.world.press(center_m + at_m * self._direction)
        size_n = float(np.linalg.norm(force_n))
        if self._compliance_m_n == 0.0 or (size_n == 0.0 and at_m == 0.0):
            self._deflection_m = 0.0
            return force_n
        if size_n > 0:
            self._direction = force_n / size_n
        gap_m = size_n * self._compliance_m_n - at_m
        low_m, high_m = 0.0, math.inf
        for _ in range(SOLVED_AT_MOST):
            if abs(gap_m) < SOLVED_N * self._compliance_m_n:
                break
            low_m, high_m = (at_m, high_m) if gap_m > 0 else (low_m, at_m)
            next_m = at_m - gap_m / self._slope
            if not low_m < next_m < high_m and (at_m, next_m) != (0.0, 0.0):
                next_m = 0.5 * (low_m + high_m) if math.isfinite(high_m) else 2.0 * at_m + FIRST_M
            force_n = self.world.press(center_m + next_m * self._direction)
            next_gap_m = float(np.linalg.norm(force_n)) * self._compliance_m_n - next_m
            if next_m != at_m:
                self._slope = min((next_gap_m - gap_m) / (next_m - at_m), -1.0)
            at_m, gap_m = next_m, next_gap_m
        self._deflection_m = at_m
        return force_n
