"""A touch by an arm that a person places: place after place is requested, and the force measured at rest there.

A person cannot control a force by hand. Therefore the tip goes down in steps, and the contact law is fitted to the
measured heights. The supervisor checks every control period, whatever the person does."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deformscope.robot.latch import Action
from deformscope.robot.readings import RobotObservation
from deformscope.robot.robot import Robot, RobotStopped
from deformscope.robot.touch import (
    STILL_FORCE,
    Phase,
    PhaseSpan,
    TouchEnding,
    TouchPlan,
    TouchRecord,
    TouchRun,
    carried_out,
)
from deformscope_drivers.arm.kinematics import FloatArray
from deformscope_drivers.manual_arm import ManualArm

FREE_STEP_M, BEGIN_M = 1e-3, 4e-3
"""Step before contact, and height above the observed surface at which the steps begin. The camera's error is below 2
mm; 1 mm on a rigid surface gives 5 N on a tip of 0.2 mm/N, below the soft stop. Larger steps may reach it at once;
smaller ones ask a person more often."""
STEPS = 7
"""Number of steps from contact to the set force: the fitted law has three unknowns, and four more points show its
noise. With more, a person has to place the stick more often."""
SETTLE_PERIODS, HOLD_PERIODS = 20, 30
"""Control periods after a person reports that the stick is placed, before and during the measurement: 0.2 s for its
release, and the mean of 0.3 s. Shorter, the hand's force is measured too; longer, a touch takes longer."""
MOST_CORRECTION_M = 0.03
"""A height further from the request is a mistake, such as cm for mm, and is requested again: corrections are a few
millimetres. A larger limit accepts mistakes; a smaller one refuses true heights of a roughly placed stick."""
AGAIN = "a height in mm on the scale, or nothing for the requested height: "


@dataclass(frozen=True, slots=True, eq=False)
class PlaceRequest:
    """A request to a person to place the stick.

    words: text for the person; T_base_ee: (4, 4) requested pose of the arm's end in the base frame [m]"""

    words: str
    T_base_ee: FloatArray


class Person(Protocol):
    """The person who places the stick, at a terminal, on the page or simulated."""

    def ask(self, request: PlaceRequest) -> None:
        """Show a request, and return immediately."""

    def answered(self) -> str | None:
        """The answer to the last request: empty = placed as requested, a text = the height read; None = none yet."""


def touch_by_hand(
    robot: Robot,
    plan: TouchPlan,
    person: Person,
    still_seen: Callable[[], bool] = lambda: True,
    on_phase: Callable[[Phase, int], None] = lambda phase, time_ns: None,
) -> TouchRecord:
    """A touch by an arm that a person places (`ManualArm`); arguments and result as in `touch.run_touch`."""
    return carried_out(PlacedRun(robot, plan, on_phase, person), robot, still_seen)


class _Steps:
    """Contact, ending and phases of a touch in steps (`touch.TouchProgress`)."""

    def __init__(self, start_s: float) -> None:
        self.contact_m: FloatArray | None = None
        self.settled, self.ending = False, TouchEnding.NO_CONTACT
        self.spans: list[PhaseSpan] = []
        self.phase, self._since_s = Phase.APPROACH, start_s

    def enter(self, phase: Phase, time_s: float) -> None:
        if phase is not self.phase:
            self.spans.append(PhaseSpan(self.phase, self._since_s, time_s))
            self.phase, self._since_s = phase, time_s

    def end(self, time_s: float) -> None:
        self.enter(Phase.DONE, time_s)


