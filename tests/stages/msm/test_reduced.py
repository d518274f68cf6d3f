"""A body of one cluster, reduced to its moments, against the particles of the reference and of the engine."""

import itertools
from typing import Any

import numpy as np
import pytest

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.reduced import Equilibrium, OneCluster
from deformscope.stages.msm.reference import Basis, Volume
from deformscope.stages.msm.solver import Msm
from tests.cases import slow, slow_but
from tests.stages import reference_states
from tests.stages.bodies import lattice

SAME = 1e-8
"""Positions by two solvers, as a share of the body's extent: what the reference's tolerance means at beta = 0.99."""

BALANCED = 1e-10
"""Largest goal - place, as a share of the extent, of a state that claims to have converged."""

VOLUMES: tuple[Volume, ...] = ("scale", "project")
BASES: tuple[Basis, ...] = ("linear", "quadratic")


def by_basis(*shapes: tuple[int, ...]) -> list[Any]:
    """Cases of a shape and a basis; slow is the quadratic one in the plane, whose kernels nothing else compiles."""
    every = list(itertools.product(shapes, BASES))
    return slow_but([one for one in every if one[1] == "linear" or len(one[0]) == 3], every)


def rough(shape: tuple[int, ...], rng: np.random.Generator, noise: float = 0.15) -> FloatArray:
    rest = lattice(shape)
    return np.asarray(rest + rng.normal(0.0, noise * 0.01, rest.shape))


def pressed(rest: FloatArray, share: float, twist: float = 0.0) -> tuple[IntArray, FloatArray]:
    """The first and last layer along the last axis held, the last one moved by a share of the height and twisted (in
    space) or sheared (in the plane)."""
    z = rest[:, -1]
    height = float(z.max())
    held = np.flatnonzero((z < 1e-9) | (z > height - 1e-9))
    position = rest[held].copy()
    top = z[held] > 0.5 * height
    position[top, -1] -= share * height
    if rest.shape[1] == 3:
        c, s = np.cos(twist), np.sin(twist)
        middle = position[top, :2].mean(axis=0)
        position[top, :2] = (position[top, :2] - middle) @ np.array([[c, s], [-s, c]]) + middle
    else:
        position[top, 0] += twist * height
    return held, position


def imbalance(
    one: OneCluster, x: FloatArray, mass: FloatArray | None, basis: Basis, beta: float, theta: float, volume: Volume
) -> float:
    """Largest goal - place by the reference, over the extent."""
    spec = reference.build_rest(one.rest, clusters.single(len(one.rest)), one.held, mass, basis)
    off = np.abs(reference_states.goals(x, spec, beta, theta, volume=volume) - x).max()
    return float(off / np.ptp(one.rest, axis=0).max())


def turned(rng: np.random.Generator, d: int) -> FloatArray:
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    return np.asarray(turn)


@pytest.mark.parametrize(
    ("shape", "basis", "volume"),
    slow_but(
        [((5, 6), "linear", "scale"), ((4, 3, 5), "quadratic", "project")],
        list(itertools.product([(5, 6), (4, 3, 5)], BASES, VOLUMES)),
    ),
)
def test_static_states_are_those_of_the_reference(
    device: str, shape: tuple[int, ...], basis: Basis, volume: Volume
) -> None:
    rng = np.random.default_rng(len(shape))
    beta = np.array([0.0, 0.5, 0.9, 0.99, 0.5, 0.9, 0.99, 0.99])
    theta = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 0.3, 1.0])
    for count in (3, 7, 12):
        rest = rough(shape, rng)
        extent = np.ptp(rest, axis=0).max()
        mass = rng.uniform(0.5, 2.0, len(rest))
        held = rng.choice(len(rest), count, replace=False)
        origin = rest @ turned(rng, len(shape)).T
        poses = origin[held] + rng.normal(0.0, 0.005, (2, count, len(shape)))
        one = OneCluster(rest, held, mass=mass, basis=basis, device=device)
        spec = reference.build_rest(rest, clusters.single(len(rest)), held, mass, basis)
        for pose in poses:
            holding = one.hold(pose)
            state = one.relax(holding, beta, theta, volume=volume)
            assert state.converged.all()
            found = one.positions(state, holding)
            np.testing.assert_array_equal(found[:, held], np.broadcast_to(pose, (len(beta), *pose.shape)))
            for row, x in enumerate(found):
                b, t = float(beta[row]), float(theta[row])
                assert imbalance(one, x, mass, basis, b, t, volume) < BALANCED
                expected, residual = reference_states.relax(spec, pose, beta=b, theta=t, volume=volume, start=origin)
                assert residual < 1e-10
                np.testing.assert_allclose(x, expected, atol=SAME * extent)


