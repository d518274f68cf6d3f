"""The warp engine against its float64 reference, on every device and in both precisions."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from deformscope.stages.msm import clusters, reference, solver
from deformscope.stages.msm.reference import Basis
from deformscope.stages.msm.solver import Msm, Precision
from tests.cases import slow_but
from tests.stages import reference_states
from tests.stages.bodies import lattice, pushed

if TYPE_CHECKING:
    from tests.stages.msm.conftest import Effort

KERNEL_TOLERANCE: dict[Precision, float] = {"float64": 1e-11, "float32": 1e-5}
"""Goals against the reference, relative to the particle spacing: rounding of sums over a few hundred particles."""

STATIC_TOLERANCE = 1e-5
"""Static states against each other, as a share of the body's extent."""

SHAPES = [((5, 7), 2), ((5, 7), 3), ((6, 6), 5), ((3, 4, 4), 2), ((4, 4, 5), 3), ((5, 4, 5), 4)]


@pytest.mark.parametrize(
    ("shape", "size", "basis"),
    slow_but(
        [((5, 7), 3, "linear"), ((3, 4, 4), 2, "linear")],  # quadratic: sheets, below
        [(*one, basis) for one in SHAPES for basis in ("linear", "quadratic")],
    ),
)
def test_goals_agree_with_the_reference(
    device: str, precision: Precision, basis: Basis, shape: tuple[int, ...], size: int
) -> None:
    rng = np.random.default_rng(len(shape) * 10 + size)
    rest = lattice(shape)
    mass = rng.uniform(0.5, 2.0, len(rest))
    grouped = clusters.lattice(rest, shape, np.arange(len(rest)), size)
    held = np.array([3, 0])
    spec = reference.build_rest(rest, grouped, held, mass, basis)
    engine = Msm(rest, grouped, held, mass=mass, basis=basis, precision=precision, device=device)
    # small and large noise, turned half round, mirrored (unevenly, so that one rotation is best) and crushed
    half_turn = np.eye(len(shape))
    half_turn[0, 0] = half_turn[1, 1] = -1.0
    mirror = np.eye(len(shape))
    mirror[0, 0] = -1.0
    states = np.stack(
        [
            rest + rng.normal(0, 0.0005, rest.shape),
            rest + rng.normal(0, 0.004, rest.shape),
            rest @ half_turn + rng.normal(0, 0.001, rest.shape),
            rest @ mirror * np.array([0.3, 0.8, 1.2])[: len(shape)] + rng.normal(0, 0.001, rest.shape),
            rest * 0.3 + rng.normal(0, 0.001, rest.shape),
        ]
    )
    beta = np.array([0.0, 0.5, 0.9, 0.6, 0.99])
    theta = np.array([0.0, 0.0, 0.3, 0.0, 0.5])
    found = engine.residual(states, beta, theta)
    for row, state in enumerate(states):
        expected = reference_states.goals(state, spec, float(beta[row]), float(theta[row])) - state
        worst = np.abs(found[row] - expected).max() / (engine.scale * max(1.0, np.abs(state).max() / 0.1))
        assert worst < KERNEL_TOLERANCE[precision] * (10.0 if basis == "quadratic" else 1.0), (row, worst)
        assert np.all(found[row][held] == 0.0)


def test_steps_agree_with_the_reference(device: str, precision: Precision) -> None:
    body = pushed((5, 6), np.random.default_rng(0))
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    engine = Msm(body.rest, body.clusters(3), body.held, precision=precision, device=device)
    x, v = body.rest.copy(), np.zeros_like(body.rest)
    gravity = np.array([-9.81, 0.0])
    for _ in range(20):
        x, v = reference_states.step(x, v, spec, body.held_position, beta=0.7, alpha=0.8, dt=2e-3, acceleration=gravity)
    state = engine.start()
    found = engine.step(state, body.held_position, 0.7, alpha=0.8, dt=2e-3, acceleration=[-9.81, 0.0], steps=20)
    np.testing.assert_allclose(found[0], x, atol=20 * KERNEL_TOLERANCE[precision] * engine.scale)
    # steps taken one call at a time are the same steps
    again = engine.start()
    for _ in range(20):
        one = engine.step(again, body.held_position, 0.7, alpha=0.8, dt=2e-3, acceleration=[-9.81, 0.0])
    np.testing.assert_array_equal(one, found)


