"""A preconditioner for the linear equations of lattice bodies: geometric multigrid, in float32.

A coarse level is a lattice body of its own, with clusters on about half the particles along each axis. Its operator
costs as little as that of the body, for any width of the clusters, and no matrix is assembled. Without conservation a
body's energy is E_A + (1 - beta) (E_R - E_A): the residual of the best affine map, and the part of the affine map that
no rotation fits. The first grows with second derivatives of the displacement, the second with strain, so clusters that
reach twice as far weigh them differently. A coarse level has the factors that preserve both energies of smooth
displacements: it is a multiple of an operator of another beta, which may be below 0. Conserved volume is strain, too.

A cycle is symmetric: Chebyshev's iteration before and after the coarse correction, whose interpolation (linear) and
restriction are transposed. Neither held particles nor coarse ones next to them move. All levels are linearised at the
state of the fine one. Any positive definite preconditioner gives the same solution: simplifications cost only
iterations."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeGuard

import numpy as np
import warp as wp
from scipy.sparse import block_diag, csr_array
from scipy.spatial import cKDTree

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm import multigrid_kernels
from deformscope.stages.msm.body import Body, BodyRest, Parameters
from deformscope.stages.msm.clusters import FLAT_MOMENT_RATIO, LatticeClusters
from deformscope.stages.msm.lattice import FILL, RESIDENT_CELLS, LatticeBody
from deformscope.stages.msm.layout import Field, Layout, upload
from deformscope.stages.msm.newton_functions import sum_functions_for

Launch: TypeAlias = Callable[[], None]

LEAST = RESIDENT_CELLS
"""Cells of the smallest body that is preconditioned: below, plain conjugate gradients are as quick."""

NARROWEST, FEWEST = 5, 150
"""Cells along an axis, and in all, below which a level is not coarsened further."""

STIFFER = 1.25
"""Factor on a coarse level's energies: too small corrections cost fewer iterations than too large ones."""

DEGREE, RANGE = 2, 5.0
"""Chebyshev's iteration: its steps, and the ratio of the largest to the smallest eigenvalue that it damps."""

LONGEST = 24
"""Cells along an axis of the coarsest level, whose equations take as many steps, at most."""

PATIENCE = 150
"""Number of directions of one solve after which it continues without the preconditioner."""


@dataclass(frozen=True, slots=True)
class CoarseRest:
    """A lattice, and how it interpolates to the next finer one.

    present, held: (n0, n1, n2); mass: the same, over the mean mass of the body; corner: the same, where clusters are
    window: (3,); edges: (3, d) vectors from a cell to the next along each axis [spacings]; affine, strain: factors of
    the two energies; weights: (n, n0), (m, n1), (l, n2) interpolation from its planes to the finer ones, along each
    axis; spread: (n0, n1, n2) sum of the weights with which finer particles interpolate from each cell"""

    present: BoolArray
    held: BoolArray
    mass: FloatArray
    corner: BoolArray
    window: tuple[int, ...]
    edges: FloatArray
    affine: float
    strain: float
    weights: list[Any]
    spread: FloatArray

    def body(self, scalar: Any, device: str) -> LatticeBody:
        """The lattice body, without particles outside all clusters."""
        d = self.edges.shape[1]
        everything = np.flatnonzero(self.present)
        counts = LatticeClusters(self.corner.shape, everything, self.window, self.corner).cluster_counts()
        cell, counts = everything[counts > 0], counts[counts > 0]
        position = np.column_stack(np.unravel_index(cell, self.corner.shape)) @ self.edges
        mass, free = self.mass.reshape(-1)[cell], ~self.held.reshape(-1)[cell]
        rest = BodyRest(position.reshape(-1, d), mass, free, counts, np.where(free, counts * mass, 0.0))
        clusters = LatticeClusters(self.corner.shape, cell, self.window, self.corner)
        return LatticeBody(rest, clusters, self.edges, scalar, device)


