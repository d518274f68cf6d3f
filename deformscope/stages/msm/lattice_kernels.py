"""Warp kernels of lattice clusters: separable window sums, whose cost does not grow with the width of a cluster.

FastLSM (Rivers and James 2007) sums the raw moments of all windows by prefix sums, which float32 cannot hold. Here the
sums are local: each axis in turn sums, over its window, the results of the axis before, and the first moments are
relative to the middle of the window. A thread slides along the axis for `run` cells, adding the cell that enters and
subtracting the one that leaves. With `run` = 1 it sums one window only, which suits a GPU for small ones.

A lattice has three axes (slow to fast: 0, 1, 2); in the plane the first has one cell. A cluster lives at the cell of
its lowest corner. Fields are structures of arrays; a cell's place is the same in every field. Places without a cluster
or a particle always stay 0, so that windows may extend beyond the edges without a test."""

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import cluster_functions_for
from deformscope.stages.msm.lanes import Ints, VectorC, kernel_in, lanes_for, members, product_for, rows_for

WHOLE = 27
"""Most cells of a window that a GPU sums up along all axes at once; for larger ones that takes longer than a pass for
each axis."""

FAR = 1e4
"""Spacings beyond which a particle has run away."""


@functools.cache
def motion_for(scalar: Any) -> Any:
    """The struct type of a time step's parameters."""

    numbers = wp.array(dtype=scalar)

    @wp.struct
    class StepMotion:
        """Additions of time stepping: alpha, the share of the last motion that continues, and a push each step."""

        stepping: int
        alpha: scalar
        going_on: scalar
        push: numbers

    return StepMotion


@functools.cache
def lattice_types_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """The struct types that the passes take, for `dim` = 2 or 3 and lanes of `width` numbers of type `scalar`."""
    numbers = wp.array(dtype=scalar)
    Motion = motion_for(scalar)
    cluster = cluster_functions_for(dim, dim, scalar, width)

    @wp.struct
    class Grid:
        """The lattice, the windows of its clusters, and where fields keep them.

        cells: along axes 0 and 1; clusters: along axes 0 and 1; plane, line: cells of one step along axis 0 and 1, each
        times `abreast`; abreast: candidates side by side in the lanes (1: cells side by side); front: numbers before
        the first place of a field; group: numbers from one group of candidates to the next; stride: from one row of a
        field to the next; window_0...: cells of a cluster along the axis; cluster_end: numbers that the clusters of a
        plane fill; run_0, run_1: cells of a sliding sum along an axis, run_back: of `finish` over whole windows;
        items_*: of a pass, in a group; blocks_*: of these, in a plane (or a line)"""

        cells_0: int
        cells_1: int
        clusters_0: int
        clusters_1: int
        window_0: int
        window_1: int
        window_2: int
        line: int
        plane: int
        abreast: int
        front: int
        group: int
        stride: int
        cluster_end: int
        run_0: int
        run_1: int
        blocks_plane: int
        blocks_clusters: int
        blocks_windows: int
        blocks_spread: int
        items_plane: int
        items_windows: int
        items_fit: int
        items_slow: int
        items_spread: int
        run_back: int
        items_back: int

    @wp.struct
    class Site:
        """Rest data of a cluster: `stride` between rows, `step` 1 if each has its own, else 0 (all are alike)."""

        valid: numbers  # 1 at a cell that has a cluster
        share: numbers  # 1 / mass of the window
        mean: numbers  # mean offset of the mass from the middle of the window, in cells
        affine: numbers  # from first moments to A~ - I, transposed: (dim, axes)
        moment: numbers  # from first moments to A_pq - A_qq, transposed: (dim, axes)
        edge_t: numbers  # the lattice's edges: an offset in cells to particle spacings, (axes, dim)
        stride: int
        step: int

    @wp.struct
    class Fields:
        """Input of the passes from particles, their intermediate results, and the candidates' parameters.

        mass: one value if all are alike; pull: 1 / number of clusters, 0 for a held particle and for a missing one
        sides: 0 for a particle that is held along `held_axis` alone, -1 if none is
        beta_stride: see `body.Parameters`"""

        mass: numbers
        free: numbers
        pull: numbers
        sides: numbers
        held_axis: int
        sums_fast: numbers
        sums_middle: numbers
        maps: numbers
        maps_slow: numbers
        maps_middle: numbers
        beta: numbers
        theta: numbers
        beta_stride: int
        volume: int

    @wp.struct
    class Smoothing:
        """A step of Chebyshev's iteration: see `multigrid_kernels.smoother_for`.

        on: whether `finish` takes it; shrink: 1 / largest eigenvalue of each candidate"""

        on: int
        keep: scalar
        gain: scalar
        shrink: numbers
        z: numbers
        left: numbers

    @wp.struct
    class Passes:
        """Parameters of the passes; motion: those of time stepping, or none.

        pair: the displacement, and the direction or the displacement one step before, as one field; pair_out: the
        residual and the direction's change; threads: number of threads of a resident block; smoothing: with what the
        passes found, on a GPU over whole windows"""

        grid: Grid
        site: Site
        rest: cluster.FitRest
        kept: cluster.Kept
        fields: Fields
        motion: Motion
        smoothing: Smoothing
        threads: int
        pair: numbers
        pair_out: numbers
        ran_away: Ints

    return members(Grid, Site, Fields, Smoothing, Passes, Motion=Motion)


