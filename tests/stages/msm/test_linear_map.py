"""The linear map of Newton's steps, against central differences of goals; margin to rounding; scratch of calls."""

from dataclasses import dataclass

import numpy as np
import pytest

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import clusters, solver
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.general import GeneralBody
from deformscope.stages.msm.lattice import LatticeBody
from deformscope.stages.msm.reference import Basis, Volume
from deformscope.stages.msm.solver import Msm
from tests.cases import slow_but
from tests.stages.bodies import lattice

STEP = 1e-3
"""Of the differences, in spacings. They are Richardson's (two central ones), whose own error is of the order STEP^4,
while rounding of goals leaves some 1e-12."""

TOLERANCE = 1e-8
"""Of a derivative, as a share of the largest one."""

STATE_TOLERANCE = 1e-13


@dataclass(frozen=True)
class Case:
    """A body and how its volume is conserved. kind: how its clusters are given"""

    shape: tuple[int, ...]
    size: int
    kind: str
    volume: Volume
    theta: float
    basis: Basis = "linear"
    mass: bool = False


def _name(case: Case) -> str:
    masses = ", masses" if case.mass else ""
    return f"{len(case.shape)}D {case.kind} {case.basis} {case.volume} {case.theta}{masses}"


PLANE, SPACE = (6, 5), (4, 3, 4)
HOW: tuple[tuple[Volume, float], ...] = (("scale", 0.0), ("project", 0.3), ("project", 0.9), ("scale", 0.3))
CASES = [
    *(
        Case(shape, 3, kind, volume, theta)
        for shape in (PLANE, SPACE)
        for kind in ("lattice", "lists")
        for volume, theta in HOW
    ),
    *(Case(shape, 3, "lattice", volume, theta, "quadratic") for shape in (PLANE, SPACE) for volume, theta in HOW),
    *(Case(PLANE, 3, kind, volume, theta, mass=True) for kind in ("lattice", "lists") for volume, theta in HOW[:3]),
    Case(SPACE, 2, "lattice", "project", 0.6, mass=True),
    Case(PLANE, 3, "lattice", "project", 0.0),
]
QUICK = [
    Case(PLANE, 3, "lattice", "project", 0.3),
    Case(PLANE, 3, "lattice", "scale", 0.3),
    Case(SPACE, 3, "lattice", "scale", 0.3),
    Case(SPACE, 3, "lists", "project", 0.9),
    Case(SPACE, 3, "lattice", "project", 0.3, "quadratic"),
    Case(PLANE, 3, "lists", "scale", 0.0, mass=True),
    Case(SPACE, 2, "lattice", "project", 0.6, mass=True),
]
"""Of each kind of body and of conservation one."""

WITH_ENERGY = [one for one in CASES if one.theta == 0.0 or one.volume == "project"]


@dataclass(frozen=True)
class Set:
    """What a case makes. position: of the held particles (n, d)"""

    engine: Msm
    held: IntArray
    position: FloatArray
    rng: np.random.Generator


def _build(case: Case, device: str, rounding: FloatArray | float = 0.0) -> Set:
    """rounding: (K, d) relative noise of the rest shape"""
    rng = np.random.default_rng([*case.shape, len(case.kind), int(10 * case.theta)])
    rest = lattice(case.shape) * (1.0 + rounding)
    grouped: Clusters = clusters.lattice(rest, case.shape, np.arange(len(rest)), case.size)
    if case.kind == "lists":
        grouped = clusters.Clusters(list(grouped), len(rest))
    near, far = np.flatnonzero(rest[:, 0] <= 0.0), np.flatnonzero(rest[:, 0] >= rest[:, 0].max() - 1e-9)
    held = np.concatenate([near, far[:2]])
    position = rest[held].copy()
    position[len(near) :] += rng.normal(0, 0.006, rest.shape[1])
    mass = rng.uniform(0.4, 2.5, len(rest)) if case.mass else None
    engine = Msm(rest, grouped, held, mass=mass, basis=case.basis, device=device)
    linear_lattice = case.kind == "lattice" and case.basis == "linear"
    assert isinstance(engine._body, LatticeBody if linear_lattice else GeneralBody)
    return Set(engine, held, position, rng)


