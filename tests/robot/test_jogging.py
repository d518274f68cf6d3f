"""Keys move the arm a step at a time, and nothing moves once none is held."""

import numpy as np
import pytest

from deformscope.robot.jogging import GRACE_S, MOVES, SPEED_M_S, Jog

PERIOD_NS = 10_000_000


def way_m(jog: Jog, presses: dict[float, str], seconds: float = 4.0) -> np.ndarray:
    """(6,) where it goes while keys are pressed at times [s]: a step of each period."""
    gone, waiting = np.zeros(6), sorted(presses.items())
    for now_ns in range(0, round(seconds * 1e9), PERIOD_NS):
        while waiting and waiting[0][0] * 1e9 <= now_ns:
            jog.press(waiting.pop(0)[1], now_ns)
        command = jog.command(now_ns)
        if command is not None:
            gone[:3] += np.asarray(command.linear_m_s) * 0.01
            gone[3:] += 0.0 if command.angular_rad_s is None else np.asarray(command.angular_rad_s) * 0.01
    return gone


@pytest.mark.parametrize(("step", "step_m"), [("1", 0.001), ("2", 0.005), ("3", 0.01)])
def test_a_press_moves_one_step(step: str, step_m: float) -> None:
    for key, (axis, sign) in MOVES.items():
        gone = way_m(Jog(), {0.0: step, 1.0: key})
        assert np.flatnonzero(gone).tolist() == [axis]
        assert np.sign(gone[axis]) == sign
        if axis < 3:
            assert abs(gone[axis]) == pytest.approx(step_m, abs=2.5e-4)


def test_a_held_key_goes_on_and_stops_when_it_is_let_go() -> None:
    jog, held = Jog(), {0.0: "d"} | {0.5 + 0.033 * count: "d" for count in range(30)}  # a terminal's repeats
    last_s = max(held)
    gone = way_m(jog, held)
    assert jog.command(round((last_s + GRACE_S) * 1e9) + PERIOD_NS) is None
    assert gone[0] <= SPEED_M_S * (last_s + GRACE_S)
    assert gone[0] > SPEED_M_S * (last_s - 0.5)


@pytest.mark.parametrize("key", [" ", "x", "1", "\x1b"])
def test_any_other_key_stops(key: str) -> None:
    jog = Jog()
    jog.press("3", 0)
    jog.press("w", 1)
    assert jog.command(2 * PERIOD_NS) is not None
    jog.press(key, 3 * PERIOD_NS)
    assert jog.command(3 * PERIOD_NS) is None


def test_a_line_that_breaks_stops_it() -> None:
    jog = Jog()
    for count in range(20):
        jog.press("r", count * 30_000_000)
    assert jog.command(19 * 30_000_000 + round(GRACE_S * 1e9)) is None
