"""Laws of the fillings against their closed forms."""

import dataclasses

import numpy as np
import pytest

from deformscope.lab.container_constants import BEARING_FACTOR, EMPTY, FLOUR, RICE, WATER, YOGURT, Content
from deformscope.lab.container_world import Gas, Patches

HALF_M = 0.03
DEEP_M = np.array([0.06])


def squeezed(patches: Patches, moves_m: list[float], step_s: float = 0.01) -> tuple[np.ndarray, float]:
    """(n,) tractions after each move of a patch, and the plastic displacement in the end."""
    traction, plastic = np.zeros(1), np.zeros(1)
    felt = []
    for move in moves_m:
        traction, plastic, _ = patches.moved(np.array([move]), traction, plastic, step_s)
        felt.append(traction[0])
    return np.array(felt), float(plastic[0])


def test_closed_air_follows_boyle() -> None:
    gas = Gas(1e-3)
    pressure, slope = gas.pressure_pa(0.5e-3)
    assert pressure == pytest.approx(101_325.0)
    assert slope == pytest.approx((gas.pressure_pa(0.5e-3 + 1e-9)[0] - pressure) / 1e-9, rel=1e-4)
    assert Gas(1e-3, warming_k=293.15).pressure_pa(0.0)[0] == pytest.approx(101_325.0)


@pytest.mark.parametrize("content", [RICE, FLOUR], ids=["rice", "flour"])
def test_a_granular_filling_hardens_along_a_hyperbola_and_unloads_along_its_elastic_slope(content: Content) -> None:
    patches = Patches.of(content, DEEP_M, HALF_M)
    k, most, half = patches.stiffness_pa_m[0], patches.most_pa[0], patches.half_m[0]
    felt, plastic = squeezed(patches, [2e-5] * 100)
    assert felt[-1] == pytest.approx(k * (2e-3 - plastic), rel=1e-6)
    assert felt[-1] == pytest.approx(most * plastic / (plastic + half), rel=1e-6)
    once, _ = squeezed(patches, [2e-3])
    assert once[0] == pytest.approx(felt[-1], rel=1e-6)  # independent of steps and rate
    released, _ = squeezed(patches, [2e-5] * 100 + [-1e-5])
    assert released[-2] - released[-1] == pytest.approx(k * 1e-5, rel=1e-6)


def test_a_granular_filling_fails_at_the_passive_pressure_of_rankine() -> None:
    felt, _ = squeezed(Patches.of(RICE, DEEP_M, HALF_M), [1.0])
    vertical = 800.0 * 9.81 * 0.06
    passive = np.tan(np.radians(45 + 32.5 / 2)) ** 2
    assert felt[0] == pytest.approx((passive - 0.46) * vertical, rel=0.05)
    cohesive, _ = squeezed(Patches.of(FLOUR, DEEP_M, HALF_M), [1.0])
    loose, _ = squeezed(Patches.of(dataclasses.replace(FLOUR, cohesion_pa=0.0), DEEP_M, HALF_M), [1.0])
    assert cohesive[0] - loose[0] == pytest.approx(2 * 300.0 * np.tan(np.radians(45 + 37.6 / 2)), rel=0.05)


def test_a_granular_filling_never_pulls_at_the_wall() -> None:
    felt, _ = squeezed(Patches.of(RICE, DEEP_M, HALF_M), [-0.01] * 3)
    vertical = 800.0 * 9.81 * 0.06
    active = np.tan(np.radians(45 - 32.5 / 2)) ** 2
    assert felt == pytest.approx([(active - 0.46) * vertical] * 3)


@pytest.mark.parametrize("speed_m_s", [0.001, 0.02])
def test_yogurt_that_flows_has_the_stress_of_herschel_and_bulkley(speed_m_s: float) -> None:
    felt, _ = squeezed(Patches.of(YOGURT, DEEP_M, HALF_M), [speed_m_s * 0.01] * 3000)
    expected = BEARING_FACTOR * (15.28 + 2.33 * (speed_m_s / HALF_M) ** 0.65)
    assert felt[-1] == pytest.approx(expected, rel=1e-3)


def test_water_resists_by_its_viscosity_alone() -> None:
    felt, _ = squeezed(Patches.of(WATER, DEEP_M, HALF_M), [0.02 * 0.01] * 50)
    assert felt[-1] == pytest.approx(BEARING_FACTOR * 1.002e-3 * 0.02 / HALF_M, rel=1e-3)


def test_nothing_resists_in_an_empty_container_nor_above_the_level() -> None:
    assert not Patches.of(EMPTY, DEEP_M, HALF_M).resist
    for content in (WATER, YOGURT, FLOUR, RICE):
        assert not Patches.of(content, -DEEP_M, HALF_M).resist
