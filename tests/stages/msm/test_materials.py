"""A beta along each axis: the energy behind it, its limits, and the engine against the reference."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm.materials import AxisBeta, axis_weights
from deformscope.stages.msm.reference import Rest
from deformscope.stages.msm.solver import Msm, Precision
from tests.cases import slow, slow_but
from tests.stages import reference_states
from tests.stages.bodies import Pushed, lattice, pushed
from tests.stages.msm import reference_material as spec

GOAL_TOLERANCE: dict[Precision, float] = {"float64": 1e-11, "float32": 2e-5}
"""Goals against the reference, in particle spacings."""

BODIES: list[tuple[tuple[int, ...], int]] = [((5, 4), 3), ((6, 4), 2), ((4, 3, 3), 3), ((5, 3, 3), 2)]


def _turn(rng: np.random.Generator, dim: int) -> FloatArray:
    q = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    q[:, 0] *= np.sign(np.linalg.det(q))
    return q


def _rest(body: Pushed, size: int = 3, mass: FloatArray | None = None) -> Rest:
    return reference.build_rest(body.rest, body.clusters(size), body.held, mass)


@pytest.mark.parametrize(("shape", "size"), [*BODIES, ((5, 4, 1), 3)])
def test_reaction_is_the_gradient_of_the_energy(shape: tuple[int, ...], size: int) -> None:
    rng = np.random.default_rng(1)
    rest = lattice(shape, 1.0)
    grouped = clusters.lattice(rest, shape, np.arange(len(rest)), size)
    body = reference.build_rest(rest, grouped, np.array([], dtype=int), rng.uniform(0.5, 2.0, len(rest)))
    beta = AxisBeta(rng.uniform(0.0, 0.95, len(shape)), _turn(rng, len(shape)))
    mirror = np.array([1.2, *[0.9] * (len(shape) - 2), -0.6])
    for x in (rest, rest * 0.6, rest * mirror, rest @ _turn(rng, len(shape))):
        x = x + rng.normal(0, 0.15, rest.shape)
        direction = rng.normal(size=x.shape)
        force = spec.axis_reaction(x, body, beta)
        h = 1e-6
        after, before = (spec.axis_energy(x + step * direction, body, beta) for step in (h, -h))
        limit = 1e-7 * np.linalg.norm(force) * np.linalg.norm(direction)
        assert np.sum(force * direction) == pytest.approx((after - before) / (2 * h), abs=limit)


def test_equal_betas_are_one_beta_in_energy_and_goals() -> None:
    rng = np.random.default_rng(2)
    body = pushed((4, 3, 3), rng)
    rest = _rest(body)
    x = body.rest + rng.normal(0, 0.002, body.rest.shape)
    for b in (0.0, 0.4, 0.95):
        beta = AxisBeta(np.full(3, b), _turn(rng, 3))
        assert spec.axis_energy(x, rest, beta) == pytest.approx(reference_states.energy(x, rest, b), rel=1e-12)
        np.testing.assert_allclose(spec.goals(x, rest, beta), reference_states.goals(x, rest, b), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_shear_gives_way_by_the_harmonic_mean_of_its_axes(dim: int) -> None:
    """Known answer: small strains of one square (cubic) cluster, whose moments are g I."""
    rest = lattice((3,) * dim, 1.0)
    body = reference.build_rest(rest, clusters.single(len(rest)), np.array([], dtype=int))
    g = float(np.sum((rest - rest.mean(axis=0))[:, 0] ** 2))
    w = 1.0 - np.array([0.2, 0.8, 0.5])[:dim]
    beta, e = AxisBeta(1.0 - w), 1e-4
    for axis in range(dim):
        pull = np.eye(dim)
        pull[axis, axis] += e
        assert spec.axis_energy(rest @ pull.T, body, beta) == pytest.approx(0.5 * g * w[axis] * e**2, rel=1e-3)
    shear = np.eye(dim)
    shear[0, 1] = shear[1, 0] = e
    mean = 2.0 * w[0] * w[1] / (w[0] + w[1])
    assert spec.axis_energy(rest @ shear.T, body, beta) == pytest.approx(0.5 * g * 2.0 * mean * e**2, rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_weights_lie_between_nothing_and_the_moments(dim: int) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        half = rng.normal(size=(1, dim, dim)) * rng.uniform(0.1, 3.0, (1, dim, 1))
        gram = half @ half.transpose(0, 2, 1)
        axes, beta = _turn(rng, dim), rng.choice([0.0, 0.3, 0.99, 1.0], (1, dim))
        w, c = axis_weights(gram, np.eye(dim)[None], beta, axes)
        size = np.trace(gram[0])
        assert np.linalg.eigvalsh(w[0, 0]).min() >= -1e-12 * size
        assert np.linalg.eigvalsh(gram[0] - w[0, 0]).min() >= -1e-9 * size
        # an axis with beta 1 is free: changing A along it costs nothing
        np.testing.assert_allclose(w[0, 0] @ axes[:, beta[0] == 1.0], 0.0, atol=1e-9 * size)
        if not beta.any():
            np.testing.assert_allclose(w[0, 0], gram[0], atol=1e-9 * size)
            np.testing.assert_allclose(c, 0.0, atol=1e-9)
        if (beta == 1.0).all():
            np.testing.assert_allclose(c[0, 0], np.eye(dim), atol=1e-9)


@pytest.mark.parametrize(("shape", "size"), slow_but(BODIES[:2], BODIES))
def test_goals_agree_with_the_reference(device: str, precision: Precision, shape: tuple[int, ...], size: int) -> None:
    rng = np.random.default_rng(4)
    dim = len(shape)
    body = pushed(shape, rng)
    mass = rng.uniform(0.5, 2.0, len(body.rest))
    rest = _rest(body, size, mass)
    engine = Msm(body.rest, body.clusters(size), body.held, mass=mass, precision=precision, device=device)
    half_turn = np.diag([-1.0, -1.0, 1.0][:dim])
    states = np.stack(
        [
            body.rest + rng.normal(0, 0.001, body.rest.shape),
            body.rest @ half_turn + rng.normal(0, 0.003, body.rest.shape),
            body.rest * 0.4 + rng.normal(0, 0.001, body.rest.shape),
            body.rest @ _turn(rng, dim),
            body.rest + rng.normal(0, 0.003, body.rest.shape),
        ]
    )
    axes, values = _turn(rng, dim), rng.uniform(0.0, 0.97, (len(states), dim))
    values[1, 0] = 0.0
    found = engine.residual(states, AxisBeta(values, axes))
    for x, value, row in zip(states, values, found, strict=True):
        expected = spec.goals(x, rest, AxisBeta(value, axes)) - x
        assert np.abs(row - expected).max() < GOAL_TOLERANCE[precision] * engine.scale * 10


@pytest.mark.parametrize("values", [(1.0, 0.0), (1.0, 1.0), (1.0, 0.3, 0.0), (1.0, 1.0, 0.3), (1.0, 1.0, 1.0)])
@pytest.mark.slow  # a limit, at several values
def test_free_axes_are_the_limit_of_soft_ones(device: str, values: tuple[float, ...]) -> None:
    rng = np.random.default_rng(11)
    body = pushed((4,) * len(values), rng)
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    x, axes = body.rest + rng.normal(0, 0.002, body.rest.shape), _turn(rng, len(values))
    free, soft = (
        engine.residual(x, AxisBeta(np.minimum(values, most), axes)) / engine.scale for most in (1.0, 1.0 - 1e-9)
    )
    np.testing.assert_allclose(free, soft, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("shape", [(5, 6), slow((4, 3, 4))])
def test_static_states_agree_with_the_reference(device: str, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(5)
    body = pushed(shape, rng)
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    axes, values = _turn(rng, len(shape)), rng.uniform(0.0, 0.95, (5, len(shape)))
    found = engine.relax(body.held_position, AxisBeta(values, axes))
    assert found.converged.all()
    for row, value in zip(found.position, values, strict=True):
        expected = spec.relax(_rest(body), body.held_position, AxisBeta(value, axes))
        np.testing.assert_allclose(row, expected, rtol=0.0, atol=1e-9 * engine.extent)


@pytest.mark.parametrize("grouping", ["lattice", "nearest", "single"])
def test_equal_betas_are_one_beta_whatever_the_clusters(device: str, grouping: str) -> None:
    rng = np.random.default_rng(6)
    body = pushed((5, 5), rng)
    grouped = {
        "lattice": body.clusters(3),
        "nearest": clusters.nearest(body.rest, 7),
        "single": clusters.single(len(body.rest)),
    }[grouping]
    engine = Msm(body.rest, grouped, body.held, device=device)
    one = engine.relax(body.held_position, np.array([0.3, 0.9]), tolerance=1e-11)
    both = AxisBeta(np.array([[0.3, 0.3], [0.9, 0.9]]), _turn(rng, 2))
    axes = engine.relax(body.held_position, both, tolerance=1e-11)
    np.testing.assert_allclose(axes.position, one.position, rtol=0.0, atol=1e-9 * engine.extent)


@pytest.mark.parametrize("shape", [(5, 6), (4, 3, 4)])
def test_a_turned_body_with_turned_axes_has_a_turned_state(device: str, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(7)
    body, turn, axes = pushed(shape, rng), _turn(rng, len(shape)), _turn(rng, len(shape))
    value = np.linspace(0.1, 0.9, len(shape))
    grouped = body.clusters(3)
    straight = Msm(body.rest, grouped, body.held, device=device)
    turned = Msm(body.rest @ turn.T, grouped, body.held, device=device)
    expected = straight.relax(body.held_position, AxisBeta(value, axes)).position @ turn.T
    found = turned.relax(body.held_position @ turn.T, AxisBeta(value, turn @ axes)).position
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8 * straight.extent)
    # the axes matter: those of the body that was not turned give another state
    other = turned.relax(body.held_position @ turn.T, AxisBeta(value, axes)).position
    assert np.abs(other - expected).max() > 1e-4 * straight.extent


def test_a_sheet_in_space_takes_the_betas_of_its_plane(device: str) -> None:
    """A flat body has no information on the third axis, and is what a body of the plane is."""
    rng = np.random.default_rng(8)
    rest = lattice((5, 6))
    grouped = clusters.lattice(rest, (5, 6), np.arange(len(rest)), 3)
    held = np.array([0, 1, 2, 3, 4, 5, 29])
    moved = rest[held] + rng.normal(0, 0.004, (7, 2)) * (np.arange(7) == 6)[:, None]
    flat = Msm(rest, grouped, held, device=device).relax(moved, AxisBeta(np.array([0.2, 0.9])))
    space = Msm(np.pad(rest, [(0, 0), (0, 1)]), grouped, held, device=device)
    found = space.relax(np.pad(moved, [(0, 0), (0, 1)]), AxisBeta(np.array([0.2, 0.9, 0.5])))
    np.testing.assert_allclose(found.position[0, :, :2], flat.position[0], rtol=0.0, atol=1e-9 * space.extent)


def test_what_it_does_not_do_is_refused(device: str) -> None:
    body = pushed((4, 4), np.random.default_rng(10))
    linear = Msm(body.rest, body.clusters(3), body.held, device=device)
    beta = AxisBeta(np.array([0.2, 0.8]))
    with pytest.raises(ValueError, match="theta = 0"):
        linear.relax(body.held_position, beta, 0.5)
    with pytest.raises(ValueError, match="2 axes; got 3"):
        linear.relax(body.held_position, AxisBeta(np.array([0.2, 0.8, 0.5])))
    with pytest.raises(ValueError, match="linear basis"):
        Msm(body.rest, body.clusters(3), body.held, basis="quadratic", device=device).relax(body.held_position, beta)
    with pytest.raises(ValueError, match="relax and residual alone"):
        linear.step(linear.start(), body.held_position, beta)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="between 0 and 1"):
        AxisBeta(np.array([0.2, 1.2]))
    with pytest.raises(ValueError, match="orthonormal"):
        AxisBeta(np.array([0.2, 0.8]), np.array([[1.0, 1.0], [0.0, 1.0]]))
