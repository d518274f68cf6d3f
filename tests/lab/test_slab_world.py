"""The slab under a tip: closed forms, energy, an independent finite element model, and what contact must obey."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq, nnls

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab import slab_world
from deformscope.lab.scene_lab import SceneLab
from deformscope.lab.scenes import POISSON, Scene, built_in, initial_modulus_pa
from deformscope.lab.slab import RigidTip, Slab, press
from deformscope.lab.slab_world import SlabWorld

BALL = RigidTip(radius=0.01)
MIDDLE = np.array([0.3, 0.2])
FOAM_PA = initial_modulus_pa(60)


def foam(modulus: Callable[[FloatArray], FloatArray] | float = FOAM_PA, **changes: object) -> Scene:
    """A flat slab of a modulus [Pa]."""
    field = modulus if callable(modulus) else lambda xy: np.full(np.shape(xy)[:-1], modulus)
    return dataclasses.replace(built_in("homogeneous-60"), _modulus=field, **changes)


def over(xy_m: FloatArray, depth_m: float, thickness_m: float = 0.05) -> FloatArray:
    """Where the ball's middle is when it has sunk so far into a flat slab."""
    return np.append(xy_m, thickness_m + 0.01 - depth_m)


@pytest.fixture(scope="module")
def even() -> SlabWorld:
    return SlabWorld(foam())


@pytest.fixture(scope="module")
def halves() -> SlabWorld:
    """37 kPa left of the middle, 93 kPa right of it."""
    return SlabWorld(foam(lambda xy: np.where(xy[..., 0] < 0.3, FOAM_PA, 2.5 * FOAM_PA)))


def test_a_press_does_not_depend_on_the_one_before() -> None:
    scene, rng = built_in("two-60-150", seed=3), np.random.default_rng(1)
    used = SlabWorld(scene)
    used.prepare(BALL, MIDDLE)
    fresh = SlabWorld(scene)
    fresh._patches = list(used._patches)
    for _ in range(40):
        at = over(MIDDLE + rng.uniform(-0.001, 0.001, 2), rng.uniform(-0.001, 0.006))
        fresh._patches[-1][1]._pushed = None
        expected = fresh.press(BALL, at)
        fresh._patches[-1][1]._pushed = (
            rng.random(len(expected.place_m) and len(used._patches[-1][1].candidate_m)) < 0.5
        )
        found = used.press(BALL, at)
        np.testing.assert_array_equal(found.node, expected.node)
        np.testing.assert_array_equal(found.force_n, expected.force_n)


@pytest.mark.parametrize("name", ["bumpy", "egg-crate"])
def test_a_laboratory_presses_as_its_world_does(name: str) -> None:
    """High above the foam, near it, in it, and where it was pressed before."""
    scene, rng = built_in(name, seed=1), np.random.default_rng(2)
    laboratory, world = SceneLab(scene, tip_radius_m=0.01, parked_m=0.2), SlabWorld(scene)
    middle = np.append(MIDDLE, scene.foam_height_m(MIDDLE))
    for height_m in (0.05, 0.03, 0.02, 0.012, 0.009, 0.007, 0.007, 0.009, 0.05, 0.007):
        at = middle + np.array([0.0, 0.0, height_m])
        np.testing.assert_array_equal(laboratory.press(at), world.press(BALL, at).force_n)
    high_m = float(scene.foam_height_m(scene.cells_m()).max()) + 0.026
    for xy_m in rng.uniform(0.0, scene.size_m, (50, 2)):
        assert world.press(BALL, np.append(xy_m, high_m)).mesh_m is None


def sneddon_n(depth_m: float, radius_m: float, modulus_pa: float) -> float:
    """A rigid ball on a half-space (Sneddon 1965), exact for a ball where Hertz has a paraboloid."""

    def beyond(a: float) -> float:
        return 0.5 * a * np.log((radius_m + a) / (radius_m - a)) - depth_m

    a = float(brentq(beyond, 1e-9, radius_m * (1 - 1e-12)))
    logarithm = np.log((radius_m + a) / (radius_m - a))
    return float(modulus_pa / (1 - POISSON**2) * (0.5 * (a**2 + radius_m**2) * logarithm - a * radius_m))