@pytest.mark.slow  # kernels of lists; the reference above judges both
def test_static_states_are_those_of_the_engine(device: str) -> None:
    rest = lattice((5, 5, 5))
    held, position = pressed(rest, 0.3, 0.2)
    beta = [0.3, 0.9, 0.99]
    one = OneCluster(rest, held, basis="linear", device=device)
    holding = one.hold(position)
    found = one.positions(one.relax(holding, beta), holding)
    engine = Msm(rest, clusters.single(len(rest)), held, device=device)
    np.testing.assert_allclose(found, engine.relax(position, beta).position, atol=1e-6 * engine.extent)
    np.testing.assert_allclose(engine.residual(found, beta), 0.0, atol=BALANCED * engine.extent)


@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize("shape", [slow((6, 5)), (4, 4, 4)])
def test_the_start_does_not_matter(device: str, shape: tuple[int, ...], volume: Volume) -> None:
    rng = np.random.default_rng(3)
    for each in ((6, 5), (4, 4, 4)):  # far enough off, a start can find another state: these draws do not
        rest = rough(each, rng, 0.05)
        held = np.arange(0, len(rest), 5)
        position = rest[held] + rng.normal(0.0, 0.004, (len(held), len(each)))
        starts = rest @ turned(rng, len(each)).T + rng.normal(0.0, 0.02, (20, *rest.shape))
        if each == shape:
            break
    one = OneCluster(rest, held, device=device)
    holding = one.hold(position)
    for beta, theta in ((0.9, 0.0), (0.9, 0.7), (0.99, 1.0)):
        alone = one.relax(holding, beta, theta, volume=volume)
        state = one.relax(holding, beta, theta, volume=volume, start=starts)
        assert alone.converged.all()
        assert state.converged.all()
        np.testing.assert_allclose(state.transform, np.repeat(alone.transform, 20, axis=0), atol=1e-10 * one.radius)


def test_size_units_and_pose_do_not_matter(device: str) -> None:
    rng = np.random.default_rng(4)
    rest = rough((4, 4, 5), rng)
    held = rng.choice(len(rest), 9, replace=False)
    position = rest[held] + rng.normal(0.0, 0.006, (9, 3))
    args = ([0.0, 0.9, 0.99], [0.0, 0.4, 1.0])

    def solved(rest: FloatArray, position: FloatArray) -> tuple[FloatArray, Equilibrium]:
        one = OneCluster(rest, held, device=device)
        holding = one.hold(position)
        state = one.relax(holding, *(np.array(a) for a in args))
        return one.positions(state, holding), state

    expected, plain = solved(rest, position)
    turn, shift = turned(rng, 3), rng.normal(0.0, 0.3, 3)
    for scale in (0.02, 100.0):  # a body of 1 mm, one of 5 m
        found, state = solved(rest * scale, position * scale)
        np.testing.assert_allclose(found / scale, expected, atol=1e-13)
        np.testing.assert_array_equal(state.iterations, plain.iterations)
    found, _ = solved(rest, position @ turn.T + shift)
    np.testing.assert_allclose(found, expected @ turn.T + shift, atol=1e-12)


