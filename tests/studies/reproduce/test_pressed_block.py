"""The pressed block against closed forms, linear finite elements, energy balance and its own refinement."""

import numpy as np
import pytest
from skfem import Basis, ElementQuad2, ElementVector, MeshQuad, asm, condense, solve
from skfem.models.elasticity import lame_parameters, linear_elasticity

from deformscope.errors import InputError
from deformscope.lab.plateau_world import OgdenFoam
from studies.reproduce import pressed_block
from studies.reproduce.pressed_block import Block, press
from studies.reproduce.virtual_foams import FOAMS, Foam, uniaxial

BLOCK = Block(0.16, 0.06, 0.1)
CLAMP_M, COARSE_M = 0.04, 0.015


def test_a_clamp_over_all_of_a_foam_that_never_widens_presses_evenly() -> None:
    law = OgdenFoam((3.0e3, 40.0), (12.0, -4.0), 0.0)
    for pressed in press(law, BLOCK, BLOCK.width_m, [0.01, 0.03], COARSE_M):
        stretch = 1 - pressed.depth_m / BLOCK.height_m
        assert pressed.force_n == pytest.approx(
            -uniaxial(law, stretch)[0] * BLOCK.width_m * BLOCK.thickness_m, rel=1e-8
        )
        np.testing.assert_allclose(pressed.displacement[:, 1], (stretch - 1) * pressed.nodes[:, 1], atol=1e-10)
        np.testing.assert_allclose(pressed.displacement[:, 0], 0.0, atol=1e-10)


@pytest.mark.parametrize("poisson", [0.1, 0.45])
def test_a_slight_push_is_linear_elasticity(poisson: float) -> None:
    law = OgdenFoam((3.0e3, 40.0), (12.0, -4.0), poisson)
    depth = 1e-7
    pressed = press(law, BLOCK, CLAMP_M, [depth], COARSE_M)[0]
    # the whole block this time, both halves of it, with scikit-fem's own elasticity
    x, y = (np.unique(np.round(axis, 12))[::2] for axis in pressed.nodes.T)
    mesh = MeshQuad.init_tensor(np.unique(np.concatenate([-x, x])), y)
    basis = Basis(mesh, ElementVector(ElementQuad2()))
    stiffness = asm(linear_elasticity(*lame_parameters(law.young, poisson)), basis)
    vertical = basis.project(lambda at: np.stack([0.0 * at[0], 0.0 * at[0] + 1.0])) > 0.5
    across, up = basis.doflocs
    bottom = up < 1e-9
    under = (up > BLOCK.height_m - 1e-9) & (np.abs(across) < 0.5 * CLAMP_M + 1e-9)
    moved = np.where(under & vertical, -depth, 0.0)
    moved = solve(*condense(stiffness, basis.zeros(), x=moved, D=np.flatnonzero(bottom | under)))
    force = -float((stiffness @ moved)[under & vertical].sum()) * BLOCK.thickness_m
    place = np.array([[0.0, 0.03], [0.03, 0.05], [-0.03, 0.05], [0.07, 0.01], [-0.02, 0.02]])
    probe = Basis(mesh, ElementQuad2()).probes(place.T)
    truth = np.stack([probe @ moved[~vertical], probe @ moved[vertical]], axis=1)
    assert pressed.force_n == pytest.approx(force, rel=1e-4)
    np.testing.assert_allclose(pressed.at(place), truth, rtol=0, atol=1e-4 * depth)


def test_ground_pushes_back_as_the_clamp_pushes() -> None:
    for pressed in press(FOAMS[2].law(), BLOCK, CLAMP_M, [0.006, 0.015], COARSE_M):
        assert pressed.force_n > 0
        assert pressed.ground_n == pytest.approx(pressed.force_n, rel=1e-7)


