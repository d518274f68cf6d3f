"""The seconds that touches take without wires: against a reckoning by hand."""

from dataclasses import replace

import numpy as np
import pytest

from deformscope.robot.touch import TouchPlan
from studies.reproduce.touch_clock import TARE_S, TouchClock
from studies.touching import Approach

UP, AT, RADIUS_M, N_PER_M = np.array([0.0, 0.0, 1.0]), np.array([0.3, 0.2, 0.05]), 0.01, 500.0


def felt(slope_n_m: float = N_PER_M) -> Approach:
    """Of a linear spring: down at 1 cm/s from 5 mm above, to 3 N."""
    gone_m = np.linspace(-0.005, 3.0 / slope_n_m, 50)
    position_m = AT + (RADIUS_M - gone_m[:, None]) * UP
    force_n = slope_n_m * np.maximum(gone_m, 0.0)
    return Approach((gone_m + 0.005) / 0.01, position_m, force_n[:, None] * UP, gone_m, force_n, 3.0, True)


def seconds(plan: TouchPlan, slope_n_m: float = N_PER_M) -> float:
    """Of a touch after one 20 cm beside it that ended as this one will."""
    clock = TouchClock(AT + (RADIUS_M + plan.standoff_m) * UP - np.array([0.2, 0.0, 0.0]), RADIUS_M)
    clock.add(plan, felt(slope_n_m))
    assert clock.center_m == pytest.approx(AT + (RADIUS_M + plan.standoff_m) * UP, abs=3e-3)
    return clock.seconds


def test_a_touch_takes_what_its_way_its_speeds_and_its_dwell_come_to() -> None:
    plan = TouchPlan(AT, UP, travel_height_m=0.11, more_force_n=None)
    way_s = 0.2 / 0.05
    down_s, up_s = 0.02 / 0.03 + 0.03 / 0.01, 0.056 / 0.03
    press_s = 0.006 / 0.01
    # speeds end softly: way, descent, press and way up, by an exponential of 4 a second each
    soft_s = 3.0
    least_s = way_s + TARE_S + down_s + press_s + plan.dwell_s + up_s
    assert least_s < seconds(plan) < least_s + soft_s


def test_low_and_fast_takes_half_of_it_and_something_stiff_is_pressed_with_more() -> None:
    plan = TouchPlan(AT, UP, travel_height_m=0.11, more_force_n=None)
    quick = replace(plan, standoff_m=0.02, slow_within_m=0.006, far_speed_m_s=0.05, travel_speed_m_s=0.15)
    quick = replace(quick, passing_m=2e-3, travel_height_m=0.08)
    assert seconds(quick) < 0.5 * seconds(plan)
    # the way down and the way up end softly over 2 cm at most, which takes half a second less; travel as much
    assert seconds(quick) - 1.2 < seconds(replace(quick, braking_per_s=8.0)) < seconds(quick) - 0.6
    assert seconds(replace(plan, more_force_n=5.0), 2e4) > seconds(plan, 2e4) + plan.dwell_s
