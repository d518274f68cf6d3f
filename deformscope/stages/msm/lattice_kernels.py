"""Warp kernels of lattice clusters: separable window sums, whose cost does not grow with the width of a cluster.

FastLSM (Rivers and James 2007) sums the raw moments of all windows by prefix sums, which float32 cannot hold. Here the
sums are local: each axis in turn adds up, over its window, what the axis before left, and the first moments are taken
about the middle of the window. A thread slides along the axis for `run` cells, adding the cell that enters and
subtracting the one that leaves; with `run` = 1 it adds up one window only, which is what a GPU wants for small ones.

A lattice has three axes (slow to fast: 0, 1, 2); in the plane the first has one cell. A cluster lives at the cell of
its lowest corner. Fields are structures of arrays; a cell's place is the same in every field. Places that no cluster
and no particle has stay 0 for ever, which is what lets every window run over the edges without asking.

Annotations here are read by warp while the closures are made, so they are not postponed (no `__future__` import).
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import GOAL, cluster_functions_for
from deformscope.stages.msm.lanes import CPU_FLAGS, lanes_for, product_for, rows_for

RESIDUAL, CHANGE, STEP = 0, 1, 2
"""What the last pass makes of the mean goals: goal - u, J p - p, or the next state of time stepping."""


@dataclass(frozen=True, slots=True)
class LatticeKernels:
    """The compiled set and its struct types."""

    grid: Any
    site: Any
    motion: Any
    windows_fast: Any
    windows_middle: Any
    fit_clusters: Any
    fit_changes: Any
    spread_slow: Any
    spread_middle: Any
    finish: Any


@functools.cache
def lattice_kernels_for(dim: int, scalar: Any, width: int) -> LatticeKernels:
    """The kernels for `dim` = 2 or 3, scalar = wp.float32 or wp.float64, and lanes of `width`."""
    module = f"deformscope_lattice_{dim}d_{scalar.__name__}_{width}"
    wp.get_module(module).options.update({"enable_backward": False, "max_unroll": 3, "cpu_compiler_flags": CPU_FLAGS})
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
    axes = dim
    lanes = lanes_for(width, scalar)
    lane, own, choose, times, below = lanes.lane, lanes.own, lanes.choose, lanes.times, lanes.below
    load_lane, store_lane = lanes.load, lanes.store
    vecs = rows_for(dim, width, scalar)
    axis_vecs = rows_for(axes, width, scalar)
    squares = rows_for(dim * dim, width, scalar)
    maps = rows_for(axes * dim, width, scalar)
    load, store, add, row, with_row, only = vecs.load, vecs.store, vecs.add, vecs.row, vecs.with_row, vecs.choose
    scale, own_mean, row_of_mean = vecs.scale, axis_vecs.own, axis_vecs.row
    own_map, store_map, only_map, with_map, row_of_map = maps.own, maps.store, maps.choose, maps.with_row, maps.row
    square_times_map = product_for(dim, axes, dim, width, scalar)
    map_times_square = product_for(axes, dim, dim, width, scalar)
    cluster = cluster_functions_for(dim, dim, scalar, width)
    fit, fit_change = cluster.fit, cluster.fit_change
    one = scalar(1.0)
    number = f"wp::{scalar.__name__}"
    each = f"for (int l = 0; l < {width}; ++l)"
    moved = " + ".join(f"mean.data[{a}][l] * slopes.data[{a * dim} + i][l]" for a in range(axes))
    far = scalar(1e4)

    def matrix_c(rows: int) -> str:
        return f"wp::mat_t<{rows}, {width}, {number}>"

    @wp.struct
    class Grid:
        """The lattice, the windows of its clusters, and where fields keep them.

        cells: along axes 0 and 1; clusters: along axes 0 and 1; plane, line: cells of one step along axis 0 and 1, each
        times `abreast`; abreast: candidates side by side in the lanes (1: cells side by side); front: numbers before
        the first place of a field; group: numbers from one group of candidates to the next; stride: from one row of a
        field to the next; window_0...: cells of a cluster along the axis; line_end, plane_end, cluster_end: numbers
        that a line, a plane, and the clusters of a plane fill
        """

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
        plane_end: int
        cluster_end: int

    @wp.struct
    class Site:
        """What a cluster is at rest: `stride` between rows, `step` 1 where each has its own, else 0 (all are alike)."""

        valid: wp.array(dtype=scalar)  # 1 at a cell that has a cluster
        share: wp.array(dtype=scalar)  # 1 / mass of the window
        mean: wp.array(dtype=scalar)  # mean offset of the mass from the middle of the window, in cells
        affine: wp.array(dtype=scalar)  # from first moments to A~ - I, transposed: (dim, axes)
        moment: wp.array(dtype=scalar)  # from first moments to A_pq - A_qq, transposed: (dim, axes)
        edge_t: wp.array(dtype=scalar)  # the lattice's edges: an offset in cells to particle spacings, (axes, dim)
        stride: int
        step: int

    @wp.struct
    class Motion:
        """What time stepping adds: alpha, the share of the last motion that goes on, and a push each step."""

        alpha: scalar
        going_on: scalar
        push: wp.array(dtype=scalar)

    @wp.func
    def middle(window: int):
        return scalar(0.5) * scalar(window - 1)

    @wp.func
    def slide_in(
        source: wp.array(dtype=scalar),
        row_in: int,
        first: int,
        step: int,
        window: int,
        run: int,
        stride: int,
        target: wp.array(dtype=scalar),
        row_sum: int,
        row_moment: int,
        count: int,
    ):
        """Sums (and first moments, where row_moment >= 0) of a vector over windows that start at `first`, `run` of them."""
        total = vecs.rows()
        moment = vecs.rows()
        h = middle(window)
        at = first + row_in * stride
        for k in range(window):
            v = load(source, at + k * step, stride)
            total = add(total, one, v)
            if row_moment >= 0:
                moment = add(moment, scalar(k) - h, v)
        for j in range(run):
            place = first + j * step
            store(target, place + row_sum * stride, stride, total, count)
            if row_moment >= 0:
                store(target, place + row_moment * stride, stride, moment, count)
            if j + 1 < run:
                leaves = load(source, place + row_in * stride, stride)
                enters = load(source, place + row_in * stride + window * step, stride)
                if row_moment >= 0:
                    moment = add(add(add(moment, -one, total), one + h, leaves), h, enters)
                total = add(add(total, -one, leaves), one, enters)

    @wp.func
    def slide_out(
        source: wp.array(dtype=scalar),
        row_in: int,
        row_slope: int,
        first: int,
        step: int,
        window: int,
        run: int,
        stride: int,
        target: wp.array(dtype=scalar),
        row_sum: int,
        count: int,
    ):
        """Sums over the clusters that a place belongs to, of a vector and (row_slope >= 0) of a slope times its offset."""
        total = vecs.rows()
        slopes = vecs.rows()
        h = middle(window)
        for k in range(window):
            at = first - k * step
            total = add(total, one, load(source, at + row_in * stride, stride))
            if row_slope >= 0:
                slope = load(source, at + row_slope * stride, stride)
                total = add(total, scalar(k) - h, slope)
                slopes = add(slopes, one, slope)
        for j in range(run):
            place = first + j * step
            store(target, place + row_sum * stride, stride, total, count)
            if j + 1 < run:
                leaves = place - (window - 1) * step
                enters = place + step
                total = add(total, -one, load(source, leaves + row_in * stride, stride))
                total = add(total, one, load(source, enters + row_in * stride, stride))
                if row_slope >= 0:
                    old = load(source, leaves + row_slope * stride, stride)
                    new = load(source, enters + row_slope * stride, stride)
                    total = add(add(add(total, one, slopes), -one - h, old), -h, new)
                    slopes = add(add(slopes, -one, old), one, new)

    @kernel
    def windows_fast(
        grid: Grid,
        # In:
        u_in: wp.array(dtype=scalar),
        before_in: wp.array(dtype=scalar),
        motion: Motion,
        mass: wp.array(dtype=scalar),
        free: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        stepping: int,
        # Out:
        sums_out: wp.array(dtype=scalar),
    ):
        """Windows along the fast axis of m u, or of m x* (eq. 3.1, 3.2): sum, first moment."""
        group, plane, block = wp.tid()
        if running[group] == 0:
            return
        in_plane = block * wp.static(width)
        cell = plane * grid.plane + in_plane
        at = grid.front + group * grid.group + cell
        count = grid.plane_end - in_plane
        h = middle(grid.window_2)
        total = vecs.rows()
        moment = vecs.rows()
        for k in range(grid.window_2):
            here = at + k * grid.abreast
            v = load(u_in, here, grid.stride)
            if stepping != 0:
                v = ahead(grid, v, before_in, motion, free, here, cell + k * grid.abreast)
            v = scale(v, particle_own(mass, cell + k * grid.abreast, grid.abreast))
            total = add(total, one, v)
            moment = add(moment, scalar(k) - h, v)
        store(sums_out, at, grid.stride, total, count)
        store(sums_out, at + wp.static(dim) * grid.stride, grid.stride, moment, count)

    @wp.func
    def particle_own(values: wp.array(dtype=scalar), cell: int, abreast: int):
        """What belongs to a particle, for the lanes at `cell` (of one group); one value if all are alike."""
        if values.shape[0] == 1:
            return own(values, 0, 0)
        if abreast == 1:
            return own(values, cell, 1)
        return own(values, cell / abreast, 0)

    @wp.func
    def ahead(
        grid: Grid,
        u: vecs.rows,
        before_in: wp.array(dtype=scalar),
        motion: Motion,
        free: wp.array(dtype=scalar),
        here: int,
        cell: int,
    ):
        """x* of eq. 3.1, 3.2: where the last motion and the push would take a free particle."""
        back = add(u, -one, load(before_in, here, grid.stride))
        moves = vecs.rows()
        moves = add(moves, motion.going_on, back)
        for k in range(wp.static(dim)):
            moves = with_row(moves, k, row(moves, k) + lane(motion.push[k]))
        return add(u, one, scale(moves, particle_own(free, cell, grid.abreast)))

    @kernel
    def windows_middle(
        grid: Grid,
        run: int,
        blocks: int,
        # In:
        sums_in: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        sums_out: wp.array(dtype=scalar),
    ):
        """Windows along the middle axis: sum, first moment along it, and the first moment along the fast axis."""
        group, plane, item = wp.tid()
        if running[group] == 0:
            return
        segment = item / blocks
        block = item - segment * blocks
        first_line = segment * run
        steps = wp.min(run, grid.clusters_1 - first_line)
        in_line = block * wp.static(width)
        end = grid.line
        if run == 1:
            end = grid.clusters_1 * grid.line  # lines follow each other: the lanes run through
            steps = 1
        count = end - in_line
        if run == 1:
            first_line = 0
        at = grid.front + group * grid.group + plane * grid.plane + first_line * grid.line + in_line
        d = wp.static(dim)
        slide_in(sums_in, 0, at, grid.line, grid.window_1, steps, grid.stride, sums_out, 0, d, count)
        slide_in(sums_in, d, at, grid.line, grid.window_1, steps, grid.stride, sums_out, 2 * d, -1, count)

    @wp.func_native(
        f"{matrix_c(axes * dim)} r; for (int a = 0; a < {axes}; ++a) for (int i = 0; i < {dim}; ++i) {each}"
        f" r.data[a * {dim} + i][l] = valid.c[l] > 0 ? moments.data[a * {dim} + i][l]"
        f" - mean.data[a][l] * total.data[i][l] : {number}(0); return r;"
    )
    def centred(moments: maps.rows, mean: axis_vecs.rows, total: vecs.rows, valid: lane) -> maps.rows:
        """First moments about the centre of mass; 0 where there is no cluster."""
        ...

    @wp.func_native(
        f"{matrix_c(dim)} r; for (int i = 0; i < {dim}; ++i) {each} r.data[i][l] = valid.c[l] > 0"
        f" ? share.c[l] * total.data[i][l] - ({moved}) : {number}(0); return r;"
    )
    def shift_of(total: vecs.rows, share: lane, mean: axis_vecs.rows, slopes: maps.rows, valid: lane) -> vecs.rows:
        """Goal displacement at the middle of the window."""
        ...

    @wp.func_native(
        f"{matrix_c(axes * dim)} r; for (int i = 0; i < {dim}; ++i) {each} {{ r.data[i][l] = a.data[i][l];"
        f" r.data[{dim} + i][l] = b.data[i][l];"
        + (f" r.data[{2 * dim} + i][l] = c.data[i][l];" if dim == 3 else "")
        + " } return r;"
    )
    def stacked(a: vecs.rows, b: vecs.rows, c: vecs.rows) -> maps.rows: ...

    @wp.func
    def fitted(
        grid: Grid,
        site: Site,
        rest: cluster.rest,
        kept: cluster.kept,
        at: int,
        cell: int,
        group: int,
        total: vecs.rows,
        moments: maps.rows,
        beta_in: wp.array(dtype=scalar),
        beta_stride: int,
        theta_in: wp.array(dtype=scalar),
        volume: int,
        what: int,
        maps_out: wp.array(dtype=scalar),
        count: int,
    ):
        """From the moments of a cluster to its goal map, as what the particles add up: a shift, and slopes by axis."""
        place, own_valid, step = rest_place(grid, site, cell)
        valid = own(site.valid, cell / grid.abreast, own_valid)
        mean = own_mean(site.mean, place, site.stride, step)
        moments = centred(moments, mean, total, valid)
        affine_t = square_times_map(own_map(site.affine, place, site.stride, step), moments)
        change_t = square_times_map(own_map(site.moment, place, site.stride, step), moments)
        beta = parameter(grid, beta_in, beta_stride, group, cell)
        theta = parameter(grid, theta_in, 0, group, cell)
        blend_t = fit(rest, place, step, kept, at, count, affine_t, change_t, beta, theta, volume, what)
        slopes = map_times_square(own_map(site.edge_t, 0, 1, 0), blend_t)
        share = own(site.share, place, step)
        if what != wp.static(GOAL):
            share = lane()
        store(maps_out, at, grid.stride, shift_of(total, share, mean, slopes, valid), count)
        store_map(maps_out, at + wp.static(dim) * grid.stride, grid.stride, only_map(valid, slopes), count)

    @wp.func
    def changed(
        grid: Grid,
        site: Site,
        rest: cluster.rest,
        kept: cluster.kept,
        at: int,
        cell: int,
        group: int,
        total: vecs.rows,
        moments: maps.rows,
        beta_in: wp.array(dtype=scalar),
        beta_stride: int,
        theta_in: wp.array(dtype=scalar),
        volume: int,
        what: int,
        maps_out: wp.array(dtype=scalar),
        count: int,
    ):
        """Derivative of `fitted` along the direction that the moments belong to."""
        place, own_valid, step = rest_place(grid, site, cell)
        valid = own(site.valid, cell / grid.abreast, own_valid)
        mean = own_mean(site.mean, place, site.stride, step)
        moments = centred(moments, mean, total, valid)
        affine_t = square_times_map(own_map(site.affine, place, site.stride, step), moments)
        change_t = square_times_map(own_map(site.moment, place, site.stride, step), moments)
        beta = parameter(grid, beta_in, beta_stride, group, cell)
        theta = parameter(grid, theta_in, 0, group, cell)
        blend_t = fit_change(rest, place, step, kept, at, affine_t, change_t, beta, theta, volume)
        slopes = map_times_square(own_map(site.edge_t, 0, 1, 0), blend_t)
        share = own(site.share, place, step)
        store(maps_out, at, grid.stride, shift_of(total, share, mean, slopes, valid), count)
        store_map(maps_out, at + wp.static(dim) * grid.stride, grid.stride, only_map(valid, slopes), count)

    @wp.func
    def rest_place(grid: Grid, site: Site, cell: int):
        """Where a cluster's rest data are, whether each lane has its own `valid`, and whether each has its own rest."""
        differ = 0
        if grid.abreast == 1:
            differ = 1
        if site.step == 0:
            return 0, differ, 0
        return cell / grid.abreast, differ, differ

    @wp.func
    def parameter(grid: Grid, values: wp.array(dtype=scalar), stride: int, group: int, cell: int):
        """A candidate's parameter, or (stride > 0) that of each cluster."""
        if stride > 0:
            return own(values, group * stride + cell, 1)
        if grid.abreast == 1:
            return own(values, group, 0)
        return own(values, group * grid.abreast, 1)

    def windows_slow(solve: Any, name: str) -> Any:
        """The kernel that ends the window sums and hands them to `solve`."""

        def windows(
            grid: Grid,
            site: Site,
            rest: cluster.rest,
            kept: cluster.kept,
            run: int,
            # In:
            sums_in: wp.array(dtype=scalar),
            beta: wp.array(dtype=scalar),
            beta_stride: int,
            theta: wp.array(dtype=scalar),
            volume: int,
            what: int,
            running: wp.array(dtype=int),
            # Out:
            maps_out: wp.array(dtype=scalar),
        ):
            """Windows along the slow axis, and with them each cluster's map."""
            group, segment, block = wp.tid()
            if running[group] == 0:
                return
            in_plane = block * wp.static(width)
            first = segment * run
            steps = wp.min(run, grid.clusters_0 - first)
            count = grid.cluster_end - in_plane
            base = grid.front + group * grid.group
            d = wp.static(dim)
            if wp.static(dim) == 2:
                at = base + in_plane
                total = load(sums_in, at, grid.stride)
                slow = load(sums_in, at + d * grid.stride, grid.stride)
                fast = load(sums_in, at + 2 * d * grid.stride, grid.stride)
                moments = stacked(slow, fast, fast)
                solve(
                    grid, site, rest, kept, at, in_plane, group, total, moments, beta, beta_stride, theta, volume, what,
                    maps_out, count,
                )  # fmt: skip
            if wp.static(dim) == 3:
                h = middle(grid.window_0)
                total = vecs.rows()
                slow = vecs.rows()
                mid = vecs.rows()
                fast = vecs.rows()
                at = base + first * grid.plane + in_plane
                for k in range(grid.window_0):
                    here = at + k * grid.plane
                    v = load(sums_in, here, grid.stride)
                    total = add(total, one, v)
                    slow = add(slow, scalar(k) - h, v)
                    mid = add(mid, one, load(sums_in, here + d * grid.stride, grid.stride))
                    fast = add(fast, one, load(sums_in, here + 2 * d * grid.stride, grid.stride))
                for j in range(steps):
                    place = at + j * grid.plane
                    moments = stacked(slow, mid, fast)
                    solve(
                        grid, site, rest, kept, place, (first + j) * grid.plane + in_plane, group, total, moments, beta,
                        beta_stride, theta, volume, what, maps_out, count,
                    )  # fmt: skip
                    if j + 1 < steps:
                        over = grid.window_0 * grid.plane
                        leaves = load(sums_in, place, grid.stride)
                        enters = load(sums_in, place + over, grid.stride)
                        slow = add(add(add(slow, -one, total), one + h, leaves), h, enters)
                        total = add(add(total, -one, leaves), one, enters)
                        mid = add(mid, -one, load(sums_in, place + d * grid.stride, grid.stride))
                        mid = add(mid, one, load(sums_in, place + d * grid.stride + over, grid.stride))
                        fast = add(fast, -one, load(sums_in, place + 2 * d * grid.stride, grid.stride))
                        fast = add(fast, one, load(sums_in, place + 2 * d * grid.stride + over, grid.stride))

        windows.__name__ = windows.__qualname__ = name
        return kernel(windows)

    fit_clusters = windows_slow(fitted, "fit_clusters")
    fit_changes = windows_slow(changed, "fit_changes")

    @kernel
    def spread_slow(
        grid: Grid,
        run: int,
        # In:
        maps_in: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        maps_out: wp.array(dtype=scalar),
    ):
        """Along the slow axis, what the clusters of a particle add up: the shift with its slope, and the two other slopes."""
        group, segment, block = wp.tid()
        if running[group] == 0:
            return
        in_plane = block * wp.static(width)
        first = segment * run
        steps = wp.min(run, grid.cells_0 - first)
        count = grid.cluster_end - in_plane
        at = grid.front + group * grid.group + first * grid.plane + in_plane
        d = wp.static(dim)
        slide_out(maps_in, 0, d, at, grid.plane, grid.window_0, steps, grid.stride, maps_out, 0, count)
        slide_out(maps_in, 2 * d, -1, at, grid.plane, grid.window_0, steps, grid.stride, maps_out, d, count)
        slide_out(maps_in, 3 * d, -1, at, grid.plane, grid.window_0, steps, grid.stride, maps_out, 2 * d, count)

    @kernel
    def spread_middle(
        grid: Grid,
        run: int,
        blocks: int,
        # In:
        maps_in: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        maps_out: wp.array(dtype=scalar),
    ):
        """The same along the middle axis: the shift with its slope, and the slope along the fast axis."""
        group, plane, item = wp.tid()
        if running[group] == 0:
            return
        segment = item / blocks
        block = item - segment * blocks
        first_line = segment * run
        steps = wp.min(run, grid.cells_1 - first_line)
        in_line = block * wp.static(width)
        end = grid.line
        if run == 1:
            end = grid.plane_end
            steps = 1
            first_line = 0
        count = end - in_line
        at = grid.front + group * grid.group + plane * grid.plane + first_line * grid.line + in_line
        d = wp.static(dim)
        slide_out(maps_in, 0, d, at, grid.line, grid.window_1, steps, grid.stride, maps_out, 0, count)
        slide_out(maps_in, 2 * d, -1, at, grid.line, grid.window_1, steps, grid.stride, maps_out, d, count)

    @kernel
    def finish(
        grid: Grid,
        # In:
        maps_in: wp.array(dtype=scalar),
        u_in: wp.array(dtype=scalar),
        before_in: wp.array(dtype=scalar),
        motion: Motion,
        pull: wp.array(dtype=scalar),
        free: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        what: int,
        # Out:
        out: wp.array(dtype=scalar),
        ran_away: wp.array(dtype=int),
    ):
        """Along the fast axis, and with it the mean goal of each particle (eq. 3.15), less where it is; 0 if held.

        pull: 1 / number of clusters, 0 for a held particle and for a missing one. With `what` = STEP, eq. 3.11: the new
        position, which may take the place of the one before. A particle that would run away marks its candidate.
        """
        group, plane, block = wp.tid()
        if running[group] == 0:
            return
        in_plane = block * wp.static(width)
        cell = plane * grid.plane + in_plane
        at = grid.front + group * grid.group + cell
        count = grid.plane_end - in_plane
        d = wp.static(dim)
        h = middle(grid.window_2)
        total = vecs.rows()
        for k in range(grid.window_2):
            here = at - k * grid.abreast
            total = add(total, one, load(maps_in, here, grid.stride))
            total = add(total, scalar(k) - h, load(maps_in, here + d * grid.stride, grid.stride))
        u = load(u_in, at, grid.stride)
        is_free = particle_own(free, cell, grid.abreast)
        if what == wp.static(STEP):
            star = ahead(grid, u, before_in, motion, free, at, cell)
            goal = scale(total, particle_own(pull, cell, grid.abreast))
            pulled = add(goal, -one, scale(star, is_free))
            new = add(star, motion.alpha, pulled)
            length2 = lane()
            for i in range(d):
                length2 += times(row(new, i), row(new, i))
            if below(length2, far * far) == 0:
                for l in range(wp.static(width)):
                    if l < count and not (length2[l] < far * far):
                        if grid.abreast == 1:
                            ran_away[group] = 1
                        else:
                            ran_away[group * grid.abreast + l] = 1
                        for i in range(d):
                            new[i, l] = u[i, l]
            store(out, at, grid.stride, new, count)
        else:
            goal = scale(total, particle_own(pull, cell, grid.abreast))
            store(out, at, grid.stride, add(goal, -one, scale(u, is_free)), count)

    return LatticeKernels(
        Grid,
        Site,
        Motion,
        windows_fast,
        windows_middle,
        fit_clusters,
        fit_changes,
        spread_slow,
        spread_middle,
        finish,
    )