@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize(("shape", "basis"), by_basis((5, 5), (4, 4, 4)))
def test_what_claims_to_have_converged_has(device: str, shape: tuple[int, ...], basis: Basis, volume: Volume) -> None:
    """Pressed to a half, to a tenth, through itself, pulled, twisted: a state, and one that holds, or word of none."""
    rest = lattice(shape)
    beta, theta = (np.ravel(v) for v in np.meshgrid([0.5, 0.9, 0.99, 0.9999], [0.0, 0.5, 1.0]))
    for share, twist in ((0.3, 0.0), (0.6, 0.0), (0.9, 0.0), (1.2, 0.0), (-0.5, 0.0), (0.3, 2.0), (0.0, 3.0)):
        held, position = pressed(rest, share, twist)
        one = OneCluster(rest, held, basis=basis, device=device)
        holding = one.hold(position)
        state = one.relax(holding, beta, theta, volume=volume)
        assert not (state.converged & state.diverged).any()
        assert np.all(state.residual[state.converged] <= 1e-10 * one.radius)
        assert np.all(state.error[state.converged] <= 1e-10 * one.radius)
        # eq. 3.17 has no static state that holds for a body turned inside out; everything else has one
        if not (share > 1.0 and volume == "scale"):
            assert state.converged.all(), (basis, share, twist)
        found = one.positions(state, holding)
        for row in np.flatnonzero(state.converged):
            b, t = float(beta[row]), float(theta[row])
            assert imbalance(one, found[row], None, basis, b, t, volume) < BALANCED
            if share > 1.0 or volume == "project":
                continue
            # a small push dies out
            spec = reference.build_rest(rest, clusters.single(len(rest)), held, basis=basis)
            near = found[row] + 1e-6 * np.random.default_rng(row).normal(size=rest.shape)
            near[held] = position
            first = np.abs(reference_states.goals(near, spec, b, t) - found[row]).max()
            for _ in range(20):
                near = reference_states.goals(near, spec, b, t)
            assert np.abs(near - found[row]).max() < 1.5 * first


def test_too_few_iterations_are_not_called_converged(device: str) -> None:
    rest = lattice((4, 4, 4))
    held, position = pressed(rest, 0.5)
    one = OneCluster(rest, held, device=device)
    state = one.relax(one.hold(position), 0.99, [0.0, 1.0], max_iterations=2)
    assert state.converged.tolist() == [True, False]
    assert not state.diverged.any()
    assert not one.relax(one.hold(np.full_like(position, np.nan)), 0.9, 0.5).converged.any()


@pytest.mark.parametrize("basis", BASES)
def test_sheets_in_space(device: str, basis: Basis) -> None:
    """Flat ones, whose normal follows the rotation, and nearly flat ones, whose thickness the fit leaves out."""
    rng = np.random.default_rng(6)
    flat = np.column_stack([lattice((5, 5)), np.zeros(25)])
    for thickness, volume in itertools.product((0.0, 4e-5), VOLUMES):
        rest = flat + np.array([0.0, 0.0, thickness]) * rng.normal(size=(25, 1))
        held = np.array([0, 4, 20, 24, 12])
        position = rest[held] @ turned(rng, 3).T + rng.normal(0.0, 0.004, (5, 3))
        one = OneCluster(rest, held, basis=basis, device=device)
        holding = one.hold(position)
        spec = reference.build_rest(rest, clusters.single(25), held, basis=basis)
        for beta, theta in ((0.5, 0.0), (0.9, 0.5), (0.99, 1.0)):
            state = one.relax(holding, beta, theta, volume=volume)
            assert state.converged.all()
            x = one.positions(state, holding)[0]
            assert imbalance(one, x, None, basis, beta, theta, volume) < BALANCED
            expected, residual = reference_states.relax(spec, position, beta=beta, theta=theta, volume=volume)
            if residual < 1e-10:
                np.testing.assert_allclose(x, expected, atol=SAME * 0.04)