@pytest.mark.parametrize("depth_m", [0.001, 0.002, 0.004, 0.007])
def test_a_ball_on_a_slab_that_is_glued_down(even: SlabWorld, depth_m: float) -> None:
    """Hertz's paraboloid on a bonded layer (Dimitriadis et al. 2002, eq. 13), times what makes it a ball."""
    nu = POISSON
    alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1.0 - nu)
    beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1.0 - nu)
    ratio = np.sqrt(0.01 * depth_m) / 0.05
    terms = [
        1.0,
        -2.0 * alpha / np.pi,
        4.0 * alpha**2 / np.pi**2,
        -8.0 / np.pi**3 * (alpha**3 + 4.0 * np.pi**2 / 15.0 * beta),
        16.0 * alpha / np.pi**4 * (alpha**3 + 3.0 * np.pi**2 / 5.0 * beta),
    ]
    known = sneddon_n(depth_m, 0.01, FOAM_PA) * sum(term * ratio**power for power, term in enumerate(terms))
    assert even.press(BALL, over(MIDDLE, depth_m)).normal_force_n == pytest.approx(known, rel=0.02)


@pytest.mark.slow
def test_a_ball_on_a_thick_slab_follows_hertz() -> None:
    """At 60 radii of thickness: within 5 % of Sneddon, and of Hertz where the two are the same."""
    thick = 0.6
    world = SlabWorld(foam(thickness_m=thick, size_m=(2.5, 2.5)))
    middle = np.array([1.25, 1.25])
    for depth in (0.002, 0.004, 0.007, 0.012):
        force = world.press(BALL, over(middle, depth, thick)).normal_force_n
        assert force == pytest.approx(sneddon_n(depth, 0.01, FOAM_PA), rel=0.05)
    hertz = 4 / 3 * FOAM_PA / (1 - POISSON**2) * np.sqrt(0.01) * 0.002**1.5
    assert world.press(BALL, over(middle, 0.002, thick)).normal_force_n == pytest.approx(hertz, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("beside_m", [None, -0.02, -0.005, 0.0, 0.01])
def test_a_finer_mesh_changes_the_force_little(beside_m: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also near a border: within 3 % from 1 to 7 mm."""

    def modulus(xy: FloatArray) -> FloatArray:
        return np.where(xy[..., 0] < (1.0 if beside_m is None else 0.3 - beside_m), FOAM_PA, 2.5 * FOAM_PA)

    depths = (0.001, 0.002, 0.004, 0.007)
    coarse = [SlabWorld(foam(modulus)).press(BALL, over(MIDDLE, depth)).normal_force_n for depth in depths]
    for name, value in {"FINE": 0.12, "GROWTH_ASIDE": 1.4, "GROWTH_DOWN": 1.45}.items():
        monkeypatch.setattr(slab_world, name, value)
    finer = SlabWorld(foam(modulus))
    fine = [finer.press(BALL, over(MIDDLE, depth)).normal_force_n for depth in depths]
    np.testing.assert_allclose(coarse, fine, rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("tip", [BALL, RigidTip((0.01, 0.01))], ids=["ball", "flat"])
def test_it_agrees_with_quadratic_elements(tip: RigidTip, even: SlabWorld) -> None:
    """`lab.slab` has other elements, another mesh and another contact algorithm."""
    slab = Slab((0.6, 0.4, 0.05), FOAM_PA, POISSON)
    points = np.array([[0.315, 0.2, 0.05], [0.3, 0.225, 0.05], [0.34, 0.2, 0.05], [0.3, 0.26, 0.05]])
    known = press(slab, (0.3, 0.2), tip, points, depth=0.004, finest=0.005)
    contact = even.press(tip, np.append(MIDDLE, 0.05 - 0.004 + (tip.radius or 0.0)))
    assert contact.normal_force_n == pytest.approx(known.force, rel=0.06)
    np.testing.assert_allclose(even.displaced_m(contact, points[:, :2]), known.displaced, atol=0.02 * 0.004)


def test_force_is_the_slope_of_the_energy(even: SlabWorld) -> None:
    """Clapeyron: U = 1/2 sum f_i w_i over the contact, and dU/dd = F however the patch grows; the force on the tip is
    opposite to what the nodes carry."""

    def energy(depth: float) -> float:
        contact = even.press(BALL, over(MIDDLE, depth))
        sunk = -even.displaced_m(contact, contact.place_m[:, :2])[:, 2]
        return 0.5 * float(contact.node_force_n @ sunk)

    for depth in (0.001, 0.004, 0.009):
        contact = even.press(BALL, over(MIDDLE, depth))
        slope = (energy(depth + 1e-6) - energy(depth - 1e-6)) / 2e-6
        assert contact.normal_force_n == pytest.approx(slope, rel=1e-4)
        np.testing.assert_allclose(contact.force_n, [0.0, 0.0, contact.node_force_n.sum()], atol=1e-12)


def test_the_surface_lies_against_the_tip_and_nowhere_inside_it(even: SlabWorld) -> None:
    contact = even.press(BALL, over(MIDDLE, 0.006))
    at = contact.place_m[:, :2]
    ball = contact.center_m[2] - np.sqrt(0.01**2 - ((at - MIDDLE) ** 2).sum(axis=1))
    np.testing.assert_allclose(0.05 + even.displaced_m(contact, at)[:, 2], ball, atol=1e-9)
    every = even.prepare(BALL, MIDDLE).candidate_m[:, :2]
    aside = ((every - MIDDLE) ** 2).sum(axis=1)
    every, aside = every[aside < 0.01**2], aside[aside < 0.01**2]
    ball = contact.center_m[2] - np.sqrt(0.01**2 - aside)
    assert (0.05 + even.displaced_m(contact, every)[:, 2] <= ball + 1e-9).all()
    assert (contact.node_force_n > 0.0).all()
    assert (contact.depth_m, contact.gap_m) == (pytest.approx(0.006), 0.0)


@pytest.mark.slow
def test_force_grows_with_the_modulus_alone(even: SlabWorld) -> None:
    firm = SlabWorld(foam(2.5 * FOAM_PA))
    one, two = (world.press(BALL, over(MIDDLE, 0.004)) for world in (even, firm))
    assert two.normal_force_n == pytest.approx(2.5 * one.normal_force_n, rel=1e-9)
    places = MIDDLE + np.array([[0.0, 0.0], [0.02, 0.01], [-0.05, 0.0]])
    np.testing.assert_allclose(firm.displaced_m(two, places), even.displaced_m(one, places), atol=1e-12)


def test_an_even_slab_answers_evenly(even: SlabWorld) -> None:
    contact = even.press(BALL, over(MIDDLE, 0.005))
    beside = np.array([[0.015, 0.004], [0.04, 0.0], [0.02, 0.03]])
    right, left = (even.displaced_m(contact, MIDDLE + side * beside) for side in (1, -1))
    np.testing.assert_allclose(right, left * (-1, -1, 1), atol=1e-9)
    assert right[0, 2] < right[1, 2] < 0.0


def test_the_softer_side_moves_more(halves: SlabWorld) -> None:
    contact = halves.press(BALL, over(MIDDLE, 0.004))
    soft, hard = halves.displaced_m(contact, MIDDLE + np.array([[-0.02, 0.0], [0.02, 0.0]]))[:, 2]
    assert soft < 1.1 * hard < 0.0


@pytest.mark.slow
def test_a_border_blends_within_a_few_centimetres(halves: SlabWorld, even: SlabWorld) -> None:
    ratio = {}
    alone = even.press(BALL, over(MIDDLE, 0.004)).normal_force_n
    for beside in (-0.04, 0.0, 0.01):
        at = MIDDLE + np.array([beside, 0.0])
        ratio[beside] = halves.press(BALL, over(at, 0.004)).normal_force_n / alone
    assert ratio[-0.04] == pytest.approx(1.0, abs=0.02)
    assert 1.3 < ratio[0.0] < 2.1 < ratio[0.01] < 2.49


def test_near_the_slabs_edge_it_is_softer_and_beside_it_is_the_table(even: SlabWorld) -> None:
    inside, edge = (even.press(BALL, over(at, 0.004)).normal_force_n for at in (MIDDLE, np.array([0.004, 0.2])))
    assert 0.4 * inside < edge < 0.9 * inside
    beside = np.array([-0.05, 0.2])
    assert even.press(BALL, np.append(beside, 0.0101)).normal_force_n == 0.0
    assert even.press(BALL, np.append(beside, 0.0099)).force_n[2] == pytest.approx(20.0)


def test_rigid_is_hundreds_of_times_stiffer(even: SlabWorld) -> None:
    rigid = SlabWorld(built_in("homogeneous-rigid"))
    depth = 0.0005
    assert rigid.press(BALL, over(MIDDLE, depth)).normal_force_n > (
        500 * even.press(BALL, over(MIDDLE, depth)).normal_force_n
    )


@pytest.mark.slow
def test_on_a_slope_the_force_is_along_the_normal() -> None:
    scene = built_in("bumpy", 2)
    world = SlabWorld(scene)
    cells = scene.cells_m()[20:60:5, 20:100:5].reshape(-1, 2)
    steep = cells[np.argmin(scene.normal(cells)[:, 2])]
    normal = scene.normal(steep)
    assert normal[2] < 0.997
    surface = np.append(steep, scene.height_m(steep))
    contact = world.press(BALL, surface + (0.01 - 0.004) * normal)
    assert contact.depth_m == pytest.approx(0.004, rel=1e-3)
    np.testing.assert_allclose(contact.force_n, contact.normal_force_n * normal, atol=1e-3 * contact.normal_force_n)
    flat = SlabWorld(foam(float(scene.modulus_pa(steep)))).press(BALL, over(MIDDLE, 0.004))
    assert contact.normal_force_n == pytest.approx(flat.normal_force_n, rel=0.1)
    assert world.press(BALL, surface + 0.0105 * normal).normal_force_n == 0.0


@pytest.mark.slow
def test_a_press_depends_on_no_other_press(halves: SlabWorld) -> None:
    at = MIDDLE + np.array([0.013, 0.007])
    again = SlabWorld(halves.scene)
    for depth in (0.009, 0.001, 0.005):
        halves.press(BALL, over(at, depth))
    one, two = (world.press(BALL, over(at, 0.004)) for world in (halves, again))
    np.testing.assert_array_equal(one.node_force_n, two.node_force_n)
    places = at + np.array([[0.0, 0.0], [0.03, 0.01]])
    np.testing.assert_array_equal(halves.displaced_m(one, places), again.displaced_m(two, places))


def test_a_little_drift_changes_little(even: SlabWorld) -> None:
    """The ball then rests on the same mesh, off its middle."""
    even.prepare(BALL, MIDDLE)
    centred, drifted = (even.press(BALL, over(MIDDLE + aside, 0.005)) for aside in (0.0, 0.0012))
    np.testing.assert_array_equal(drifted.mesh_m, MIDDLE)
    assert drifted.normal_force_n == pytest.approx(centred.normal_force_n, rel=0.03)


@pytest.mark.slow
def test_a_flat_tip_keeps_its_footprint_while_it_drifts() -> None:
    """King 1987: a square of side 2a on a half-space, 2.02 sqrt(4 a^2 / pi) E* d; a slab is stiffer."""
    world, tip = SlabWorld(foam()), RigidTip((0.01, 0.006))
    forces = [world.press(tip, np.append(MIDDLE + aside, 0.049)).normal_force_n for aside in (0.0, 2e-4, -2e-4)]
    np.testing.assert_allclose(forces, forces[0], rtol=1e-3)
    half_space = 2.02 * np.sqrt(4 * 0.01 * 0.006 / np.pi) * FOAM_PA / (1 - POISSON**2) * 0.001
    assert 1.05 * half_space < forces[0] < 1.35 * half_space


@pytest.mark.slow
def test_an_old_contact_can_still_be_seen(even: SlabWorld) -> None:
    """Its mesh may be long gone."""
    contact = even.press(BALL, over(MIDDLE, 0.005))
    places = MIDDLE + np.array([[0.0, 0.0], [0.03, 0.0]])
    seen = even.displaced_m(contact, places)
    for aside in (0.05, 0.06, 0.07):
        even.prepare(RigidTip(radius=0.015), MIDDLE + aside)
    np.testing.assert_array_equal(even.displaced_m(contact, places), seen)


def test_far_above_nothing_is_felt_and_nothing_moves(even: SlabWorld) -> None:
    contact = even.press(BALL, over(MIDDLE, -0.03))
    assert contact.mesh_m is None
    assert (contact.normal_force_n, contact.depth_m, contact.gap_m) == (0.0, pytest.approx(-0.03), pytest.approx(0.03))
    assert not even.displaced_m(contact, MIDDLE[None]).any()


@pytest.mark.parametrize("seed", range(5))
def test_contact_forces_are_those_of_least_squares(seed: int) -> None:
    """Any compliance, overlaps of either sign, some nodes beside the tip."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(30, 30))
    compliance = root @ root.T + 0.1 * np.eye(30)
    overlap = random.normal(size=30)
    overlap[:5] = -np.inf
    force = slab_world._without_pull(compliance, overlap)
    factor = np.linalg.cholesky(compliance[5:, 5:]).T
    known = nnls(factor, np.linalg.solve(factor.T, overlap[5:]))[0]
    np.testing.assert_allclose(force[5:], known, atol=1e-6 * known.max())
    assert not force[:5].any()


def test_what_is_no_place_is_refused(even: SlabWorld) -> None:
    with pytest.raises(InputError, match="three finite numbers"):
        even.press(BALL, np.array([0.3, np.nan, 0.05]))