def _state(made: Set, case: Case, beta: FloatArray | float, theta: FloatArray | float) -> FloatArray:
    relaxed = made.engine.relax(
        made.position, beta, theta, volume=case.volume, tolerance=STATE_TOLERANCE, max_iterations=20_000
    )
    assert not relaxed.diverged.any()
    # at 1e-13 rounding may stop it short of its own flag
    assert np.all(relaxed.residual < 1e-12 * made.engine.extent), relaxed
    return relaxed.position


@pytest.mark.parametrize("case", slow_but([one for one in QUICK if one in WITH_ENERGY], WITH_ENERGY), ids=_name)
def test_the_linear_map_is_the_slope_of_the_goals(device: str, case: Case) -> None:
    """At shapes away from any static state, of two candidates at once; eq. 3.17 needs no derivatives."""
    made = _build(case, device)
    engine, beta, theta = made.engine, np.array([0.6, 0.9]), np.array([1.0, 0.5]) * case.theta
    free = engine.free[:, None]
    spread = 0.05 * engine.scale * free
    position = engine.rest + spread * made.rng.standard_normal((2, *engine.rest.shape))
    direction = free * made.rng.standard_normal(position.shape)

    def residual(by: float) -> FloatArray:
        return engine.residual(position + by * engine.scale * direction, beta, theta, volume=case.volume)

    near, wide = ((residual(h) - residual(-h)) / (2 * h) for h in (STEP, 2 * STEP))
    newton = engine._at(position, beta, theta, case.volume)
    newton.layout.put(direction, newton.direction)
    operator = newton.operator
    operator.change(newton.direction, newton.changed, newton.parameters, newton._every_group, newton._kept)
    found = newton.layout.get(newton.changed, engine.dim) * engine.scale
    expected = (4 * near - wide) / 3
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=TOLERANCE * np.abs(expected).max())


ROUNDING = 2e-15
"""Relative noise of what goes in: as much as other kernels of a BLAS change what they give."""


@pytest.mark.parametrize("case", slow_but(QUICK[1:4], CASES), ids=_name)
def test_every_solve_has_margin_to_rounding(device: str, case: Case) -> None:
    """Whatever the last digits are, states converge even to a hundredth of the default tolerance."""
    rng = np.random.default_rng(5)
    for _ in range(6):
        made = _build(case, device, ROUNDING * rng.standard_normal((np.prod(case.shape), len(case.shape))))
        position = made.position * (1.0 + ROUNDING * rng.standard_normal(made.position.shape))
        tolerance = 0.01 * solver.TOLERANCE["float64"]
        state = made.engine.relax(position, 0.6, case.theta, volume=case.volume, tolerance=tolerance)
        assert state.converged.all()


def test_calls_leave_nothing_behind_for_later_ones(device: str) -> None:
    """Scratch is shared by calls of one size; the same question has the same answer, bit for bit."""
    for volume, theta in HOW:
        case = Case(PLANE, 3, "lattice", volume, theta)
        made = _build(case, device)
        position = _state(made, case, 0.6, theta)

        def ask(made: Set = made, case: Case = case, at: FloatArray = position) -> FloatArray:
            left = made.engine.residual(at + 0.002, 0.6, case.theta, volume=case.volume)
            again = made.engine.relax(made.position, 0.6, case.theta, volume=case.volume)
            return np.concatenate([each.ravel() for each in (left, again.position)])

        first = ask()
        made.engine.relax(made.position, 0.2, theta, volume=volume)
        made.engine.residual(position + 0.001, 0.9)
        np.testing.assert_array_equal(ask(), first)
