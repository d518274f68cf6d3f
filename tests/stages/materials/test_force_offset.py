"""The time of a force log at a video's first frame: shifted, slow, of another rate and unit, or of another push."""

import numpy as np
import pytest
from scipy.signal import lfilter

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.materials.plane_modulus import find_offset
from deformscope.stages.materials.press_cycle import PressForce

FPS = 15.0
FRAMES: FloatArray = np.arange(40) / FPS


def depth_at(time_s: FloatArray, *, begin_s: float = 0.6, rise_s: float = 1.2) -> FloatArray:
    """A push that begins and ends smoothly, and is held then."""
    share = np.clip((time_s - begin_s) / rise_s, 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))


def force_of(depth: FloatArray) -> FloatArray:
    """Of a foam that stiffens [N]."""
    return 3.0 * depth + 2.0 * depth**2


def log_of(
    offset_s: float, rate_hz: float, rng: np.random.Generator, *, lag_s: float = 0.0, zero_n: float = 0.0,
    step_n: float = 0.01, seconds: float = 12.0,
) -> PressForce:  # fmt: skip
    """Readings of a display that settles with a time constant, whose clock shows offset_s at the first frame."""
    dense_hz = 2000.0
    dense = np.arange(0.0, seconds, 1.0 / dense_hz)
    force = force_of(depth_at(dense - offset_s))
    if lag_s:
        keep = np.exp(-1.0 / (lag_s * dense_hz))
        force = lfilter([1.0 - keep], [1.0, -keep], force)
    time_s = np.arange(0.3 / rate_hz, seconds - 0.1, 1.0 / rate_hz)
    read = np.interp(time_s, dense, force) + zero_n + 0.005 * rng.standard_normal(len(time_s))
    return PressForce(time_s, np.round(read / step_n) * step_n, 0.005)


def seen(rng: np.random.Generator) -> FloatArray:
    return 100.0 * depth_at(FRAMES) + 0.1 * rng.standard_normal(len(FRAMES))


@pytest.mark.parametrize("rate_hz", [10.0, 23.0, 100.0])
def test_offsets_are_within_a_frame_and_their_intervals_hold(rate_hz: float) -> None:
    held = near = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        offset_s = float(rng.uniform(0.0, 5.0))
        found = find_offset(FRAMES, seen(rng), log_of(offset_s, rate_hz, rng), 0.9)
        near += abs(found.value - offset_s) <= 1.0 / FPS
        held += found.interval[0] <= offset_s <= found.interval[1]
        assert found.force_n[-1] == pytest.approx(5.0, rel=0.02)
    assert near >= 18
    assert held >= 15  # of 20 at .9, fewer than that have a chance of .01


def test_a_short_push_and_its_end_in_view_are_not_taken_for_an_earlier_one_on_a_slow_display() -> None:
    near = held = refused = 0
    frames = np.arange(30) / 30.0
    for seed in range(20):
        rng = np.random.default_rng([seed, 1])
        depth = 30.0 * depth_at(frames, begin_s=0.2, rise_s=0.67)
        depth += 0.15 * lfilter([0.66], [1.0, -0.75], rng.standard_normal(len(frames)))  # flow shares its errors
        dense = np.arange(0.0, 5.0, 0.02)
        force = force_of(depth_at(dense - 2.3, begin_s=0.2, rise_s=0.67)) / 5.0 + 2e-3 * rng.standard_normal(len(dense))
        try:
            found = find_offset(frames, depth, PressForce(dense, force, 2e-3), 0.9)
        except InputError:
            refused += 1
            continue
        near += abs(found.value - 2.3) <= 1.0 / 30.0
        held += found.interval[0] <= 2.3 <= found.interval[1]
        assert found.force_n[-1] == pytest.approx(1.0, rel=0.05)
    assert refused <= 2
    assert near >= 16
    assert held >= 16


@pytest.mark.parametrize("lag_s", [0.2, 0.5])
def test_a_slow_display_does_not_delay_the_push_and_its_last_reading_is_completed(lag_s: float) -> None:
    rng = np.random.default_rng(1)
    frames = FRAMES[:30]  # the scale has not settled at the last one
    log = log_of(2.0, 20.0, rng, lag_s=lag_s)
    found = find_offset(frames, seen(rng)[:30], log, 0.9)
    assert log.at(frames[-1:] + 2.0)[0] < 0.97 * 5.0
    assert found.value == pytest.approx(2.0, abs=1.0 / FPS)
    assert found.lag_s == pytest.approx(lag_s, rel=0.5)
    assert found.force_n[-1] == pytest.approx(5.0, abs=max(0.1, 3.0 * found.force_sd_n))


def test_the_zero_of_a_log_is_that_of_the_depth() -> None:
    rng = np.random.default_rng(2)
    found = find_offset(FRAMES, seen(rng), log_of(1.0, 50.0, rng, zero_n=1.7), 0.9)
    assert found.force_n[-1] == pytest.approx(5.0, rel=0.02)
    assert np.abs(found.force_n[:8]).max() < 0.05


def test_a_given_offset_is_kept() -> None:
    rng = np.random.default_rng(3)
    found = find_offset(FRAMES, seen(rng), log_of(1.0, 50.0, rng, zero_n=0.5), 0.9, 1.02)
    assert (found.value, found.interval) == (1.02, (1.02, 1.02))
    assert found.force_n[-1] == pytest.approx(5.0, rel=0.02)


@pytest.mark.parametrize("kind", ["elsewhere", "another", "a slope alone", "nothing"])
def test_logs_that_do_not_show_the_push_are_refused(kind: str) -> None:
    rng = np.random.default_rng(4)
    depth, log = seen(rng), log_of(1.0, 50.0, rng)
    if kind == "elsewhere":
        kept = log.time_s < 1.8
        log = PressForce(log.time_s[kept], log.force_n[kept], log.zero_sd_n)
        log = PressForce(np.append(log.time_s, 30.0), np.append(log.force_n, 5.0), 0.005)
    elif kind == "another":
        log = PressForce(log.time_s, np.sin(9.0 * log.time_s) + 0.1 * rng.standard_normal(len(log.time_s)), 0.005)
    elif kind == "a slope alone":
        depth = 100.0 * FRAMES / FRAMES[-1]
        log = PressForce(log.time_s, 0.5 * log.time_s, 0.005)
    else:
        log = PressForce(log.time_s, 0.005 * rng.standard_normal(len(log.time_s)), 0.005)
    with pytest.raises(InputError, match="force log"):
        find_offset(FRAMES, depth, log, 0.9)
