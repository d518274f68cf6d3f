"""Lattice clusters on a device: their rest data, and the launches that make goals of displacements."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm import lattice_kernels as k
from deformscope.stages.msm.body import Body, BodyRest, Operator, Parameters, RestArrays, rest_struct, upload_rows
from deformscope.stages.msm.cluster_functions import cluster_functions_for
from deformscope.stages.msm.clusters import FLAT_MOMENT_RATIO, LatticeClusters
from deformscope.stages.msm.layout import Field, Layout, upload, widths
from deformscope.stages.msm.resident_kernels import THREADS, resident_kernels_for

REGULAR = 1e-6
"""Largest distance of a particle from its place, in spacings, at which the lattice counts as even."""

FITTED, AT_ONCE = 100_000, 16_384
"""Particles that a lattice's edges are fitted to, and of which places are compared at once (they fit into a cache)."""

SLIDE = {"cpu": (3, 32), "cuda": (4, 8)}
"""Widest window that is summed at each cell separately, and the run of a sliding sum over wider ones."""

SLIDE_FROM = 500_000
"""Number of cells from which a GPU slides over wide windows: smaller bodies have too few threads for it."""

RESIDENT_CELLS = 8192
"""Largest number of cells for which one block of a GPU's threads computes a whole body."""


FILL, MARCH = 60_000, 8
"""Number of threads that keep a GPU busy, and the most planes that one of them goes along where there are more."""


def lattice_edges(rest: FloatArray, clusters: LatticeClusters) -> FloatArray | None:
    """(axes, d) from one cell to the next along each axis, if the rest shape (K, d) is an even lattice, else None."""
    used = [axis for axis, count in enumerate(clusters.shape) if count > 1]

    def index(some: Any) -> FloatArray:
        left, found = clusters.cell[some], np.empty((len(clusters.shape), len(clusters.cell[some])))
        for axis in reversed(range(len(found))):  # `np.unravel_index` takes five times as long
            before = left // clusters.shape[axis]
            found[axis], left = left - before * clusters.shape[axis], before
        return found[used].T

    count = len(rest)
    some = slice(None) if count <= FITTED else np.random.default_rng(0).integers(count, size=FITTED)
    middle, centre = index(some).mean(axis=0), rest[some].mean(axis=0)
    edges = np.zeros((len(clusters.shape), rest.shape[1]))
    edges[used] = np.linalg.lstsq(index(some) - middle, rest[some] - centre, rcond=None)[0]
    parts = [slice(first, first + AT_ONCE) for first in range(0, count, AT_ONCE)]
    off = (np.abs((index(part) - middle) @ edges[used] - (rest[part] - centre)).max(initial=0.0) for part in parts)
    return edges if all(each <= REGULAR for each in off) else None


