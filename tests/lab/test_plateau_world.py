"""Foam that yields under a ball: large-strain finite elements around its axis, and the slab that takes their force."""

from math import pi

import numpy as np
import pytest

from deformscope.errors import InputError
from deformscope.lab.live_lab import LayerWorld
from deformscope.lab.plateau_world import OgdenFoam, PlateauWorld, _Layer, force_share, press_ball
from deformscope.lab.scene_lab import SceneLab
from deformscope.lab.scenes import Piece, built_in
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld

RADIUS_M, THICKNESS_M, POISSON = 0.01, 0.05, 0.2
TIP = RigidTip(radius=RADIUS_M)
MIDDLE = np.array([0.3, 0.2])


def law(exponent: float, modulus_pa: float = 1e5, poisson: float = POISSON) -> OgdenFoam:
    return OgdenFoam((0.5 * modulus_pa / (1.0 + poisson),), (exponent,), poisson)


def bonded_layer_n(modulus_pa: float, poisson: float, depth_m: float) -> float:
    """Force of a ball on a bonded layer, small strain (Dimitriadis et al. 2002, eq. 12)."""
    chi = np.sqrt(RADIUS_M * depth_m) / THICKNESS_M
    a = -(1.2876 - 1.4678 * poisson + 1.3442 * poisson**2) / (1.0 - poisson)
    b = (0.6387 - 1.0277 * poisson + 1.5164 * poisson**2) / (1.0 - poisson)
    series = 1.0 - 2.0 * a / pi * chi + 4.0 * a**2 / pi**2 * chi**2
    series -= 8.0 / pi**3 * (a**3 + 4.0 * pi**2 / 15.0 * b) * chi**3
    series += 16.0 * a / pi**4 * (a**3 + 3.0 * pi**2 / 5.0 * b) * chi**4
    return float(4.0 / 3.0 * modulus_pa / (1.0 - poisson**2) * np.sqrt(RADIUS_M) * depth_m**1.5 * series)


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_a_light_press_is_that_of_a_bonded_linear_layer(poisson: float) -> None:
    # 0.2 mm of a ball of 10 mm: strains of some 3 %, by which exponents from 1 to 5 change the force by 5 %
    found = press_ball(law(3.0, poisson=poisson), RADIUS_M, THICKNESS_M, [0.0002], fine=0.06).force_n[0]
    assert found == pytest.approx(bonded_layer_n(1e5, poisson, 0.0002), rel=0.03)


def test_forces_balance_and_go_with_the_modulus() -> None:
    soft, firm = (press_ball(law(12.0, pa), RADIUS_M, THICKNESS_M, [0.001, 0.004], fine=0.2) for pa in (1e4, 7e4))
    assert soft.ground_n == pytest.approx(soft.force_n, rel=1e-6)
    assert firm.force_n == pytest.approx(7.0 * soft.force_n, rel=1e-6)
    assert firm.contact_m == pytest.approx(soft.contact_m, rel=1e-9)
    assert (np.diff(soft.contact_m) > 0.0).all()


def test_forces_are_the_slope_of_the_energy_and_the_tangent_that_of_the_forces() -> None:
    layer = _Layer(law(12.0), RADIUS_M, THICKNESS_M, fine=0.5)
    layer.push(layer.basis.zeros(), 0.0, 0.003)
    random = np.random.default_rng(0)
    state = 1e-4 * random.standard_normal(layer.basis.N)
    state[layer.basis.doflocs[0] < 1e-9] = 0.0  # on the axis nothing goes aside
    way = random.standard_normal(layer.basis.N)
    way[layer.basis.doflocs[0] < 1e-9] = 0.0
    force, tangent = layer._assemble(state)
    step = 1e-8
    energies = [layer._energy(state + side * step * way) for side in (-1.0, 1.0)]
    forces = [layer._assemble(state + side * step * way)[0] for side in (-1.0, 1.0)]
    assert (energies[1] - energies[0]) / (2.0 * step) == pytest.approx(float(force @ way), rel=1e-5)
    along = tangent @ way
    assert np.linalg.norm((forces[1] - forces[0]) / (2.0 * step) - along) < 1e-4 * np.linalg.norm(along)


@pytest.mark.slow
def test_a_finer_mesh_finds_the_same() -> None:
    depth_m = [0.0005, 0.002, 0.006, 0.012]
    coarse, fine = (press_ball(law(20.0), RADIUS_M, THICKNESS_M, depth_m, size).force_n for size in (0.1, 0.05))
    assert coarse == pytest.approx(fine, rel=0.015)


def test_depths_must_rise_and_end_above_the_table() -> None:
    for wrong in ([], [0.002, 0.001], [0.05]):
        with pytest.raises(InputError, match="depths that rise"):
            press_ball(law(6.0), RADIUS_M, THICKNESS_M, wrong)


def test_a_slab_that_yields_takes_the_share_and_one_that_does_not_is_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def share(yields: int, poisson: float, radius_m: float, thickness_m: float, depth_m: np.ndarray) -> np.ndarray:
        asked.append((yields, poisson, radius_m, thickness_m))
        return 1.0 - 40.0 * depth_m

    monkeypatch.setattr("deformscope.lab.plateau_world.force_share", share)
    scene = built_in("two-61y19-150", seed=1000)
    yielding, linear = PlateauWorld(scene), SlabWorld(scene)
    cells = scene.cells_m().reshape(-1, 2)
    for label, expected in ((0, 1.0 - 40.0 * 0.004), (1, 1.0)):
        inside = cells[scene.label(cells) == label]
        deep = inside[np.argmin(np.linalg.norm(inside - inside.mean(axis=0), axis=1))]
        center = np.array([*deep, THICKNESS_M + RADIUS_M - 0.004])
        felt, before = yielding.press(TIP, center), linear.press(TIP, center)
        assert felt.normal_force_n == pytest.approx(expected * before.normal_force_n, rel=1e-9)
        assert felt.depth_m == before.depth_m
        away = center + np.array([0.0, 0.0, 0.02])
        assert yielding.press(TIP, away).normal_force_n == 0.0
    assert asked == [(19, POISSON, RADIUS_M, THICKNESS_M)]


@pytest.mark.slow
def test_foam_that_yields_gives_way_the_deeper_the_more() -> None:
    share = force_share(20, POISSON, RADIUS_M, THICKNESS_M, np.array([0.0005, 0.002, 0.006]))
    assert (np.diff(share) < 0.0).all()
    assert share[-1] == pytest.approx(0.41, abs=0.02)  # by a mesh twice as fine


def test_names_of_scenes_say_what_yields() -> None:
    assert Piece.named("60y20").plateau_exponent == 20
    assert Piece.named("60y20").modulus_pa == Piece.named("60").modulus_pa
    assert [piece.plateau_exponent for piece in built_in("two-60y20-150").pieces] == [20, 0]
    for name in ("homogeneous-60y", "homogeneous-60c30y20", "homogeneous-60y20c30", "homogeneous-60y0"):
        with pytest.raises(InputError, match="a scene"):
            built_in(name)
    with pytest.raises(InputError, match="that does not yield"):
        built_in("buried-60y20-600")
    with pytest.raises(InputError, match="yield, or that creep"):
        SceneLab(built_in("two-60y20-150c30"), tip_radius_m=0.01, parked_m=0.2)
    with pytest.raises(InputError, match="neither creeps nor yields"):
        LayerWorld(built_in("two-60y20-150"), RADIUS_M)
