"""The preconditioner of large lattices: symmetric, positive, as good for large bodies as for small, never harmful."""

from typing import Any

import numpy as np
import pytest

from deformscope.arrays import FloatArray
from deformscope.stages.msm import clusters, iteration, multigrid, reference
from deformscope.stages.msm.multigrid import Multigrid
from deformscope.stages.msm.solver import Msm, Precision
from tests.cases import slow, slow_but
from tests.stages import reference_states
from tests.stages.bodies import lattice

BODIES = {
    "2D": ((9, 12), 3, 0.0, 0.0),
    "2D, pairs": ((9, 12), 2, 0.0, 0.0),
    "2D, wide": ((13, 17), 5, 0.0, 0.0),
    "2D, holes": ((9, 12), 3, 0.08, 0.0),
    "2D, held here and there": ((12, 15), 3, 0.0, 0.05),
    "slender": ((6, 40), 3, 0.0, 0.0),
    "3D": ((6, 7, 8), 3, 0.0, 0.0),
    "3D, holes, held here and there": ((7, 8, 6), 2, 0.06, 0.03),
}
"""Lattice, cluster width, share of missing and of held particles."""

QUICK = ("2D, wide", "2D, holes", "2D, held here and there", "3D")

named = pytest.mark.parametrize("name", slow_but(QUICK, BODIES))


