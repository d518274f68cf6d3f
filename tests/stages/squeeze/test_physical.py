"""Physical features of squeezes whose force, place and stiffness are known."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.squeeze.physical import physical_features, pressure_axis
from deformscope.stages.squeeze.trial import PHYSICAL

TEXEL = (0.0034, 0.0034)
AREA = TEXEL[0] * TEXEL[1]


def pad(force_n: float, row: int = 4, column: int = 2) -> FloatArray:
    pressure = np.zeros((13, 6))
    pressure[row : row + 2, column : column + 2] = force_n / (4 * AREA)
    return pressure


def squeeze(noise: float = 0.0, seed: int = 0) -> tuple[FloatArray, list[list[FloatArray]], FloatArray]:
    """1 s without contact, 1 s in which 300 N/m are pressed by 8 mm, and 1 s in which a fifth of the force is lost."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 3.0, 0.04)
    depth = np.clip(time - 1.0, 0.0, 1.0) * 0.008
    force = 300.0 * depth * np.where(time > 2.0, 0.8, 1.0)
    frames = [[pad(max(f + random.normal(0.0, noise), 0.0)), pad(f, row=8)] for f in force]
    return time, frames, depth


def test_what_is_known_is_found() -> None:
    time, frames, depth = squeeze()
    found = physical_features(time, frames, TEXEL, depth, 1.0, 2.0)
    assert found.values.shape == (len(PHYSICAL),)
    assert found["force_n"] == pytest.approx(2.4)
    assert found["contact_area_m2"] == pytest.approx(4 * AREA)
    assert found["center_x_m"] == pytest.approx(3 * TEXEL[0])
    assert found["center_y_m"] == pytest.approx(7 * TEXEL[1])  # of both pads
    assert found["peak_pa"] == pytest.approx(2.4 / (4 * AREA))
    assert found["indentation_m"] == pytest.approx(0.008)
    assert found["onset_rate_n_per_s"] == pytest.approx(2.4, rel=0.05)
    assert found["stiffness_n_per_m"] == pytest.approx(300.0)
    assert found["relaxation"] == pytest.approx(0.2, abs=0.001)


def test_the_interval_of_stiffness_holds_the_truth_nine_times_in_ten() -> None:
    held = 0
    for seed in range(60):
        found = physical_features(*_with(squeeze(0.2, seed)), 1.0, 2.0)
        held += found["stiffness_low_n_per_m"] <= 300.0 <= found["stiffness_high_n_per_m"]
    assert 48 <= held <= 60


def _with(given: tuple[FloatArray, list[list[FloatArray]], FloatArray]) -> tuple[object, ...]:
    time, frames, depth = given
    return time, frames, TEXEL, depth


@pytest.mark.parametrize("angle_deg", [-80.0, -30.0, 0.0, 45.0, 90.0])
def test_the_axis_of_a_line_of_pressure(angle_deg: float) -> None:
    column, row = np.meshgrid(np.arange(6.0) - 2.5, np.arange(13.0) - 6.0)
    along = np.radians(angle_deg)
    across = -column * np.sin(along) + row * np.cos(along)
    lengthwise = column * np.cos(along) + row * np.sin(along)
    angle, elongation = pressure_axis(np.exp(-(across**2) / 0.5 - lengthwise**2 / 4.0), TEXEL)
    assert np.sin(angle - along) == pytest.approx(0.0, abs=0.03)
    assert elongation > 0.6


def test_without_contact_nothing_is_made_up() -> None:
    time, _, depth = squeeze()
    found = physical_features(time, [[pad(0.0), pad(0.0)] for _ in time], TEXEL, depth, 1.0, 2.0)
    assert found["force_n"] == 0.0
    assert np.isnan([found["center_x_m"], found["orientation_rad"], found["relaxation"]]).all()
    assert np.isnan(pressure_axis(np.zeros((3, 3)), TEXEL)).all()
    with pytest.raises(InputError, match="from first contact to steady state"):
        physical_features(time, [[pad(0.0)] for _ in time], TEXEL, depth, 5.0, 6.0)
    with pytest.raises(InputError, match="as many times as frames"):
        physical_features(time[:-1], [[pad(0.0)] for _ in time], TEXEL, depth, 1.0, 2.0)