@dataclass(frozen=True, eq=False)
class PassHelpers:
    """What the functions of all passes share.

    window: cells along every axis, or 0; whole: whether windows are summed along all axes at once, from predicted
    displacements (eq. 3.1, 3.2) that the step before leaves; vecs, maps: rows of vectors and of matrices of lanes;
    types: see `lattice_types_for`; all others: functions of `pass_helpers_for`"""

    dim: int
    scalar: Any
    width: int
    window: int
    whole: bool
    numbers: Any
    lanes: SimpleNamespace
    vecs: SimpleNamespace
    maps: SimpleNamespace
    types: SimpleNamespace
    middle: Any
    cells_of: Any
    run_of: Any
    plane_share: Any
    share_of: Any
    particle_own: Any
    ahead: Any


def pass_helpers_for(dim: int, scalar: Any, width: int, window: int) -> PassHelpers:
    """The helpers for windows of `window` cells along every axis, or (0) as the grid gives them."""
    numbers = wp.array(dtype=scalar)
    lanes, vecs = lanes_for(width, scalar), rows_for(dim, width, scalar)
    types = lattice_types_for(dim, scalar, width)
    Grid, Motion = types.Grid, types.Motion
    lane, own, one = lanes.lane, lanes.own, scalar(1.0)

    @wp.func
    def middle(window_here: int):
        return scalar(0.5) * scalar(window_here - 1)

    @wp.func
    def cells_of(asked: int):
        if wp.static(window > 0):
            return wp.static(window)
        else:  # noqa: RET505 (a static `if` compiles one of the two)
            return asked

    @wp.func
    def run_of(asked: int):
        if wp.static(window > 0):
            return wp.static(1)
        else:  # noqa: RET505
            return asked

    @wp.func
    def plane_share(grid: Grid, item: int):
        """An item's first cell, and numbers from there to the end of its plane."""
        plane = item / grid.blocks_plane
        in_plane = (item - plane * grid.blocks_plane) * wp.static(width)
        return plane * grid.plane + in_plane, grid.plane - in_plane

    @wp.func
    def share_of(grid: Grid, item: int, items: int, blocks: int, count_1: int):
        """An item's first cell, how many of `count_1` lines it has, and numbers from there to the end of a line."""
        per_plane = items / grid.cells_0
        plane = item / per_plane
        rest = item - plane * per_plane
        segment = rest / blocks
        in_line = (rest - segment * blocks) * wp.static(width)
        first = segment * grid.run_1
        count = grid.line - in_line
        if grid.run_1 == 1:  # lines follow each other: the lanes run through
            count = count_1 * grid.line - in_line
        cell = plane * grid.plane + first * grid.line + in_line
        return cell, wp.min(grid.run_1, count_1 - first), count

    @wp.func
    def particle_own(values: numbers, cell: int, abreast: int):
        """Data of a particle, for the lanes at `cell` (of one group); one value if all are alike."""
        if values.shape[0] == 1:
            return own(values, 0, 0)
        if wp.static(width == 1) or abreast == 1:
            return own(values, cell, 1)
        return own(values, cell / abreast, 0)

    @wp.func
    def ahead(grid: Grid, u: vecs.rows, before: vecs.rows, motion: Motion, free: numbers, cell: int):
        """x* of eq. 3.1, 3.2: where the last motion and the push would take a free particle."""
        back = vecs.add(u, -one, before)
        moves = vecs.rows()
        moves = vecs.add(moves, motion.going_on, back)
        for k in range(wp.static(dim)):
            moves = vecs.with_row(moves, k, vecs.row(moves, k) + lane(motion.push[k]))
        return vecs.add(u, one, vecs.scale(moves, particle_own(free, cell, grid.abreast)))

    return PassHelpers(
        dim=dim,
        scalar=scalar,
        width=width,
        window=window,
        whole=0 < window**dim <= WHOLE,
        numbers=numbers,
        lanes=lanes,
        vecs=vecs,
        maps=rows_for(dim * dim, width, scalar),
        types=types,
        middle=middle,
        cells_of=cells_of,
        run_of=run_of,
        plane_share=plane_share,
        share_of=share_of,
        particle_own=particle_own,
        ahead=ahead,
    )