class PlacedRun(TouchRun):
    """A touch in steps, for each of which a person places the stick."""

    def __init__(self, robot: Robot, plan: TouchPlan, on_phase: Callable[[Phase, int], None], person: Person) -> None:
        super().__init__(robot, plan, on_phase)
        self._person = person
        self._center_m: FloatArray = np.zeros(3)

    def travel(self) -> None:
        """The person lifts the stick, and takes it above the place."""
        self._robot.cycle()
        began = self._now_s()
        self._tell(Phase.TRAVEL)
        self._place(self._plan.places_m(self._robot.placement.center_offset_m)[1], "lift the tip, and place it")
        self._spans.append(PhaseSpan(Phase.TRAVEL, began, self._now_s()))

    def touch(self, still_seen: Callable[[], bool]) -> None:
        """Lower the tip in steps to the set force or the greatest depth, dwell in view of the camera, and lift it."""
        plan, robot = self._plan, self._robot
        self._machine = steps = _Steps(self._now_s())
        self._tell(Phase.APPROACH)
        touching_m = plan.point_m + robot.placement.center_offset_m * plan.normal
        down_m, before_m, before_n, set_n = -BEGIN_M, -BEGIN_M, 0.0, plan.set_force_n
        while True:
            self._place(touching_m - down_m * plan.normal, "lower the tip")
            down_m = float((touching_m - self._center_m) @ plan.normal)
            along_n = self._held(HOLD_PERIODS)
            if steps.contact_m is None and along_n > plan.contact_force_n:
                steps.contact_m = self._center_m
                self._enter(steps, Phase.PRESS)
            depth_m = 0.0 if steps.contact_m is None else float((steps.contact_m - self._center_m) @ plan.normal)
            reached = along_n >= set_n * (1.0 - STILL_FORCE)
            if reached and plan.more_force_n is not None and set_n < plan.more_force_n and depth_m < plan.small_dent_m:
                set_n, reached = plan.more_force_n, False
                self._enter(steps, Phase.PRESS_MORE)
            if reached or depth_m >= plan.max_depth_m or down_m >= plan.miss_m + plan.max_depth_m:
                break
            if steps.contact_m is None and down_m >= plan.miss_m:
                break
            step_m = self._step_m(set_n, along_n, (along_n - before_n) / max(down_m - before_m, 1e-9))
            before_m, before_n = down_m, along_n
            down_m = min(down_m + step_m, plan.miss_m + plan.max_depth_m)
        if steps.contact_m is not None:
            steps.ending = TouchEnding.SET_FORCE if reached else TouchEnding.DEPTH
            self._depth_m, self._loading_s = depth_m, self._now_s()
            self._enter(steps, Phase.DWELL if steps.phase is Phase.PRESS else Phase.DWELL_MORE)
            self._robot.camera_needed = True
            self._held(round(100 * self._plan.dwell_s), still_seen)
            self._robot.camera_needed = False
            self._end_s, steps.settled = self._now_s(), True
        self._enter(steps, Phase.RETREAT)
        self._place(plan.places_m(robot.placement.center_offset_m)[1], "lift the tip")
        steps.end(self._now_s())
        self._ending = steps.ending

    def _step_m(self, set_n: float, along_n: float, stiffness_n_m: float) -> float:
        """How much further down the next step goes [m]: a STEPS-th of the set force by the stiffness of the last step.

        set_n, along_n: requested and measured force along the normal [N]; stiffness_n_m: that of the last step [N/m]"""
        arm = self._robot.arm
        assert isinstance(arm, ManualArm)
        finest_m = arm.config.resolution_m
        if along_n <= self._plan.contact_force_n or stiffness_n_m <= 0.0:
            return FREE_STEP_M
        wanted_m = min(set_n / STEPS, max(set_n - along_n, 0.0) + 0.02 * set_n) / stiffness_n_m
        return float(np.clip(np.round(wanted_m / finest_m), 1, max(1, round(FREE_STEP_M / finest_m))) * finest_m)

    def _enter(self, steps: _Steps, phase: Phase) -> None:
        steps.enter(phase, self._now_s())
        self._tell(phase)

    def _held(self, periods: int, still_seen: Callable[[], bool] = lambda: True) -> float:
        """Mean force along the normal over some control periods [N]; the record keeps their readings."""
        along_n = []
        for _ in range(periods):
            along_n.append(float(self._see(self._cycle()) @ self._plan.normal))
            still_seen()
        return float(np.mean(along_n))

    def _cycle(self) -> RobotObservation:
        """A control period; a force that is too high ends the touch."""
        seen = self._robot.cycle()
        if (verdict := self._robot.supervisor.verdict).action is not Action.GO_ON:
            raise RobotStopped(verdict)
        return seen

    def _place(self, center_m: FloatArray, what: str) -> None:
        """Have the tip's centre put to (3,) [m, surface frame], and wait until it is at rest there."""
        robot, plan, arm = self._robot, self._plan, self._robot.arm
        assert isinstance(arm, ManualArm)
        lowest_m = float(center_m[2]) - robot.placement.center_offset_m
        x_cm, y_cm = 100.0 * center_m[:2]
        where = f"x {x_cm:.1f} cm, y {y_cm:.1f} cm, {1e3 * lowest_m:.1f} mm above the table"
        self._person.ask(
            PlaceRequest(f"{what}: {where}; Enter when it is there", robot.placement.T_base_ee(center_m, plan.normal))
        )
        while True:
            while (answer := self._person.answered()) is None:
                self._cycle()
            if (height_m := height_m_of(answer, lowest_m)) is not None:
                break
            self._person.ask(PlaceRequest(AGAIN, robot.placement.T_base_ee(center_m, plan.normal)))
        self._center_m = np.array([*center_m[:2], height_m + robot.placement.center_offset_m])
        arm.place(robot.placement.T_base_ee(self._center_m, plan.normal))
        for _ in range(SETTLE_PERIODS):
            self._cycle()


def height_m_of(answer: str, asked_m: float) -> float | None:
    """Height above the table [m] from an answer in mm, empty = as requested; None if no number or too far from it."""
    if not answer:
        return asked_m
    with contextlib.suppress(ValueError):
        height_m = float(answer.replace(",", ".")) / 1e3
        if abs(height_m - asked_m) < MOST_CORRECTION_M:
            return height_m
    return None
