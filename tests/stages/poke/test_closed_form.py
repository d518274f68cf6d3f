"""Closed forms against figures typed from the literature and against each other."""

import numpy as np
import pytest
from scipy.integrate import quad

from deformscope.stages.msm.poke import Tip
from deformscope.stages.poke.closed_form import HalfSpace, half_space


def test_forces_of_flat_and_round_tips() -> None:
    solid = HalfSpace(50e3)
    # Sneddon: F = 2 a E* d; a = 1 cm, d = 2 mm
    assert solid.force(Tip("disc", (0.02,)), 0.002) == pytest.approx(2.0)
    # Hertz: F = 4/3 E* sqrt(R) d^1.5; R = 1 cm, d = 4 mm
    assert solid.force(Tip("sphere", (0.02,)), 0.004) == pytest.approx(4.0 / 3.0 * 50e3 * 0.1 * 0.004**1.5)
    # King: a square presses 1.2 % more than the disc of its area
    ratio = solid.force(Tip("flat", (0.02, 0.02)), 0.001) / solid.force(
        Tip("disc", (2 * np.sqrt(4e-4 / np.pi),)), 0.001
    )
    assert ratio == pytest.approx(1.012)


@pytest.mark.parametrize("tip", [Tip("flat", (0.02, 0.03)), Tip("disc", (0.02,)), Tip("sphere", (0.02,))])
def test_depth_is_the_inverse_of_force_and_one_poke_makes_the_half_space(tip: Tip) -> None:
    solid = half_space(tip, 0.003, 4.2)
    assert solid.force(tip, 0.003) == pytest.approx(4.2)
    assert solid.depth(tip, 4.2) == pytest.approx(0.003)


def test_the_dent_of_a_disc_is_boussinesqs() -> None:
    solid, tip = HalfSpace(50e3, 0.3), Tip("disc", (0.02,))
    moved = solid.surface(tip, 0.002, np.array([[0.0, 0.0], [0.005, 0.0], [0.02, 0.0], [0.0, 0.1]]))
    np.testing.assert_allclose(moved[:2, 2], -0.002)
    assert moved[2, 2] == pytest.approx(-0.002 * 2.0 / np.pi * np.pi / 6.0)  # asin(1/2) = 30 degrees
    # far away every load is a point: u_z = F (1 - nu^2) / (pi E r) = F / (pi E* r)
    assert moved[3, 2] == pytest.approx(-solid.force(tip, 0.002) / (np.pi * 50e3 * 0.1), rel=2e-3)
    # and u_r = -(1 - 2 nu) F / (4 pi G r), G = E* (1 - nu) / 2
    assert moved[3, 1] == pytest.approx(-0.4 * solid.force(tip, 0.002) / (4 * np.pi * 0.35 * 50e3 * 0.1), rel=1e-9)


def test_a_balls_dent_is_the_integral_of_hertzs_pressure() -> None:
    solid, tip, depth = HalfSpace(50e3), Tip("sphere", (0.02,)), 0.001
    a = np.sqrt(0.01 * depth)
    peak = 2.0 * solid.modulus / np.pi * np.sqrt(depth / 0.01)
    r = 0.006

    def ring(s: float) -> float:
        inner = quad(lambda t: 1.0 / np.sqrt(r**2 + s**2 - 2 * r * s * np.cos(t)), 0.0, np.pi)[0]
        return float(peak * np.sqrt(1.0 - (s / a) ** 2) * s * 2.0 * inner)

    expected = quad(ring, 0.0, a)[0] / (np.pi * solid.modulus)
    assert -solid.surface(tip, depth, np.array([[r, 0.0]]))[0, 2] == pytest.approx(expected, rel=1e-6)


def test_the_dent_is_smooth_where_contact_ends() -> None:
    solid, tip = HalfSpace(50e3), Tip("sphere", (0.02,))
    a = np.sqrt(0.01 * 0.002)
    beside = solid.surface(tip, 0.002, np.array([[a * 0.999999, 0.0], [a * 1.000001, 0.0]]))
    np.testing.assert_allclose(beside[0], beside[1], rtol=1e-4)