@pytest.mark.parametrize("case", slow_but([3, 4], range(8)))
def test_relax_finds_the_static_state_of_the_reference(device: str, precision: Precision, case: int) -> None:
    rng = np.random.default_rng(100 + case)
    shape = tuple(rng.integers(4, 7, 2)) if case % 2 else tuple(rng.integers(3, 5, 3))
    body = pushed(shape, rng)
    grouped = body.clusters(int(rng.integers(2, 6)))
    beta = [0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 0.99, 0.5][case]
    spec = reference.build_rest(body.rest, grouped, body.held)
    expected, residual = reference_states.relax(spec, body.held_position, beta=beta)
    assert residual < 1e-9
    engine = Msm(body.rest, grouped, body.held, precision=precision, device=device)
    state = engine.relax(body.held_position, beta)
    assert state.converged[0]
    limit = STATIC_TOLERANCE if precision == "float64" else 10 * STATIC_TOLERANCE
    assert np.abs(state.position[0] - expected).max() < limit * engine.extent
    # tested on the equations themselves, too
    assert np.abs(engine.residual(state.position, beta)).max() < limit * engine.extent


@pytest.mark.parametrize("case", slow_but([1, 2], range(10)))
def test_stepping_to_rest_and_relaxing_agree(device: str, case: int) -> None:
    rng = np.random.default_rng(200 + case)
    shape = tuple(rng.integers(4, 8, 2)) if case % 2 else tuple(rng.integers(3, 5, 3))
    body = pushed(shape, rng)
    beta = float(rng.uniform(0.0, 0.95))
    engine = Msm(body.rest, body.clusters(int(rng.integers(2, 5))), body.held, device=device)
    moving = engine.start()
    for _ in range(20):
        stepped = engine.step(moving, body.held_position, beta, steps=1000)
        if np.abs(engine.residual(stepped, beta)).max() < 1e-10 * engine.extent:
            break
    relaxed = engine.relax(body.held_position, beta)
    assert relaxed.converged[0]
    assert np.abs(relaxed.position[0] - stepped[0]).max() < STATIC_TOLERANCE * engine.extent


def test_error_estimate_is_no_smaller_than_the_error(device: str) -> None:
    for size, beta in [(2, 0.99), (3, 0.9), (2, 0.5)]:
        body = pushed((7, 15), np.random.default_rng(size))
        engine = Msm(body.rest, body.clusters(size), body.held, device=device)
        loose = engine.relax(body.held_position, beta, tolerance=1e-3)
        tight = engine.relax(body.held_position, beta, tolerance=1e-12)
        assert np.sqrt(np.mean(np.sum((loose.position - tight.position) ** 2, axis=-1))) <= loose.error[0]


def test_candidates_of_one_launch_are_what_each_would_be_alone(device: str) -> None:
    body = pushed((5, 6), np.random.default_rng(3))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    betas = np.array([0.1, 0.5, 0.9])
    together = engine.relax(body.held_position, betas)
    poses = np.stack([body.held_position, body.rest[body.held], 0.5 * (body.held_position + body.rest[body.held])])
    moved = engine.relax(poses, 0.5)
    for row, beta in enumerate(betas):
        alone = engine.relax(body.held_position, beta).position[0]
        np.testing.assert_allclose(alone, together.position[row], atol=1e-9 * engine.extent)
        alone = engine.relax(poses[row], 0.5).position[0]
        np.testing.assert_allclose(alone, moved.position[row], atol=1e-9 * engine.extent)


