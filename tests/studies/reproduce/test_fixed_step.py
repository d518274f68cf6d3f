"""Algorithm 2 as printed: against a transcription by hand, on errors that are known."""

from collections.abc import Callable

import numpy as np
import pytest

from studies.reproduce.fixed_step import MOST_STEPS, fixed_step_descent

START, BOUNDS = 0.5, (0.0, 1.0)


def transcribed(slope: Callable[[float], float], lam: float = 0.01, eps: float = 1e-2) -> tuple[float, int]:
    """Lines 2 to 9 of the print with the true slope: theta and n at `return`."""
    theta, n = START, 1
    while True:
        theta = theta - lam * slope(theta)
        if abs(slope(theta)) < eps:
            return theta, n
        n += 1


@pytest.mark.parametrize(
    ("error", "slope"),
    [
        (lambda b: 0.4 * (b - 0.72) ** 2 + 0.03, lambda b: 0.8 * (b - 0.72)),
        (lambda b: 0.1 + 0.02 * np.cos(4.0 * b), lambda b: -0.08 * np.sin(4.0 * b)),
        (lambda b: np.hypot(0.02, b - 0.2), lambda b: (b - 0.2) / np.hypot(0.02, b - 0.2)),
    ],
)
def test_it_takes_the_steps_that_are_printed(error: Callable[[float], float], slope: Callable[[float], float]) -> None:
    counted: list[float] = []

    def known(beta: float) -> float:
        counted.append(beta)
        return float(error(beta))

    found = fixed_step_descent(known, START, BOUNDS)
    theta, steps = transcribed(slope)
    assert found.value == pytest.approx(theta, abs=1e-5)
    assert found.steps == pytest.approx(steps, abs=1)
    assert found.error == pytest.approx(error(theta), abs=1e-6)
    assert found.evaluations == len(counted)


def test_it_stops_early_where_the_error_is_flat() -> None:
    """A valley of 0.001 cm is not worth a step: it stops after the first, far from the minimum."""
    found = fixed_step_descent(lambda theta: 0.05 + 0.004 * (theta - 0.95) ** 2, START, BOUNDS)
    assert found.steps == 1
    assert abs(found.value - 0.95) > 0.4
    assert "slope is below 0.01 cm" in found.stopped


def test_it_stays_in_the_range_and_gives_up_where_it_swings() -> None:
    ended = fixed_step_descent(lambda theta: -theta, START, BOUNDS)
    swings = fixed_step_descent(lambda theta: 2.0 * abs(theta - 0.505), START, BOUNDS)
    assert (ended.value, ended.stopped) == (1.0, "at the end of the range")
    assert (swings.steps, swings.stopped) == (MOST_STEPS, f"{MOST_STEPS} steps were taken")