def windows_fast_for(helpers: PassHelpers) -> Any:
    """The pass along the fast axis."""
    dim, scalar, numbers, vecs = helpers.dim, helpers.scalar, helpers.numbers, helpers.vecs
    Passes, one = helpers.types.Passes, scalar(1.0)
    middle, cells_of, particle_own = helpers.middle, helpers.cells_of, helpers.particle_own

    @wp.func
    def windows_fast(
        passes: Passes, u_in: numbers, offset: int, before_in: numbers, before_offset: int, group: int, item: int
    ):
        """Windows along the fast axis of m u, or of m x* (eq. 3.1, 3.2): sum, first moment."""
        grid = passes.grid
        fields = passes.fields
        cell, count = helpers.plane_share(grid, item)
        at = grid.front + group * grid.group + cell
        h = middle(cells_of(grid.window_2))
        total = vecs.rows()
        fast = vecs.rows()
        for k in range(cells_of(grid.window_2)):
            away = k * grid.abreast
            v = vecs.load(u_in, offset + at + away, grid.stride)
            if passes.motion.stepping != 0:
                before = vecs.load(before_in, before_offset + at + away, grid.stride)
                v = helpers.ahead(grid, v, before, passes.motion, fields.free, cell + away)
            v = vecs.scale(v, particle_own(fields.mass, cell + away, grid.abreast))
            total = vecs.add(total, one, v)
            fast = vecs.add(fast, scalar(k) - h, v)
        vecs.store(fields.sums_fast, at, grid.stride, total, count)
        vecs.store(fields.sums_fast, at + wp.static(dim) * grid.stride, grid.stride, fast, count)

    return windows_fast


def windows_middle_for(helpers: PassHelpers) -> Any:
    """The pass along the middle axis."""
    dim, scalar, numbers, vecs = helpers.dim, helpers.scalar, helpers.numbers, helpers.vecs
    Passes, one = helpers.types.Passes, scalar(1.0)
    middle, cells_of, run_of, share_of = helpers.middle, helpers.cells_of, helpers.run_of, helpers.share_of

    @wp.func
    def slide_in(
        source_in: numbers,
        row_in: int,
        first: int,
        step: int,
        window_here: int,
        run: int,
        stride: int,
        target_out: numbers,
        row_sum: int,
        row_moment: int,
        count: int,
    ):
        """Sums of a vector over `run` windows, from the one at `first` on; with row_moment >= 0 also first moments."""
        total = vecs.rows()
        moment = vecs.rows()
        h = middle(cells_of(window_here))
        at = first + row_in * stride
        for k in range(cells_of(window_here)):
            v = vecs.load(source_in, at + k * step, stride)
            total = vecs.add(total, one, v)
            if row_moment >= 0:
                moment = vecs.add(moment, scalar(k) - h, v)
        for j in range(run_of(run)):
            place = first + j * step
            vecs.store(target_out, place + row_sum * stride, stride, total, count)
            if row_moment >= 0:
                vecs.store(target_out, place + row_moment * stride, stride, moment, count)
            if j + 1 < run_of(run):
                leaves = vecs.load(source_in, place + row_in * stride, stride)
                enters = vecs.load(source_in, place + row_in * stride + window_here * step, stride)
                if row_moment >= 0:
                    moment = vecs.add(vecs.add(vecs.add(moment, -one, total), one + h, leaves), h, enters)
                total = vecs.add(vecs.add(total, -one, leaves), one, enters)

    @wp.func
    def windows_middle(passes: Passes, group: int, item: int):
        """Windows along the middle axis: sum, first moment along it, and the first moment along the fast axis."""
        grid = passes.grid
        cell, steps, count = share_of(grid, item, grid.items_windows, grid.blocks_windows, grid.clusters_1)
        at = grid.front + group * grid.group + cell
        d = wp.static(dim)
        source = passes.fields.sums_fast
        target = passes.fields.sums_middle
        slide_in(source, 0, at, grid.line, grid.window_1, steps, grid.stride, target, 0, d, count)
        slide_in(source, d, at, grid.line, grid.window_1, steps, grid.stride, target, 2 * d, -1, count)

    return windows_middle


