"""Lattice clusters on a device: their rest data, and the launches that make goals of displacements."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.msm import lattice_kernels as k
from deformscope.stages.msm.body import Body, BodyRest, Operator, Parameters, RestArrays, rest_struct
from deformscope.stages.msm.cluster_functions import GOAL, cluster_functions_for
from deformscope.stages.msm.clusters import FLAT_MOMENT_RATIO, LatticeClusters
from deformscope.stages.msm.layout import Field, Layout, upload, widths
from deformscope.stages.msm.resident_kernels import THREADS, resident_kernels_for

REGULAR = 1e-6
"""Spacings by which a particle may stand beside its place in an even lattice to be taken as standing on it."""

SLIDE = {"cpu": (3, 32), "cuda": (4, 8)}
"""Widest window that is summed up anew at each cell, and the run of a sum that slides over wider ones."""

RESIDENT_CELLS = 8192
"""Cells up to which one block of a GPU's threads goes through a whole body by itself."""

FIELDS = ("mass", "free", "pull", "sums_fast", "sums_middle", "maps", "maps_slow", "maps_middle")


def lattice_edges(rest: FloatArray, clusters: LatticeClusters) -> FloatArray | None:
    """(axes, d) from one cell to the next along each axis, if the rest shape (K, d) is an even lattice, else None."""
    index = np.column_stack(np.unravel_index(clusters.cell, clusters.shape)).astype(np.float64)
    used = [axis for axis, count in enumerate(clusters.shape) if count > 1]
    centred = index[:, used] - index[:, used].mean(axis=0)
    edges = np.zeros((len(clusters.shape), rest.shape[1]))
    edges[used] = np.linalg.lstsq(centred, rest - rest.mean(axis=0), rcond=None)[0]
    off = centred @ edges[used] - (rest - rest.mean(axis=0))
    return edges if np.abs(off).max(initial=0.0) <= REGULAR else None


