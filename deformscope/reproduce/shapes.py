"""What beta and theta do to a body: Thesis figures 3.5, 3.7 and 3.13, and Algorithm 2 on a body whose beta is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.fit.model import Model, Observation
from deformscope.stages.msm import clusters
from deformscope.stages.msm.reference import Basis
from deformscope.stages.msm.state_sweep import PressedLattice, StateSweep, sweep_states

SPACING_M, SIDE_M = 0.01, 0.1
BETAS, THETAS = 0.01 * np.arange(100), 0.01 * np.arange(101)
"""What is swept: at beta = 1 nothing is rigid, and no state static."""

ENDS: dict[Basis, tuple[float, tuple[float, float]]] = {
    "linear": (0.0, (0.04, 0.02)),
    "quadratic": (np.radians(60.0), (0.03, -0.02)),
}
"""By how much the top of the column is turned, clockwise, and moved [m]: sheared and stretched, or bent."""
PRESSED_M, CUBE_M = 0.02, 0.03
"""By how much the sheet's middle particle and the cube's top are pressed down; the cube as in experiment 3.A."""
CUBE_SIDE, CUBE_BETA = 11, 0.99
PUSH_M, PUSH_MOST = 1e-3, 20_000
"""Of the push without a place: acceleration times the squared time step [m] of each of the particles that are pushed;
steps at most."""
KNOWN_BETA, NOISE_M = 0.7, 2e-4


def grid(*shape: int, spacing_m: float = SPACING_M) -> FloatArray:
    """(K, d) places of a lattice [m], the last axis fastest."""
    axes = np.meshgrid(*(spacing_m * np.arange(count) for count in shape), indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, len(shape))


def column(basis: Basis) -> PressedLattice:
    """Figure 3.5: one cluster in the plane, its bottom held, its top held elsewhere."""
    rest = grid(6, 12)
    bottom, top = rest[:, 1] == 0.0, rest[:, 1] == rest[:, 1].max()
    middle = rest[top].mean(axis=0)
    angle, moved_m = ENDS[basis]
    cosine, sine = np.cos(angle), np.sin(angle)
    target = rest.copy()
    target[top] = (rest[top] - middle) @ np.array([[cosine, -sine], [sine, cosine]]) + middle + moved_m
    held = np.flatnonzero(bottom | top)
    return PressedLattice(f"one cluster, {basis}", rest, (6, 12), held, target[held], basis)


def sheet() -> PressedLattice:
    """Figure 3.13: 15 x 7 particles of experiment 3.B, the ground held, the middle particle of the top pressed down."""
    rest = grid(15, 7)
    pressed = 7 * 7 + 6
    held = np.append(np.flatnonzero(rest[:, 1] == 0.0), pressed)
    target = rest[held].copy()
    target[-1, 1] -= PRESSED_M
    return PressedLattice("clusters of 3 x 3, one particle pressed", rest, (15, 7), held, target, cluster_size=3)


def cube(side: int = CUBE_SIDE) -> PressedLattice:
    """Figure 3.7: the cube of experiment 3.A, one quadratic cluster, pressed from above."""
    rest = grid(side, side, side, spacing_m=SIDE_M / (side - 1))
    bottom, top = rest[:, 2] < 1e-9, rest[:, 2] > SIDE_M - 1e-9
    target = rest - CUBE_M * top[:, None] * [0.0, 0.0, 1.0]
    held = np.flatnonzero(bottom | top)
    shape = (side, side, side)
    return PressedLattice(
        "middle layer of a cube pressed by 3 cm", rest, shape, held, target[held], "quadratic", layer=side // 2
    )


def all_sweeps(progress: Callable[[int, int], None] = lambda done, total: None) -> tuple[StateSweep, ...]:
    """Both columns and the sheet over beta, the cube over theta."""
    jobs: list[Callable[[], StateSweep]] = [
        lambda: sweep_states(column("linear"), "beta", BETAS, 0.0),
        lambda: sweep_states(column("quadratic"), "beta", BETAS, 0.0),
        lambda: sweep_states(sheet(), "beta", BETAS, 0.0),
        lambda: sweep_states(cube(), "theta", THETAS, CUBE_BETA),
    ]
    found = []
    for number, job in enumerate(jobs):
        progress(number, len(jobs))
        found.append(job())
    return tuple(found)


def middle_of(lattice: PressedLattice) -> IntArray:
    """(3,) the middle particles of a sheet's top."""
    return (lattice.shape[0] // 2 + np.array([-1, 0, 1])) * lattice.shape[1] + lattice.shape[1] - 1


def pushed(lattice: PressedLattice, beta: float) -> FloatArray:
    """(K, 2) where a sheet on its ground comes to rest under a push down on the middle of its top (Thesis figure
    3.13 (c)): the fixed point of x = g(x + f dt^2 / m), with alpha = 1."""
    ground = np.flatnonzero(lattice.rest[:, 1] == 0.0)
    body = lattice.body().holding(ground)
    held: BoolArray = clusters.held_mask(len(lattice.rest), ground)
    offset = np.zeros_like(lattice.rest)
    offset[middle_of(lattice), 1] = -PUSH_M
    at = goal = lattice.rest
    for _ in range(PUSH_MOST):
        moved = at + offset
        goal = np.where(held[:, None], lattice.rest, moved + body.residual(moved, beta)[0])
        if np.abs(goal - at).max() < 1e-8:
            break
        at = goal
    return goal


def known_sheet(seed: int = 0) -> tuple[Observation, Model]:
    """The sheet at a beta that is known, seen with noise, and the model that it was made by."""
    lattice = sheet()
    state = sweep_states(lattice, "beta", np.array([KNOWN_BETA]), 0.0).position[0]
    noisy = state + NOISE_M * np.random.default_rng(seed).standard_normal(state.shape)
    noisy[lattice.held] = lattice.target
    everyone = np.ones(len(state), dtype=bool)
    cell = np.arange(len(state))
    seen = Observation(lattice.rest, noisy, lattice.held, everyone, shape=lattice.shape, cell=cell)
    return seen, Model("beta", "linear", lattice.cluster_size)