def test_force_is_the_energys_slope_over_depth() -> None:
    half = pressed_block._Half(FOAMS[1].law(), BLOCK, CLAMP_M, COARSE_M)
    step = 1e-5
    state, energy = half.push(half.basis.zeros(), 0.0, 0.01 - step), []
    force = 0.0
    for depth in (0.01 - step, 0.01, 0.01 + step):
        state = half.push(state, depth - step, depth)
        energy.append(half._energy(state) * half.thickness)
        if depth == 0.01:
            force = half.result(state, depth).force_n
    assert force == pytest.approx((energy[2] - energy[0]) / (2 * step), rel=1e-5)


def test_twice_as_firm_moves_alike_with_twice_the_force() -> None:
    law = FOAMS[0].law()
    firmer = OgdenFoam(tuple(2 * mu for mu in law.shear), law.exponent, law.poisson)
    one, two = (press(each, BLOCK, CLAMP_M, [0.01], COARSE_M)[0] for each in (law, firmer))
    np.testing.assert_allclose(two.displacement, one.displacement, rtol=0, atol=1e-9 * 0.01)
    assert two.force_n == pytest.approx(2 * one.force_n, rel=1e-7)


@pytest.mark.slow
def test_load_steps_do_not_decide_the_state() -> None:
    law = FOAMS[3].law()
    once = press(law, BLOCK, CLAMP_M, [0.012], COARSE_M)[-1]
    often = press(law, BLOCK, CLAMP_M, [0.003, 0.006, 0.009, 0.012], COARSE_M)[-1]
    np.testing.assert_allclose(once.displacement, often.displacement, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_finer_elements_change_little_and_do_not_lock() -> None:
    law = OgdenFoam((3.0e3, 40.0), (12.0, -4.0), 0.45)
    place = np.array([[0.0, 0.03], [0.03, 0.04], [0.05, 0.02]])
    coarse, fine = (press(law, BLOCK, CLAMP_M, [0.01], size)[-1] for size in (0.01, 0.006))
    assert coarse.force_n == pytest.approx(fine.force_n, rel=0.02)
    np.testing.assert_allclose(coarse.at(place), fine.at(place), rtol=0, atol=0.02 * 0.01)


def test_left_mirrors_right() -> None:
    pressed = press(FOAMS[2].law(), BLOCK, CLAMP_M, [0.01], COARSE_M)[0]
    right = np.array([[0.01, 0.05], [0.04, 0.03]])
    np.testing.assert_allclose(pressed.at(right * [-1, 1]), pressed.at(right) * [-1, 1], atol=1e-15)


@pytest.mark.slow
def test_a_push_that_cannot_be_followed_says_how_far_it_came() -> None:
    with pytest.raises(InputError, match=r"no equilibrium found beyond [\d.]+ mm, before 61\.00 mm"):
        press(FOAMS[0].law(), BLOCK, CLAMP_M, [BLOCK.height_m + 0.001], 0.03)


@pytest.mark.parametrize(("clamp", "depths"), [(0.2, [0.01]), (0.04, []), (0.04, [0.01, 0.01]), (0.04, [-0.01])])
def test_what_is_no_push_is_refused(clamp: float, depths: list[float]) -> None:
    with pytest.raises(InputError, match="depths that rise"):
        press(FOAMS[0].law(), BLOCK, clamp, depths, COARSE_M)


@pytest.mark.slow  # load steps of five foams
@pytest.mark.parametrize(
    ("foam", "at_8_mm"), list(zip(FOAMS, (0.47, 0.33, 0.74, 0.38, 0.59), strict=True)), ids=lambda one: str(one)[:24]
)
def test_foam_with_a_plateau_meets_a_tip_with_less_and_less(foam: Foam, at_8_mm: float) -> None:
    """Force over depth of a flat tip of 16 mm on 5 cm, over that of a slight push."""
    slight, *deeper = press(foam.law(), Block(0.16, 0.05, 0.016), 0.016, [1e-6, 0.004, 0.008], 0.004)
    share = [one.force_n / one.depth_m / (slight.force_n / slight.depth_m) for one in deeper]
    assert 1.0 > share[0] > share[1] == pytest.approx(at_8_mm, abs=0.02)