def coarser(fine: CoarseRest) -> CoarseRest | None:
    """The next level, None without one."""
    shape = fine.present.shape
    if any(1 < n < NARROWEST for n in shape) or fine.present.size <= FEWEST:
        return None
    counts = [(n + 1) // 2 for n in shape]
    ratio = np.array([(n - 1) / max(c - 1, 1) if n > 1 else 1.0 for n, c in zip(shape, counts, strict=True)])
    place = [np.arange(n) / each for n, each in zip(shape, ratio, strict=True)]
    weights, exact = (
        [_interpolation(p, c, dtype) for p, c in zip(place, counts, strict=True)] for dtype in (np.float32, np.float64)
    )
    near = np.ix_(*(np.rint(p).astype(int) for p in place))
    cell = np.ravel_multi_index(np.broadcast_arrays(*near), counts).reshape(-1)

    def total(values: FloatArray | BoolArray) -> FloatArray:
        """(n0, n1, n2) sums over the fine cells that are nearest to each coarse one."""
        return np.bincount(cell, values.reshape(-1).astype(float), minlength=int(np.prod(counts))).reshape(counts)

    many = total(fine.present)
    present, held = many > 0, total(fine.held) > 0
    mass = np.divide(total(fine.mass), many, out=np.zeros_like(many), where=present)
    window = tuple(min(w if w <= 3 else w // 2 + 1, c) for w, c in zip(fine.window, counts, strict=True))
    edges = fine.edges * ratio[:, None]
    axis = int(np.argmax(shape))
    affine, strain = _energies(fine.window, axis)
    affine_here, strain_here = _energies(window, axis)
    corner = _corners(mass, window, edges)
    volume, far = STIFFER * float(fine.corner.sum()) / max(float(corner.sum()), 1.0), float(ratio[axis])
    return CoarseRest(
        present=present,
        held=held,
        mass=mass,
        corner=corner,
        window=window,
        edges=edges,
        affine=fine.affine * affine * volume / (far**4 * affine_here),
        strain=fine.strain * strain * volume / (far**2 * strain_here),
        weights=weights,
        spread=np.einsum("abc,ai,bj,ck->ijk", fine.present, *(each.toarray() for each in exact), optimize=True),
    )


def _interpolation(place: FloatArray, count: int, dtype: type[Any]) -> Any:
    """(n, count) linear interpolation from planes to between them: to places (n,) from 0 to count - 1."""
    before = np.clip(place.astype(int), 0, max(count - 2, 0))
    ahead = (place - before).astype(dtype)
    planes = np.minimum(np.stack([before, before + 1], axis=1), count - 1)
    both = np.stack([1 - ahead, ahead], axis=1)
    return csr_array((both.ravel(), planes.ravel(), 2 * np.arange(len(place) + 1)), shape=(len(place), count))


def levels_of(body: LatticeBody, rest: BodyRest) -> list[tuple[CoarseRest, LatticeBody]]:
    """The body itself and its coarser levels, as bodies in float32."""

    def at_cells(values: Any) -> Any:
        return body.at_cells(values, np.asarray(values).dtype).reshape(body.shape)

    level: CoarseRest | None = CoarseRest(
        present=at_cells(np.ones(len(body.cell), dtype=bool)),
        held=at_cells(~rest.free),
        mass=at_cells(rest.mass / rest.mass.mean()),
        corner=body.corner,
        window=body.window,
        edges=body.edges,
        affine=1.0,
        strain=1.0,
        weights=[],
        spread=np.ones(body.shape),
    )
    found = []
    while level is not None:
        found.append((level, level.body(wp.float32, body.device)))
        level = coarser(level)
    return found


def _energies(window: tuple[int, ...], axis: int) -> tuple[float, float]:
    """Energies of a cluster for a displacement quadratic in space, and for a strain; over the same factors for all."""
    w = window[axis]
    second, fourth = (w * w - 1) / 12, (w * w - 1) * (3 * w * w - 7) / 240
    return float(np.prod(window)) * (fourth + second**2), float(np.prod(window)) * second


def _corners(mass: FloatArray, window: tuple[int, ...], edges: FloatArray) -> BoolArray:
    """Where the particles of a window span as many directions as there are; masses (n0, n1, n2)."""
    corner = np.zeros(mass.shape, dtype=bool)
    corner[tuple(slice(n - w + 1) for n, w in zip(mass.shape, window, strict=True))] = True
    if (mass > 0).all():
        return corner
    cell = np.flatnonzero(mass)
    one = np.ones(len(cell))
    rest = BodyRest(np.zeros((len(cell), edges.shape[1])), mass.reshape(-1)[cell], one > 0, one.astype(int), one)
    body = LatticeBody(rest, LatticeClusters(mass.shape, cell, window, corner), edges, wp.float64, "cpu")
    values = np.linalg.eigvalsh(body.moments()[2])
    spanned = np.count_nonzero(values > FLAT_MOMENT_RATIO * np.maximum(values[:, -1:], 1e-300), axis=1)
    return np.asarray(
        corner & (spanned >= min(np.count_nonzero(np.array(mass.shape) > 1), edges.shape[1])).reshape(mass.shape)
    )


class _Level:
    """A lattice body in float32, its fields for the candidates, and its parameters."""

    def __init__(self, rest: CoarseRest, body: LatticeBody, size: int, volume: int) -> None:
        self.rest, self.body, self.volume = rest, body, volume
        self.layout: Layout = body.layout(size, filled=volume != 0)
        self.operator = body.operator(self.layout)
        self.kept = self.operator.kept(volume)
        d, layout = body.dim, self.layout
        self.right, self.z, self.left, self.direction, self.changed = (layout.field(d) for _ in range(5))
        self.u = self.direction  # its value is needed only while no cycle runs
        self.ratio = rest.strain / rest.affine
        zero = np.zeros(size)
        self.shrink = layout.each(zero)
        self.parameters = Parameters(layout.each(zero), layout.each(zero), 0, volume)
        self.place = _cells(layout, body)
        span = sum_functions_for(d, wp.float32, layout.width).Span()
        span.abreast, span.blocks = layout.abreast, layout.blocks
        span.front, span.group, span.stride = layout.front, layout.group, layout.stride
        self.span = span
        self.smooth = multigrid_kernels.smoother_for(d, layout.width)
        self.every_group = wp.full(layout.groups, 1, dtype=int, device=layout.device)

    def set(self, beta: FloatArray, theta: FloatArray) -> bool:
        """Whether other arrays than before hold the parameters. beta: (B,) or (B, C) of this level's clusters"""
        own, mean = 1.0 - self.ratio * (1.0 - beta), beta.reshape(len(beta), -1).mean(axis=1)
        theta_own = theta
        if self.volume:
            own_mean = 1.0 - self.ratio * (1.0 - mean)
            theta_own = self.ratio * mean * theta / np.where(np.abs(own_mean) < 1e-3, 1e-3, own_mean)
        strain = (1.0 - beta + (beta.T * theta).T).reshape(len(beta), -1)
        self.layout.refill(self.shrink, 1.0 / np.maximum(1.0, self.ratio * strain.max(axis=1)))
        self.layout.refill(self.parameters.theta, theta_own)
        stride = self.operator.beta_stride if beta.ndim > 1 else 0
        if stride == self.parameters.beta_stride == 0:
            self.layout.refill(self.parameters.beta, own)
            return False
        values = self.operator.cluster_values(own) if stride else self.layout.each(own)
        if stride == self.parameters.beta_stride:
            self.parameters.beta.assign(values)
            return False
        self.parameters = Parameters(values, self.parameters.theta, stride, self.volume)
        return True


def _cells(layout: Layout, body: LatticeBody) -> Any:
    cells = multigrid_kernels.Cells()
    cells.front, cells.group, cells.stride, cells.abreast = layout.front, layout.group, layout.stride, layout.abreast
    cells.cells_0, cells.cells_1, cells.cells_2 = body.shape
    return cells


class Multigrid:
    """The preconditioner of a lattice body for one method's candidates."""

    def __init__(self, body: LatticeBody, rest: BodyRest, layout: Layout, size: int, volume: int) -> None:
        self.layout = layout
        self.kernels = multigrid_kernels.transfer_kernels_for(body.dim, body.scalar)
        body.coarse = body.coarse or levels_of(body, rest)
        self.levels = [_Level(level, each, size, volume) for level, each in body.coarse]
        self._between = [self._transfers(*pair) for pair in zip(self.levels, self.levels[1:], strict=False)]
        self.z = layout.field(body.dim)
        self.outside = _cells(layout, body)
        self.along = layout.each(np.zeros(size), wp.float64)
        self.plain, self.applied = (layout.each(np.zeros(size), int) for _ in range(2))
        self.longest = max(body.shape)
        self._steps = max(self.levels[-1].body.shape)
        self._same_groups = self.levels[0].layout.groups == layout.groups

    @staticmethod
    def worth(body: Body, rest: BodyRest) -> TypeGuard[LatticeBody]:
        """Whether a body is large enough, wide enough for coarsening to a small size, and held in every piece: a piece
        that nothing holds does not move. In float64: the last digits of float32 hide the forces of slow modes. No
        particle
        slips: coarse ones are held along every axis."""
        if not isinstance(body, LatticeBody) or len(body.cell) <= LEAST or body.scalar is not wp.float64:
            return False
        if rest.held_axis >= 0:
            return False
        shape = np.array(body.shape)
        while min(shape[shape > 1], default=0) >= NARROWEST and np.prod(shape) > FEWEST:
            shape = (shape + 1) // 2
        if tuple(shape) == tuple(body.shape) or shape.max() > LONGEST:
            return False
        from scipy.ndimage import label  # slow to import

        pieces, count = label(body.at_cells(np.ones(len(body.cell)), float).reshape(body.shape), np.ones((3, 3, 3)))
        return bool(len(np.unique(pieces.reshape(-1)[body.cell[~rest.free]])) == count)

    def _transfers(self, fine: _Level, coarse: _Level) -> tuple[Launch, Launch, Launch]:
        """Between two levels: the residual for the coarse one, its correction back, and displacements to it."""
        device, rest = self.layout.device, coarse.rest
        to_fine = block_diag(rest.weights, format="csr")
        to_fine.eliminate_zeros()

        def launch(weights: Any, source: _Level, target: _Level, fields: tuple[Any, ...], out: Field) -> Launch:
            """fields: two that are added, and the weights of the cells of source and target"""
            transfer = multigrid_kernels.Transfer()
            transfer.begin, transfer.plane = upload(weights.indptr, int, device), upload(weights.indices, int, device)
            transfer.weight = upload(weights.data, wp.float32, device)
            given: list[Any] = [
                each if isinstance(each, wp.array) else upload(each, wp.float32, device) for each in fields
            ]
            abreast, dim = target.layout.abreast, target.body.dim
            if wp.get_device(device).is_cpu:
                cells = source.body.count, target.body.count
                own = [np.repeat(w.numpy().reshape(-1)[:n], abreast) for w, n in zip(given[2:], cells, strict=True)]
                weighted = [*given[:2], *(upload(w, wp.float32, device) for w in own)]
                work = wp.empty((source.place.cells_1 + 1) * source.place.cells_2 * abreast, wp.float32, device=device)
                planes = (target.layout.groups, dim, target.place.cells_0)
                inputs = [transfer, source.place, target.place, *weighted, work]
                return functools.partial(wp.launch, self.kernels.gather_planes, planes, inputs, [out], device=device)
            inputs, each_cell = [transfer, source.place, target.place, *given], target.body.count
            candidates = target.layout.groups * abreast
            rows_each = dim if candidates * each_cell >= FILL else 1  # a small lattice has threads to spare
            kernel = multigrid_kernels.gather_kernel_for(rows_each, int(np.diff(weights.indptr).max()))
            threads = (candidates, dim // rows_each, each_cell)
            return functools.partial(wp.launch, kernel, threads, inputs, [out], device=device)

        metric = coarse.operator.metric.numpy()[: coarse.body.count].astype(np.float64)
        by_metric = np.divide(fine.rest.affine / rest.affine, metric, out=np.zeros_like(metric), where=metric > 0)
        half_mean = np.divide(0.5, rest.spread, out=np.zeros_like(rest.spread), where=rest.spread > 1e-6)
        half_free, ones = 0.5 * fine.operator.arrays.free.numpy(), np.ones(coarse.body.count)
        left = (fine.left, fine.changed, fine.operator.metric, by_metric)
        to_coarse = to_fine.T.tocsr()
        return (
            launch(to_coarse, fine, coarse, left, coarse.right),
            launch(to_fine, coarse, fine, (coarse.z, coarse.z, ones, half_free), fine.direction),
            launch(to_coarse, fine, coarse, (fine.u, fine.u, fine.rest.present, half_mean), coarse.u),
        )

    def set(self, beta: FloatArray, theta: FloatArray) -> bool:
        """Parameters of candidates, beta (B,) or (B, C), theta (B,); whether graphs must be captured again."""
        near = self._nearest if beta.ndim > 1 else [None] * len(self.levels)
        each = [beta if some is None else beta[:, some] for some in near]
        changed = [level.set(own, theta) for level, own in zip(self.levels, each, strict=True)]
        return any(changed)

    @functools.cached_property
    def _nearest(self) -> list[IntArray]:
        """(C,) of each level: the body's cluster that is nearest to each of its own."""
        middle = []
        for level in self.levels:
            body = level.body
            corner = np.column_stack(np.unravel_index(body.clusters_at, body.shape))
            middle.append((corner + (np.array(body.window) - 1) / 2) @ body.edges)
        tree = cKDTree(middle[0])
        return [np.asarray(tree.query(each)[1]) for each in middle]

    def reset(self) -> None:
        """Every candidate is preconditioned, and none was."""
        for each in (self.plain, self.applied, self.along):
            each.zero_()

    @property
    def given_up(self) -> bool:
        """Whether all candidates go without."""
        return bool(self.plain.numpy()[: self.layout.candidates].all())

    def used(self, linearised: Field, predicted: BoolArray) -> tuple[IntArray, BoolArray]:
        """(B,) evaluations in the finest level, and which candidates left it. linearised: how often each was;
        predicted: (B,) once more"""
        size = self.layout.candidates
        evaluations = linearised.numpy()[:size] + predicted + 2 * DEGREE * self.applied.numpy()[:size]
        return evaluations, self.plain.numpy()[:size] != 0

    def linearise(self, u: Field, running: Field) -> None:
        """Linearises every level where the body is: its displacements, as those of the coarse particles."""
        levels = self.levels
        self._convert(self.kernels.put_in, u, levels[0].u)
        for index, level in enumerate(levels):
            flags = self._flags(level, running)
            level.operator.residual(level.u, level.changed, level.parameters, flags, level.kept)
            if index + 1 < len(levels):
                _restrict, _correct, displace = self._between[index]
                displace()

    def cycle(self, rho: Field, running: Field) -> None:
        """`z` of a residual."""
        self._convert(self.kernels.put_in, rho, self.levels[0].right)
        self._visit(0, running)
        self._convert(self.kernels.take_out, self.levels[0].z, self.z)

    def _visit(self, index: int, running: Field) -> None:
        level = self.levels[index]
        if index + 1 == len(self.levels):
            self._smooth(level, running, self._steps, 0.75 * self._steps**2, begins=True)
            return
        restrict, correct, _displace = self._between[index]
        self._smooth(level, running, DEGREE, RANGE, begins=True)
        self._change(level, running)
        restrict()
        self._visit(index + 1, running)
        correct()
        self._step(level, running, 1.0, 0.0)  # along what came back
        self._smooth(level, running, DEGREE, RANGE, begins=False)

    def _smooth(self, level: _Level, running: Field, steps: int, ratio: float, *, begins: bool) -> None:
        """Chebyshev's iteration on eigenvalues from 1 / ratio of the largest to it (Saad 2003, algorithm 12.1)."""
        half, middle = (1.0 - 1.0 / ratio) / 2.0, (1.0 + 1.0 / ratio) / 2.0
        rho, keep, gain = half / middle, 0.0, 1.0 / middle
        for step in range(steps):
            if begins and step == 0:
                self._step(level, running, keep, gain, begins=True)
            else:
                self._change_and_step(level, running, keep, gain)
            after = 1.0 / (2.0 * middle / half - rho)
            keep, gain, rho = after * rho, 2.0 * after / half, after

    def _step(self, level: _Level, running: Field, keep: float, gain: float, *, begins: bool = False) -> None:
        """Continues along `keep` of the last direction and `gain` of the residual."""
        inputs = [level.span, self._flags(level, running), int(begins), keep, gain, level.shrink, level.right]
        inputs += [level.changed, level.z, level.left, level.direction]
        dim = (level.layout.groups, level.layout.blocks)
        wp.launch(level.smooth, dim, inputs, device=level.layout.device)

    def _change_and_step(self, level: _Level, running: Field, keep: float, gain: float) -> None:
        if level.operator.looks_ahead:
            smoother = keep, gain, level.shrink, level.z, level.left
            flags = self._flags(level, running)
            level.operator.change_and_smooth(level.direction, level.parameters, flags, level.kept, smoother)
            return
        self._change(level, running)
        self._step(level, running, keep, gain)

    def _change(self, level: _Level, running: Field) -> None:
        level.operator.change(level.direction, level.changed, level.parameters, self._flags(level, running), level.kept)

    def _flags(self, level: _Level, running: Field) -> Field:
        """Which groups run, where the levels group the candidates as the body does."""
        return running if self._same_groups else level.every_group

    def _convert(self, kernel: wp.Kernel, values: Field, out: Field) -> None:
        """Between the body's fields and those of the first level."""
        own = self.levels[0]
        places = [self.outside, own.place] if kernel is self.kernels.put_in else [own.place, self.outside]
        dim = (self.layout.groups * self.layout.abreast, own.body.count)
        wp.launch(kernel, dim=dim, inputs=[*places, values], outputs=[out], device=self.layout.device)
