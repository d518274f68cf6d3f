"""The specification itself, against answers worked out by hand and properties of the equations."""

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.msm import clusters, reference
from tests.stages import reference_states
from tests.stages.bodies import lattice, pushed


def _whole(rest: FloatArray, basis: reference.Basis = "linear") -> reference.Rest:
    return reference.build_rest(rest, clusters.single(len(rest)), np.array([], dtype=int), basis=basis)


def _turn(angle: float, dim: int) -> FloatArray:
    q = np.eye(dim)
    q[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return q


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("beta", [0.0, 0.4, 1.0])
def test_a_rigid_motion_is_its_own_goal(dim: int, beta: float) -> None:
    rest = lattice((4,) * dim)
    moved = rest @ _turn(2.5, dim).T + 0.3
    for basis in ("linear", "quadratic"):
        np.testing.assert_allclose(reference_states.goals(moved, _whole(rest, basis), beta, 0.7), moved, atol=1e-12)


def test_stretched_square_by_hand() -> None:
    """Eq. 3.13 for x stretched by 1.5: R = I and A = diag(1.5, 1), so the goal's stretch is 1 + 0.5 beta."""
    rest = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    stretched = rest * [1.5, 1.0]
    goal = reference_states.goals(stretched, _whole(rest), 0.3)
    np.testing.assert_allclose(np.ptp(goal, axis=0), [1.15, 1.0], atol=1e-12)
    np.testing.assert_allclose(goal.mean(axis=0), stretched.mean(axis=0), atol=1e-12)


def test_volume_conservation_by_hand() -> None:
    """Eq. 3.17 in the plane takes the square root: A = diag(1.5, 1) at theta = 1 becomes diag(1.5, 1) / sqrt(1.5)."""
    a = reference_states.conserve_volume(np.diag([1.5, 1.0]), 1.0, np.eye(2))
    np.testing.assert_allclose(a, np.diag([1.5, 1.0]) / np.sqrt(1.5))
    a = reference_states.conserve_volume(np.diag([2.0, 1.0, 0.5][:3]), 1.0, np.eye(3))
    np.testing.assert_allclose(np.linalg.det(a), 1.0)
    half = reference_states.conserve_volume(np.diag([8.0, 1.0, 1.0]), 0.5, np.eye(3))
    np.testing.assert_allclose(half, np.diag([8.0, 1.0, 1.0]) / 1.5)


@pytest.mark.parametrize("det", [0.0, -0.2, -8.0])
@pytest.mark.parametrize("theta", [0.3, 1.0])
def test_volume_conservation_of_crushed_and_inverted_clusters_stays_finite(det: float, theta: float) -> None:
    a = reference_states.conserve_volume(np.diag([det, 1.0, 1.0]), theta, np.eye(3))
    assert np.isfinite(a).all()
    assert np.abs(a).max() <= max(1.0, abs(det)) / reference.MIN_DENOMINATOR


def test_flat_cluster_conserves_its_area() -> None:
    span = np.eye(3)[:, :2]
    a = reference_states.conserve_volume(np.diag([2.0, 2.0, 0.0]), 1.0, span)
    np.testing.assert_allclose(a[:2, :2], np.eye(2))


@pytest.mark.parametrize("dim", [2, 3])
def test_full_deformability_follows_any_affine_map(dim: int) -> None:
    rng = np.random.default_rng(0)
    rest = lattice((3,) * dim)
    moved = rest @ (np.eye(dim) + rng.normal(0, 0.3, (dim, dim))).T
    np.testing.assert_allclose(reference_states.goals(moved, _whole(rest), 1.0), moved, atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_quadratic_basis_follows_a_bend(dim: int) -> None:
    rest = lattice((4,) * dim)
    moved = rest.copy()
    moved[:, 1] += 4.0 * rest[:, 0] ** 2 + 2.0 * rest[:, 0] * rest[:, 1]
    np.testing.assert_allclose(reference_states.goals(moved, _whole(rest, "quadratic"), 1.0), moved, atol=1e-12)
    assert np.abs(reference_states.goals(moved, _whole(rest), 1.0) - moved).max() > 1e-4


def test_centred_quadratic_basis_does_not_drift() -> None:
    rest = lattice((4, 4, 4))
    bent = rest.copy()
    bent[:, 2] += 5.0 * rest[:, 0] ** 2
    goal = reference_states.goals(bent, _whole(rest, "quadratic"), 0.3)
    np.testing.assert_allclose(goal.mean(axis=0), bent.mean(axis=0), atol=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_rotation_is_proper_and_the_best_of_many(dim: int) -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        a = rng.normal(size=(dim, dim))
        r = reference_states.rotation(a, 1.0)
        assert np.isclose(np.linalg.det(r), 1.0)
        for _ in range(50):
            other, _ = np.linalg.qr(rng.normal(size=(dim, dim)))
            other[:, 0] *= np.sign(np.linalg.det(other))
            assert np.sum(r * a) >= np.sum(other * a) - 1e-9


def test_no_preferred_rotation_is_none() -> None:
    np.testing.assert_array_equal(reference_states.rotation(np.zeros((3, 3)), 1.0), np.eye(3))
    np.testing.assert_array_equal(reference_states.rotation(np.diag([1.0, -1.0]), 2.0), np.eye(2))
    assert np.isclose(np.linalg.det(reference_states.rotation(-np.eye(3), 3.0)), 1.0)


def test_pull_to_the_goals_is_the_gradient_of_the_energy() -> None:
    """`reaction` against finite differences of E = 1/2 sum_c (1 - beta) |p - R q|^2 + beta |p - A q|^2."""
    rng = np.random.default_rng(5)
    rest = lattice((4, 3, 3), 1.0)
    body = reference.build_rest(rest, clusters.lattice(rest, (4, 3, 3), np.arange(36), 2), np.array([0]))
    x = rest + rng.normal(0, 0.2, rest.shape)
    beta = 0.37

    def energy(x: FloatArray) -> float:
        total = 0.0
        for c in body.clusters:
            p = (x[c.index] - x[c.index].mean(axis=0)) / c.radius
            a = p.T @ c.q @ c.inverse
            stiff = np.sum((p - c.q @ reference_states.rotation(p.T @ c.q, float(np.sum(c.q**2))).T) ** 2)
            soft = np.sum((p - c.q @ a.T) ** 2)
            total += 0.5 * c.radius**2 * ((1 - beta) * stiff + beta * soft)
        return float(total)

    direction = rng.normal(size=x.shape)
    h = 1e-5
    slope = (energy(x + h * direction) - energy(x - h * direction)) / (2 * h)
    np.testing.assert_allclose(np.sum(reference_states.reaction(x, body, beta) * direction), slope, rtol=1e-8)


def test_static_state_does_not_depend_on_the_start() -> None:
    rng = np.random.default_rng(6)
    body = pushed((5, 6), rng)
    rest = reference.build_rest(body.rest, body.clusters(3), body.held)
    ends = []
    for _ in range(3):
        start = body.rest + rng.normal(0, 0.01, body.rest.shape)
        state, residual = reference_states.relax(rest, body.held_position, beta=0.6, start=start)
        assert residual < 1e-10
        ends.append(state)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)
    np.testing.assert_allclose(ends[0], ends[2], atol=1e-8)


def test_reaction_at_the_static_state_is_zero_where_free_and_balanced_where_held() -> None:
    body = pushed((5, 6), np.random.default_rng(7))
    rest = reference.build_rest(body.rest, body.clusters(3), body.held)
    state, _ = reference_states.relax(rest, body.held_position, beta=0.6)
    force = reference_states.reaction(state, rest, 0.6)
    free = ~clusters.held_mask(len(body.rest), body.held)
    assert np.abs(force[free]).max() < 1e-9 * np.abs(force).max() + 1e-12
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12)


def test_dt_does_not_change_the_motion() -> None:
    body = pushed((4, 5), np.random.default_rng(8))
    rest = reference.build_rest(body.rest, body.clusters(2), body.held)
    ends = []
    for dt in (2e-5, 2e-3):
        x, v = body.rest.copy(), np.zeros_like(body.rest)
        for _ in range(30):
            x, v = reference_states.step(x, v, rest, body.held_position, beta=0.5, dt=dt)
        ends.append(x)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)
