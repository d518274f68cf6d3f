"""How long touches take a robot: their real plans, step by step, on an arm that follows every velocity at once.

A clock for studies without wires. Not included: the arm's and the sensor's delays, turning the stick, and pictures in
which the dent still moves."""

from collections.abc import Callable

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured, Touch
from deformscope.experiments.measured import SetupGeometry
from deformscope.robot.readings import PERIOD_NS
from deformscope.robot.touch import TARE_PERIODS, Phase, TouchPlan, TouchStateMachine
from deformscope.robot.travel import PASSED_M, REACHED_M, capped
from deformscope.stages.regions.touches import MapGrid
from studies.touching import Approach

Reachable = Callable[[MapGrid], BoolArray]

PERIOD_S = PERIOD_NS / 1e9
TARE_S = (TARE_PERIODS + 5) * PERIOD_S
AT_MOST_S = 60.0


class PlannedTouches(AsMeasured):
    """Planned touches of robots that give measurements; these robots move like those that give frames."""

    def __init__(self, setup: SetupGeometry, options: ExploreOptions, reachable: Reachable) -> None:
        super().__init__(setup.size_m, reachable)
        self._setup, self._options = setup, options

    def approach(
        self, xy_m: FloatArray, height_m: float, normal: FloatArray, over_m: float | None, known_m: float | None = None
    ) -> Touch:
        plan = self._setup.plan(xy_m, height_m, normal, over_m, self._options, known_m)
        return Touch(xy_m, height_m, normal, plan)


class TouchClock:
    """seconds: seconds of the touches so far; center_m: (3,) place of the tip's centre [m, surface frame]"""

    def __init__(self, center_m: FloatArray, center_offset_m: float) -> None:
        self.seconds, self.center_m = 0.0, np.asarray(center_m, dtype=np.float64)
        self._offset_m = center_offset_m

    def add(self, plan: TouchPlan, felt: Approach) -> None:
        """Travel to a touch, take the tare, repeat the touch's motion, and go back."""
        crossing_m, above_m, _ = plan.places_m(self._offset_m)
        high_m = float(crossing_m[2])
        if self.center_m[2] < high_m:
            self._go(np.append(self.center_m[:2], high_m + PASSED_M), plan, PASSED_M)
        if high_m > above_m[2] + REACHED_M:
            self._go(crossing_m, plan, PASSED_M)
        self._go(above_m, plan, max(REACHED_M, plan.passing_m))
        self.seconds += TARE_S
        self._touch(plan, felt)

    def _go(self, goal_m: FloatArray, plan: TouchPlan, near_m: float) -> None:
        while np.linalg.norm(goal_m - self.center_m) >= near_m:
            self._move(capped(goal_m - self.center_m, plan.travel_speed_m_s, plan.braking_per_s))

    def _touch(self, plan: TouchPlan, felt: Approach) -> None:
        normal, began_s = plan.normal, self.seconds
        gone_m = (felt.position_m[0] - felt.position_m) @ normal
        # the arm's readings are noisy, its way is not
        gone_m = np.polyval(np.polyfit(felt.time_s, gone_m, 1), felt.time_s)
        slope = (felt.true_force_n[-1] - felt.true_force_n[-2]) / (gone_m[-1] - gone_m[-2])
        machine = TouchStateMachine(plan, self._offset_m, self.seconds)
        while machine.phase is not Phase.DONE and self.seconds < began_s + AT_MOST_S:
            deep_m = float((felt.position_m[0] - self.center_m) @ normal)
            force_n = float(np.interp(deep_m, gone_m, felt.true_force_n))
            force_n += slope * max(deep_m - float(gone_m[-1]), 0.0)
            self._move(machine.step(self.seconds, self.center_m, force_n * normal))

    def _move(self, velocity_m_s: FloatArray) -> None:
        self.center_m = self.center_m + PERIOD_S * velocity_m_s
        self.seconds += PERIOD_S