@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize(("shape", "basis"), by_basis((2, 2), (2, 2, 2), (3, 3, 2), (1, 4), (1, 1, 4), (1, 1)))
def test_bodies_too_small_for_their_basis(device: str, shape: tuple[int, ...], basis: Basis, volume: Volume) -> None:
    rng = np.random.default_rng(7)
    rest = lattice(shape)
    for count in (0, 1, 2, 3):
        held = rng.choice(len(rest), min(count, len(rest)), replace=False)
        one = OneCluster(rest, held, basis=basis, device=device)
        holding = one.hold(rest[held] + rng.normal(0.0, 0.002, (len(held), len(shape))))
        for beta, theta in ((0.0, 0.0), (0.5, 0.0), (0.9, 0.5), (0.9, 1.0)):
            state = one.relax(holding, beta, theta, volume=volume)
            assert state.converged.all(), (basis, count, beta, theta)
            x = one.positions(state, holding)[0]
            spec = reference.build_rest(rest, clusters.single(len(rest)), held, basis=basis)
            if volume == "scale" or theta == 0.0:
                np.testing.assert_allclose(reference_states.goals(x, spec, beta, theta), x, atol=1e-10)


@pytest.mark.parametrize("volume", VOLUMES)
def test_bodies_that_are_free_to_turn(device: str, volume: Volume) -> None:
    rng = np.random.default_rng(8)
    rest = rough((4, 4, 4), rng)
    elsewhere = rest @ turned(rng, 3).T + 0.2
    for held in ([], [5], [5, 40]):
        one = OneCluster(rest, np.array(held, dtype=int), device=device)
        holding = one.hold(elsewhere[held])
        for beta, theta in ((0.0, 0.0), (0.9, 0.6), (0.99, 1.0)):
            # an undeformed body stays one, and where it was
            state = one.relax(holding, beta, theta, volume=volume, start=elsewhere)
            assert state.converged.all()
            np.testing.assert_allclose(one.positions(state, holding)[0], elsewhere, atol=1e-8)
    # two particles pulled apart leave it free to turn about the line between them
    one = OneCluster(rest, np.array([5, 40]), device=device)
    holding = one.hold(rest[[5, 40]] * 1.2)
    state = one.relax(holding, 0.9)
    assert state.converged.all()
    assert imbalance(one, one.positions(state, holding)[0], None, "quadratic", 0.9, 0.0, volume) < BALANCED


def test_all_particles_held(device: str) -> None:
    rest = lattice((3, 3, 3))
    one = OneCluster(rest, np.arange(27), device=device)
    holding = one.hold(rest * [0.3, 1.0, 1.0])
    state = one.relax(holding, [0.5, 0.99], [0.0, 1.0])
    assert state.converged.all()
    np.testing.assert_array_equal(one.positions(state, holding), np.stack([rest * [0.3, 1.0, 1.0]] * 2))


def test_many_candidates_are_each_alone(device: str) -> None:
    rng = np.random.default_rng(9)
    rest = rough((4, 4, 4), rng)
    held, _ = pressed(lattice((4, 4, 4)), 0.3)
    poses = rest[held] + rng.normal(0.0, 0.003, (6, len(held), 3))
    theta = np.linspace(0.0, 1.0, 6)
    one = OneCluster(rest, held, device=device)
    together = one.relax(one.hold(poses), 0.9, theta)
    before = together.transform.copy()
    for row in range(6):
        alone = one.relax(one.hold(poses[row]), 0.9, float(theta[row]))
        np.testing.assert_array_equal(alone.transform[0], together.transform[row])
        np.testing.assert_array_equal(alone.translation[0], together.translation[row])
    np.testing.assert_array_equal(together.transform, before)  # results are the caller's own
