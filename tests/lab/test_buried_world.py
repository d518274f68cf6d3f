"""A slab with a ball in it: what it changes of a touch, beside one fine mesh of everything."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex1, MeshHex

from deformscope.arrays import FloatArray
from deformscope.lab.elasticity import dissected, stiffness_of
from deformscope.lab.scene_lab import BuriedWorld, slab_world
from deformscope.lab.scenes import BuriedBall, Scene, built_in
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import _without_pull
from studies.touching import force_curve

RADIUS_M, FORCE_N = 0.01, 3.0
TIP = RigidTip(radius=RADIUS_M)
UP = np.array([0.0, 0.0, 1.0])


def with_ball(depth_m: float, times: float) -> Scene:
    """A ball in the middle of the foam, so many times as stiff."""
    scene = built_in("empty", 1)
    return replace(scene, buried=BuriedBall((0.1, 0.1), 0.02, depth_m, times * scene.pieces[0].modulus_pa))


def log_stiffness(scene: Scene, xy_m: FloatArray) -> float:
    rest = np.array([*xy_m, scene.thickness_m + RADIUS_M])
    depth_m, force_n = force_curve(slab_world(scene), TIP, rest, UP, 1.1 * FORCE_N, 0.015)
    return float(np.log(FORCE_N / np.interp(FORCE_N, force_n, depth_m)))


@pytest.mark.slow
def test_it_is_felt_above_it_the_less_the_deeper_and_the_farther() -> None:
    scene = with_ball(0.01, 10.0)
    foam = log_stiffness(replace(scene, buried=None), np.array([0.1, 0.1]))
    shallow, aside, deep = (
        log_stiffness(one, np.array([x, 0.1])) - foam
        for one, x in ((scene, 0.1), (scene, 0.12), (with_ball(0.02, 10.0), 0.1))
    )
    assert 0.2 < shallow < 0.4
    assert 0.3 * shallow < aside < 0.7 * shallow
    assert 0.3 * shallow < deep < 0.6 * shallow
    assert log_stiffness(with_ball(0.01, 0.1), np.array([0.1, 0.1])) < foam - 0.1


def test_a_ball_of_the_foam_itself_changes_nothing() -> None:
    scene = replace(with_ball(0.01, 1.0), size_m=(0.1, 0.1), thickness_m=0.04)
    scene = replace(scene, buried=BuriedBall((0.05, 0.05), 0.01, 0.01, scene.pieces[0].modulus_pa))
    world = BuriedWorld(scene, scene.buried or pytest.fail("nothing is buried"))
    centre_m = np.array([0.05, 0.05, scene.thickness_m + RADIUS_M - 0.006])
    ours, plain = world.press(TIP, centre_m), slab_world(replace(scene, buried=None)).press(TIP, centre_m)
    np.testing.assert_allclose(ours.force_n, plain.force_n, rtol=1e-9)


@pytest.mark.slow
def test_the_surface_moves_as_the_contact_says() -> None:
    """Under the tip the moved surface lies on the ball that presses it, to a hundredth of the dent."""
    scene = with_ball(0.012, 10.0)
    world = slab_world(scene)
    centre_m = np.array([0.11, 0.1, scene.thickness_m + RADIUS_M - 0.006])
    contact = world.press(TIP, centre_m)
    place = contact.place_m + world.displaced_m(contact, contact.place_m[:, :2]) * UP
    wanted = centre_m[2] - np.sqrt(RADIUS_M**2 - np.linalg.norm((contact.place_m - centre_m)[:, :2], axis=1) ** 2)
    np.testing.assert_allclose(place[:, 2], wanted, atol=6e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("depth_m", "times"), [(0.01, 10.0), (0.02, 10.0), (0.015, 0.1)])
@pytest.mark.parametrize("aside_m", [0.0, 0.02])
def test_as_one_fine_mesh_has_it(depth_m: float, times: float, aside_m: float) -> None:
    """Within a tenth of what the ball changes, or .004 of log stiffness."""
    scene = with_ball(depth_m, times)
    plain, at = replace(scene, buried=None), np.array([0.1 + aside_m, 0.1])
    ours = log_stiffness(scene, at) - log_stiffness(plain, at)
    fine = _fine_log_stiffness(scene, aside_m) - _fine_log_stiffness(plain, aside_m)
    assert ours == pytest.approx(fine, rel=0.1, abs=0.004)


def _fine_log_stiffness(scene: Scene, aside_m: float) -> float:
    """Half the slab, cut through the ball's middle and the tip: elements of 1.5 mm at the tip, of 3 mm in the ball."""

    def spread(middle: float, low: float, high: float) -> FloatArray:
        right, step = [0.0], 0.0015
        while right[-1] < 0.2:
            step = 0.0015 if right[-1] < 0.0105 else 0.003 if right[-1] < 0.045 else 1.6 * step
            right.append(right[-1] + step)
        every = middle + np.concatenate([-np.array(right[:0:-1]), right])
        return np.concatenate([[low], every[(every > low + 1e-3) & (every < high - 1e-3)], [high]])

    depths, step = [0.0], 0.0011
    while depths[-1] < scene.thickness_m:
        step = min(1.35 * step, 0.003) if depths[-1] < 0.062 else 1.6 * step
        depths.append(depths[-1] + step)
    z = scene.thickness_m * (1.0 - np.array(depths[::-1]) / depths[-1])
    axes = (spread(0.1 + aside_m, 0.0, 0.2), spread(0.1, 0.1, 0.2), z)
    mesh = MeshHex.init_tensor(*axes)
    basis = Basis(mesh, ElementHex1(), intorder=2)
    corner = mesh.p[:, mesh.t]
    share = (np.arange(4) + 0.5) / 4
    spots = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 1, 3)
    places = corner.min(axis=1).T + spots * np.ptp(corner, axis=1).T
    modulus = scene.modulus_pa(places[..., :2])
    if (ball := scene.buried) is not None:
        middle = np.array([0.1, 0.1, scene.thickness_m - ball.depth_m - ball.radius_m])
        modulus = np.where(np.linalg.norm(places - middle, axis=-1) < ball.radius_m, ball.modulus_pa, modulus)
    place = np.empty((basis.N, 3))
    place[basis.nodal_dofs[0]] = mesh.p.T
    held = np.zeros((basis.N, 3), dtype=bool)
    held[place[:, 2] < 1e-9] = True
    held[place[:, 1] < 0.1 + 1e-9, 1] = True
    free = np.flatnonzero(~held.ravel())
    free = free[dissected(place[free // 3], axes)]
    own = stiffness_of(basis, modulus.mean(axis=0), np.full(len(corner[0, 0]), scene.poisson))[free][:, free].tocsc()
    factors = splu(own, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    away = np.linalg.norm(place[:, :2] - (0.1 + aside_m, 0.1), axis=1)
    node = np.flatnonzero((place[:, 2] > scene.thickness_m - 1e-9) & (away < 0.0105))
    at = np.searchsorted(np.sort(free), 3 * node + 2)
    at = np.argsort(free)[at]
    load = np.zeros((len(free), len(node)))
    load[at, np.arange(len(node))] = 1.0
    compliance = factors.solve(load)[at]
    depth_m, force_n = np.linspace(0.003, 0.009, 7), []
    sinks = RADIUS_M - np.sqrt(np.maximum(RADIUS_M**2 - away[node] ** 2, 0.0))
    for depth in depth_m:
        overlap = np.where(away[node] < RADIUS_M, depth - sinks, -np.inf)
        force_n.append(2.0 * _without_pull(0.5 * (compliance + compliance.T), overlap).sum())  # of both halves
    return float(np.log(FORCE_N / np.interp(FORCE_N, force_n, depth_m)))
