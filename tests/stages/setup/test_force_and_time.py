"""How a force sensor sits, what hangs on it, and by how much clocks differ."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import correlate
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.force import PRESSED, PUSHED, force_gain, free_air, hanging_weight, mount, tool_load
from deformscope.stages.setup.timing import time_offset

DRAWS = 200
DOWN = Rotation.from_euler("x", 180, degrees=True)
AT_LEAST, AT_MOST = (int(binom.ppf(share, DRAWS, 0.9)) for share in (1e-4, 1.0 - 1e-4))
AXES = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, 1]], dtype=float)


def sitting(turn_rad: float, *, mirrored: bool, upside_down: bool) -> FloatArray:
    """(3, 3) from the sensor's axes to the tip's."""
    turn = Rotation.from_euler("z", turn_rad).as_matrix()
    return turn @ np.diag([1.0, -1.0 if mirrored else 1.0, -1.0 if upside_down else 1.0])


def pushes(R: FloatArray, sd_rad: float, random: np.random.Generator, axes: FloatArray = AXES) -> FloatArray:
    """(n, 3) [N] felt while somebody pushes along the axes."""
    wobble = Rotation.from_rotvec(sd_rad * random.standard_normal((len(axes), 3)))
    return random.uniform(2.0, 6.0, (len(axes), 1)) * wobble.apply(axes) @ R


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("upside_down", [False, True])
def test_signs_and_turn_are_found_again(mirrored: bool, upside_down: bool) -> None:
    R = sitting(2.2, mirrored=mirrored, upside_down=upside_down)
    found = mount(pushes(R, 0.0, np.random.default_rng(0)), AXES)
    assert found.R_tip_force == pytest.approx(R)
    assert np.linalg.det(found.R_tip_force) == pytest.approx(np.linalg.det(R))


def test_the_interval_of_the_turn_holds_it_in_nine_of_ten() -> None:
    random = np.random.default_rng(1)
    hits = 0
    for _ in range(DRAWS):
        turn_rad = random.uniform(-np.pi, np.pi)
        sd_rad = min(PUSHED.sd * np.sqrt(PUSHED.weight / random.chisquare(PUSHED.weight)), 0.15)
        R = sitting(turn_rad, mirrored=bool(random.integers(2)), upside_down=False)
        found = mount(pushes(R, sd_rad, random), AXES)
        off = np.angle(np.exp(1j * (found.turn_rad - turn_rad)))
        hits += abs(off) <= found.turn_half_rad
    assert AT_LEAST <= hits <= AT_MOST


def test_the_interval_of_the_gain_holds_it_in_nine_of_ten() -> None:
    random = np.random.default_rng(4)
    hits = 0
    for _ in range(DRAWS):
        gain = random.uniform(0.9, 1.1)
        sd_n = PRESSED.sd * np.sqrt(PRESSED.weight / random.chisquare(PRESSED.weight))
        held = random.standard_normal(3)
        felt = gain * (5.0 + sd_n * random.standard_normal((4, 1))) * held / np.linalg.norm(held)
        found = force_gain(felt, 5.0)
        hits += abs(found.gain - gain) <= found.half
    assert AT_LEAST <= hits <= AT_MOST
    assert found.sd < found.half < 0.02


@pytest.mark.parametrize(("felt_n", "load_n", "expected"), [(5.0, 0.5, "1 N or more"), (0.5, 5.0, "between 0.5 and 2")])
def test_a_load_that_does_not_say_the_gain_is_refused(felt_n: float, load_n: float, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        force_gain(np.full((4, 3), felt_n / np.sqrt(3.0)), load_n)


def test_pushes_that_do_not_say_how_it_sits_are_refused() -> None:
    random = np.random.default_rng(2)
    felt = pushes(sitting(0.4, mirrored=False, upside_down=False), 0.02, random)
    contradicting = felt.copy()
    contradicting[-1] *= -1.0
    with pytest.raises(InputError, match=r"one axis alone.*push \+x as well"):
        mount(felt[[0, 2, 4]], AXES[[0, 2, 4]])
    with pytest.raises(InputError, match="along the stick"):
        mount(felt[:4], AXES[:4])
    with pytest.raises(InputError, match="contradict"):
        mount(contradicting, AXES)
    with pytest.raises(InputError, match=r"0.5 N or more.*push harder"):
        mount(0.05 * felt, AXES)
    with pytest.raises(InputError, match="across it"):
        mount(felt[[4, 1, 2, 3, 0, 5]], AXES)


def test_drift_and_noise_of_free_air() -> None:
    random = np.random.default_rng(3)
    time_s = np.arange(0.0, 20.0, 0.004)
    hits = 0
    for _ in range(60):
        drift = random.uniform(-0.3, 0.3, 3)
        force_n = 0.2 + drift * time_s[:, None] / 60.0 + 0.01 * random.standard_normal((len(time_s), 3))
        found = free_air(time_s, force_n)
        hits += np.count_nonzero(np.abs(found.drift_n_per_min - drift) <= found.drift_half)
    assert found.noise_n == pytest.approx([0.01] * 3, rel=0.1)
    assert found.tare_n == pytest.approx(0.2 + drift / 6.0, abs=0.002)
    assert binom.ppf(1e-4, 180, 0.9) <= hits <= binom.ppf(1.0 - 1e-4, 180, 0.9)
    with pytest.raises(InputError, match="readings in free air"):
        free_air(time_s[:100], force_n[:100])


def test_a_hanging_weight_is_found_from_free_air_in_some_poses() -> None:
    random = np.random.default_rng(4)
    R = sitting(1.0, mirrored=True, upside_down=False)
    turns = Rotation.from_euler("xy", [[180, 0], [140, 0], [220, 0], [180, 40], [180, -40]], degrees=True).as_matrix()
    down_n = np.array([0.0, 0.0, -0.35])
    hits = 0
    for _ in range(DRAWS):
        felt = np.array([0.1, -0.2, 0.3]) - np.array([R.T @ turn.T @ down_n for turn in turns])
        found = hanging_weight(felt + 0.01 * random.standard_normal(felt.shape), turns, R)
        hits += abs(found.down @ down_n / np.linalg.norm(found.down) - found.weight_n) <= found.weight_half_n
    assert AT_LEAST <= hits <= DRAWS
    assert found.bias_n == pytest.approx([0.1, -0.2, 0.3], abs=0.06)
    with pytest.raises(InputError, match="turned too little"):
        hanging_weight(felt, np.array([turns[0]] * 5), R)


def tap(time_s: FloatArray, at_s: FloatArray) -> FloatArray:
    """Short blows."""
    return np.exp(-0.5 * ((time_s[:, None] - at_s) / 0.02) ** 2).sum(axis=1)


AT_S = np.array([1.1, 2.0, 3.3])


def signals(offset_s: float, random: np.random.Generator, hz: float = 100.0) -> tuple[FloatArray, ...]:
    x_time_s, y_time_s = np.arange(0.0, 4.5, 1e-3), np.arange(0.0, 4.5, 1.0 / hz)
    x = 5.0 * tap(x_time_s, AT_S) + 0.01 * random.standard_normal(len(x_time_s))
    y = 0.4 * tap(y_time_s, AT_S + offset_s) + 1.0 + 0.03 * random.standard_normal(len(y_time_s))
    return x_time_s, x, y_time_s, y


def test_the_interval_of_an_offset_holds_it_in_nine_of_ten() -> None:
    random = np.random.default_rng(5)
    hits = 0
    for _ in range(DRAWS):
        offset_s = random.uniform(-0.1, 0.1)
        found = time_offset(*signals(offset_s, random))
        hits += found.low_s <= offset_s <= found.high_s
    assert AT_LEAST <= hits <= AT_MOST


def test_the_offset_is_where_the_cross_correlation_is_highest() -> None:
    x_time_s, x, y_time_s, y = signals(0.037, np.random.default_rng(6), hz=1000.0)
    lag = np.argmax(correlate(y - y.mean(), x - x.mean())) - (len(x) - 1)
    found = time_offset(x_time_s, x, y_time_s, y)
    assert found.offset_s == pytest.approx(1e-3 * lag, abs=2e-3)
    assert found.high_s - found.low_s < 0.005


def test_signals_without_a_tap_are_refused() -> None:
    random = np.random.default_rng(7)
    x_time_s, x, y_time_s, y = signals(0.0, random)
    with pytest.raises(InputError, match=r"appears in the second signal as a peak.*tap harder"):
        time_offset(x_time_s, x, y_time_s, 1.0 + 0.01 * random.standard_normal(len(y)))
    with pytest.raises(InputError, match=r"explained by the first"):
        time_offset(x_time_s, x, y_time_s, tap(y_time_s, np.array([1.5, 2.7])))
    with pytest.raises(InputError, match="both signals have"):
        time_offset(x_time_s, x, y_time_s + 100.0, y)


def weighed(random: np.random.Generator, noise: tuple[float, float], count: int = 8) -> tuple[tuple[Any, ...], Any]:
    """Arguments of `tool_load` for a tool, by the laws of a rigid body, and its weight (3,), centre and biases."""
    turns = np.array([(Rotation.from_rotvec(0.6 * random.standard_normal(3)) * DOWN).as_matrix() for _ in range(count)])
    R = Rotation.from_euler("z", random.uniform(0, 360), degrees=True).as_matrix() @ np.diag([1.0, 1.0, -1.0])
    weight_n, center_m = np.array([0.1, -0.2, -1.9]), np.array([0.01, -0.02, 0.06])
    bias_n, bias_nm = random.standard_normal(3), 0.1 * random.standard_normal(3)
    pulled_n = np.array([-R.T @ turn.T @ weight_n for turn in turns])
    force_n = bias_n + pulled_n + noise[0] * random.standard_normal((count, 3))
    torque_nm = bias_nm + np.cross(center_m, pulled_n) + noise[1] * random.standard_normal((count, 3))
    return (force_n, torque_nm, turns, R), (weight_n, center_m, bias_n, bias_nm)


def test_a_tool_of_known_mass_and_centre_is_found_exactly() -> None:
    given, (weight_n, center_m, bias_n, bias_nm) = weighed(np.random.default_rng(4), (0.0, 0.0))
    found = tool_load(*given)
    np.testing.assert_allclose(found.weight.weight_n * found.weight.down, weight_n, atol=1e-9)
    np.testing.assert_allclose(found.center_m, center_m, atol=1e-9)
    np.testing.assert_allclose(found.weight.bias_n, bias_n, atol=1e-9)
    np.testing.assert_allclose(found.bias_nm, bias_nm, atol=1e-9)
    assert tool_load(given[0], None, *given[2:]).center_m is None


def test_nine_of_ten_intervals_of_a_tool_hold_the_truth() -> None:
    random, held = np.random.default_rng(5), []
    for _ in range(DRAWS):
        given, (weight_n, center_m, bias_n, bias_nm) = weighed(random, (0.01, 0.001))
        found = tool_load(*given)
        off_n = found.weight.weight_n - np.linalg.norm(weight_n)
        held.append(
            [
                abs(off_n) <= found.weight.weight_half_n,
                *(np.abs(found.weight.bias_n - bias_n) <= found.weight.bias_half_n),
                *(np.abs(found.center_m - center_m) <= found.center_half_m),
                *(np.abs(found.bias_nm - bias_nm) <= found.bias_half_nm),
            ]
        )
    assert all(AT_LEAST <= count <= AT_MOST for count in np.sum(held, axis=0)), np.sum(held, axis=0)


def test_a_tool_that_cannot_be_weighed_is_refused() -> None:
    (force_n, torque_nm, turns, R), _ = weighed(np.random.default_rng(6), (0.0, 0.0))
    with pytest.raises(InputError, match="turned too little"):
        tool_load(force_n, torque_nm, np.array([turns[0]] * 8), R)
    with pytest.raises(InputError, match="a tool of"):
        tool_load(np.ones((8, 3)), torque_nm, turns, R)
    with pytest.raises(InputError, match="forces of one weight"):
        tool_load(force_n, torque_nm, turns, Rotation.from_euler("x", 90, degrees=True).as_matrix())
