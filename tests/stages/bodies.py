"""Bodies that tests deform: lattices, what is held, and how it is moved."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import clusters
from deformscope.stages.msm.clusters import Clusters

SPACING_M = 0.01


def lattice(shape: Sequence[int], spacing: float = SPACING_M) -> FloatArray:
    """(K, d) points of a regular lattice, last axis fastest."""
    axes = [np.arange(n) * spacing for n in shape]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(shape))


@dataclass(frozen=True)
class Pushed:
    """A lattice whose first layer stands still while some particles of its last layer are moved."""

    rest: FloatArray
    shape: tuple[int, ...]
    held: IntArray
    held_position: FloatArray

    def clusters(self, size: int) -> Clusters:
        return clusters.lattice(self.rest, self.shape, np.arange(len(self.rest)), size)


def pushed(shape: Sequence[int], rng: np.random.Generator, push: float = 1.0) -> Pushed:
    """One to three particles of the far side moved by about `push` spacings in a random direction."""
    rest = lattice(shape)
    near = np.flatnonzero(rest[:, 0] <= 0.0)
    far = np.flatnonzero(rest[:, 0] >= rest[:, 0].max() - 1e-9)
    held = np.concatenate([near, rng.choice(far, int(rng.integers(1, 4)), replace=False)])
    position = rest[held].copy()
    position[len(near) :] += rng.normal(0.0, push * SPACING_M, rest.shape[1])
    return Pushed(rest, tuple(int(n) for n in shape), held, position)
