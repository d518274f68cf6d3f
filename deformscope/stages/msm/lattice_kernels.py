"""Warp kernels of lattice clusters: separable window sums, whose cost does not grow with the width of a cluster.

FastLSM (Rivers and James 2007) sums the raw moments of all windows by prefix sums, which float32 cannot hold. Here the
sums are local: each axis in turn sums, over its window, the results of the axis before, and the first moments are
relative to the middle of the window. A thread slides along the axis for `run` cells, adding the cell that enters and
subtracting the one that leaves. With `run` = 1 it sums one window only, which suits a GPU for small ones.

A lattice has three axes (slow to fast: 0, 1, 2); in the plane the first has one cell. A cluster lives at the cell of
its lowest corner. Fields are structures of arrays; a cell's place is the same in every field. Places without a cluster
or a particle always stay 0, so that windows may extend beyond the edges without a test.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import GOAL, cluster_functions_for
from deformscope.stages.msm.lanes import Ints, lanes_for, product_for, rows_for
from deformscope.stages.msm.members import kernel_in, members

BOTH = 4
"""Widest windows that a GPU sums up along two axes at once; of wider ones that takes longer than one more pass."""

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
def lattice_functions_for(dim: int, scalar: Any, width: int, window: int = 0) -> SimpleNamespace:
    """The functions for `dim` = 2 or 3, scalar = wp.float32 or wp.float64, and lanes of `width`.

    window: cells of a cluster along every axis, each summed separately, narrow ones along two axes together: a GPU then
    loads all its numbers together, and waits for fewer passes; 0: any windows and runs, given by the grid
    """
    numbers = wp.array(dtype=scalar)
    Motion = motion_for(scalar)
    lanes = lanes_for(width, scalar)
    lane, own, times, below = lanes.lane, lanes.own, lanes.times, lanes.below
    vecs = rows_for(dim, width, scalar)
    maps = rows_for(dim * dim, width, scalar)
    load, store, add, row, with_row = vecs.load, vecs.store, vecs.add, vecs.row, vecs.with_row
    scale, own_mean = vecs.scale, vecs.own
    own_map, store_map, only_map = maps.own, maps.store, maps.choose
    product = product_for(dim, dim, dim, width, scalar)
    cluster = cluster_functions_for(dim, dim, scalar, width)
    own_moments = rows_for(dim * (dim + 1) // 2, width, scalar).own
    one = scalar(1.0)
    both = 0 < window <= BOTH
    number = f"wp::{scalar.__name__}"
    each = f"for (int l = 0; l < {width}; ++l)"
    moved = " + ".join(f"mean.data[{a}][l] * slopes.data[{a * dim} + i][l]" for a in range(dim))
    far = scalar(FAR)

    def matrix_c(rows: int) -> str:
        return f"wp::mat_t<{rows}, {width}, {number}>"

    @wp.struct
    class Grid:
        """The lattice, the windows of its clusters, and where fields keep them.

        cells: along axes 0 and 1; clusters: along axes 0 and 1; plane, line: cells of one step along axis 0 and 1, each
        times `abreast`; abreast: candidates side by side in the lanes (1: cells side by side); front: numbers before
        the first place of a field; group: numbers from one group of candidates to the next; stride: from one row of a
        field to the next; window_0...: cells of a cluster along the axis; cluster_end: numbers that the clusters of a
        plane fill; run_0, run_1: cells of a sliding sum along an axis; items_*: of a pass, in a group; blocks_*: of
        these, in a plane (or a line)
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
        what: GOAL, BY_BETA or BY_THETA; beta_stride: see `body.Parameters`
        """

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
        what: int

    @wp.struct
    class Passes:
        """Parameters of the passes; motion: those of time stepping, or none.

        pair: the displacement, and the direction or the displacement one step before, as one field; pair_out: the
        residual and the direction's change; threads: number of threads of a resident block
        """

        grid: Grid
        site: Site
        rest: cluster.FitRest
        kept: cluster.Kept
        fields: Fields
        motion: Motion
        threads: int
        pair: numbers
        pair_out: numbers
        ran_away: Ints

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
    def slide_in(
        source: numbers,
        row_in: int,
        first: int,
        step: int,
        window_here: int,
        run: int,
        stride: int,
        target: numbers,
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
            v = load(source, at + k * step, stride)
            total = add(total, one, v)
            if row_moment >= 0:
                moment = add(moment, scalar(k) - h, v)
        for j in range(run_of(run)):
            place = first + j * step
            store(target, place + row_sum * stride, stride, total, count)
            if row_moment >= 0:
                store(target, place + row_moment * stride, stride, moment, count)
            if j + 1 < run_of(run):
                leaves = load(source, place + row_in * stride, stride)
                enters = load(source, place + row_in * stride + window_here * step, stride)
                if row_moment >= 0:
                    moment = add(add(add(moment, -one, total), one + h, leaves), h, enters)
                total = add(add(total, -one, leaves), one, enters)

    @wp.func
    def slide_out(
        source: numbers,
        row_in: int,
        row_slope: int,
        first: int,
        step: int,
        window_here: int,
        run: int,
        stride: int,
        target: numbers,
        row_sum: int,
        count: int,
    ):
        """Sums over the clusters of a place, of a vector and (if row_slope >= 0) of a slope times its offset."""
        total = vecs.rows()
        slopes = vecs.rows()
        h = middle(cells_of(window_here))
        for k in range(cells_of(window_here)):
            at = first - k * step
            total = add(total, one, load(source, at + row_in * stride, stride))
            if row_slope >= 0:
                slope = load(source, at + row_slope * stride, stride)
                total = add(total, scalar(k) - h, slope)
                slopes = add(slopes, one, slope)
        for j in range(run_of(run)):
            place = first + j * step
            store(target, place + row_sum * stride, stride, total, count)
            if j + 1 < run_of(run):
                leaves = place - (window_here - 1) * step
                enters = place + step
                total = add(total, -one, load(source, leaves + row_in * stride, stride))
                total = add(total, one, load(source, enters + row_in * stride, stride))
                if row_slope >= 0:
                    old = load(source, leaves + row_slope * stride, stride)
                    new = load(source, enters + row_slope * stride, stride)
                    total = add(add(add(total, one, slopes), -one - h, old), -h, new)
                    slopes = add(add(slopes, -one, old), one, new)

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
    def windows_fast(
        passes: Passes, u_in: numbers, offset: int, before_in: numbers, before_offset: int, group: int, item: int
    ):
        """Windows along the fast axis of m u, or of m x* (eq. 3.1, 3.2): sum, first moment.

        Narrow windows along the middle axis too: see `windows_middle`.
        """
        grid = passes.grid
        fields = passes.fields
        motion = passes.motion
        if wp.static(both):
            cell, _steps, count = share_of(grid, item, grid.items_windows, grid.blocks_windows, grid.clusters_1)
            lines = cells_of(grid.window_1)
        else:
            cell, count = plane_share(grid, item)
            lines = int(1)
        at = grid.front + group * grid.group + cell
        d = wp.static(dim)
        h_1, h = middle(cells_of(grid.window_1)), middle(cells_of(grid.window_2))
        total = vecs.rows()
        mid = vecs.rows()
        fast = vecs.rows()
        for j in range(lines):
            along = vecs.rows()
            for k in range(cells_of(grid.window_2)):
                away = j * grid.line + k * grid.abreast
                v = load(u_in, offset + at + away, grid.stride)
                if motion.stepping != 0:
                    v = ahead(grid, v, before_in, motion, fields.free, before_offset + at + away, cell + away)
                v = scale(v, particle_own(fields.mass, cell + away, grid.abreast))
                along = add(along, one, v)
                fast = add(fast, scalar(k) - h, v)
            total = add(total, one, along)
            mid = add(mid, scalar(j) - h_1, along)
        if wp.static(both):
            store(fields.sums_middle, at, grid.stride, total, count)
            store(fields.sums_middle, at + d * grid.stride, grid.stride, mid, count)
            store(fields.sums_middle, at + 2 * d * grid.stride, grid.stride, fast, count)
        else:
            store(fields.sums_fast, at, grid.stride, total, count)
            store(fields.sums_fast, at + d * grid.stride, grid.stride, fast, count)

    @wp.func
    def particle_own(values: numbers, cell: int, abreast: int):
        """Data of a particle, for the lanes at `cell` (of one group); one value if all are alike."""
        if values.shape[0] == 1:
            return own(values, 0, 0)
        if wp.static(width == 1) or abreast == 1:
            return own(values, cell, 1)
        return own(values, cell / abreast, 0)

    @wp.func
    def ahead(grid: Grid, u: vecs.rows, before_in: numbers, motion: Motion, free: numbers, here: int, cell: int):
        """x* of eq. 3.1, 3.2: where the last motion and the push would take a free particle."""
        back = add(u, -one, load(before_in, here, grid.stride))
        moves = vecs.rows()
        moves = add(moves, motion.going_on, back)
        for k in range(wp.static(dim)):
            moves = with_row(moves, k, row(moves, k) + lane(motion.push[k]))
        return add(u, one, scale(moves, particle_own(free, cell, grid.abreast)))

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

    @wp.func_native(
        f"{matrix_c(dim * dim)} r; for (int a = 0; a < {dim}; ++a) for (int i = 0; i < {dim}; ++i) {each}"
        f" r.data[a * {dim} + i][l] = valid.c[l] > 0 ? moments.data[a * {dim} + i][l]"
        f" - mean.data[a][l] * total.data[i][l] : {number}(0); return r;"
    )
    def centred(moments: maps.rows, mean: vecs.rows, total: vecs.rows, valid: lane) -> maps.rows:
        """First moments about the centre of mass; 0 where there is no cluster."""

    @wp.func_native(
        f"{matrix_c(dim)} r; for (int i = 0; i < {dim}; ++i) {each} r.data[i][l] = valid.c[l] > 0"
        f" ? share.c[l] * total.data[i][l] - ({moved}) : {number}(0); return r;"
    )
    def shift_of(total: vecs.rows, share: lane, mean: vecs.rows, slopes: maps.rows, valid: lane) -> vecs.rows:
        """Goal displacement at the middle of the window."""

    @wp.func_native(
        f"{matrix_c(dim * dim)} r; for (int i = 0; i < {dim}; ++i) {each} {{ r.data[i][l] = a.data[i][l];"
        f" r.data[{dim} + i][l] = b.data[i][l];"
        + (f" r.data[{2 * dim} + i][l] = c.data[i][l];" if dim == 3 else "")
        + " } return r;"
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

    def fits(changing: bool, name: str) -> Any:
        """The function that ends the window sums, and computes a cluster's goal map from its moments, or with
        `changing` its derivative along them."""

        @wp.func(name=f"{name}_at")
        def solve(passes: Passes, at: int, cell: int, group: int, total: vecs.rows, moments: maps.rows, count: int):
            """The goal map as sums for the particles: a shift, and slopes by axis."""
            grid = passes.grid
            site = passes.site
            rest = passes.rest
            kept = passes.kept
            fields = passes.fields
            place, valid_place, differ = rest_place(grid, site, cell)
            valid = own(site.valid, valid_place, differ)
            step = differ * site.step
            mean = own_mean(site.mean, place, site.stride, step)
            moments = centred(moments, mean, total, valid)
            affine_t = product(own_map(site.affine, place, site.stride, step), moments)
            change_t = product(own_map(site.moment, place, site.stride, step), moments)
            beta = parameter(grid, fields.beta, fields.beta_stride, group, cell)
            theta = parameter(grid, fields.theta, 0, group, cell)
            volume = fields.volume
            if wp.static(changing):
                t = cluster.turned_change(kept, at, change_t)
                blend_t = cluster.blend_change(rest, place, step, kept, at, affine_t, t, beta, theta, volume)
            else:
                a_qq = own_moments(rest.a_qq, place, rest.stride, step)
                t = cluster.turned(kept, at, count, a_qq, change_t)
                blend_t = cluster.blend(
                    rest, place, step, kept, at, count, affine_t, t, beta, theta, volume, fields.what
                )
            slopes = product(own_map(site.edge_t, 0, 1, 0), blend_t)
            share = own(site.share, place, step)
            if fields.what != wp.static(GOAL):
                share = lane()
            store(fields.maps, at, grid.stride, shift_of(total, share, mean, slopes, valid), count)
            store_map(fields.maps, at + wp.static(dim) * grid.stride, grid.stride, only_map(valid, slopes), count)

        @wp.func(name=name)
        def windows(passes: Passes, group: int, item: int):
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
                slow = load(source, at + d * grid.stride, grid.stride)
                fast = load(source, at + 2 * d * grid.stride, grid.stride)
                total = load(source, at, grid.stride)
                solve(passes, at, in_plane, group, total, stacked(slow, fast, fast), count)
            if wp.static(dim) == 3:
                h = middle(cells_of(grid.window_0))
                total = vecs.rows()
                slow = vecs.rows()
                mid = vecs.rows()
                fast = vecs.rows()
                at = base + first * grid.plane + in_plane
                for k in range(cells_of(grid.window_0)):
                    here = at + k * grid.plane
                    v = load(source, here, grid.stride)
                    total = add(total, one, v)
                    slow = add(slow, scalar(k) - h, v)
                    mid = add(mid, one, load(source, here + d * grid.stride, grid.stride))
                    fast = add(fast, one, load(source, here + 2 * d * grid.stride, grid.stride))
                for j in range(run_of(steps)):
                    place = at + j * grid.plane
                    cell = (first + j) * grid.plane + in_plane
                    solve(passes, place, cell, group, total, stacked(slow, mid, fast), count)
                    if j + 1 < run_of(steps):
                        over = grid.window_0 * grid.plane
                        leaves = load(source, place, grid.stride)
                        enters = load(source, place + over, grid.stride)
                        slow = add(add(add(slow, -one, total), one + h, leaves), h, enters)
                        total = add(add(total, -one, leaves), one, enters)
                        mid = add(mid, -one, load(source, place + d * grid.stride, grid.stride))
                        mid = add(mid, one, load(source, place + d * grid.stride + over, grid.stride))
                        fast = add(fast, -one, load(source, place + 2 * d * grid.stride, grid.stride))
                        fast = add(fast, one, load(source, place + 2 * d * grid.stride + over, grid.stride))

        return windows

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
    def finish(
        passes: Passes,
        u_in: numbers,
        offset: int,
        before_in: numbers,
        before_offset: int,
        out: numbers,
        group: int,
        item: int,
    ):
        """Along the fast axis, and with it the mean goal of each particle (eq. 3.15), less where it is; 0 if held.

        Stepping, eq. 3.11: the new position, which may take the place of the one before. offset: from the first number
        of `u_in` to that of the field meant, and the same in `out`; before_offset: the same of `before_in`, and of
        `out` when stepping. Narrow windows along the middle axis too: see `spread_middle`.
        """
        grid = passes.grid
        fields = passes.fields
        motion = passes.motion
        cell, count = plane_share(grid, item)
        at = grid.front + group * grid.group + cell
        d = wp.static(dim)
        h_1, h = middle(cells_of(grid.window_1)), middle(cells_of(grid.window_2))
        if wp.static(both):
            lines = cells_of(grid.window_1)
        else:
            lines = int(1)
        total = vecs.rows()
        for j in range(lines):
            for k in range(cells_of(grid.window_2)):
                here = at - j * grid.line - k * grid.abreast
                if wp.static(both):
                    total = add(total, one, load(fields.maps_slow, here, grid.stride))
                    slope = load(fields.maps_slow, here + d * grid.stride, grid.stride)
                    total = add(total, scalar(j) - h_1, slope)
                    total = add(total, scalar(k) - h, load(fields.maps_slow, here + 2 * d * grid.stride, grid.stride))
                else:
                    total = add(total, one, load(fields.maps_middle, here, grid.stride))
                    total = add(total, scalar(k) - h, load(fields.maps_middle, here + d * grid.stride, grid.stride))
        goal = scale(total, particle_own(fields.pull, cell, grid.abreast))
        u = load(u_in, offset + at, grid.stride)
        is_free = particle_own(fields.free, cell, grid.abreast)
        if motion.stepping == 0:
            if fields.what == wp.static(GOAL):
                goal = add(goal, -one, scale(u, is_free))
            for i in range(wp.static(dim)):
                if i == fields.held_axis:
                    goal = with_row(goal, i, times(row(goal, i), particle_own(fields.sides, cell, grid.abreast)))
            store(out, offset + at, grid.stride, goal, count)
        else:
            star = ahead(grid, u, before_in, motion, fields.free, before_offset + at, cell)
            new = add(star, motion.alpha, add(goal, -one, scale(star, is_free)))
            length2 = lane()
            for i in range(wp.static(dim)):
                length2 += times(row(new, i), row(new, i))
            if below(length2, far * far) == 0:
                first, step = group * grid.abreast, wp.min(grid.abreast - 1, 1)
                new = hold_back(new, u, passes.ran_away, first, step, count)
            store(out, before_offset + at, grid.stride, new, count)

    return members(
        *(Grid, Site, Fields, Passes, windows_fast, windows_middle, spread_slow, spread_middle, finish),
        fit_clusters=fits(False, "fit_clusters"),
        fit_changes=fits(True, "fit_changes"),
        Motion=Motion,
        both=both,
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
    def finish(passes: Passes, running: Ints, u_in: numbers, before_in: numbers, out: numbers):
        group, item = wp.tid()
        if running[group] != 0:
            functions.finish(passes, u_in, 0, before_in, 0, out, group, item)

    def pass_of(name: str, **options: Any) -> Any:
        """The kernel of a pass over fields that passes leave to each other."""
        function = getattr(functions, name)

        @kernel(name=name, **options)
        def one_pass(passes: Passes, running: Ints):
            group, item = wp.tid()
            if running[group] != 0:
                function(passes, group, item)

        return one_pass

    many: Any = {"launch_bounds": (256, 2)}  # else too few threads fit to hide what they wait for
    fits = (pass_of(name, **many) for name in ("fit_clusters", "fit_changes"))
    passes = (pass_of(name) for name in ("windows_middle", "spread_slow", "spread_middle"))
    return members(windows_fast, finish, *passes, *fits)
