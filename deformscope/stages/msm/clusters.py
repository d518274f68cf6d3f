"""Which particles form a cluster (Thesis 4.1.3): lattice windows, nearest neighbours, or lists of indices."""

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
import scipy  # its parts are imported as they are first used

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError

FLAT_MOMENT_RATIO = 1e-4
"""A rest cluster is flat in a direction whose second moment is below this share of its largest (extent below 1 %). A
direction flatter than this does not determine the fit, so that it is left out (pseudo-inverse) instead of amplified."""


class Clusters:
    """Overlapping clusters in compressed rows: cluster c holds `members[offsets[c]:offsets[c + 1]]`.

    members: (M,) int32 particle indices; offsets: (C + 1,) int32; particle_count: K. Every particle is in one at least.
    """

    def __init__(self, rows: Sequence[IntArray], particle_count: int) -> None:
        self.particle_count = particle_count
        self._rows = rows

    @cached_property
    def _packed(self) -> tuple[IntArray, IntArray]:
        """(n,) particles of all clusters, one after the other, and (C + 1,) where each begins."""
        offsets = np.concatenate([[0], np.cumsum([len(row) for row in self._rows])])
        return np.concatenate(self._rows).astype(np.int32), offsets.astype(np.int32)

    @property
    def members(self) -> IntArray:
        """(n,) the particles of all clusters, one cluster after the other."""
        return self._packed[0]

    @property
    def offsets(self) -> IntArray:
        """(C + 1,) where each cluster begins in `members`, and the end."""
        return self._packed[1]

    @property
    def count(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[IntArray]:
        return (self.members[a:b] for a, b in zip(self.offsets[:-1], self.offsets[1:], strict=True))

    def cluster_counts(self) -> IntArray:
        """N_i of Thesis eq. 3.15: how many clusters each particle belongs to, (K,)."""
        return np.bincount(self.members, minlength=self.particle_count)

    def spacing(self, rest: FloatArray) -> float:
        """`spacing` of the particles (K, d)."""
        return spacing(rest)


class LatticeClusters(Clusters):
    """Clusters that are windows of a lattice, stored as such: their index lists are made only on request.

    shape: lattice; cell: (K,) flat index of each particle; window: particles of a cluster along each axis
    corner: (shape) True at the lowest corner of each cluster"""

    def __init__(self, shape: tuple[int, ...], cell: IntArray, window: tuple[int, ...], corner: BoolArray) -> None:
        self.particle_count = len(cell)
        self.shape, self.cell, self.window, self.corner = shape, cell, window, corner

    @cached_property
    def _packed(self) -> tuple[IntArray, IntArray]:
        """(n,) particles of all clusters, one after the other, and (C + 1,) where each begins."""
        rows = _windows(_particle_at(self.shape, self.cell), self.window)
        rows = rows.reshape(-1, int(np.prod(self.window)))[self.corner[_fitting(self.shape, self.window)].reshape(-1)]
        present = rows >= 0
        offsets = np.concatenate([[0], np.cumsum(present.sum(axis=1))])
        return rows[present].astype(np.int32), offsets.astype(np.int32)

    @property
    def count(self) -> int:
        return int(np.count_nonzero(self.corner))

    @cached_property
    def in_order(self) -> bool:
        """Whether the lattice is full, and its cells are the particles one after another."""
        return len(self.cell) == self.corner.size and np.array_equal(self.cell, np.arange(len(self.cell)))

    def cluster_counts(self) -> IntArray:
        """(K,) the number of clusters that each particle is in."""
        padded = np.pad(self.corner, [(w - 1, 0) for w in self.window])
        return _window_sums(padded, self.window).reshape(-1)[self.cell]

    def spacing(self, rest: FloatArray) -> float:
        """`spacing` of the particles (K, d), without a search if they lie along the axes of a full lattice."""
        count, d = rest.shape
        if len(self.shape) != d or not self.in_order:
            return spacing(rest)
        near = []
        for axis, along in enumerate(np.moveaxis(rest.reshape(*self.shape, d), -1, 0)):
            lines = np.moveaxis(along, axis, -1)
            first = lines[(0,) * (d - 1)]
            if not (lines == first).all():
                return spacing(rest)
            step = np.diff(np.sort(first), prepend=-np.inf, append=np.inf)
            near.append(np.sort(np.sqrt(np.minimum(step[1:], step[:-1]) ** 2)))
        values = np.sort(np.concatenate(near))
        at_least = np.prod([len(each) - np.searchsorted(each, values) for each in near], axis=0)  # particles so far off
        middle = [values[np.count_nonzero(at_least >= count - rank) - 1] for rank in ((count - 1) // 2, count // 2)]
        return float(np.mean(middle))


def single(particle_count: int) -> Clusters:
    """One cluster of all particles (Thesis 5.1)."""
    return Clusters([np.arange(particle_count)], particle_count)


def lattice(rest: FloatArray, shape: Sequence[int], cell: IntArray, size: int) -> Clusters:
    """Clusters of all windows of `size` particles per side, stride 1, of a lattice, perhaps with holes (fig. 3.6).

    rest: (K, d) rest positions; shape: lattice, last axis fastest; cell: (K,) flat index of each particle. `size` is
    clipped to the lattice. A window stays if its present particles span as many directions as a full one. A particle in
    no window (thin walls next to holes) has the smallest cluster of nearest neighbours that spans them too."""
    dims = tuple(int(n) for n in shape)
    if size < 2:
        raise InputError("a cluster size of at least 2 particles per side", str(size))
    window = tuple(min(size, n) for n in dims)
    corner = np.zeros(dims, dtype=bool)
    if len(cell) == corner.size:
        corner[_fitting(dims, window)] = True
        return LatticeClusters(dims, np.asarray(cell), window, corner)
    particle_at = _particle_at(dims, cell)
    present = _window_sums(particle_at >= 0, window)
    fits = present == int(np.prod(window))
    directions = min(sum(n > 1 for n in dims), rest.shape[1])
    view = _windows(particle_at, window)
    for place in np.argwhere(~fits & (present > directions)):
        some = view[tuple(place)].reshape(-1)
        fits[tuple(place)] = rank(rest[some[some >= 0]]) >= directions
    corner[_fitting(dims, window)] = fits
    found = LatticeClusters(dims, np.asarray(cell), window, corner)
    alone = np.flatnonzero(found.cluster_counts() == 0)
    if not alone.size:
        return found
    return Clusters(
        [*found, *_adopt(rest, alone, directions)] if found.count else _adopt(rest, alone, directions), len(rest)
    )


def nearest(rest: FloatArray, member_count: int) -> Clusters:
    """One cluster around each of the particles (K, d): itself and its nearest neighbours, `member_count` in all (points
    without a lattice). Equal clusters are stored once."""
    count = min(member_count, len(rest))
    _, index = scipy.spatial.cKDTree(rest).query(rest, k=count)
    rows = np.unique(np.sort(np.asarray(index).reshape(len(rest), count), axis=1), axis=0)
    return Clusters(list(rows), len(rest))


def rank(points: FloatArray) -> int:
    """How many directions a set of points (n, d) spans, by `FLAT_MOMENT_RATIO`."""
    q = points - points.mean(axis=0)
    moments = np.linalg.eigvalsh(q.T @ q)
    return 0 if moments[-1] <= 0.0 else int(np.count_nonzero(moments > FLAT_MOMENT_RATIO * moments[-1]))


def find_lattice(rest: FloatArray, tolerance: float = 0.01) -> tuple[tuple[int, ...], IntArray] | None:
    """The full regular lattice of `rest` (K, d), within `tolerance` of a cell; None if there is none.

    Returns its shape (one entry an axis of space, last fastest) and the flat cell of each particle. An axis along
    which all particles agree has one cell: a flat sheet in space is a lattice too."""
    k, d = rest.shape
    extent = float(np.ptp(rest, axis=0).max())
    if k < 4 or extent <= 0.0:
        return None
    neighbour = spacing(rest)
    shape: list[int] = []
    index = np.zeros((k, d), dtype=np.int64)
    for axis in range(d):
        values = np.sort(rest[:, axis])
        jumps = np.diff(values)
        if values[-1] - values[0] <= 2 * tolerance * neighbour:
            shape.append(1)
            continue
        # planes of the lattice stand apart; within a plane the coordinates differ by at most the tolerance
        plane_gap = 0.5 * jumps.max()
        number = 1 + int(np.count_nonzero(jumps > plane_gap))
        step = (values[-1] - values[0]) / max(number - 1, 1)
        place = (rest[:, axis] - values[0]) / step
        index[:, axis] = np.rint(place)
        if np.abs(place - index[:, axis]).max() > 2 * tolerance:
            return None
        shape.append(number)
    if int(np.prod(shape)) != k or sum(n > 1 for n in shape) < 2:
        return None
    cell = np.asarray(np.ravel_multi_index(tuple(index.T), tuple(shape)))
    if np.unique(cell).size != k:
        return None
    return tuple(shape), cell


def held_mask(particle_count: int, held: IntArray) -> BoolArray:
    """(K,) True where the position is prescribed."""
    mask = np.zeros(particle_count, dtype=bool)
    mask[held] = True
    return mask


def spacing(rest: FloatArray) -> float:
    """Median distance of points (K, d) to the nearest neighbour, which makes everything dimensionless."""
    distance, _ = scipy.spatial.cKDTree(rest).query(rest, k=2)
    return float(np.median(distance[:, 1]))


def _particle_at(shape: tuple[int, ...], cell: IntArray) -> IntArray:
    """The particle in each cell of a lattice, -1 where there is none. cell: (K,) flat index of each particle's"""
    found = np.full(shape, -1, dtype=np.int64)
    found.reshape(-1)[cell] = np.arange(len(cell))
    return found


def _windows(values: IntArray, window: tuple[int, ...]) -> IntArray:
    return np.lib.stride_tricks.sliding_window_view(values, window)


def _fitting(shape: tuple[int, ...], window: tuple[int, ...]) -> tuple[slice, ...]:
    """The cells at which a window that fits into the lattice can have its lowest corner."""
    return tuple(slice(n - w + 1) for n, w in zip(shape, window, strict=True))


def _window_sums(values: IntArray | BoolArray, window: tuple[int, ...]) -> IntArray:
    """Sums of values (any axes) over windows of this size; each axis is shorter by its width less 1."""
    sums = values.astype(np.int32)
    for axis, width in enumerate(window):
        total, before = np.cumsum(sums, axis=axis, dtype=np.int32), (slice(None),) * axis
        sums = total[(*before, slice(width - 1, None))].copy()
        sums[(*before, slice(1, None))] -= total[(*before, slice(None, -width))]
    return sums


def _adopt(rest: FloatArray, alone: IntArray, directions: int) -> list[IntArray]:
    """A cluster (n,) for each particle of (K, d) in none: itself and neighbours enough to span all directions."""
    tree = scipy.spatial.cKDTree(rest)
    adopted = []
    for particle in alone:
        row = np.array([particle])
        for count in range(directions + 1, len(rest) + 1):
            row = np.atleast_1d(tree.query(rest[particle], k=count)[1])
            if rank(rest[row]) >= directions:
                break
        adopted.append(np.sort(row))
    return adopted
