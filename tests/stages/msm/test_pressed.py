"""Two hundred pressed bodies of every kind: each converges to the float64 reference, or says that it diverged.

The default run takes twelve; all of them: `pytest -m "slow or not slow" tests/stages/msm/test_pressed.py` (minutes).
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.sparse import csc_array, identity
from scipy.sparse.linalg import spsolve

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import clusters, multigrid, reference
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.reference import Rest, Volume
from deformscope.stages.msm.solver import TOLERANCE, Msm, Precision
from tests.stages import reference_states
from tests.stages.bodies import SPACING_M, lattice


@dataclass(frozen=True)
class Pressed:
    """A lattice between two plates, the upper of which comes down by a share of the height, a little unevenly.

    aside: spacings by which that plate moves along the first axis
    missing, held: shares of particles that are holes, and that stay where they were at rest; shear: of the lattice
    aided: preconditioned by multigrid whatever its size, where that serves it"""

    shape: tuple[int, ...]
    size: int
    beta: float
    theta: float
    volume: Volume
    share: float
    aside: float = 0.0
    shear: float = 0.0
    missing: float = 0.0
    held: float = 0.0
    aided: bool = False
    precision: Precision = "float64"

    def body(self) -> tuple[FloatArray, Clusters, IntArray, FloatArray]:
        """Rest shape (K, d), its clusters, which particles are held (n,), and where (n, d)."""
        rng = np.random.default_rng(3)
        rest = lattice(self.shape)
        up = rest[:, -1]
        plate = (up == 0.0) | (up == up.max())
        cell = np.flatnonzero((rng.random(len(rest)) >= self.missing) | plate)
        rest, plate = rest[cell], plate[cell]
        low = rest[:, -1] == 0.0
        rest[:, 0] += self.shear * rest[:, -1]
        held = np.flatnonzero(plate | (rng.random(len(rest)) < self.held))
        position = rest[held].copy()
        moved = plate[held] & ~low[held]
        position[moved, -1] -= self.share * up.max()
        position[moved, 0] += self.aside * SPACING_M
        position[moved, :-1] += rng.normal(0.0, 0.02 * SPACING_M, (np.count_nonzero(moved), len(self.shape) - 1))
        return rest, clusters.lattice(rest, self.shape, cell, self.size), held, position


SHAPES = ((6, 9), (9, 8), (12, 7), (11, 12), (17, 9), (4, 40), (4, 4, 5), (5, 6, 4), (6, 5, 7), (7, 6, 6))
BETAS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)
MODES: tuple[tuple[Volume, float], ...] = (("scale", 0.0), ("project", 0.5), ("project", 1.0), ("scale", 0.3))
SLENDER = (
    Pressed((4, 4, 200), 3, 0.5, 0.0, "scale", 0.0005),
    Pressed((4, 4, 200), 2, 0.9, 0.0, "scale", 0.0, aside=20.0),
    Pressed((4, 4, 200), 3, 0.8, 0.5, "project", 0.0005),
    Pressed((200, 4, 4), 3, 0.9, 0.0, "scale", 0.3),
    Pressed((200, 4, 4), 2, 0.99, 0.0, "scale", 0.3, held=0.01),
    Pressed((200, 4, 4), 3, 0.7, 0.3, "scale", 0.2),
)
"""Struts are pressed as far as they stay straight: of one that has buckled rounding hides which way it is turned."""
LARGE = (
    Pressed((100, 90), 3, 0.9, 0.0, "scale", 0.3),
    Pressed((95, 95), 2, 0.99, 0.0, "scale", 0.2, held=0.01),
    Pressed((90, 100), 5, 0.7, 0.5, "project", 0.3, missing=0.05),
    Pressed((38, 6, 37), 3, 0.8, 0.0, "scale", 0.3),
    Pressed((100, 90), 3, 0.9, 0.0, "scale", 0.3, precision="float32"),
)


def _made(count: int) -> list[Pressed]:
    """Bodies of some hundred particles, every kind of each shape."""
    rng = np.random.default_rng(33)
    found = []
    for index in range(count):
        shape = SHAPES[index % len(SHAPES)]
        volume, theta = MODES[int(rng.integers(len(MODES)))]
        size = int(rng.choice([2, 2, 3, 3, 4, 5, 9]))
        beta, share = float(rng.choice(BETAS)), float(rng.choice([0.1, 0.2, 0.3, 0.45, 0.6]))
        shear, missing = float(rng.choice([0.0, 0.0, 0.3, 1.0])), float(rng.choice([0.0, 0.0, 0.05, 0.12]))
        held, aided = float(rng.choice([0.0, 0.01])), bool(rng.integers(2))
        precision: Precision = "float32" if index % 10 == 9 else "float64"
        kind = {"shear": shear, "missing": missing, "held": held}
        found.append(Pressed(shape, size, beta, theta, volume, share, **kind, aided=aided, precision=precision))
    return found


CASES = [*SLENDER, *LARGE, *_made(200 - len(SLENDER) - len(LARGE))]
QUICK = (*range(30, 39), 41, 71, 103)


def _distance(x: FloatArray, spec: Rest, case: Pressed) -> float:
    """Distance to the static state, root mean square over the free particles: a Newton step of the reference, by the
    differences of each of its clusters' goals."""
    dim, h = x.shape[1], 1e-5 * SPACING_M
    counts = np.bincount(np.concatenate([each.index for each in spec.clusters]), minlength=len(x))
    rows, columns, values = [], [], []

    def goals(at: FloatArray, cluster: reference.RestCluster) -> FloatArray:
        found = reference_states.cluster_goals(at, cluster, case.beta, case.theta, volume=case.volume)
        return np.asarray(found / counts[cluster.index, None]).reshape(-1)

    for cluster in spec.clusters:
        unknowns = (cluster.index[:, None] * dim + np.arange(dim)).reshape(-1)
        for one in unknowns:
            at = x.flat[one]
            x.flat[one] = at + h
            ahead = goals(x, cluster)
            x.flat[one] = at - h
            values.append((ahead - goals(x, cluster)) / (2.0 * h))
            x.flat[one] = at
            rows.append(unknowns)
            columns.append(np.full(len(unknowns), one))
    size = x.size
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    slope = csc_array(identity(size, format="csc") - csc_array(entries, shape=(size, size)))
    free = np.flatnonzero(np.repeat(~clusters.held_mask(len(x), spec.held), dim))
    left = (reference_states.goals(x, spec, case.beta, case.theta, volume=case.volume) - x).reshape(-1)[free]
    step = spsolve(slope[free][:, free], left, permc_spec="MMD_AT_PLUS_A")
    return float(np.sqrt(np.mean(np.sum(step.reshape(-1, dim) ** 2, axis=1))))


