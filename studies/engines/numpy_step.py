"""The step that the engine is compared with: NumPy, float64, vectorised over all clusters, rotations by batched SVD.

It takes a step to the goals (eq. 3.15) of a full lattice of unit masses with a linear basis and theta = 0, in fast
plain NumPy. Sums over windows go axis by axis, so that a window of w particles per side costs about 3 w additions per
channel instead of w^3. One `np.linalg.svd` call turns all clusters."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class NumpyLattice:
    """A full lattice in clusters of all its windows, ready to be stepped. Lengths are in units of the spacing.

    rest: (d, *shape); size: particles along a cluster's side; held: (*shape,) particles whose position is prescribed;
    count: (*shape,) number of clusters to which each particle belongs"""

    rest: FloatArray
    size: int
    held: BoolArray
    count: FloatArray

    @classmethod
    def build(cls, size: int, held: BoolArray) -> "NumpyLattice":
        """At rest, one unit apart. size: size of a cluster, in particles; held: (rows, columns[, layers]) mask"""
        rest = np.indices(held.shape, dtype=np.float64)
        windows: FloatArray = np.ones([n - size + 1 for n in held.shape])
        for axis in range(held.ndim):
            windows = _spread(windows, np.ones(size), axis)
        return cls(rest, size, held, windows)

    def step(
        self, x: FloatArray, v: FloatArray, held_position: FloatArray, beta: float, alpha: float = 1.0, dt: float = 2e-3
    ) -> tuple[FloatArray, FloatArray]:
        """One time step (Algorithm 1 with eq. 3.11). x, v: (d, *shape); held_position: (d, n)."""
        x_star = x + v * dt
        x_star[:, self.held] = held_position
        goal = self._goals(x_star, beta)
        goal[:, self.held] = held_position
        x_new = x_star + alpha * (goal - x_star)
        return x_new, (x_new - x) / dt

    def _goals(self, x: FloatArray, beta: float) -> FloatArray:
        """Mean goal of each particle over its clusters (eq. 3.15)."""
        d, ones = len(x), np.ones(self.size)
        offset = np.arange(self.size) - (self.size - 1) / 2
        total: FloatArray = x - self.rest  # becomes its sums over windows
        moments: list[FloatArray] = []  # sums of u q_j
        for axis in range(d):
            moments = [*(_gather(m, ones, axis + 1) for m in moments), _gather(total, offset, axis + 1)]
            total = _gather(total, ones, axis + 1)
        mean = total / self.size**d
        spread = float(offset @ offset) * self.size ** (d - 1)  # sum of q_j^2 over a window: A_qq is this times I
        change = np.stack(moments, axis=1).reshape(d, d, -1).transpose(2, 0, 1) / spread  # A - I (eq. 3.7)
        left, _, right = np.linalg.svd(change + np.eye(d))
        left[:, :, -1] *= np.linalg.det(left @ right)[:, None]  # a rotation, never a reflection (eq. 3.9)
        blend = beta * change + (1.0 - beta) * (left @ right - np.eye(d))  # eq. 3.13, less I
        columns = list(np.moveaxis(blend, 0, -1).reshape(d, d, *mean.shape[1:]).swapaxes(0, 1))
        for axis in range(d):  # back to the particles: sum over windows of mean + blend q
            mean = _spread(mean, ones, axis + 1) + _spread(columns[axis], offset, axis + 1)
            columns[axis + 1 :] = [_spread(column, ones, axis + 1) for column in columns[axis + 1 :]]
        goal: FloatArray = self.rest + mean / self.count
        return goal


def _gather(particles: FloatArray, weight: FloatArray, axis: int) -> FloatArray:
    """Weighted sums over windows along one axis, which becomes shorter."""
    length = particles.shape[axis] - len(weight) + 1
    windows: FloatArray = weight[0] * _part(particles, axis, 0, length)
    for i in map(int, np.flatnonzero(weight[1:]) + 1):
        part = _part(particles, axis, i, length)
        windows += part if weight[i] == 1 else weight[i] * part
    return windows


def _spread(windows: FloatArray, weight: FloatArray, axis: int) -> FloatArray:
    """The transpose of `_gather`: each window adds to its particles."""
    length = windows.shape[axis]
    shape = list(windows.shape)
    shape[axis] = length + len(weight) - 1
    particles = np.zeros(shape)
    for i in map(int, np.flatnonzero(weight)):
        part = _part(particles, axis, i, length)
        part += windows if weight[i] == 1 else weight[i] * windows
    return particles


def _part(a: FloatArray, axis: int, first: int, length: int) -> FloatArray:
    return a[(slice(None),) * axis + (slice(first, first + length),)]
