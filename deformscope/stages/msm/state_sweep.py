"""Static states of a body over beta or theta: what the two parameters do to it (Thesis figures 3.5, 3.7 and 3.13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.msm import clusters
from deformscope.stages.msm.reference import Basis
from deformscope.stages.msm.solver import Msm

_TETRAHEDRA = ((1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1))
"""Of a cell: the corners that join 0 and 7 (bits: which axes are at their far end)."""


@dataclass(frozen=True, slots=True)
class PressedLattice:
    """A lattice of particles of which some are held elsewhere.

    name: what it is; rest: (K, d) [m], the last axis of `shape` fastest; held: (h,); target: (h, d) where they are held
    cluster_size: particles a side; None: one cluster of all
    layer: of a body in space, the index along its second axis of the particles that are looked at
    """

    name: str
    rest: FloatArray
    shape: tuple[int, ...]
    held: IntArray
    target: FloatArray
    basis: Basis = "linear"
    cluster_size: int | None = None
    layer: int = 0

    @property
    def clusters(self) -> clusters.Clusters:
        """Which particles belong together."""
        if self.cluster_size is None:
            return clusters.single(len(self.rest))
        return clusters.lattice(self.rest, self.shape, np.arange(len(self.rest)), self.cluster_size)

    def body(self) -> Msm:
        """The model of it, in float64."""
        return Msm(self.rest, self.clusters, self.held, basis=self.basis, precision="float64", device="cpu")

    @property
    def shown(self) -> IntArray:
        """(rows, columns) particles that are looked at: all in the plane, one layer in space."""
        every = np.arange(len(self.rest)).reshape(self.shape)
        return every if every.ndim == 2 else every[:, self.layer]

    def seen(self, position: FloatArray) -> FloatArray:
        """(..., rows, columns, 2) where they are, from the side [m]. position: (..., K, d)"""
        return np.asarray(position[..., self.shown, :][..., [0, -1]])

    def size(self, position: FloatArray) -> FloatArray:
        """(...,) area or volume [m^2, m^3] of positions (..., K, d), by the lattice's cells."""
        grid = position.reshape(*position.shape[:-2], *self.shape, -1)
        d = len(self.shape)
        ends = (slice(None, -1), slice(1, None))
        corner = [grid[..., *(ends[bits >> axis & 1] for axis in range(d)), :] for bits in range(2**d)]
        far = corner[-1] - corner[0]
        if d == 2:
            sides = [corner[at] - corner[0] for at in (1, 2)]
            parts = [0.5 * np.linalg.det(np.stack(pair, axis=-1)) for pair in ((sides[0], far), (far, sides[1]))]
        else:
            edges = [[corner[at] - corner[0] for at in pair] for pair in _TETRAHEDRA]
            parts = [np.linalg.det(np.stack([*pair, far], axis=-1)) / 6.0 for pair in edges]
        return np.asarray(sum(parts).sum(axis=tuple(range(-d, 0))))


@dataclass(frozen=True, slots=True)
class StateSweep:
    """Static states of a lattice over one parameter.

    over: which; value: (n,); other: the value of the other one; position: (n, K, d) [m]; converged: (n,)
    moved_m: (n,) mean displacement of the particles that are not held; size: (n,) area or volume, over that at rest
    """

    lattice: PressedLattice
    over: Literal["beta", "theta"]
    value: FloatArray
    other: float
    position: FloatArray
    converged: BoolArray
    moved_m: FloatArray
    size: FloatArray

    def at(self, value: float) -> FloatArray:
        """(K, d) at the swept value nearest to it."""
        return np.asarray(self.position[int(np.abs(self.value - value).argmin())])


def sweep_states(
    lattice: PressedLattice, over: Literal["beta", "theta"], value: FloatArray, other: float
) -> StateSweep:
    """The static state at each value (n,) of a parameter. Raises InputError where one does not exist."""
    beta, theta = (value, other) if over == "beta" else (other, value)
    found = lattice.body().relax(lattice.target, np.broadcast_to(beta, value.shape), theta)
    if found.diverged.any():
        raise InputError(f"a static state at every {over}", f"none at {value[found.diverged][0]:g}", "fewer values")
    free = ~clusters.held_mask(len(lattice.rest), lattice.held)
    position = found.settled
    moved = np.linalg.norm(position - lattice.rest, axis=2)[:, free].mean(axis=1)
    size = lattice.size(position) / lattice.size(lattice.rest)
    return StateSweep(lattice, over, value, other, position, found.converged, moved, size)


@dataclass(frozen=True, slots=True)
class StateSweeps:
    """Several of them, to be looked at together. text: what there is to see, as Markdown"""

    sweeps: tuple[StateSweep, ...]
    text: str