class LatticeBody(Body):
    """A body whose clusters are windows of an even lattice; linear basis."""

    terms: int

    def __init__(
        self, rest: BodyRest, clusters: LatticeClusters, edges: FloatArray, scalar: type[Any], device: str
    ) -> None:
        d = self.terms = rest.position.shape[1]
        super().__init__(d, scalar, device)
        shape = (*(1,) * (3 - len(clusters.shape)), *clusters.shape)
        window = (*(1,) * (3 - len(clusters.window)), *clusters.window)
        if d == 2 and shape[0] > 1:
            raise ValueError(f"expected a lattice of two axes in the plane; got {clusters.shape}")
        self.shape, self.window = shape, window
        self.cell = clusters.cell
        self.corner = clusters.corner.reshape(shape)
        self.edges = np.zeros((3, d))
        self.edges[3 - len(edges) :] = edges
        mass = np.zeros(int(np.prod(shape)))
        mass[self.cell] = rest.mass
        self.mass = mass.reshape(shape)
        self.count = int(np.prod(shape))
        counts = np.zeros(self.count)
        counts[self.cell] = rest.counts
        free = np.zeros(self.count)
        free[self.cell] = rest.free
        self.pull = np.divide(free, counts, out=np.zeros_like(free), where=counts > 0)
        self.free = free
        self.metric = np.zeros(self.count)
        self.metric[self.cell] = rest.metric
        self.alike = bool((self.mass == self.mass.flat[0]).all())

    @property
    def clusters_at(self) -> IntArray:
        """Flat cell of each cluster, (C,)."""
        return np.flatnonzero(self.corner.reshape(-1))

    def layout(self, candidates: int) -> Layout:
        width, abreast = widths(candidates, self.scalar, self.device, cells_in_lanes=True)
        cells = self.count * abreast
        line, plane = self.shape[2] * abreast, self.shape[1] * self.shape[2] * abreast
        group = -(-cells // width) * width
        w = self.window
        front = (w[0] - 1) * plane + (w[1] - 1) * line + (w[2] - 1) * abreast
        front = -(-front // 16) * 16
        groups = -(-candidates // abreast)
        stride = front + groups * group + w[2] * abreast + 2 * width
        stride = -(-stride // 16) * 16
        return Layout(candidates, width, abreast, self.count, front, group, stride, self.cell, self.scalar, self.device)

    def operator(self, layout: Layout) -> LatticeOperator:
        return LatticeOperator(self, layout, self.arrays(layout.width))

    def _make_arrays(self, width: int) -> _LatticeArrays:
        return _LatticeArrays(self, width)

    def moments(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mass (n,), mean offset [cells] (n, 3) and second moments about it [spacings^2] (n, d, d) of the windows.

        One row stands for all where they are alike, else there is one for each cell (0 where no cluster is).
        """
        offset = [np.arange(w) - (w - 1) / 2 for w in self.window]
        if self.alike:
            grid = np.stack(np.meshgrid(*offset, indexing="ij"), axis=-1).reshape(1, -1, 3)
            mass = np.full(grid.shape[:2], self.mass.flat[0])
            total = mass.sum(axis=1)
            mean = np.zeros((1, 3))
            second = np.einsum("nk,nka,nkb->nab", mass, grid, grid)
        else:
            places = tuple(slice(n - w + 1) for n, w in zip(self.shape, self.window, strict=True))
            total = np.zeros(self.shape)
            first = np.zeros((*self.shape, 3))
            second = np.zeros((*self.shape, 3, 3))
            for step in np.ndindex(*self.window):
                away = np.array([offset[axis][i] for axis, i in enumerate(step)])
                part = self.mass[tuple(slice(i, i + s.stop) for i, s in zip(step, places, strict=True))]
                total[places] += part
                first[places] += part[..., None] * away
                second[places] += part[..., None, None] * np.outer(away, away)
            chosen = self.corner
            total = np.where(chosen, total, 0.0).reshape(-1)
            mean = np.divide(
                first.reshape(-1, 3), total[:, None], out=np.zeros((self.count, 3)), where=total[:, None] > 0
            )
            second = second.reshape(-1, 3, 3) - total[:, None, None] * mean[:, :, None] * mean[:, None, :]
            second[total == 0] = 0.0
        return total, mean, np.einsum("ai,nab,bj->nij", self.edges, second, self.edges)


def _window_sums(values: FloatArray, window: tuple[int, ...], moment: int | None) -> FloatArray:
    """(B, cells, d) sums over windows from each cell on, 0 where none fits; weighted with the offset along an axis."""
    for axis, width in enumerate(window):
        weight = np.arange(width) - (width - 1) / 2 if axis == moment else np.ones(width)
        views = np.lib.stride_tricks.sliding_window_view(values, width, axis=axis + 1)
        total = views @ weight
        pad = [(0, 0)] * values.ndim
        pad[axis + 1] = (0, width - 1)
        values = np.pad(total, pad)
    return values


class _LatticeArrays:
    """Rest data on the device, for lanes of one width."""

    def __init__(self, body: LatticeBody, width: int) -> None:
        d, scalar, device = body.dim, body.scalar, body.device
        limit, _ = SLIDE["cpu" if device.startswith("cpu") else "cuda"]
        wide = set(body.window[3 - d :])
        window = 0 if device.startswith("cpu") or len(wide) > 1 or max(wide) > limit else max(wide)
        self.kernels = k.lattice_kernels_for(d, scalar, width, window) if width == 1 else None
        self.functions = k.lattice_functions_for(d, scalar, width, window)
        self.window = self.functions.both
        self.resident = resident_kernels_for(d, scalar, width, window)
        functions = cluster_functions_for(d, d, scalar, width)
        total, mean, gram = body.moments()
        n = len(total)
        axes = d  # along which the passes take moments
        edges = body.edges[3 - axes :]
        values, vectors = np.linalg.eigh(gram)
        determined = values > FLAT_MOMENT_RATIO * np.maximum(values[:, -1:], np.finfo(float).tiny)
        inverse = np.where(determined, 1.0 / np.where(determined, values, 1.0), 0.0)
        pinv = np.einsum("nik,nk,njk->nij", vectors, inverse, vectors)
        size = values.sum(axis=1)
        size[size <= 0.0] = 1.0  # no cluster there
        span_count = determined.sum(axis=1)
        packed = np.argsort(~determined, axis=1, kind="stable")  # spanned directions first
        ordered = np.take_along_axis(vectors, packed[:, None, :], axis=2)
        order_determined = np.take_along_axis(determined, packed, axis=1)
        span = ordered * order_determined[:, None, :]
        spread = np.where(order_determined, np.sqrt(np.take_along_axis(np.maximum(values, 0), packed, axis=1)), 1.0)
        mean_log = np.log(spread).sum(axis=1) / np.maximum(span_count, 1)
        stretch = np.where(order_determined, spread / np.exp(mean_log)[:, None], 0.0)
        unstretch = np.divide(1.0, stretch, out=np.zeros_like(stretch), where=stretch > 0)
        root, lift = span * stretch[:, None, :], np.einsum("nk,nik->nki", unstretch, span)
        full = span_count == d  # a full root must not be a reflection
        root[full] = np.einsum("nik,njk->nij", root[full], ordered[full])
        lift[full] = np.einsum("nik,nkj->nij", ordered[full], lift[full])
        spare = 2 * width
        site = self.functions.Site()
        site.valid = upload(body.corner.astype(np.float64), scalar, device, spare)
        site.stride = n + (spare if n > 1 else 0)
        site.step = int(n > 1)

        def rows(each: FloatArray) -> Any:
            """(n, ...) as rows of n."""
            flat = each.reshape(n, -1).T
            return upload(np.pad(flat, ((0, 0), (0, site.stride - n))), scalar, device)

        site.share = rows(np.divide(1.0, total, out=np.zeros(n), where=total > 0))
        site.mean = rows(mean[:, 3 - axes :])
        site.affine = rows(np.einsum("nij,aj->nia", pinv, edges))
        site.moment = rows(np.einsum("ai,n->nia", edges, 1.0 / size))
        site.edge_t = upload(edges, scalar, device)
        self.site = site
        null = np.eye(d) - np.einsum("nik,nk,njk->nij", vectors, determined, vectors)
        self.rest = rest_struct(
            functions,
            RestArrays(gram / size[:, None, None], null, span, span_count, root, lift),
            site.stride,
            scalar,
            device,
        )
        self.Kept, self.Motion = functions.Kept, self.functions.Motion
        spare += body.window[2]  # a window reaches over the last cell, too
        self.mass = upload(
            body.mass.reshape(-1)[:1] if body.alike else body.mass, scalar, device, 0 if body.alike else spare
        )
        self.free = upload(body.free, scalar, device, spare)
        self.pull = upload(body.pull, scalar, device, spare)
        self.metric = upload(body.metric, scalar, device, spare)


class LatticeOperator(Operator):
    """Goals of lattice clusters."""

    def __init__(self, body: LatticeBody, layout: Layout, arrays: _LatticeArrays) -> None:
        super().__init__(body, layout, arrays, layout.stride)
        kk = arrays.functions
        n, w, many = body.shape, body.window, layout.abreast
        grid = kk.Grid()
        grid.cells_0, grid.cells_1 = n[0], n[1]
        grid.clusters_0, grid.clusters_1 = n[0] - w[0] + 1, n[1] - w[1] + 1
        grid.window_0, grid.window_1, grid.window_2 = w
        grid.line, grid.plane, grid.abreast = n[2] * many, n[1] * n[2] * many, many
        grid.front, grid.group, grid.stride = layout.front, layout.group, layout.stride
        grid.cluster_end = ((grid.clusters_1 - 1) * n[2] + n[2] - w[2] + 1) * many
        limit, run = SLIDE["cpu" if layout.device.startswith("cpu") else "cuda"]
        grid.run_0 = 1 if w[0] <= limit else run
        grid.run_1 = 1 if w[1] <= limit else run

        def blocks(numbers: int) -> int:
            return -(-numbers // layout.width)

        grid.blocks_plane, grid.blocks_clusters = blocks(grid.plane), blocks(grid.cluster_end)
        grid.items_plane = n[0] * grid.blocks_plane
        grid.items_fit = -(-grid.clusters_0 // grid.run_0) * grid.blocks_clusters
        grid.items_slow = -(-n[0] // grid.run_0) * grid.blocks_clusters
        if grid.run_1 == 1:
            grid.blocks_windows, grid.blocks_spread = blocks(grid.clusters_1 * grid.line), grid.blocks_plane
            segments = (1, 1)
        else:
            grid.blocks_windows = grid.blocks_spread = blocks(grid.line)
            segments = (-(-grid.clusters_1 // run), -(-n[1] // run))
        grid.items_windows = n[0] * segments[0] * grid.blocks_windows
        grid.items_spread = n[0] * segments[1] * grid.blocks_spread
        self.grid = grid
        d = body.dim
        fields = kk.Fields()
        fields.mass, fields.free, fields.pull = arrays.mass, arrays.free, arrays.pull
        fields.sums_fast, fields.sums_middle = layout.field(2 * d), layout.field(3 * d)
        fields.maps = self.maps = layout.field(d + d * d)
        fields.maps_slow = layout.field(3 * d) if d == 3 else fields.maps
        fields.maps_middle = layout.field(2 * d)
        self._fields = fields
        self.beta_stride = layout.group
        self.resident = arrays.resident
        if layout.device.startswith("cpu"):
            self.threads = 1
        elif body.count <= RESIDENT_CELLS:  # else passes are launched one by one
            self.threads = THREADS[layout.scalar]

    def residual(
        self, u: Field, out: Field, parameters: Parameters, running: Field, kept: object = None, what: int = GOAL
    ) -> None:
        kept = self.unkept() if kept is None else kept
        self._goals(u, out, self.fields(parameters, what), running, kept, changing=False)

    def change(self, direction: Field, out: Field, parameters: Parameters, running: Field, kept: object) -> None:
        self._goals(direction, out, self.fields(parameters), running, kept, changing=True)

    def _goals(self, u: Field, out: Field, fields: object, running: Field, kept: object, *, changing: bool) -> None:
        a, layout = self.arrays, self.layout
        if a.kernels is None:
            wp.launch(
                a.resident.goals,
                dim=layout.groups,
                inputs=[self.grid, a.site, a.rest, kept, fields, self.still, running, int(changing), u],
                outputs=[out, self._nothing],
                device=layout.device,
            )
            return
        self._windows(fields, self.still, running, u, u)
        self._fit(a.kernels.fit_changes if changing else a.kernels.fit_clusters, fields, running, kept)
        self._spread(fields, self.still, running, u, u, out, self._nothing)

    def step(
        self, u: Field, before: Field, motion: object, parameters: Parameters, running: Field, ran_away: Field
    ) -> None:
        fields = self.fields(parameters)
        self._windows(fields, motion, running, u, before)
        self._fit(self.arrays.kernels.fit_clusters, fields, running, self.unkept())
        self._spread(fields, motion, running, u, before, before, ran_away)

    def fields(self, parameters: Parameters, what: int = GOAL) -> Any:
        """What the passes work on, for these parameters."""
        fields = self.arrays.functions.Fields()
        for name in FIELDS:
            setattr(fields, name, getattr(self._fields, name))
        fields.beta, fields.theta = parameters.beta, parameters.theta
        fields.beta_stride, fields.volume, fields.what = parameters.beta_stride, parameters.volume, what
        return fields

    def cluster_values(self, values: FloatArray) -> Field:
        """(B, C) one value for each cluster, as the kernels read them."""
        layout = self.layout
        host = np.zeros((layout.groups, layout.group // layout.abreast, layout.abreast))
        host[:, self.body.clusters_at, :] = self.by_group(values).transpose(0, 2, 1)
        return upload(host, layout.scalar, layout.device, 2 * layout.width)

    def cluster_gradient(self, adjoint: Field) -> FloatArray:
        """(B, C): see `Operator.cluster_gradient`."""
        axes = self.dim
        maps = self._cluster_fields(self.maps, self.dim * (1 + axes))
        body = self.body
        weighted = np.zeros((self.layout.candidates, body.count, self.dim))
        weighted[:, body.cell] = self.layout.get(adjoint, self.dim) * body.mass.reshape(-1)[body.cell, None]
        weighted = weighted.reshape(-1, *body.shape, self.dim)
        sums = [_window_sums(weighted, body.window, None)]
        sums += [_window_sums(weighted, body.window, axis) for axis in range(3 - axes, 3)]
        kept = np.concatenate([each[:, body.corner] for each in sums], axis=-1)
        return np.asarray(np.einsum("bcr,bcr->bc", maps, kept))

    def _cluster_fields(self, field: Field, rows: int) -> FloatArray:
        """(B, C, rows) of a field of clusters."""
        layout = self.layout
        host = np.asarray(field.numpy(), dtype=np.float64).reshape(rows, layout.stride)
        body = host[:, layout.front : layout.front + layout.groups * layout.group]
        body = body.reshape(rows, layout.groups, -1, layout.abreast)[:, :, self.body.clusters_at, :]
        return body.transpose(1, 3, 2, 0).reshape(-1, len(self.body.clusters_at), rows)[: layout.candidates]

    def stay_stepping(
        self, pair: Field, swapped: bool, motion: object, parameters: Parameters, steps: int, ran_away: Field
    ) -> None:
        """`steps` time steps in one launch, of the displacement and the one before in the halves of `pair`."""
        a, layout = self.arrays, self.layout
        wp.launch(
            a.resident.steps,
            dim=layout.groups * self.threads,
            block_dim=self.threads,
            inputs=[
                *(self.grid, a.site, a.rest, self.unkept(), self.fields(parameters), motion),
                *(steps, int(swapped), self.threads, pair, ran_away),
            ],
            device=layout.device,
        )

    def stay_relaxing(
        self,
        parameters: Parameters,
        kept: object,
        span: object,
        state: object,
        most: int,
        limit: int,
        arrays: list[Any],
    ) -> Any:
        """The command for up to `limit` evaluations of Newton's steps in one launch.

        arrays: as its kernel lists them
        """
        a, layout = self.arrays, self.layout
        return wp.launch(
            a.resident.relax,
            dim=layout.groups * self.threads,
            block_dim=self.threads,
            inputs=[
                *(self.grid, a.site, a.rest, kept, self.fields(parameters), self.still, span, state),
                *(layout.groups, most, limit, self.threads, *arrays, self._nothing),
            ],
            device=layout.device,
            record_cmd=True,
        )

    def _windows(self, fields: object, motion: object, running: Field, u: Field, before: Field) -> None:
        kk, grid = self.arrays.kernels, self.grid
        first = grid.items_windows if self.arrays.window else grid.items_plane
        self.launch(kk.windows_fast, first, [grid, fields, motion, running, u, before])
        if not self.arrays.window:
            self.launch(kk.windows_middle, grid.items_windows, [grid, fields, running])

    def _fit(self, kernel: wp.Kernel, fields: object, running: Field, kept: object) -> None:
        grid = self.grid
        self.launch(kernel, grid.items_fit, [grid, self.arrays.site, self.arrays.rest, kept, fields, running])

    def _spread(
        self, fields: object, motion: object, running: Field, u: Field, before: Field, out: Field, ran_away: Field
    ) -> None:
        kk, grid = self.arrays.kernels, self.grid
        if self.dim == 3:
            self.launch(kk.spread_slow, grid.items_slow, [grid, fields, running])
        if not self.arrays.window:
            self.launch(kk.spread_middle, grid.items_spread, [grid, fields, running])
        self.launch(kk.finish, grid.items_plane, [grid, fields, motion, running, u, before], [out, ran_away])
