"""The bodies that are measured: a cube pressed between two plates, and one that is poked."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm.clusters import Clusters, lattice

PRESSED = 0.1
"""Share of its height by which the cube is pressed."""


@dataclass(frozen=True, slots=True)
class BenchBody:
    """A full lattice with some particles held. Lengths are in units of its spacing.

    named: its name in the table; shape: (d,); rest: (K, d); held: (n,) indices; held_position: (n, d)"""

    named: str
    shape: tuple[int, ...]
    rest: FloatArray
    held: IntArray
    held_position: FloatArray

    @property
    def particles(self) -> int:
        return len(self.rest)

    def clusters(self, size: int) -> Clusters:
        """Clusters of all windows with `size` particles along a side."""
        return lattice(self.rest, self.shape, np.arange(self.particles), size)


def counted(particles: int) -> str:
    """`1 000 000 particles`."""
    return f"{particles:,} particles".replace(",", " ")


def cube(side: int) -> BenchBody:
    """side^3 particles; the bottom plate is held, the top plate pressed towards it."""
    shape = (side, side, side)
    rest = np.indices(shape, dtype=np.float64).reshape(3, -1).T
    plate = np.arange(side * side)
    held = np.concatenate([plate, plate + side**3 - side * side])
    position = rest[held]
    position[side * side :, 0] -= PRESSED * (side - 1)
    return BenchBody(f"{counted(side**3)} between plates", shape, rest, held, position)


def poked(side: int) -> BenchBody:
    """A cube of which the middle ninth of the top is held and pressed by the same share.

    The plates hold the whole of both faces, so every column of a cube without volume conservation is pressed alike.
    Conjugate gradients solve it in about as many iterations as there are layers: such static states are too easy."""
    body = cube(side)
    tool = slice(side // 3, max(side - side // 3, side // 3 + 1))
    index = np.arange(body.particles).reshape(body.shape)
    held = np.concatenate([index[0].ravel(), index[-1, tool, tool].ravel()])
    position = body.rest[held]
    position[side * side :, 0] -= PRESSED * (side - 1)
    return BenchBody(f"{counted(side**3)} poked", body.shape, body.rest, held, position)