@pytest.mark.parametrize("case", [CASES[index] for index in QUICK], ids=repr)
def test_a_pressed_body_is_that_of_the_reference_or_says_that_it_diverged(
    case: Pressed, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _compare(case, device, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("case", [case for index, case in enumerate(CASES) if index not in QUICK], ids=repr)
def test_the_other_pressed_bodies_are_those_of_the_reference(case: Pressed, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a CPU alone: nearly all of the time is the reference's."""
    _compare(case, "cpu", monkeypatch)


def _compare(case: Pressed, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if case.aided:
        monkeypatch.setattr(multigrid, "LEAST", 0)
        monkeypatch.setattr(multigrid, "FEWEST", 20)
    rest, grouped, held, position = case.body()
    engine = Msm(rest, grouped, held, precision=case.precision, device=device)
    found = engine.relax(position, case.beta, case.theta, volume=case.volume)
    assert np.isfinite(found.position).all()
    if found.diverged[0]:
        assert case.volume == "scale"
        assert case.theta > 0.0
        return
    assert found.converged[0]
    distance = _distance(found.position[0], reference.build_rest(rest, grouped, held), case)
    assert distance <= TOLERANCE[case.precision] * engine.extent


@pytest.mark.slow
def test_a_strut_that_has_buckled_says_how_far_it_may_be() -> None:
    """Next to nothing turns it about its axis: rounding hides the rest of the way, and it is not called converged."""
    case = Pressed((4, 4, 200), 3, 0.5, 0.0, "scale", 0.05)
    rest, grouped, held, position = case.body()
    found = Msm(rest, grouped, held).relax(position, case.beta)
    assert not found.converged[0]
    assert not found.diverged[0]
    assert _distance(found.position[0], reference.build_rest(rest, grouped, held), case) <= found.error[0]