def map_functions_for(helpers: PassHelpers) -> SimpleNamespace:
    """The functions that make a cluster's map of its moments."""
    dim, width, numbers, lanes = helpers.dim, helpers.width, helpers.numbers, helpers.lanes
    vecs, maps = helpers.vecs, helpers.maps
    Grid, Site, lane, own = helpers.types.Grid, helpers.types.Site, lanes.lane, lanes.own
    c = VectorC(width, helpers.scalar)
    each = f"for (int i = 0; i < {dim}; ++i)"
    valid_c, total_i = f"{c.at('valid.c[0]')} > (V)0", c.at("total.data[i][0]")
    place, mean_a = f"[a * {dim} + i][0]", c.at("mean.data[a][0]")
    moved = " + ".join(c.at(f"mean.data[{a}][0]") + " * " + c.at(f"slopes.data[{a * dim} + i][0]") for a in range(dim))

    def result_c(rows: int) -> str:
        return f"{c.declared} wp::mat_t<{rows}, {width}, wp::{helpers.scalar.__name__}> r;"

    @wp.func_native(
        f"{result_c(dim * dim)} for (int a = 0; a < {dim}; ++a) {each}"
        f" {c.at('r.data' + place)} = {valid_c} ? {c.at('moments.data' + place)} - {mean_a} * {total_i} : (V)0;"
        " return r;"
    )
    def centred(moments: maps.rows, mean: vecs.rows, total: vecs.rows, valid: lane) -> maps.rows:
        """First moments about the centre of mass; 0 where there is no cluster."""

    @wp.func_native(
        f"{result_c(dim)} {each} {c.at('r.data[i][0]')} ="
        f" {valid_c} ? {c.at('share.c[0]')} * {total_i} - ({moved}) : (V)0; return r;"
    )
    def shift_of(total: vecs.rows, share: lane, mean: vecs.rows, slopes: maps.rows, valid: lane) -> vecs.rows:
        """Goal displacement at the middle of the window."""

    parts = [(f"r.data[{k * dim} + i][0]", f"{name}.data[i][0]") for k, name in enumerate("abc"[:dim])]

    @wp.func_native(
        f"{result_c(dim * dim)} {each} {{ {' '.join(f'{c.at(to)} = {c.at(of)};' for to, of in parts)} }} return r;"
    )
    def stacked(a: vecs.rows, b: vecs.rows, c: vecs.rows) -> maps.rows: ...

    @wp.func
    def rest_place(grid: Grid, site: Site, cell: int):
        """Where a cluster's rest data are, where its `valid` is; 1 if the lanes are clusters (each with its own)."""
        if wp.static(width == 1) or grid.abreast == 1:
            return cell * site.step, cell, 1
        return (cell / grid.abreast) * site.step, cell / grid.abreast, 0

    @wp.func
    def parameter(grid: Grid, values: numbers, stride: int, group: int, cell: int):
        """A candidate's parameter, or (stride > 0) that of each cluster."""
        if stride > 0:
            return own(values, group * stride + cell, 1)
        if wp.static(width == 1) or grid.abreast == 1:
            return own(values, group, 0)
        return own(values, group * grid.abreast, 1)

    return members(centred, shift_of, stacked, rest_place, parameter)


