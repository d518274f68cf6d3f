"""Algorithm 2 of the thesis as it is printed: fixed steps down a numerical slope, with its early stops.

Choices that the thesis does not state: the error is in centimetres, as in Thesis figure 3.11, and the slope is a
central difference. The search stops when the slope's size is below epsilon, and stays in the range."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

RATE, STOP = 0.01, 1e-2
"""lambda and epsilon of the thesis (3.5.1.1)."""
BESIDE, MOST_STEPS = 1e-3, 5000
"""Half the distance over which the slope is taken; number of steps after which it is abandoned."""


@dataclass(frozen=True, slots=True)
class FixedSteps:
    """value: where it stopped; error: error there [cm]; steps: number of steps; evaluations: evaluations of the error;
    stopped: why"""

    value: float
    error: float
    steps: int
    evaluations: int
    stopped: str


def fixed_step_descent(
    error: Callable[[float], float], start: float, bounds: tuple[float, float], most: int = MOST_STEPS
) -> FixedSteps:
    """Follow an error [cm] down from a start. Thesis Algorithm 2."""

    def slope(at: float) -> float:
        low, high = max(at - BESIDE, bounds[0]), min(at + BESIDE, bounds[1])
        return (error(high) - error(low)) / (high - low)

    value = start
    falls = slope(value)
    for step in range(1, most + 1):
        moved = float(np.clip(value - RATE * falls, *bounds))
        stuck = moved == value
        value, falls = moved, slope(moved)
        if abs(falls) < STOP or stuck:
            why = "at the end of the range" if stuck else f"the slope is below {STOP:g} cm"
            return FixedSteps(value, error(value), step, 2 * step + 3, why)
    return FixedSteps(value, error(value), most, 2 * most + 3, f"{most} steps were taken")