@pytest.fixture(autouse=True)
def all_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small bodies are preconditioned, too."""
    monkeypatch.setattr(multigrid, "LEAST", 0)
    monkeypatch.setattr(multigrid, "FEWEST", 20)


def _poked(name: str, device: str = "cpu", precision: Precision = "float64") -> tuple[Msm, FloatArray]:
    """A body whose bottom stands, and the middle of whose top is pushed in and aside; (n, d) where it is held."""
    shape, size, missing, held_share = BODIES[name]
    return _body(shape, size, missing, held_share, device, precision)


def _body(
    shape: tuple[int, ...],
    size: int,
    missing: float = 0.0,
    held_share: float = 0.0,
    device: str = "cpu",
    precision: Precision = "float64",
) -> tuple[Msm, FloatArray]:
    rng = np.random.default_rng(2)
    rest = lattice(shape, 1.0)
    bottom, top = rest[:, 0] == 0, rest[:, 0] == shape[0] - 1
    middle = (np.abs(rest[:, 1:] - (np.array(shape[1:]) - 1) / 2) <= np.array(shape[1:]) / 6).all(axis=1)
    cell = np.flatnonzero((rng.random(len(rest)) >= missing) | bottom | top)
    rest, bottom, tool = rest[cell], bottom[cell], (top & middle)[cell]
    held = np.flatnonzero(bottom | tool | (rng.random(len(rest)) < held_share))
    position = rest[held].copy()
    position[tool[held]] += np.array([-0.08, 0.03, 0.0])[: len(shape)] * shape[0]
    return Msm(rest, clusters.lattice(rest, shape, cell, size), held, device=device, precision=precision), position


def _plain(monkeypatch: pytest.MonkeyPatch, engine: Msm) -> Msm:
    """The same body, never preconditioned."""
    made = engine.holding(engine.held)
    with monkeypatch.context() as patch:
        patch.setattr(Multigrid, "worth", staticmethod(lambda body, rest: False))
        for size in (1, 5):
            for volume in ("scale", "project"):
                made._method(*made._kind(np.full(size, float(volume == "project")), size, "project"))
    return made


def _newton(engine: Msm, beta: float, position: FloatArray) -> Any:
    return engine._at(position[None], beta, 0.0, "scale")


@named
@pytest.mark.parametrize("beta", [slow(0.0), slow(0.6), 0.99])
def test_the_preconditioner_is_symmetric_and_positive(name: str, beta: float, device: str) -> None:
    engine, held = _poked(name, device)
    newton = _newton(engine, beta, engine.relax(held, beta).position[0])
    grid, layout = newton.multigrid, newton.layout
    assert len(grid.levels) > 1
    unknowns = np.flatnonzero(np.repeat(engine.free, engine.dim))
    columns = []
    for one in unknowns:
        unit = np.zeros((1, *engine.rest.shape))
        unit.reshape(-1)[one] = 1.0
        layout.put(unit, newton.rho)
        grid.cycle(newton.rho, newton._every_group)
        columns.append(layout.get(grid.z, engine.dim).reshape(-1)[unknowns])
    metric = np.repeat(engine._particles.metric, engine.dim)[unknowns]
    product = metric[:, None] * np.column_stack(columns) * np.sqrt(1 / np.outer(metric, metric))
    size = np.linalg.norm(product, 2)
    assert np.abs(product - product.T).max() < 2e-6 * size
    assert np.linalg.eigvalsh(product + product.T).min() > 0.1


@named
@pytest.mark.parametrize("volume", ["scale", "project"])
def test_states_are_those_without_it_and_obey_the_equations(
    name: str, volume: reference.Volume, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine, held = _poked(name, device)
    beta = np.array([0.0, 0.5, 0.8, 0.9, 0.99])
    theta = 0.5 if volume == "project" else 0.0
    found = engine.relax(held, beta, theta, volume=volume)
    assert found.converged.all()
    assert not found.unaided.any()
    assert (found.smoothed > 0).all()
    (method,) = engine._scratch.values()
    assert not method.multigrid.plain.numpy().any()  # nor what fills up the lanes
    plain = _plain(monkeypatch, engine).relax(held, beta, theta, volume=volume)
    assert plain.converged.all()
    assert (plain.smoothed == 0).all()
    apart = np.sqrt(np.mean(np.sum((found.position - plain.position) ** 2, axis=-1), axis=-1))
    assert apart.max() < 2e-9 * engine.extent  # each is known to 1e-9
    rest = reference.build_rest(engine.rest, engine._clusters, engine.held)
    for x, b in zip(found.position[[0, -1]], beta[[0, -1]], strict=True):
        left = reference_states.goals(x, rest, float(b), theta, volume=volume) - x
        assert np.sqrt(np.mean(np.sum(left**2, axis=-1))) < 1e-9 * engine.extent


def test_betas_of_clusters_are_those_without_it(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    engine, held = _poked("2D, holes", device)
    beta = np.random.default_rng(1).uniform(0.0, 0.99, (5, engine.cluster_count))
    found, plain = (each.relax(held, beta) for each in (engine, _plain(monkeypatch, engine)))
    assert found.converged.all()
    assert not found.unaided.any()
    np.testing.assert_allclose(found.position, plain.position, atol=1e-8 * engine.extent)


def test_a_candidate_that_nothing_moves_stays_among_others(device: str) -> None:
    engine, held = _poked("2D, wide", device)
    rest = engine.rest[engine.held]
    some = rest + np.array([0.0, 0.4, 0.7, 1.0, 0.0])[:, None, None] * (held - rest)
    found = engine.relax(some, 0.7)
    assert found.converged.all()
    np.testing.assert_allclose(found.position[[0, 4]], engine.rest[None].repeat(2, axis=0), atol=1e-9)
    alone = engine.relax(some[2], 0.7)
    np.testing.assert_allclose(found.position[2], alone.position[0], atol=1e-8 * engine.extent)


@pytest.mark.parametrize("kind", ["long", "cut apart", "narrow"])
def test_what_it_does_not_serve_goes_without(kind: str, device: str) -> None:
    shape = {"long": (6, 400), "narrow": (4, 40)}.get(kind, (14, 31))
    engine, position = _body(shape, 3, device=device)
    if kind == "cut apart":  # nothing holds the piece on the right
        cell = np.flatnonzero((engine.rest[:, 1] < 14) | (engine.rest[:, 1] > 16))
        rest = engine.rest[cell]
        held = np.flatnonzero((rest[:, 0] == 0) & (rest[:, 1] < 14))
        engine, position = Msm(rest, clusters.lattice(rest, shape, cell, 3), held, device=device), rest[held]
    assert engine._method(*engine._kind(np.zeros(1), 1, "scale")).multigrid is None
    assert engine.relax(position, 0.5, max_iterations=5).smoothed[0] == 0


def test_states_of_single_precision_are_those_of_double_precision(device: str) -> None:
    """Of a large lattice: rounding of single precision would hide what its slow modes pull."""
    found, exact = (
        engine.relax(held, 0.9, tolerance=1e-9)
        for engine, held in (_poked("2D, wide", device, precision) for precision in ("float32", "float64"))
    )
    assert found.converged.all()
    assert (found.smoothed > 0).all()
    np.testing.assert_array_equal(found.position, exact.position)


def test_a_residual_that_was_never_taken_is_not_told(device: str) -> None:
    engine, held = _poked("2D, wide", device)
    found = engine.relax(held, 0.7, max_iterations=2)
    assert not found.converged[0]
    assert found.residual[0] > 1e-6


@pytest.mark.parametrize(("dim", "sides"), [(2, (17, 33, 65)), slow(3, (9, 17, 33))])
@pytest.mark.parametrize("beta", [0.5, 0.9, 0.99])
def test_cycles_hardly_grow_with_the_body(dim: int, sides: tuple[int, ...], beta: float, device: str) -> None:
    """Of a linear solve to 1e-8; plain conjugate gradients need twice as many each time, at .99 three times."""
    cycles = []
    for side in sides:
        engine, _ = _body((side,) * dim, 3, device=device)
        newton = _newton(engine, beta, engine.rest)
        right = np.zeros((1, *engine.rest.shape))
        right[0, engine.rest[:, 0] == side - 2, 0] = 1.0  # just below the top
        newton.layout.put(right, newton.residual)
        newton.multigrid.reset()
        newton._begin(0.0, 1e-8, outer=0)
        newton.replay(newton._launch_aim)
        newton._descend(newton.state.most)
        assert (newton.state.square.numpy() <= newton.state.target.numpy())[0]
        cycles.append(int(newton.multigrid.applied.numpy()[0]))
    assert cycles[-1] <= 1.6 * cycles[0], cycles
    assert cycles[-1] <= 25, cycles


@pytest.mark.parametrize("fault", ["negative", "not a number", "useless"])
def test_a_bad_preconditioner_is_given_up(fault: str, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    engine, held = _poked("2D, holes", device)
    plain = _plain(monkeypatch, engine).relax(held, 0.9)
    wild = 10.0 ** np.random.default_rng(0).uniform(-3, 3, (1, *engine.rest.shape))
    monkeypatch.setattr(iteration, "PATIENCE", 20)

    def cycle(self: Multigrid, rho: Any, running: Any) -> None:
        values = self.layout.get(rho, engine.dim)
        self.layout.put(values * {"negative": -1.0, "not a number": np.nan, "useless": wild}[fault], self.z)

    monkeypatch.setattr(Multigrid, "cycle", cycle)
    # a host's copy is not recorded
    monkeypatch.setattr(iteration.Iteration, "replay", lambda self, launches, *given: launches(*given))
    found = engine.relax(held, 0.9)
    assert found.converged.all()
    assert found.unaided.all()
    np.testing.assert_allclose(found.position, plain.position, atol=2e-9 * engine.extent)


def test_small_bodies_go_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    engine, held = _poked("3D")
    found = engine.relax(held, 0.5)
    assert found.converged.all()
    assert (found.smoothed == 0).all()
    assert not found.unaided.any()
    assert engine._method(*engine._kind(np.zeros(1), 1, "scale")).multigrid is None