def test_candidates_taken_in_turns_are_the_same(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    body = pushed((5, 6), np.random.default_rng(9))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    betas = np.linspace(0, 0.95, 7)
    at_once = engine.relax(body.held_position, betas)
    monkeypatch.setattr(solver, "PARTICLES_AT_ONCE", 70)
    seen: list[tuple[int, int]] = []
    in_turns = engine.relax(body.held_position, betas, progress=lambda done, all_: seen.append((done, all_)))
    np.testing.assert_allclose(in_turns.position, at_once.position, atol=1e-9 * engine.extent)
    np.testing.assert_array_equal(in_turns.converged, at_once.converged)
    assert {all_ for _, all_ in seen} == {7}
    assert max(done for done, _ in seen) >= 6


def test_runs_repeat_bit_for_bit(device: str, precision: Precision) -> None:
    body = pushed((6, 7), np.random.default_rng(4))
    ends = []
    for _ in range(2):
        engine = Msm(body.rest, body.clusters(3), body.held, precision=precision, device=device)
        relaxed = engine.relax(body.held_position, np.linspace(0, 0.99, 20)).position
        ends.append((relaxed, engine.step(engine.start(3), body.held_position, [0.1, 0.5, 0.9], steps=50)))
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    np.testing.assert_array_equal(ends[0][1], ends[1][1])


@pytest.mark.parametrize("shape", [(6, 7), (4, 4, 5)])
@pytest.mark.parametrize("lists", [False, True])
def test_what_a_call_leaves_on_the_device_changes_no_later_one(
    device: str, precision: Precision, shape: tuple[int, ...], lists: bool
) -> None:
    body = pushed(shape, np.random.default_rng(4))
    grouped = body.clusters(3)
    some = clusters.Clusters(list(grouped), len(body.rest)) if lists else grouped
    engine = Msm(body.rest, some, body.held, precision=precision, device=device)
    kept, forgetful = engine.start(2), engine.start(2)
    held, beta = body.held_position.copy(), np.array([0.2, 0.8])
    by_cluster = np.linspace(0.1, 0.9, 2 * grouped.count).reshape(2, -1)
    calls: list[dict[str, Any]] = [
        {"steps": 7},
        {"steps": 2},
        {"steps": 5, "dt": 1e-3, "acceleration": [0.0] * (len(shape) - 1) + [-9.8]},
        {"steps": 2, "alpha": 0.5},
        {"steps": 4, "theta": 0.3, "volume": "project"},
        {"steps": 3, "beta": by_cluster},
        {"steps": 6, "held_from": body.rest[body.held]},
    ]
    for number, call in enumerate([*calls, *calls]):
        held += 0.01 * (number % 3 == 2) * np.ptp(body.rest)  # in place: the engine must not take it for the old one
        beta += 0.01 * (number % 4 == 1)
        for state in (kept, forgetful):
            engine.advance(state, held, **{"beta": beta, **call})
        forgetful._kept.clear()
        forgetful.held = None, None, None
        np.testing.assert_array_equal(engine.positions(kept), engine.positions(forgetful))
    assert np.isfinite(engine.positions(kept)).all()


def test_size_and_units_do_not_matter(device: str, precision: Precision) -> None:
    body = pushed((5, 6), np.random.default_rng(5))
    ends = []
    for scale in (1.0, 1e3, 1e-4):
        engine = Msm(body.rest * scale, body.clusters(3), body.held, precision=precision, device=device)
        ends.append(engine.relax(body.held_position * scale, 0.7).position[0] / scale)
    # the digits of the input differ with its scale; its meaning does not
    limit = 1e-8 if precision == "float64" else 1e-4
    np.testing.assert_allclose(ends[1], ends[0], atol=limit * 0.05)
    np.testing.assert_allclose(ends[2], ends[0], atol=limit * 0.05)


def test_a_free_body_follows_where_it_is_put(device: str) -> None:
    rest = lattice((4, 5))
    engine = Msm(rest, clusters.lattice(rest, (4, 5), np.arange(20), 3), [], device=device)
    moved = rest @ np.array([[0.0, -1.0], [1.0, 0.0]]) + 3.0
    found = engine.relax(np.zeros((0, 2)), [0.0, 0.5], start=moved)
    np.testing.assert_allclose(found.position, np.stack([moved, moved]), atol=1e-9)
    assert np.isfinite(engine.step(engine.start(2), np.zeros((0, 2)), 0.5, acceleration=[0.0, -9.81], steps=5)).all()


@pytest.mark.parametrize("basis", ["linear", "quadratic"])
@pytest.mark.slow  # quadratic kernels in space
def test_sheets_that_are_not_quite_flat_agree_with_the_reference(device: str, basis: Basis) -> None:
    """Their pseudo-inverse drops a direction that is there: what it leaves undetermined must turn with the cluster."""
    rng = np.random.default_rng(10)
    rest = np.column_stack([lattice((5, 5)), rng.normal(0, 4e-5, 25)])
    grouped = clusters.lattice(rest, (5, 5, 1), np.arange(25), 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    spec = reference.build_rest(rest, grouped, np.array([0]), basis=basis)
    engine = Msm(rest, grouped, np.array([0]), basis=basis, device=device)
    for state, theta in ((rest @ turn.T, 0.0), (rest @ turn.T + rng.normal(0, 2e-3, rest.shape), 0.4)):
        expected = reference_states.goals(state, spec, 0.6, theta) - state
        assert np.abs(engine.residual(state, 0.6, theta)[0] - expected).max() < 1e-8 * engine.scale
    np.testing.assert_allclose(engine.residual(rest @ turn.T, 0.6), 0.0, atol=1e-12)


def test_where_rotations_tie_one_of_the_best_is_taken(device: str) -> None:
    """Lines, mirror images and points: the fit is as good as the reference's, though the rotation may be another."""
    rest = lattice((3, 3, 3))
    grouped = clusters.single(27)
    spec = reference.build_rest(rest, grouped, np.array([], dtype=int))
    engine = Msm(rest, grouped, [], device=device)
    for squeeze in ([1.0, 0.0, 0.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, -1.0], [0.0, 0.0, 0.0]):
        state = rest * squeeze
        expected = np.sum((reference_states.goals(state, spec, 0.0) - state) ** 2)
        assert np.sum(engine.residual(state, 0.0)[0] ** 2) == pytest.approx(expected, rel=1e-9, abs=1e-18)


def test_a_rod_turns_without_resistance(device: str) -> None:
    rest = np.column_stack([np.arange(5) * 0.01, np.zeros(5), np.zeros(5)])
    upright = rest[:, [1, 2, 0]]
    spec = reference.build_rest(rest, clusters.single(5), np.array([], dtype=int))
    np.testing.assert_allclose(reference_states.goals(upright, spec, 0.0), upright, atol=1e-12)
    engine = Msm(rest, clusters.single(5), [], device=device)
    np.testing.assert_allclose(engine.residual(upright, 0.0), 0.0, atol=1e-9)


@pytest.mark.slow  # kernels of lists
def test_free_form_clusters_in_any_order(device: str) -> None:
    rng = np.random.default_rng(6)
    rest = rng.uniform(0, 0.1, (40, 3))
    grouped = clusters.nearest(rest, 12)
    held = np.array([7, 2, 30])
    position = rest[held] + rng.normal(0, 0.01, (3, 3))
    expected, _ = reference_states.relax(reference.build_rest(rest, grouped, held), position, beta=0.4)
    found = Msm(rest, grouped, held, device=device).relax(position, 0.4)
    assert found.converged[0]
    np.testing.assert_allclose(found.position[0], expected, atol=1e-6)
    np.testing.assert_array_equal(found.position[0][held], rest[held] + (position - rest[held]))


@dataclasses.dataclass(frozen=True)
class Degenerate:
    """A body or a state on which a careless solver divides by zero."""

    shape: tuple[int, ...]
    size: int
    basis: Basis
    held: tuple[int, ...]
    squeeze: tuple[float, ...]


DEGENERATE = {
    "flat sheet in space": Degenerate((4, 4, 1), 3, "linear", (0, 3, 12, 15), (1.2, 1.0, 1.0)),
    "flat sheet, quadratic": Degenerate((4, 4, 1), 3, "quadratic", (0, 3, 12, 15), (1.2, 1.0, 1.0)),
    "2x2 quadratic": Degenerate((4, 4), 2, "quadratic", (0, 3, 12, 15), (0.7, 1.0)),
    "2x2x2 quadratic": Degenerate((3, 3, 3), 2, "quadratic", (0, 2, 18, 26), (0.7, 1.0, 1.0)),
    "crushed to a line": Degenerate((4, 4), 3, "linear", tuple(range(15)), (0.0, 1.0)),
    "crushed to a point": Degenerate((3, 3, 3), 3, "linear", tuple(range(26)), (0.0, 0.0, 0.0)),
    "inverted": Degenerate((4, 4), 3, "linear", (0, 1, 2, 3, 12, 13, 14, 15), (-1.0, 1.0)),
    "inverted in space": Degenerate((3, 3, 3), 2, "linear", (*range(9), *range(18, 27)), (-1.0, 1.0, 1.0)),
    "all held": Degenerate((3, 3), 2, "linear", tuple(range(9)), (0.5, 1.0)),
    "one held": Degenerate((3, 3), 2, "linear", (4,), (1.0, 1.0)),
}


@pytest.mark.parametrize("theta", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", slow_but([n for n in DEGENERATE if n != "2x2 quadratic"], DEGENERATE))
def test_degenerate_clusters_stay_finite(
    device: str, precision: Precision, name: str, theta: float, effort: Effort
) -> None:
    effort.of_no_concern()  # finite, converged or not
    case = DEGENERATE[name]
    rest = lattice(case.shape)
    grouped = clusters.lattice(rest, case.shape, np.arange(len(rest)), case.size)
    held = np.array(case.held)
    position = (rest * case.squeeze)[held]
    engine = Msm(rest, grouped, held, basis=case.basis, precision=precision, device=device)
    state = engine.relax(position, np.array([0.0, 0.5, 0.9]), theta, max_iterations=500)
    assert np.isfinite(state.position).all()
    assert np.isfinite(engine.step(engine.start(), position, 0.5, theta, steps=50)).all()
    np.testing.assert_allclose(
        state.position[:, held], np.broadcast_to(position, (3, *position.shape)), atol=1e-6 * engine.extent
    )
    spec = reference.build_rest(rest, grouped, held, basis=case.basis)
    x = rest.copy()
    x[held] = position
    assert np.isfinite(reference_states.goals(x, spec, 0.5, theta)).all()


def test_divergence_is_reported_and_never_shown_as_a_result(device: str, effort: Effort) -> None:
    """Eq. 3.17 with overlapping clusters runs away by plain steps; whatever relax does, it says so or it is static."""
    effort.of_no_concern()
    shape = (6, 6, 6)
    rest = lattice(shape)
    low, high = np.flatnonzero(rest[:, 2] <= 0), np.flatnonzero(rest[:, 2] >= rest[:, 2].max() - 1e-9)
    held = np.concatenate([low, high])
    position = rest[held].copy()
    position[len(low) :, 2] *= 0.7
    engine = Msm(rest, clusters.lattice(rest, shape, np.arange(len(rest)), 3), held, device=device)
    state = engine.relax(position, 0.99, np.array([0.0, 0.5, 1.0]), max_iterations=300)
    left = np.abs(engine.residual(state.position, 0.99, np.array([0.0, 0.5, 1.0]))).max(axis=(1, 2))
    assert np.isfinite(state.position).all()
    assert np.all(left[state.converged] < 1e-6 * engine.extent)
    assert not np.any(state.converged & state.diverged)


def test_warm_start_saves_iterations_and_changes_nothing(device: str) -> None:
    body = pushed((7, 9), np.random.default_rng(8))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    cold = engine.relax(body.held_position, 0.70)
    warm = engine.relax(body.held_position, 0.70, start=engine.relax(body.held_position, 0.71).position)
    assert warm.iterations[0] < cold.iterations[0]
    np.testing.assert_allclose(warm.position, cold.position, atol=1e-7 * engine.extent)


def test_reaction_is_the_references_gradient_of_the_energy(device: str) -> None:
    rng = np.random.default_rng(11)
    body = pushed((5, 4, 4), rng)
    grouped = body.clusters(3)
    engine = Msm(body.rest, grouped, body.held, device=device)
    position = body.rest + rng.normal(0.0, 2e-4, body.rest.shape)
    rest = reference.build_rest(body.rest, grouped, body.held)
    for beta, theta in ((0.4, 0.0), (0.8, 0.6)):
        found = engine.reaction(position, beta, theta)[0]
        np.testing.assert_allclose(found, reference_states.reaction(position, rest, beta, theta), atol=1e-12)