class LatticeBody(Body):
    """A body whose clusters are windows of an even lattice; linear basis."""

    def __init__(
        self, rest: BodyRest, clusters: LatticeClusters, edges: FloatArray, scalar: type[Any], device: str
    ) -> None:
        d = rest.position.shape[1]
        super().__init__(d, scalar, device)
        shape = (*(1,) * (3 - len(clusters.shape)), *clusters.shape)
        window = (*(1,) * (3 - len(clusters.window)), *clusters.window)
        if d == 2 and shape[0] > 1:
            raise ValueError(f"expected a lattice of two axes in the plane; got {clusters.shape}")
        self.shape, self.window, self.count = shape, window, int(np.prod(shape))
        self.rest, self.cell = rest, clusters.cell
        self.corner = clusters.corner.reshape(shape)
        self.edges = np.zeros((3, d))
        self.edges[3 - len(edges) :] = edges
        self.alike = len(self.cell) == self.count and bool((rest.mass == rest.mass[0]).all())
        self._place = slice(None) if clusters.in_order else self.cell

    def at_cells(self, values: FloatArray | BoolArray | float, dtype: Any = np.float64, spare: int = 0) -> FloatArray:
        """Values (K,) of the particles at their cells, 0 at other cells; `spare` more at the end."""
        made = np.zeros(self.count + spare, dtype=dtype)
        made[: self.count][self._place] = values
        return made

    @property
    def clusters_at(self) -> IntArray:
        """Flat cell of each cluster, (C,)."""
        return np.flatnonzero(self.corner.reshape(-1))

    def layout(self, candidates: int, *, filled: bool = False) -> Layout:
        width, abreast = widths(candidates, self.scalar, self.device, cells_in_lanes=True, filled=filled)
        cells = self.count * abreast
        line, plane = self.shape[2] * abreast, self.shape[1] * self.shape[2] * abreast
        group = -(-cells // width) * width
        w = self.window
        front = (w[0] - 1) * plane + (w[1] - 1) * line + (w[2] - 1) * abreast
        front = -(-front // 16) * 16
        groups = -(-candidates // abreast)
        stride = front + groups * group + w[2] * abreast + 2 * width
        stride = -(-stride // 16) * 16
        where = self.cell, self.scalar, self.device, self.there(self.cell)
        return Layout(candidates, width, abreast, self.count, front, group, stride, *where)

    def operator(self, layout: Layout) -> "LatticeOperator":
        return LatticeOperator(self, layout, self.arrays(layout.width))

    def _make_arrays(self, width: int) -> "_LatticeArrays":
        return _LatticeArrays(self, width)

    def moments(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mass (n,), mean offset [cells] (n, 3) and second moments about it [spacings^2] (n, d, d) of the windows. One
        row if all clusters are equal, else one for each cell (0 where no cluster is)."""
        if self.alike:
            mass, chosen = np.full(self.window, self.rest.mass[0]), np.ones_like(self.corner[:1, :1, :1])
        else:
            mass, chosen = self.at_cells(self.rest.mass).reshape(self.shape), self.corner
        kept = tuple(slice(n) for n in chosen.shape)

        def sums(*axes: int) -> FloatArray:
            """(n,) masses times the offsets along these axes, summed over windows."""
            found = _window_sums(mass[None, ..., None], self.window, [axes.count(axis) for axis in range(3)])
            return np.where(chosen, found[0, ..., 0][kept], 0.0).reshape(-1)

        total = sums()
        first = np.stack([sums(a) for a in range(3)], axis=-1)
        mean = np.divide(first, total[:, None], out=np.zeros_like(first), where=total[:, None] > 0)
        pairs = {(a, b): sums(a, b) for a in range(3) for b in range(a + 1)}
        second = np.stack([pairs[max(a, b), min(a, b)] for a in range(3) for b in range(3)], axis=-1).reshape(-1, 3, 3)
        second -= total[:, None, None] * mean[:, :, None] * mean[:, None, :]
        return total, mean, np.einsum("ai,nab,bj->nij", self.edges, second, self.edges)


def _window_sums(values: FloatArray, window: tuple[int, ...], powers: Sequence[int] = (0, 0, 0)) -> FloatArray:
    """(B, cells, d) sums over windows from each cell on, 0 where none fits, of values times powers of the offsets."""
    for axis, (width, power) in enumerate(zip(window, powers, strict=True)):
        views = np.lib.stride_tricks.sliding_window_view(values, width, axis=axis + 1)
        total = views @ (np.arange(width) - (width - 1) / 2) ** power
        pad = [(0, 0)] * values.ndim
        pad[axis + 1] = (0, width - 1)
        values = np.pad(total, pad)
    return values


class _LatticeArrays:
    """Rest data on the device, for lanes of one width."""

    def __init__(self, body: LatticeBody, width: int) -> None:
        d, scalar, device = body.dim, body.scalar, body.device
        wide = set(body.window[3 - d :])
        small = max(wide) ** d <= k.WHOLE or RESIDENT_CELLS < body.count < SLIDE_FROM
        self.window = window = max(wide) if width == 1 and len(wide) == 1 and small else 0
        self.kernels = k.lattice_kernels_for(d, scalar, width, window) if width == 1 else None
        self.functions = k.lattice_functions_for(d, scalar, width, window)
        self.resident = resident_kernels_for(d, scalar, width, window)
        functions = cluster_functions_for(d, d, scalar, width)
        total, mean, gram = body.moments()
        n = len(total)
        edges = body.edges[3 - d :]  # along which the passes take moments
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
        site.valid = upload(body.corner, scalar, device, spare)
        site.stride = n + (spare if n > 1 else 0)
        site.step = int(n > 1)

        rows = functools.partial(upload_rows, stride=site.stride, scalar=scalar, device=device)
        site.share = rows(np.divide(1.0, total, out=np.zeros(n), where=total > 0))
        site.mean = rows(mean[:, 3 - d :])
        site.affine = rows(np.einsum("nij,aj->nia", pinv, edges))
        site.moment = rows(np.einsum("ai,n->nia", edges, 1.0 / size))
        site.edge_t = upload(edges, scalar, device)
        self.site = site
        null = np.eye(d) - np.einsum("nik,nk,njk->nij", vectors, determined, vectors)
        arrays = RestArrays(gram / size[:, None, None], null, span, span_count, root, lift)
        self.rest = rest_struct(functions, arrays, site.stride, scalar, device)
        self.Kept, self.Motion = functions.Kept, self.functions.Motion
        spare += body.window[2]  # a window reaches over the last cell, too
        number = np.float64 if scalar is wp.float64 else np.float32

        def at_cells(values: FloatArray | BoolArray) -> Any:
            return wp.array(body.at_cells(values, number, spare), dtype=scalar, device=device)

        rest = body.rest
        self.mass = upload(rest.mass[:1], scalar, device) if body.alike else at_cells(rest.mass)
        self.free, self.metric = at_cells(rest.free), at_cells(rest.metric)
        self.pull = at_cells(rest.free / rest.counts)
        self.sides = self.free if rest.held_axis < 0 else at_cells(~rest.slipping)


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
        grid.run_0 = 1 if arrays.window or w[0] <= limit else run
        grid.run_1 = 1 if arrays.window or w[1] <= limit else run

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
        d = body.dim
        fields = kk.Fields()
        fields.mass, fields.free, fields.pull = arrays.mass, arrays.free, arrays.pull
        fields.sides, fields.held_axis = arrays.sides, body.rest.held_axis
        between = 0 if kk.whole else d
        fields.sums_fast, fields.sums_middle = layout.field(2 * between), layout.field(3 * between)
        fields.maps = self.maps = layout.field(d + d * d)
        fields.maps_slow = layout.field(3 * between) if d == 3 else fields.maps
        fields.maps_middle = layout.field(2 * between)
        self.fields = fields
        self.beta_stride = layout.group
        self.resident, self.looks_ahead = arrays.resident, kk.whole
        if layout.device.startswith("cpu"):
            self.threads = 1
        elif body.count <= RESIDENT_CELLS:  # else passes are launched one by one
            self.threads = THREADS[layout.scalar]
        self.grid = self._resident_grid = self._marching(grid, 1)
        if kk.whole:
            self.grid = self._marching(grid, min(max(1, n[0] * grid.plane * layout.groups // FILL), MARCH))
            planes_at_once = max(1, self.threads // grid.plane)
            self._resident_grid = self._marching(grid, -(-n[0] // planes_at_once))

    def _marching(self, grid: Any, run: int) -> Any:
        """The grid where a thread of `finish` over whole windows goes along `run` planes."""
        found = self.arrays.functions.Grid()
        found.assign(grid)
        found.run_back = run
        found.items_back = -(-grid.cells_0 // run) * grid.plane if self.looks_ahead else grid.items_plane
        return found

    def residual(self, u: Field, out: Field, parameters: Parameters, running: Field, kept: object = None) -> None:
        self._launch_passes(self._passes(parameters, kept), running, u, u, u, out, changing=False)

    def change(self, direction: Field, out: Field, parameters: Parameters, running: Field, kept: object) -> None:
        p = direction
        self._launch_passes(self._passes(parameters, kept), running, p, p, p, out, changing=True)

    def change_and_smooth(
        self,
        direction: Field,
        parameters: Parameters,
        running: Field,
        kept: object,
        smoother: tuple[float, float, Field, Field, Field],
    ) -> None:
        """`change`, and with it the next direction. smoother: see `lattice_kernels.Smoothing`"""
        passes, p = self._passes(parameters, kept), direction
        smoothing = self.arrays.functions.Smoothing()
        smoothing.on, (smoothing.keep, smoothing.gain, smoothing.shrink, smoothing.z, smoothing.left) = 1, smoother
        passes.smoothing = smoothing
        self._launch_passes(passes, running, p, p, p, p, changing=True)

    def look_ahead(self, state: Any, motion: object) -> None:
        passes = self._passes(None)
        passes.motion = motion
        inputs = [passes, state.running, state.u, state.before]
        self.launch(self.arrays.kernels.look_ahead, self.grid.items_plane, inputs, [state.star])

    def step(self, state: Any, motion: object, parameters: Parameters) -> None:
        passes = self._passes(parameters)
        passes.motion, passes.ran_away = motion, state.ran_away
        before = state.before
        self._launch_passes(passes, state.running, state.u, before, state.star, before, changing=False)

    def cluster_values(self, values: FloatArray) -> Field:
        """(B, C) one value for each cluster, as the kernels read them."""
        layout = self.layout
        host = np.zeros((layout.groups, layout.group // layout.abreast, layout.abreast))
        host[:, self.body.clusters_at, :] = self.by_group(values).transpose(0, 2, 1)
        return upload(host, layout.scalar, layout.device, 2 * layout.width)

    def stay_stepping(
        self, pair: Field, swapped: bool, motion: object, parameters: Parameters, steps: int, ran_away: Field
    ) -> None:
        """`steps` time steps in one launch, of the displacement, the one before and x* in the parts of `pair`."""
        passes = self._stepping
        self._set(passes, parameters)
        passes.motion, passes.pair, passes.ran_away = motion, pair, ran_away
        self._stay(self.resident.steps, [passes, steps, int(swapped)])

    def stay_relaxing(
        self, parameters: Parameters, kept: object, newton: list[Any], pair: Field, pair_out: Field
    ) -> Any:
        """The command for evaluations of Newton's steps in one launch, up to a limit. newton, pairs: for its kernel"""
        passes = self._passes(parameters, kept)
        passes.grid, passes.pair, passes.pair_out = self._resident_grid, pair, pair_out
        return self._stay(self.resident.relax, [passes, *newton, 0], record_cmd=True)

    def _stay(self, kernel: wp.Kernel, inputs: list[Any], *, record_cmd: bool = False) -> Any:
        dim, device = self.layout.groups * self.threads, self.layout.device
        return wp.launch(kernel, dim, inputs, device=device, block_dim=self.threads, record_cmd=record_cmd)

    @functools.cached_property
    def _stepping(self) -> Any:
        """Parameters of the steps, reused from call to call: making them takes as long as a short call's steps."""
        passes = self._passes(None)
        passes.grid = self._resident_grid
        return passes

    def _passes(self, parameters: Parameters | None, kept: object = None) -> Any:
        """Parameters of the passes, without motion. kept: place of the values for `change` (None: nowhere)"""
        passes = self.arrays.functions.Passes()
        passes.grid, passes.site, passes.rest = self.grid, self.arrays.site, self.arrays.rest
        passes.kept, passes.fields, passes.motion = kept or self.unkept(), self.fields, self.still
        passes.threads, passes.ran_away = self.threads, self._nothing
        if parameters is not None:
            self._set(passes, parameters)
        return passes

    def _set(self, passes: Any, parameters: Parameters) -> None:
        fields = passes.fields
        fields.beta, fields.theta = parameters.beta, parameters.theta
        fields.beta_stride, fields.volume = parameters.beta_stride, parameters.volume

    def _launch_passes(
        self, passes: object, running: Field, u: Field, before: Field, star: Field, out: Field, *, changing: bool
    ) -> None:
        """All passes over the groups that run; on a GPU one by one."""
        kk, grid = self.arrays.kernels, self.grid
        if kk is None:
            inputs = [passes, running, int(changing), u, out]
            wp.launch(self.resident.goals, self.layout.groups, inputs, device=self.layout.device)
            return
        if not self.looks_ahead:
            self.launch(kk.windows_fast, grid.items_plane, [passes, running, u, before])
            self.launch(kk.windows_middle, grid.items_windows, [passes, running])
        self.launch(kk.fit_changes if changing else kk.fit_clusters, grid.items_fit, [passes, running, star])
        if self.dim == 3 and not self.looks_ahead:
            self.launch(kk.spread_slow, grid.items_slow, [passes, running])
        if not self.looks_ahead:
            self.launch(kk.spread_middle, grid.items_spread, [passes, running])
        self.launch(kk.finish, grid.items_back, [passes, running, u, before, star], [out])