def fit_for(helpers: PassHelpers, functions: SimpleNamespace, changing: bool, name: str) -> Any:
    """The pass along the slow axis, which ends the window sums and computes each cluster's goal map from its moments,
    or with `changing` its derivative along them; functions: those that `map_functions_for` returns"""
    dim, scalar, width, vecs, maps = helpers.dim, helpers.scalar, helpers.width, helpers.vecs, helpers.maps
    Passes, own, one = helpers.types.Passes, helpers.lanes.own, scalar(1.0)
    middle, cells_of, run_of, particle_own = helpers.middle, helpers.cells_of, helpers.run_of, helpers.particle_own
    numbers = helpers.numbers
    cluster = cluster_functions_for(dim, dim, scalar, width)
    product = product_for(dim, dim, dim, width, scalar)
    moments_own = rows_for(dim * (dim + 1) // 2, width, scalar).own

    @wp.func(name=f"{name}_at")
    def solve(passes: Passes, at: int, cell: int, group: int, total: vecs.rows, moments: maps.rows, count: int):
        """The goal map as sums for the particles: a shift, and slopes by axis."""
        grid = passes.grid
        site = passes.site
        rest = passes.rest
        kept = passes.kept
        fields = passes.fields
        place, valid_place, differ = functions.rest_place(grid, site, cell)
        valid = own(site.valid, valid_place, differ)
        step = differ * site.step
        mean = vecs.own(site.mean, place, site.stride, step)
        moments = functions.centred(moments, mean, total, valid)
        affine_t = product(maps.own(site.affine, place, site.stride, step), moments)
        change_t = product(maps.own(site.moment, place, site.stride, step), moments)
        beta = functions.parameter(grid, fields.beta, fields.beta_stride, group, cell)
        theta = functions.parameter(grid, fields.theta, 0, group, cell)
        volume = fields.volume
        if wp.static(changing):
            t = cluster.turned_change(kept, at, change_t)
            blend_t = cluster.blend_change(rest, place, step, kept, at, affine_t, t, beta, theta, volume)
        else:
            a_qq = moments_own(rest.a_qq, place, rest.stride, step)
            t = cluster.turned(kept, at, count, a_qq, change_t)
            blend_t = cluster.blend(rest, place, step, kept, at, count, affine_t, t, beta, theta, volume)
        slopes = product(maps.own(site.edge_t, 0, 1, 0), blend_t)
        share = own(site.share, place, step)
        vecs.store(fields.maps, at, grid.stride, functions.shift_of(total, share, mean, slopes, valid), count)
        maps.store(fields.maps, at + wp.static(dim) * grid.stride, grid.stride, maps.choose(valid, slopes), count)

    @wp.func(name=f"{name}_whole")
    def whole(passes: Passes, u_in: numbers, offset: int, group: int, item: int):
        """Windows along all axes, and with them each cluster's map."""
        grid = passes.grid
        segment = item / grid.blocks_clusters
        in_plane = item - segment * grid.blocks_clusters
        first = segment * grid.plane + in_plane
        at = grid.front + group * grid.group + first
        side = cells_of(grid.window_1)
        planes = cells_of(grid.window_0)
        if wp.static(dim == 2):
            planes = int(1)
        h = middle(side)
        total = vecs.rows()
        slow = vecs.rows()
        mid = vecs.rows()
        fast = vecs.rows()
        for i in range(planes):
            here = vecs.rows()
            mid_here = vecs.rows()
            fast_here = vecs.rows()
            for j in range(side):
                along = vecs.rows()
                for k in range(side):
                    away = i * grid.plane + j * grid.line + k
                    v = vecs.load(u_in, offset + at + away, grid.stride)
                    v = vecs.scale(v, particle_own(passes.fields.mass, first + away, 1))
                    along = vecs.add(along, one, v)
                    fast_here = vecs.add(fast_here, scalar(k) - h, v)
                here = vecs.add(here, one, along)
                mid_here = vecs.add(mid_here, scalar(j) - h, along)
            total = vecs.add(total, one, here)
            slow = vecs.add(slow, scalar(i) - h, here)
            mid = vecs.add(mid, one, mid_here)
            fast = vecs.add(fast, one, fast_here)
        if wp.static(dim == 2):
            slow = mid
            mid = fast
        moments = functions.stacked(slow, mid, fast)
        solve(passes, at, first, group, total, moments, grid.cluster_end - in_plane)

    @wp.func(name=name)
    def windows(passes: Passes, u_in: numbers, offset: int, group: int, item: int):
        """Windows along the slow axis, and with them each cluster's map."""
        grid = passes.grid
        segment = item / grid.blocks_clusters
        in_plane = (item - segment * grid.blocks_clusters) * wp.static(width)
        first = segment * grid.run_0
        steps = wp.min(grid.run_0, grid.clusters_0 - first)
        count = grid.cluster_end - in_plane
        base = grid.front + group * grid.group
        d = wp.static(dim)
        source = passes.fields.sums_middle
        if wp.static(dim) == 2:
            at = base + in_plane
            slow = vecs.load(source, at + d * grid.stride, grid.stride)
            fast = vecs.load(source, at + 2 * d * grid.stride, grid.stride)
            total = vecs.load(source, at, grid.stride)
            solve(passes, at, in_plane, group, total, functions.stacked(slow, fast, fast), count)
        if wp.static(dim) == 3:
            h = middle(cells_of(grid.window_0))
            total = vecs.rows()
            slow = vecs.rows()
            mid = vecs.rows()
            fast = vecs.rows()
            at = base + first * grid.plane + in_plane
            for k in range(cells_of(grid.window_0)):
                here = at + k * grid.plane
                v = vecs.load(source, here, grid.stride)
                total = vecs.add(total, one, v)
                slow = vecs.add(slow, scalar(k) - h, v)
                mid = vecs.add(mid, one, vecs.load(source, here + d * grid.stride, grid.stride))
                fast = vecs.add(fast, one, vecs.load(source, here + 2 * d * grid.stride, grid.stride))
            for j in range(run_of(steps)):
                place = at + j * grid.plane
                cell = (first + j) * grid.plane + in_plane
                solve(passes, place, cell, group, total, functions.stacked(slow, mid, fast), count)
                if j + 1 < run_of(steps):
                    over = grid.window_0 * grid.plane
                    leaves = vecs.load(source, place, grid.stride)
                    enters = vecs.load(source, place + over, grid.stride)
                    slow = vecs.add(vecs.add(vecs.add(slow, -one, total), one + h, leaves), h, enters)
                    total = vecs.add(vecs.add(total, -one, leaves), one, enters)
                    mid = vecs.add(mid, -one, vecs.load(source, place + d * grid.stride, grid.stride))
                    mid = vecs.add(mid, one, vecs.load(source, place + d * grid.stride + over, grid.stride))
                    fast = vecs.add(fast, -one, vecs.load(source, place + 2 * d * grid.stride, grid.stride))
                    fast = vecs.add(fast, one, vecs.load(source, place + 2 * d * grid.stride + over, grid.stride))

    return whole if helpers.whole else windows


def spreads_for(helpers: PassHelpers) -> tuple[Any, Any]:
    """The passes along the slow and along the middle axis from clusters back to particles."""
    dim, scalar, width, numbers, vecs = helpers.dim, helpers.scalar, helpers.width, helpers.numbers, helpers.vecs
    Passes, one = helpers.types.Passes, scalar(1.0)
    middle, cells_of, run_of, share_of = helpers.middle, helpers.cells_of, helpers.run_of, helpers.share_of

    @wp.func
    def slide_out(
        source_in: numbers,
        row_in: int,
        row_slope: int,
        first: int,
        step: int,
        window_here: int,
        run: int,
        stride: int,
        target_out: numbers,
        row_sum: int,
        count: int,
    ):
        """Sums over the clusters of a place, of a vector and (if row_slope >= 0) of a slope times its offset."""
        total = vecs.rows()
        slopes = vecs.rows()
        h = middle(cells_of(window_here))
        for k in range(cells_of(window_here)):
            at = first - k * step
            total = vecs.add(total, one, vecs.load(source_in, at + row_in * stride, stride))
            if row_slope >= 0:
                slope = vecs.load(source_in, at + row_slope * stride, stride)
                total = vecs.add(total, scalar(k) - h, slope)
                slopes = vecs.add(slopes, one, slope)
        for j in range(run_of(run)):
            place = first + j * step
            vecs.store(target_out, place + row_sum * stride, stride, total, count)
            if j + 1 < run_of(run):
                leaves = place - (window_here - 1) * step
                enters = place + step
                total = vecs.add(total, -one, vecs.load(source_in, leaves + row_in * stride, stride))
                total = vecs.add(total, one, vecs.load(source_in, enters + row_in * stride, stride))
                if row_slope >= 0:
                    old = vecs.load(source_in, leaves + row_slope * stride, stride)
                    new = vecs.load(source_in, enters + row_slope * stride, stride)
                    total = vecs.add(vecs.add(vecs.add(total, one, slopes), -one - h, old), -h, new)
                    slopes = vecs.add(vecs.add(slopes, -one, old), one, new)

    @wp.func
    def spread_slow(passes: Passes, group: int, item: int):
        """Sum over the clusters of a particle along the slow axis: the shift with its slope, the other slopes."""
        grid = passes.grid
        segment = item / grid.blocks_clusters
        in_plane = (item - segment * grid.blocks_clusters) * wp.static(width)
        first = segment * grid.run_0
        steps = wp.min(grid.run_0, grid.cells_0 - first)
        count = grid.cluster_end - in_plane
        at = grid.front + group * grid.group + first * grid.plane + in_plane
        d = wp.static(dim)
        source = passes.fields.maps
        target = passes.fields.maps_slow
        slide_out(source, 0, d, at, grid.plane, grid.window_0, steps, grid.stride, target, 0, count)
        slide_out(source, 2 * d, -1, at, grid.plane, grid.window_0, steps, grid.stride, target, d, count)
        slide_out(source, 3 * d, -1, at, grid.plane, grid.window_0, steps, grid.stride, target, 2 * d, count)

    @wp.func
    def spread_middle(passes: Passes, group: int, item: int):
        """The same along the middle axis: the shift with its slope, and the slope along the fast axis."""
        grid = passes.grid
        cell, steps, count = share_of(grid, item, grid.items_spread, grid.blocks_spread, grid.cells_1)
        at = grid.front + group * grid.group + cell
        d = wp.static(dim)
        source = passes.fields.maps_slow
        target = passes.fields.maps_middle
        slide_out(source, 0, d, at, grid.line, grid.window_1, steps, grid.stride, target, 0, count)
        slide_out(source, 2 * d, -1, at, grid.line, grid.window_1, steps, grid.stride, target, d, count)

    return spread_slow, spread_middle


def finish_for(helpers: PassHelpers) -> Any:
    """The last pass, along the fast axis (and for narrow windows along the middle axis too)."""
    dim, scalar, width, window, whole = helpers.dim, helpers.scalar, helpers.width, helpers.window, helpers.whole
    numbers, lanes, vecs = helpers.numbers, helpers.lanes, helpers.vecs
    Passes, one, far = helpers.types.Passes, scalar(1.0), scalar(FAR)
    middle, cells_of, plane_share = helpers.middle, helpers.cells_of, helpers.plane_share
    particle_own, ahead = helpers.particle_own, helpers.ahead
    lane, times, below = lanes.lane, lanes.times, lanes.below

    @wp.func(inline=False)  # rare
    def hold_back(new: vecs.rows, u: vecs.rows, ran_away: Ints, first: int, step: int, count: int):
        """A particle that would run away stays, and marks its candidate."""
        for l in range(wp.static(width)):
            length2 = scalar(0.0)
            for i in range(wp.static(dim)):
                length2 += new[i, l] * new[i, l]
            if l < count and not (length2 < far * far):
                ran_away[first + l * step] = 1
                for i in range(wp.static(dim)):
                    new[i, l] = u[i, l]
        return new

    @wp.func
    def residual_of(passes: Passes, total: vecs.rows, u: vecs.rows, cell: int):
        """From the sum over a particle's clusters to its mean goal (eq. 3.15), less where it is; 0 if held."""
        grid = passes.grid
        fields = passes.fields
        goal = vecs.scale(total, particle_own(fields.pull, cell, grid.abreast))
        goal = vecs.add(goal, -one, vecs.scale(u, particle_own(fields.free, cell, grid.abreast)))
        for i in range(wp.static(dim)):
            if i == fields.held_axis:
                goal = vecs.with_row(goal, i, times(vecs.row(goal, i), particle_own(fields.sides, cell, grid.abreast)))
        return goal

    @wp.func
    def conclude(
        passes: Passes,
        total: vecs.rows,
        u_in: numbers,
        offset: int,
        before_in: numbers,
        before_offset: int,
        star: numbers,
        star_offset: int,
        goals_out: numbers,
        group: int,
        cell: int,
        count: int,
    ):
        """`residual_of`, or stepping (eq. 3.11) the new position, which may take the place of the one before.

        offset: from the first number of `u_in` to that of the field meant, and the same in `goals_out`; before_offset:
        the same of `before_in`, and of `goals_out` when stepping; star: x* of the step, then of the next, where whole
        windows are summed"""
        grid = passes.grid
        fields = passes.fields
        motion = passes.motion
        at = grid.front + group * grid.group + cell
        u = vecs.load(u_in, offset + at, grid.stride)
        if motion.stepping == 0:
            found = residual_of(passes, total, u, cell)
            if wp.static(whole):
                smoothing = passes.smoothing
                if smoothing.on != 0:
                    left = vecs.add(vecs.load(smoothing.left, at, grid.stride), one, found)
                    vecs.store(smoothing.left, at, grid.stride, left, count)
                    left = vecs.scale(left, lanes.own(smoothing.shrink, group, 0))
                    found = vecs.add(vecs.add(vecs.rows(), smoothing.keep, u), smoothing.gain, left)
                    z = vecs.add(vecs.load(smoothing.z, at, grid.stride), one, found)
                    vecs.store(smoothing.z, at, grid.stride, z, count)
            vecs.store(goals_out, offset + at, grid.stride, found, count)
        else:
            goal = vecs.scale(total, particle_own(fields.pull, cell, grid.abreast))
            is_free = particle_own(fields.free, cell, grid.abreast)
            if wp.static(whole):
                x = vecs.load(star, star_offset + at, grid.stride)
            else:
                before = vecs.load(before_in, before_offset + at, grid.stride)
                x = ahead(grid, u, before, motion, fields.free, cell)
            new = vecs.add(x, motion.alpha, vecs.add(goal, -one, vecs.scale(x, is_free)))
            length2 = lane()
            for i in range(wp.static(dim)):
                length2 += times(vecs.row(new, i), vecs.row(new, i))
            if below(length2, far * far) == 0:
                first, step = group * grid.abreast, wp.min(grid.abreast - 1, 1)
                new = hold_back(new, u, passes.ran_away, first, step, count)
            vecs.store(goals_out, before_offset + at, grid.stride, new, count)
            if wp.static(whole):
                x = ahead(grid, new, u, motion, fields.free, cell)
                vecs.store(star, star_offset + at, grid.stride, x, count)

    @wp.func
    def finish(
        passes: Passes,
        u_in: numbers,
        offset: int,
        before_in: numbers,
        before_offset: int,
        star: numbers,
        star_offset: int,
        goals_out: numbers,
        group: int,
        item: int,
    ):
        """Along the fast axis, and `conclude`."""
        grid = passes.grid
        source = passes.fields.maps_middle
        cell, count = plane_share(grid, item)
        at = grid.front + group * grid.group + cell
        h = middle(cells_of(grid.window_2))
        total = vecs.rows()
        for k in range(cells_of(grid.window_2)):
            here = at - k * grid.abreast
            total = vecs.add(total, one, vecs.load(source, here, grid.stride))
            slope = vecs.load(source, here + wp.static(dim) * grid.stride, grid.stride)
            total = vecs.add(total, scalar(k) - h, slope)
        conclude(
            passes, total, u_in, offset, before_in, before_offset, star, star_offset, goals_out, group, cell, count
        )

    @wp.func
    def plane_sums(passes: Passes, at: int):
        """Over the clusters of a plane: their shifts with the slopes in it, and in space their slopes across it."""
        grid = passes.grid
        maps = passes.fields.maps
        d = wp.static(dim)
        h = middle(cells_of(grid.window_2))
        total = vecs.rows()
        across = vecs.rows()
        for j in range(cells_of(grid.window_1)):
            for k in range(cells_of(grid.window_2)):
                here = at - j * grid.line - k
                total = vecs.add(total, one, vecs.load(maps, here, grid.stride))
                if wp.static(dim == 3):
                    across = vecs.add(across, one, vecs.load(maps, here + d * grid.stride, grid.stride))
                along = vecs.load(maps, here + wp.static((dim - 1) * dim) * grid.stride, grid.stride)
                total = vecs.add(total, scalar(j) - h, along)
                total = vecs.add(total, scalar(k) - h, vecs.load(maps, here + d * d * grid.stride, grid.stride))
        return total, across

    @wp.func
    def finish_planes(
        passes: Passes,
        u_in: numbers,
        offset: int,
        before_in: numbers,
        before_offset: int,
        star: numbers,
        star_offset: int,
        goals_out: numbers,
        group: int,
        item: int,
    ):
        """`finish` over whole windows: a thread goes along the slow axis, and keeps the sums of the last planes."""
        grid = passes.grid
        segment = item / grid.plane
        in_plane = item - segment * grid.plane
        first = segment * grid.run_back
        base = grid.front + group * grid.group + in_plane
        h = middle(cells_of(grid.window_0))
        last_total = vecs.rows()
        last_across = vecs.rows()
        older_total = vecs.rows()
        older_across = vecs.rows()
        for plane in range(
            first - wp.static(window - 1 if dim == 3 else 0), wp.min(first + grid.run_back, grid.cells_0)
        ):
            found, across = plane_sums(passes, base + plane * grid.plane)
            total = found
            if plane >= first:
                if wp.static(dim == 3):
                    found = vecs.add(vecs.add(found, -h, across), one, last_total)
                    found = vecs.add(found, one - h, last_across)
                if wp.static(dim == 3 and window == 3):
                    found = vecs.add(vecs.add(found, one, older_total), h, older_across)
                cell = plane * grid.plane + in_plane
                conclude(
                    passes, found, u_in, offset, before_in, before_offset, star, star_offset, goals_out, group, cell, 1
                )
            older_total = last_total
            older_across = last_across
            last_total = total
            last_across = across

    return finish_planes if whole else finish


def look_ahead_for(helpers: PassHelpers) -> Any:
    """The pass that begins time stepping."""
    numbers, vecs, ahead = helpers.numbers, helpers.vecs, helpers.ahead
    Passes = helpers.types.Passes

    @wp.func
    def look_ahead(
        passes: Passes,
        u_in: numbers,
        offset: int,
        before_in: numbers,
        before_offset: int,
        star: numbers,
        star_offset: int,
        group: int,
        item: int,
    ):
        """x* of the first step (eq. 3.1, 3.2)."""
        grid = passes.grid
        cell, count = helpers.plane_share(grid, item)
        at = grid.front + group * grid.group + cell
        before = vecs.load(before_in, before_offset + at, grid.stride)
        u = vecs.load(u_in, offset + at, grid.stride)
        x = ahead(grid, u, before, passes.motion, passes.fields.free, cell)
        vecs.store(star, star_offset + at, grid.stride, x, count)

    return look_ahead


@functools.cache
def lattice_functions_for(dim: int, scalar: Any, width: int, window: int = 0) -> SimpleNamespace:
    """The passes for `dim` = 2 or 3, scalar = wp.float32 or wp.float64, and lanes of `width`.

    window: cells of a cluster along every axis, each summed separately, narrow ones along all axes together: a GPU then
    loads all its numbers together, and waits for fewer passes; 0: any windows and runs, given by the grid"""
    helpers = pass_helpers_for(dim, scalar, width, window)
    maps = map_functions_for(helpers)
    return members(
        *(windows_fast_for(helpers), windows_middle_for(helpers), *spreads_for(helpers)),
        look_ahead_for(helpers),
        finish=finish_for(helpers),
        fit_clusters=fit_for(helpers, maps, False, "fit_clusters"),
        fit_changes=fit_for(helpers, maps, True, "fit_changes"),
        whole=helpers.whole,
        **vars(helpers.types),
    )


@functools.cache
def lattice_kernels_for(dim: int, scalar: Any, width: int, window: int = 0) -> SimpleNamespace:
    """A kernel for each pass: a GPU's threads share the items of all groups."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"lattice_{dim}d_{scalar.__name__}_{width}_{window}", scalar)
    functions = lattice_functions_for(dim, scalar, width, window)
    Passes = functions.Passes

    @kernel
    def windows_fast(passes: Passes, running: Ints, u_in: numbers, before_in: numbers):
        group, item = wp.tid()
        if running[group] != 0:
            functions.windows_fast(passes, u_in, 0, before_in, 0, group, item)

    @kernel
    def look_ahead(passes: Passes, running: Ints, u_in: numbers, before_in: numbers, star: numbers):
        group, item = wp.tid()
        if running[group] != 0:
            functions.look_ahead(passes, u_in, 0, before_in, 0, star, 0, group, item)

    @kernel
    def finish(passes: Passes, running: Ints, u_in: numbers, before_in: numbers, star: numbers, out: numbers):
        group, item = wp.tid()
        if running[group] != 0:
            functions.finish(passes, u_in, 0, before_in, 0, star, 0, out, group, item)

    def pass_of(name: str) -> Any:
        """The kernel of a pass over fields that passes leave to each other."""
        function = getattr(functions, name)

        @kernel(name=name)
        def one_pass(passes: Passes, running: Ints):
            group, item = wp.tid()
            if running[group] != 0:
                function(passes, group, item)

        return one_pass

    def fit_of(name: str) -> Any:
        """The kernel that ends the window sums of a field."""
        function = getattr(functions, name)

        # else too few threads fit to hide what they wait for
        @kernel(name=name, launch_bounds=(256, 2))
        def fit(passes: Passes, running: Ints, u_in: numbers):
            group, item = wp.tid()
            if running[group] != 0:
                function(passes, u_in, 0, group, item)

        return fit

    fits = (fit_of(name) for name in ("fit_clusters", "fit_changes"))
    passes = (pass_of(name) for name in ("windows_middle", "spread_slow", "spread_middle"))
    return members(windows_fast, look_ahead, finish, *passes, *fits)
