"""Derivatives of static states by their parameters, against central differences of `relax`."""

from collections.abc import Callable
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
from tests.stages.bodies import lattice, pushed

STEP = 2e-4
"""Of the differences. They are Richardson's (two central ones), whose own error is of the order STEP^4: below 1e-8 of
the derivative, while states known to 1e-12 of the body leave 1e-8 too."""

TOLERANCE = 1e-6
"""Of a derivative, as a share of the largest one of its kind."""

STATE_TOLERANCE = 1e-13
SINGLE_TOLERANCE = 1e-12
"""Of one cluster, whose radius is a third of its extent: the next to what its own rounding lets it prove."""


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
SINGLE = [
    Case(shape, 9, "single", volume, theta, basis, mass=basis == "linear")
    for shape in (PLANE, SPACE)
    for basis in ("linear", "quadratic")
    for volume, theta in HOW
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
QUICK_SINGLE = [Case(SPACE, 9, "single", how, 0.3, "quadratic") for how in ("scale", "project")]
"""Of each kind of body and of conservation one."""


@dataclass(frozen=True)
class Set:
    """What a case makes. position: of the held particles (n, d)"""

    engine: Msm
    held: IntArray
    position: FloatArray
    rng: np.random.Generator

    @property
    def cluster_count(self) -> int:
        return self.engine.cluster_count


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
    if case.kind != "single":
        linear_lattice = case.kind == "lattice" and case.basis == "linear"
        assert isinstance(engine._body, LatticeBody if linear_lattice else GeneralBody)
    return Set(engine, held, position, rng)


def _state(made: Set, case: Case, beta: FloatArray | float, theta: FloatArray | float) -> FloatArray:
    relaxed = made.engine.relax(
        made.position,
        beta,
        theta,
        volume=case.volume,
        tolerance=SINGLE_TOLERANCE if case.kind == "single" else STATE_TOLERANCE,
        max_iterations=20_000,
    )
    assert not relaxed.diverged.any()
    # at 1e-13 rounding may stop it short of its own flag
    assert np.all(relaxed.residual < 1e-12 * made.engine.extent), relaxed
    return relaxed.position


def _difference(f: Callable[[float], FloatArray], at: float) -> FloatArray:
    """df / dx by Richardson's extrapolation of central differences; one-sided (of fourth order) at 0."""
    h = STEP
    if at < 2 * h:
        return (-25 * f(at) + 48 * f(at + h) - 36 * f(at + 2 * h) + 16 * f(at + 3 * h) - 3 * f(at + 4 * h)) / (12 * h)
    near, wide = (f(at + h) - f(at - h)) / (2 * h), (f(at + 2 * h) - f(at - 2 * h)) / (4 * h)
    return (4 * near - wide) / 3


def _close(found: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=TOLERANCE * np.abs(expected).max())


@pytest.mark.parametrize("case", slow_but([*QUICK, *QUICK_SINGLE], [*CASES, *SINGLE]), ids=_name)
def test_sensitivity_is_the_slope_of_static_states(device: str, case: Case) -> None:
    made = _build(case, device)
    beta = 0.6
    found = made.engine.sensitivity(_state(made, case, beta, case.theta), beta, case.theta, volume=case.volume)
    assert found.converged
    _close(found.beta, _difference(lambda b: _state(made, case, b, case.theta), beta))
    _close(found.theta, _difference(lambda t: _state(made, case, beta, t), case.theta))
    assert np.all(found.beta[:, made.held] == 0.0)
    assert np.all(found.theta[:, made.held] == 0.0)


ROUNDING = 2e-15
"""Relative noise of what goes in: as much as other kernels of a BLAS change what they give."""


@pytest.mark.parametrize("case", slow_but(QUICK[1:4], CASES), ids=_name)
def test_every_solve_has_margin_to_rounding(device: str, case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the last digits are, states and derivatives converge even to a hundredth of the default tolerances."""
    monkeypatch.setattr(solver, "LINEAR_TOLERANCE", {"float64": 0.01 * solver.LINEAR_TOLERANCE["float64"]})
    rng = np.random.default_rng(5)
    for _ in range(6):
        made = _build(case, device, ROUNDING * rng.standard_normal((np.prod(case.shape), len(case.shape))))
        position = made.position * (1.0 + ROUNDING * rng.standard_normal(made.position.shape))
        tolerance = 0.01 * solver.TOLERANCE["float64"]
        state = made.engine.relax(position, 0.6, case.theta, volume=case.volume, tolerance=tolerance)
        assert state.converged.all()
        assert made.engine.sensitivity(state.position, 0.6, case.theta, volume=case.volume).converged


BATCH = [
    Case(PLANE, 3, "lattice", "project", 0.4, mass=True),
    Case(SPACE, 3, "lists", "project", 0.4),
    Case(SPACE, 3, "lattice", "scale", 0.0),
    Case(PLANE, 3, "lattice", "scale", 0.3),
    Case(PLANE, 9, "single", "scale", 0.3, "quadratic"),
]


@pytest.mark.parametrize("size", [2, 5])
@pytest.mark.parametrize("case", slow_but(BATCH[:4], BATCH), ids=_name)
def test_derivatives_of_candidates_are_those_of_each_alone(device: str, case: Case, size: int) -> None:
    made = _build(case, device)
    beta = np.linspace(0.3, 0.9, size)
    theta = np.linspace(0.5, 1.0, size) * case.theta
    position = _state(made, case, beta, theta)
    changes = made.engine.sensitivity(position, beta, theta, volume=case.volume)
    assert changes.converged
    for row in range(size):
        b, t = float(beta[row]), float(theta[row])
        one = made.engine.sensitivity(position[row], b, t, volume=case.volume)
        np.testing.assert_allclose(changes.beta[row], one.beta[0], rtol=0.0, atol=1e-8 * np.abs(one.beta).max())
        np.testing.assert_allclose(changes.theta[row], one.theta[0], rtol=0.0, atol=1e-8 * np.abs(one.theta).max())


def test_derivatives_leave_nothing_behind_for_later_calls(device: str) -> None:
    """Scratch is shared by calls of one size; the same question has the same answer, bit for bit."""
    for volume, theta in HOW:
        case = Case(PLANE, 3, "lattice", volume, theta)
        made = _build(case, device)
        position = _state(made, case, 0.6, theta)

        def ask(made: Set = made, case: Case = case, at: FloatArray = position) -> FloatArray:
            changes = made.engine.sensitivity(at, 0.6, case.theta, volume=case.volume)
            again = made.engine.relax(made.position, 0.6, case.theta, volume=case.volume)
            return np.concatenate([each.ravel() for each in (changes.beta, changes.theta, again.position)])

        first = ask()
        made.engine.sensitivity(position, 0.2, theta, volume=volume)
        made.engine.residual(position + 0.001, 0.9)
        np.testing.assert_array_equal(ask(), first)


def test_where_nothing_changes_the_derivatives_are_zero(device: str) -> None:
    """At rest no beta moves anything."""
    body = pushed((6, 7), np.random.default_rng(30))
    engine = Msm(body.rest, body.clusters(3), body.held, device=device)
    still = engine.sensitivity(body.rest, [0.2, 0.7])
    assert still.converged
    np.testing.assert_array_equal(still.beta, 0.0)
