"""Lattice clusters summed axis by axis, against the float64 reference and against the same clusters as lists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import warp as wp

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import clusters, reference
from deformscope.stages.msm import lattice as lattice_body
from deformscope.stages.msm.clusters import Clusters, LatticeClusters
from deformscope.stages.msm.general import GeneralBody
from deformscope.stages.msm.lanes import LANES
from deformscope.stages.msm.lattice import LatticeBody
from deformscope.stages.msm.reference import Rest, Volume
from deformscope.stages.msm.solver import Msm, Precision
from tests.cases import Patch, slow, slow_but
from tests.stages import reference_states
from tests.stages.bodies import SPACING_M, lattice

KERNEL_TOLERANCE: dict[Precision, float] = {"float64": 1e-11, "float32": 1e-5}
"""Goals against the reference in particle spacings: rounding of sums over a few hundred particles."""

ROUNDING: dict[Precision, float] = {"float64": 2.0**-53, "float32": 2.0**-24}
"""Of one addition, as a share of the sum."""

RUN = 64
"""A sum slides over at most so many windows before it is taken anew: each of them adds its rounding."""


@dataclass(frozen=True)
class Lattice:
    """A body on an even lattice. missing: flat cells without a particle; edges: (d, d) rows from cell to cell [m];
    order: particles are shuffled; mass: they differ"""

    shape: tuple[int, ...]
    size: int
    missing: tuple[int, ...] = ()
    edges: tuple[tuple[float, ...], ...] | None = None
    order: bool = False
    mass: bool = False

    def build(self) -> Body:
        rng = np.random.default_rng([*self.shape, self.size])
        index = lattice(self.shape, 1.0)
        rest = index * SPACING_M if self.edges is None else SPACING_M * index @ np.array(self.edges)
        cell = np.setdiff1d(np.arange(len(rest)), self.missing)
        if self.order:
            cell = rng.permutation(cell)
        rest = rest[cell]
        mass = rng.uniform(0.3, 3.0, len(rest)) if self.mass else np.ones(len(rest))
        return Body(rest, clusters.lattice(rest, self.shape, cell, self.size), mass, rng)


@dataclass(frozen=True)
class Body:
    rest: FloatArray
    clusters: Clusters
    mass: FloatArray
    rng: np.random.Generator

    @property
    def held(self) -> IntArray:
        return np.array([0, len(self.rest) - 1])

    def spec(self) -> Rest:
        return reference.build_rest(self.rest, self.clusters, self.held, self.mass)

    def engine(self, precision: Precision, device: str) -> Msm:
        engine = Msm(self.rest, self.clusters, self.held, mass=self.mass, precision=precision, device=device)
        assert isinstance(engine._body, LatticeBody)
        return engine

    def as_lists(self, precision: Precision, device: str) -> Msm:
        lists = clusters.Clusters(list(self.clusters), len(self.rest))
        engine = Msm(self.rest, lists, self.held, mass=self.mass, precision=precision, device=device)
        assert isinstance(engine._body, GeneralBody)
        return engine

    def states(self, count: int) -> FloatArray:
        """(count, K, d): noisy, stretched and sheared unevenly, and turned."""
        dim = self.rest.shape[1]
        found = []
        for row in range(count):
            q = np.linalg.qr(self.rng.normal(size=(dim, dim)))[0]
            q[:, 0] *= np.sign(np.linalg.det(q))
            strain = np.diag(self.rng.uniform(0.5, 1.5, dim)) + np.triu(self.rng.normal(0, 0.2, (dim, dim)), 1)
            shaped = self.rest @ strain if row % 2 else self.rest
            noise = self.rng.normal(0, (0.05, 0.3)[row % 2] * SPACING_M, self.rest.shape)
            found.append(shaped @ (q if row % 3 else np.eye(dim)) + noise)
        return np.stack(found)


def _sheared(dim: int) -> tuple[tuple[float, ...], ...]:
    """Rows of an even lattice that is stretched unevenly, sheared and turned."""
    q = np.linalg.qr(np.random.default_rng(dim).normal(size=(dim, dim)))[0]
    edges = (np.diag([1.0, 1.7, 0.8][:dim]) + np.triu(np.full((dim, dim), 0.4), 1)) @ q
    return tuple(map(tuple, edges.tolist()))


def _hole(shape: tuple[int, ...], *cells: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(np.ravel_multi_index(cell, shape)) for cell in cells)


CASES = {
    **{f"plane, width {w}": Lattice((10, 11), w) for w in range(2, 10)},
    **{f"space, width {w}": Lattice((5, 6, 7), w) for w in range(2, 6)},
    "plane, as wide as the lattice": Lattice((3, 9), 9),
    "space, as wide as two axes": Lattice((9, 4, 4), 6),
    "wide windows that slide along both axes": Lattice((9, 9, 4), 7),
    "long along the slow axis": Lattice((40, 3, 3), 5),
    "long along the middle axis": Lattice((3, 40, 3), 5),
    "long along the fast axis": Lattice((3, 3, 40), 5),
    "plane, long": Lattice((70, 3), 6),
    "plane, wide": Lattice((3, 70), 6),
    "sheet": Lattice((6, 7, 1), 3),
    "sheet across the fast axis": Lattice((1, 6, 7), 4),
    "sheet across the middle axis": Lattice((6, 1, 7), 3),
    "rod along the fast axis": Lattice((1, 1, 9), 3),
    "rod along the middle axis": Lattice((1, 9, 1), 4),
    "rod along the slow axis": Lattice((9, 1, 1), 5),
    "rod in the plane": Lattice((1, 9), 3),
    "rod in the plane, upright": Lattice((9, 1), 4),
    "plane with holes": Lattice((8, 9), 3, missing=_hole((8, 9), (3, 4), (3, 5), (6, 2))),
    "plane without a corner": Lattice((7, 8), 4, missing=_hole((7, 8), (0, 0), (0, 1), (6, 7))),
    "space with holes": Lattice((5, 6, 5), 3, missing=_hole((5, 6, 5), (2, 2, 2), (2, 3, 2), (0, 5, 1))),
    "space without corners": Lattice((5, 5, 5), 3, missing=_hole((5, 5, 5), (0, 0, 0), (4, 4, 4), (0, 4, 0))),
    "sheet with a hole": Lattice((6, 7, 1), 3, missing=_hole((6, 7, 1), (2, 3, 0))),
    "masses": Lattice((5, 6, 5), 3, mass=True),
    "masses in the plane": Lattice((9, 8), 4, mass=True),
    "masses, holes, shuffled": Lattice(
        (5, 6, 5), 3, missing=_hole((5, 6, 5), (2, 2, 2), (0, 0, 0)), order=True, mass=True
    ),
    "masses on a sheet": Lattice((6, 1, 7), 3, mass=True),
    "shuffled": Lattice((4, 5, 6), 3, order=True),
    "oblique in the plane": Lattice((8, 7), 4, edges=_sheared(2)),
    "oblique in space": Lattice((5, 4, 6), 3, edges=_sheared(3)),
    "oblique, masses, holes, shuffled": Lattice(
        (6, 7), 3, missing=_hole((6, 7), (3, 3)), edges=_sheared(2), order=True, mass=True
    ),
    "oblique sheet": Lattice((6, 7, 1), 3, edges=_sheared(3), mass=True),
    "mirrored lattice": Lattice((4, 5, 4), 3, edges=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))),
}


def _limit(precision: Precision, body: Body, states: FloatArray) -> float:
    """Tolerance [m]: that of the sums, and what displacements that are large lose of their last digits.

    Four roundings on the way from a displacement to its goal, and one for each window over which a sum slid: there
    (along all axes but the fast one), and on the way back from clusters to particles."""
    scale = clusters.spacing(body.rest)
    moved = float(np.abs(states - body.rest).max()) / scale
    slides = 0
    if isinstance(body.clusters, LatticeClusters):
        slides = min(RUN, max(body.clusters.shape[:-1]))
    return scale * (KERNEL_TOLERANCE[precision] + (4 + 2 * slides) * ROUNDING[precision] * moved)


def _expected(states: FloatArray, spec: Rest, beta: FloatArray, theta: FloatArray, volume: Volume) -> FloatArray:
    """goals - x by the reference."""
    rows = [
        reference_states.goals(x, spec, float(b), float(th), volume=volume) - x
        for x, b, th in zip(states, beta, theta, strict=True)
    ]
    return np.stack(rows)


QUICK = [
    "plane, width 3",
    "plane, width 8",
    "space, width 3",
    "wide windows that slide along both axes",
    "plane, long",
    "sheet across the fast axis",
    "rod along the middle axis",
    "space with holes",
    "masses, holes, shuffled",
    "oblique, masses, holes, shuffled",
    "oblique sheet",
]
"""Of each kind of lattice one."""


@pytest.mark.parametrize("name", slow_but(QUICK, CASES))
def test_goals_are_the_references_and_those_of_the_same_clusters_as_lists(
    device: str, precision: Precision, name: str
) -> None:
    body = CASES[name].build()
    spec, engine, lists = body.spec(), body.engine(precision, device), body.as_lists(precision, device)
    states = body.states(3)
    beta = np.array([0.0, 0.7, 0.95])
    conserving = np.array([0.0, 0.6, 0.3])
    for volume, theta in (("scale", np.zeros(3)), ("project", conserving), ("scale", conserving)):
        how: Volume = "project" if volume == "project" else "scale"
        expected = _expected(states, spec, beta, theta, how)
        limit = _limit(precision, body, states)
        for each in (engine, lists):
            found = each.residual(states, beta, theta, volume=how)
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=limit, err_msg=f"{how}, theta {theta}")
            assert np.all(found[:, body.held] == 0.0)


@pytest.mark.parametrize("count", slow_but([2, 17], [1, 2, 5, 17, 40]))
@pytest.mark.parametrize(
    "name",
    slow_but(
        ["plane with holes", "masses, holes, shuffled"],
        ["plane with holes", "space without corners", "masses, holes, shuffled", "space, as wide as two axes"],
    ),
)
def test_any_number_of_candidates_gives_each_its_own_goals(
    device: str, precision: Precision, name: str, count: int
) -> None:
    body = CASES[name].build()
    states = body.states(count)
    beta, theta = body.rng.uniform(0.0, 1.0, count), body.rng.uniform(0.0, 0.9, count)
    found = body.engine(precision, device).residual(states, beta, theta, volume="project")
    some = np.unique(np.r_[: min(count, 3), count // 2, count - 1])
    expected = _expected(states[some], body.spec(), beta[some], theta[some], "project")
    np.testing.assert_allclose(found[some], expected, rtol=0.0, atol=_limit(precision, body, states))
    as_lists = body.as_lists(precision, device).residual(states, beta, theta, volume="project")
    np.testing.assert_allclose(found, as_lists, rtol=0.0, atol=2 * _limit(precision, body, states))


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize(
    "name",
    slow_but(
        ["plane with holes", "masses, holes, shuffled"],
        ["plane with holes", "masses, holes, shuffled", "wide windows that slide along both axes", "oblique sheet"],
    ),
)
def test_a_beta_for_each_cluster(device: str, precision: Precision, name: str, count: int) -> None:
    body = CASES[name].build()
    states = body.states(count)
    beta = body.rng.uniform(0.0, 1.0, (count, body.clusters.count))
    spec = body.spec()
    expected = np.zeros_like(states)
    for row, x in enumerate(states):
        for b, cluster in zip(beta[row], spec.clusters, strict=True):
            expected[row, cluster.index] += reference_states.cluster_goals(x, cluster, float(b), 0.4, volume="project")
    expected = expected / body.clusters.cluster_counts()[:, None] - states
    expected[:, body.held] = 0.0
    limit = _limit(precision, body, states)
    for engine in (body.engine(precision, device), body.as_lists(precision, device)):
        found = engine.residual(states, beta, 0.4, volume="project")
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=limit)
        # one number for all clusters, and the same number for each of them, are the same
        even = engine.residual(states, np.full_like(beta, 0.6))
        np.testing.assert_allclose(even, engine.residual(states, 0.6), rtol=0.0, atol=1e-3 * limit)


@pytest.mark.parametrize("count", slow_but([1], [1, 5]))  # a step of five is below
@pytest.mark.parametrize(
    "name",
    slow_but(
        ["plane, width 4", "masses on a sheet"],
        ["plane, width 4", "space with holes", "masses on a sheet", "oblique in space"],
    ),
)
def test_steps_are_the_references(device: str, precision: Precision, name: str, count: int) -> None:
    body = CASES[name].build()
    dim = body.rest.shape[1]
    beta = np.linspace(0.2, 0.9, count)
    moved = body.rest[body.held] + body.rng.normal(0, 0.5 * SPACING_M, (count, 2, dim))
    push = [0.5, -9.81, 0.3][:dim]
    spec = body.spec()
    limit = 20 * _limit(precision, body, body.rest[None] + 3 * SPACING_M)  # the rounding of 12 steps, and their motion
    found = {}
    for kind, engine in (("lattice", body.engine(precision, device)), ("lists", body.as_lists(precision, device))):
        state = engine.start(count)
        for dt, steps in ((2e-3, 7), (1e-3, 5)):
            found[kind] = engine.step(
                state, moved, beta, 0.4, volume="project", alpha=0.8, dt=dt, acceleration=push, steps=steps
            )
        assert not state.diverged.any()
    for row in range(count):
        x, v = body.rest.copy(), np.zeros_like(body.rest)
        for dt, steps in ((2e-3, 7), (1e-3, 5)):
            for _ in range(steps):
                x, v = reference_states.step(
                    x, v, spec, moved[row], beta=float(beta[row]), theta=0.4, alpha=0.8, dt=dt, acceleration=push,
                    volume="project",
                )  # fmt: skip
        for kind in found:
            np.testing.assert_allclose(found[kind][row], x, rtol=0.0, atol=limit, err_msg=kind)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("name", ["plane with holes", "masses, holes, shuffled"])
def test_a_step_without_motion_goes_to_the_goals_of_each_cluster(
    device: str, precision: Precision, name: str, count: int
) -> None:
    body = CASES[name].build()
    states = body.states(count)
    beta = body.rng.uniform(0.0, 1.0, (count, body.clusters.count))
    limit = _limit(precision, body, states)
    for engine in (body.engine(precision, device), body.as_lists(precision, device)):
        stepped = engine.step(engine.start(count, states), states[:, body.held], beta, 0.4, volume="project")
        expected = states + engine.residual(states, beta, 0.4, volume="project")
        np.testing.assert_allclose(stepped, expected, rtol=0.0, atol=limit)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("name", ["plane without a corner", "masses, holes, shuffled", "oblique in the plane"])
def test_static_states_are_those_of_the_same_clusters_as_lists(device: str, name: str, count: int) -> None:
    body = CASES[name].build()
    moved = body.rest[body.held] + body.rng.normal(0, SPACING_M, (count, 2, body.rest.shape[1]))
    beta = np.linspace(0.3, 0.9, count)
    ends = [
        engine.relax(moved, beta, 0.3, volume="project", tolerance=3e-10)
        for engine in (body.engine("float64", device), body.as_lists("float64", device))
    ]
    assert ends[0].converged.all()
    assert ends[1].converged.all()
    # two estimates of 3e-10 of the body's extent each, of root mean squares over some hundred particles
    np.testing.assert_allclose(ends[0].position, ends[1].position, rtol=0.0, atol=1e-8 * np.ptp(body.rest))
    spec = body.spec()
    for row, x in enumerate(ends[0].position):
        left = reference_states.goals(x, spec, float(beta[row]), 0.3, volume="project") - x
        assert np.abs(left).max() < 1e-10 * np.ptp(body.rest)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize(
    ("shape", "size"),
    slow_but(
        [((3, 200, 3), 9), ((300, 2), 9)],
        [((200, 3, 3), 9), ((3, 200, 3), 9), ((3, 3, 200), 9), ((300, 2), 9), ((2, 300), 9), ((300, 3), 4)],
    ),
)
def test_running_sums_do_not_drift_along_long_lattices(
    device: str, precision: Precision, shape: tuple[int, ...], size: int, count: int
) -> None:
    body = Lattice(shape, size).build()
    states = body.rest + body.rng.normal(0, 0.3 * SPACING_M, (count, *body.rest.shape))
    found = body.engine(precision, device).residual(states, 0.8)
    expected = _expected(states[-1:], body.spec(), np.array([0.8]), np.zeros(1), "scale")
    np.testing.assert_allclose(found[-1:], expected, rtol=0.0, atol=KERNEL_TOLERANCE[precision] * SPACING_M)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize(
    "name",
    slow_but(
        ["plane, long", "space with holes"], ["plane, width 7", "space, width 4", "plane, long", "space with holes"]
    ),
)
def test_far_away_and_turned_half_round_goals_keep_their_digits(
    device: str, precision: Precision, name: str, count: int
) -> None:
    body = CASES[name].build()
    dim = body.rest.shape[1]
    half_turn = np.diag([-1.0, -1.0, 1.0][:dim])
    away = 1000 * SPACING_M * np.array([0.6, -0.8, 0.3][:dim])
    noise = body.rng.normal(0, 0.2 * SPACING_M, body.rest.shape)
    spec, engine = body.spec(), body.engine(precision, device)
    for x in (body.rest + noise + away, body.rest @ half_turn + noise, body.rest @ half_turn + noise - away):
        states = np.broadcast_to(x, (count, *x.shape))
        limit = _limit(precision, body, states)
        found = engine.residual(states, 0.7)
        expected = _expected(x[None], spec, np.array([0.7]), np.zeros(1), "scale")[0]
        np.testing.assert_allclose(found[0], expected, rtol=0.0, atol=limit)
        np.testing.assert_allclose(found[-1], expected, rtol=0.0, atol=limit)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("name", ["plane with holes", "masses, holes, shuffled", "space, as wide as two axes"])
def test_goals_do_not_depend_on_what_was_asked_before(device: str, precision: Precision, name: str, count: int) -> None:
    body = CASES[name].build()
    states, others = body.states(count), body.states(count)
    engine = body.engine(precision, device)
    first = engine.residual(states, 0.7)
    engine.residual(others, 0.3)
    np.testing.assert_array_equal(engine.residual(states, 0.7), first)
    # candidates that end at different times leave scratch of different age
    moved = body.rest[body.held] + body.rng.normal(0, SPACING_M, (count, 2, body.rest.shape[1]))
    relaxed = engine.relax(moved, np.linspace(0.99, 0.0, count))
    np.testing.assert_array_equal(engine.residual(states, 0.7), first)
    engine.residual(np.full_like(states, np.nan), 0.7)
    np.testing.assert_array_equal(engine.residual(states, 0.7), first)
    again = engine.relax(moved, np.linspace(0.99, 0.0, count))
    np.testing.assert_array_equal(again.position, relaxed.position)
    np.testing.assert_array_equal(again.iterations, relaxed.iterations)


def test_a_candidate_that_is_not_a_number_spoils_no_other(device: str, precision: Precision) -> None:
    body = CASES["plane with holes"].build()
    engine = body.engine(precision, device)
    states = body.states(6)
    good = engine.residual(states, 0.7)
    spoiled = states.copy()
    spoiled[2] = np.nan
    spoiled[4] = 1e30
    found = engine.residual(spoiled, 0.7)
    others = [0, 1, 3, 5]
    np.testing.assert_array_equal(found[others], good[others])
    kept = engine.relax(body.rest[body.held] * 1.1, 0.7, start=states)
    ended = engine.relax(body.rest[body.held] * 1.1, 0.7, start=spoiled)
    np.testing.assert_array_equal(ended.position[others], kept.position[others])
    assert not ended.converged[[2, 4]].any()


@pytest.mark.slow
@pytest.mark.parametrize("case", [Lattice((7, 8, 9), 3), Lattice((9, 8, 10), 6), Lattice((11, 12), 7)])
def test_passes_one_lane_wide_step_as_the_kernels_that_stay(monkeypatch: Patch, device: str, case: Lattice) -> None:
    """As on a GPU for larger bodies: a launch for each pass, of windows that are all summed up anew."""
    body = case.build()
    held = body.rest[body.held] + 0.2 * SPACING_M
    beta = np.array([0.3, 0.8])

    def stepped() -> tuple[FloatArray, int]:
        engine = body.engine("float64", device)
        state = engine.start(2)
        if not lattice_body.RESIDENT_CELLS:
            state.operator.threads = 0
        engine.advance(state, held, beta, steps=7)
        return engine.positions(state), state.operator.arrays.window

    stays, _ = stepped()
    monkeypatch.setattr(lattice_body, "RESIDENT_CELLS", 0)
    monkeypatch.setattr(lattice_body, "widths", lambda *_args, **_options: (1, 1))
    passes, window = stepped()
    assert window == case.size
    np.testing.assert_allclose(passes, stays, rtol=0, atol=1e-10 * SPACING_M)
    assert np.abs(stays[0] - stays[1]).max() > 1e-4 * SPACING_M


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 5])
def test_goals_do_not_depend_on_the_width_of_the_lanes_but_for_rounding(monkeypatch: Patch, count: int) -> None:
    body = Lattice((5, 6, 7), 3).build()
    states = body.states(count)
    found = {}
    for bits in (256, 512):
        monkeypatch.setitem(LANES, wp.float64, bits // 64)
        engine = body.engine("float64", "cpu")
        found[bits] = engine.residual(states, 0.6)
        assert engine._body.layout(count).width == bits // 64
    np.testing.assert_allclose(found[256], found[512], rtol=0, atol=1e-11 * SPACING_M)


def test_runs_repeat_bit_for_bit(device: str, precision: Precision) -> None:
    for name in ("space, width 4", "plane, long", "masses, holes, shuffled"):
        ends = []
        for _ in range(2):
            body = CASES[name].build()
            engine = body.engine(precision, device)
            moved = body.rest[body.held] * 1.05
            for count in (1, 6):
                beta = np.linspace(0.2, 0.95, count)
                ends.append(engine.relax(moved, beta).position)
                ends.append(engine.step(engine.start(count), moved, beta, 0.3, volume="project", steps=9))
        for first, second in zip(ends[: len(ends) // 2], ends[len(ends) // 2 :], strict=True):
            np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("kind", ["uneven", slow("quadratic")])
def test_uneven_and_quadratic_bodies_are_taken_as_lists_and_agree_with_the_reference(device: str, kind: str) -> None:
    shape = (5, 6)
    rng = np.random.default_rng(1)
    even = lattice(shape)
    rest = even + rng.normal(0, 1e-3 * SPACING_M, even.shape) if kind == "uneven" else even
    basis: reference.Basis = "linear" if kind == "uneven" else "quadratic"
    held = np.array([0])
    x = even + rng.normal(0, 0.2 * SPACING_M, even.shape)
    grouped = clusters.lattice(rest, shape, np.arange(30), 3)
    assert isinstance(grouped, LatticeClusters)
    engine = Msm(rest, grouped, held, basis=basis, device=device)
    assert isinstance(engine._body, GeneralBody)
    expected = reference_states.goals(x, reference.build_rest(rest, grouped, held, basis=basis), 0.6) - x
    np.testing.assert_allclose(engine.residual(x, 0.6)[0], expected, rtol=0.0, atol=1e-11 * SPACING_M)


def test_a_particle_that_no_window_keeps_makes_a_body_of_lists(device: str) -> None:
    cell = np.array([0, 1, 5, 6, 2, 3, 4])  # a 2x2 block and a thin tail of one row
    rest = lattice((2, 5))[cell]
    grouped = clusters.lattice(rest, (2, 5), cell, 2)
    engine = Msm(rest, grouped, [0], device=device)
    assert isinstance(engine._body, GeneralBody)
    x = rest + np.random.default_rng(2).normal(0, 0.2 * SPACING_M, rest.shape)
    expected = reference_states.goals(x, reference.build_rest(rest, grouped, np.array([0])), 0.6) - x
    np.testing.assert_allclose(engine.residual(x, 0.6)[0], expected, rtol=0.0, atol=1e-11 * SPACING_M)


@pytest.mark.parametrize(("shape", "dim"), [((6, 7), 3), ((9,), 3), ((9,), 2), ((1, 6, 7), 2)])
def test_lattices_of_other_axes_than_their_space(device: str, shape: tuple[int, ...], dim: int) -> None:
    """A sheet or a rod, counted along its own axes only, or along one more than the plane has."""
    rng = np.random.default_rng(3)
    used = lattice(shape, 1.0)[:, [axis for axis, n in enumerate(shape) if n > 1]]
    rest = SPACING_M * used @ np.linalg.qr(rng.normal(size=(dim, dim)))[0][: used.shape[1]]
    grouped = clusters.lattice(rest, shape, np.arange(len(rest)), 3)
    held = np.array([0])
    engine = Msm(rest, grouped, held, device=device)
    spec = reference.build_rest(rest, grouped, held)
    x = rest + rng.normal(0, 0.2 * SPACING_M, rest.shape)
    for theta in (0.0, 0.5):
        expected = reference_states.goals(x, spec, 0.6, theta, volume="project") - x
        found = engine.residual(x, 0.6, theta, volume="project")[0]
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * SPACING_M)
