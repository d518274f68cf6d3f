"""The finite element slab under a tip: closed forms, equilibrium, refinement, contact."""

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.slab import RigidTip, Slab, press

DEEP = Slab((0.5, 0.5, 0.2), 50e3, 0.3)
THIN = Slab((0.2, 0.2, 0.03), 50e3, 0.2)
MIDDLE = (0.1, 0.1)


@pytest.mark.slow
def test_a_deep_slab_is_nearly_a_half_space() -> None:
    """F = 2 * 1.012 * sqrt(A / pi) E* d (King 1987); 20 half widths of thickness and a coarse mesh stiffen a little."""
    found = press(DEEP, (0.25, 0.25), RigidTip((0.01, 0.01)), DEEP.grid(0.1), depth=0.001, finest=0.005)
    half_space = 2 * 1.012 * np.sqrt(4e-4 / np.pi) * 50e3 / (1 - 0.09) * 0.001
    assert half_space < found.force < 1.15 * half_space


@pytest.mark.slow
def test_a_wide_tip_on_a_thin_slab_is_a_column() -> None:
    """Far from the tip's edge the strain is uniaxial: modulus E (1 - nu) / ((1 + nu) (1 - 2 nu))."""
    found = press(THIN, MIDDLE, RigidTip((0.08, 0.08), bonded=True), THIN.grid(0.05), depth=0.001, finest=0.01)
    modulus = 50e3 * 0.8 / (1.2 * 0.6)
    column = modulus * 0.16**2 * 0.001 / 0.03
    assert column < found.force < 1.3 * column


def test_it_is_linear_and_force_and_depth_belong_together() -> None:
    points = THIN.grid(0.01)
    one = press(THIN, MIDDLE, RigidTip((0.01, 0.01)), points, depth=0.001, finest=0.005)
    two = press(THIN, MIDDLE, RigidTip((0.01, 0.01)), points, force=2.0 * one.force, finest=0.005)
    assert two.depth == pytest.approx(0.002)
    np.testing.assert_allclose(two.displaced, 2.0 * one.displaced, atol=1e-12)
    np.testing.assert_allclose(one.displaced[one.touched, 2], -0.001, rtol=1e-9)
    assert one.touched.sum() == 9


@pytest.mark.slow
def test_a_finer_mesh_changes_little() -> None:
    points = THIN.grid(0.01)
    coarse, fine = (
        press(THIN, MIDDLE, RigidTip((0.01, 0.01)), points, depth=0.001, finest=finest) for finest in (0.0034, 0.0023)
    )
    assert fine.force == pytest.approx(coarse.force, rel=0.02)
    assert np.abs(fine.displaced - coarse.displaced).max() < 0.02 * 0.001


def test_a_bonded_tip_is_stiffer_and_holds_the_surface_still_sideways() -> None:
    points = THIN.grid(0.01)
    free, stuck = (
        press(THIN, MIDDLE, RigidTip((0.02, 0.02), bonded=b), points, depth=0.001, finest=0.01) for b in (False, True)
    )
    assert free.force < stuck.force < 1.2 * free.force
    np.testing.assert_allclose(stuck.displaced[stuck.touched, :2], 0.0, atol=1e-15)
    assert np.abs(free.displaced[free.touched, :2]).max() > 1e-5


@pytest.mark.slow
def test_a_ball_follows_hertz_on_a_deep_slab_and_pulls_at_nothing() -> None:
    found = press(DEEP, (0.25, 0.25), RigidTip(radius=0.03), DEEP.grid(0.1), depth=0.004, finest=0.003)
    hertz = 4 / 3 * 50e3 / 0.91 * np.sqrt(0.03) * 0.004**1.5
    assert found.force == pytest.approx(hertz, rel=0.12)


@pytest.mark.slow
def test_stiffness_may_vary_over_the_slab() -> None:
    halves = Slab((0.3, 0.2, 0.03), lambda place: np.where(place[:, 0] < 0.15, 20e3, 60e3), 0.2)
    soft, hard = (
        press(halves, at, RigidTip((0.01, 0.01)), halves.grid(0.05), depth=0.001, finest=0.005).force
        for at in ((0.05, 0.1), (0.25, 0.1))
    )
    assert hard / soft == pytest.approx(3.0, rel=0.02)


@pytest.mark.slow
def test_near_the_edge_it_is_softer() -> None:
    middle, edge = (
        press(THIN, at, RigidTip((0.01, 0.01)), THIN.grid(0.05), depth=0.001, finest=0.005).force
        for at in (MIDDLE, (0.01, 0.1))
    )
    assert 0.5 * middle < edge < 0.9 * middle


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="a flat tip or a ball"):
        RigidTip()
    with pytest.raises(InputError, match="a depth or a force"):
        press(THIN, MIDDLE, RigidTip((0.01, 0.01)), THIN.grid(0.05))
