"""The drift of a force sensor since its tare: a known ramp is found, noise averages out, the line stays short."""

import dataclasses

import numpy as np
import pytest

from deformscope.frames import WrenchFrame
from deformscope.rig.alarms import POINTS, TareDrift
from deformscope_drivers.clock import Stamp


def frames(seconds: float, ramp_n_s: float, start: int = 0, sigma_n: float = 0.1) -> list[WrenchFrame]:
    """100 a second, on an offset of (1, 2, 3) N; the ramp goes along z."""
    random = np.random.default_rng(1000 + start)
    found = []
    for at in range(start, start + int(100 * seconds)):
        force = np.array([[1.0, 2.0, 3.0 + ramp_n_s * at / 100]]) + random.normal(0, sigma_n, (1, 3))
        found.append(WrenchFrame(Stamp(10**10 + at * 10**7), at, np.rint(100 * force).astype(int).ravel(), force))
    return found


def test_a_ramp_since_the_tare() -> None:
    drift = TareDrift()
    drift.add(frames(60.0, 0.01))
    assert drift.unit == "N"
    np.testing.assert_allclose(drift.now, [0.0, 0.0, 0.58], atol=0.05)
    assert drift.line[0] == 0.0
    assert drift.line[-1] == pytest.approx(0.58, abs=0.06)
    assert 55.0 < drift.lasted_s < 60.0
    drift.tare()
    assert drift.line == ()
    drift.add(frames(20.0, 0.01, start=6000))
    np.testing.assert_allclose(drift.now, [0.0, 0.0, 0.18], atol=0.05)  # from the new zero on


def test_the_line_of_hours_is_short_and_whole() -> None:
    drift = TareDrift()
    second = frames(1.01, 0.0, sigma_n=0.0)[::50]
    for at in range(1000):
        for frame in second:
            load = frame.force_n + np.array([0.0, 0.0, at / 1000])
            drift.add([WrenchFrame(Stamp(frame.stamp.host_ns + at * 2 * 10**9), at, frame.counts, load)])
    assert POINTS / 2 <= len(drift.line) <= POINTS + 1
    np.testing.assert_allclose(np.diff(drift.line), drift.line[1], rtol=1e-6)


def test_a_press_is_no_drift() -> None:
    """A sensor that is pressed with 4 N for 20 s drifts no more than before, and goes on when it is let go."""
    drift = TareDrift()
    drift.add(frames(10.0, 0.01))
    for frame in frames(20.0, 0.01, start=1000):
        drift.add([dataclasses.replace(frame, force_n=frame.force_n + np.array([0.0, 0.0, 4.0]))])
    assert drift.loaded
    assert max(drift.line) < 0.2
    seconds = len(drift.line)
    drift.add(frames(10.0, 0.01, start=3000))
    assert not drift.loaded
    assert len(drift.line) > seconds
    np.testing.assert_allclose(drift.now, [0.0, 0.0, 0.38], atol=0.05)


def test_without_a_sensitivity_it_is_in_counts() -> None:
    drift = TareDrift()
    for at in range(300):
        counts = np.array([5, 5, 5 + (at >= 150)])
        drift.add([WrenchFrame(Stamp(at * 10**7), at, counts, np.full((1, 3), np.nan))])
    assert drift.unit == "counts"
    np.testing.assert_allclose(drift.now, [0.0, 0.0, 0.5], atol=0.02)
