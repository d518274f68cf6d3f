"""`python -m studies reproduce shapes`: effect of beta and theta on a body, the states of Thesis figures 3.5, 3.7 and
3.13.

    python -m studies reproduce shapes --record shapes.rrd

The recording has them on timelines of beta and theta; `python -m studies figures` draws them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.pictures.report import Table
from deformscope.session import with_costs
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm.reference import Basis
from studies.reproduce.state_sweep import StateSweep, StateSweeps
from studies.runner import Study, StudyOptions, StudyReport

BETAS, THETAS = 0.01 * np.arange(100), 0.01 * np.arange(101)
"""Range of the sweep: at beta = 1 nothing is rigid, and no state static."""
SPACING_M, SIDE_M, CUBE_SIDE, CUBE_BETA = 0.01, 0.1, 11, 0.99
PRESSED_M, CUBE_M = 0.02, 0.03
"""By how much the sheet's middle particle and the cube's top are pressed down; the cube as in experiment 3.A."""
ENDS: dict[Basis, tuple[float, tuple[float, float]]] = {
    "linear": (0.0, (0.04, 0.02)),
    "quadratic": (np.radians(60.0), (0.03, -0.02)),
}
"""How the top of the column is turned, clockwise, and moved [m]: sheared and stretched, or bent."""


@dataclass(frozen=True, slots=True)
class HeldLattice:
    """A lattice with some particles held at other places, and its model. seen: its observation, in which only the held
    particles have moved; shape: shape of the lattice"""

    name: str
    seen: Observation
    model: Model
    shape: tuple[int, ...]

    def side(self, position: FloatArray) -> FloatArray:
        """Positions (..., rows, columns, 2) from (..., K, d): in space, those of the middle layer along the second
        axis."""
        grid = position.reshape(*position.shape[:-2], *self.shape, -1)[..., [0, -1]]
        return grid if len(self.shape) == 2 else grid[..., self.shape[1] // 2, :, :]

    def sweep(self, value: FloatArray) -> StateSweep:
        """The static state at each value (n,) of the model's parameter."""
        rest, held, over = self.seen.rest, self.seen.held, self.model.parameter
        beta, theta = (value, 0.0) if over == "beta" else (np.full(value.shape, self.model.beta), value)
        found = self.model.body(self.seen).relax(self.seen.deformed[held], beta, theta)
        if not found.converged.all():
            raise InputError(f"a static state at every {over}", f"none at {value[~found.converged][0]:g}")
        moved = np.linalg.norm(np.delete(found.position - rest, held, axis=1), axis=2).mean(axis=1)
        marked = np.isin(np.arange(len(rest)), held)[:, None] * np.ones(rest.shape[1])
        sides = self.side(rest), self.side(found.position), self.side(marked)[..., 0] > 0
        if over == "beta":
            return StateSweep(self.name, over, value, *sides, "mean displacement of free particles [mm]", 1e3 * moved)
        volume = np.array([ConvexHull(one).volume for one in (rest, *found.position)])
        return StateSweep(self.name, over, value, *sides, "volume [% of that at rest]", 1e2 * volume[1:] / volume[0])


def lattice(*shape: int, spacing_m: float = SPACING_M) -> FloatArray:
    """(K, d) places of a lattice [m], the last axis fastest."""
    axes = np.meshgrid(*(spacing_m * np.arange(count) for count in shape), indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, len(shape))


def _body(name: str, shape: tuple[int, ...], model: Model, rest: FloatArray, target: FloatArray) -> HeldLattice:
    """Particles (K, d) at rest, held where their targets (K, d) are no NaN."""
    held = np.flatnonzero(np.isfinite(target[:, 0]))
    deformed = np.where(np.isfinite(target), target, rest)
    everyone = np.ones(len(rest), dtype=bool)
    seen = Observation(rest, deformed, held, everyone, shape=shape, cell=np.arange(len(rest)), held_measured=False)
    return HeldLattice(name, seen, model, shape)


def column(basis: Basis) -> HeldLattice:
    """Figure 3.5: one cluster in the plane, its bottom held, its top held at other places."""
    rest = lattice(6, 12)
    top = rest[:, 1] == rest[:, 1].max()
    angle, moved_m = ENDS[basis]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = rest[top].mean(axis=0)
    target = np.where(rest[:, 1:] == 0.0, rest, np.nan)
    target[top] = (rest[top] - middle) @ turn + middle + moved_m
    return _body(f"one cluster, {basis}", (6, 12), Model("beta", basis, None), rest, target)


def sheet() -> HeldLattice:
    """Figure 3.13: 15 x 7 particles as in experiment 3.B, the ground held, the middle of the top pressed down."""
    rest = lattice(15, 7)
    target = np.where(rest[:, 1:] == 0.0, rest, np.nan)
    target[7 * 7 + 6] = rest[7 * 7 + 6] - [0.0, PRESSED_M]
    return _body("clusters of 3 x 3, one particle pressed", (15, 7), Model("beta", "linear", 3), rest, target)


def cube(side: int = CUBE_SIDE) -> HeldLattice:
    """Figure 3.7: the cube of experiment 3.A, one quadratic cluster, pressed from above."""
    rest = lattice(side, side, side, spacing_m=SIDE_M / (side - 1))
    bottom, top = rest[:, 2:] < 1e-9, rest[:, 2:] > SIDE_M - 1e-9
    target = np.where(bottom, rest, np.where(top, rest - [0.0, 0.0, CUBE_M], np.nan))
    model = Model("theta", "quadratic", None, beta=CUBE_BETA)
    return _body("middle layer of a cube pressed by 3 cm", (side, side, side), model, rest, target)


def all_sweeps() -> tuple[StateSweep, ...]:
    """Sweeps of both columns and of the sheet over beta, and of the cube over theta."""
    bodies = column("linear"), column("quadratic"), sheet(), cube()
    return tuple(one.sweep(BETAS if one.model.parameter == "beta" else THETAS) for one in bodies)


@dataclass(frozen=True, slots=True)
class ShapesConfig(StudyOptions):
    """The effect of beta and theta on a body (figures 3.5, 3.7 and 3.13 of the thesis). It takes some seconds."""


def report(options: ShapesConfig, seconds: float) -> StudyReport:
    """What is swept, in words; the states are recorded."""
    sweeps, costs = with_costs("states", all_sweeps)
    table = Table([(one.to_text(),) for one in sweeps], caption="Static states")
    return StudyReport([table], sweeps, results=(StateSweeps(sweeps),), costs=costs)


STUDY = Study(ShapesConfig, lambda options: [], report)
