"""Warp kernels that stay: all passes of a step, and all steps, or many evaluations of a relaxation, in one launch.

A block of threads keeps to one group of candidates and goes through its passes, meeting at a barrier after each. On a
GPU that saves the launches between passes, which cost more than a small body's work, and what a pass leaves is still
near when the next reads it; on a CPU a block is one thread, and there are no launches left to pay for at any size.
There every launch, a single evaluation too, goes through one copy of all passes in one module: compiling is what a
first start waits for.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import cluster_functions_for
from deformscope.stages.msm.iteration_kernels import newton_functions_for
from deformscope.stages.msm.lanes import Doubles, Ints, module_options
from deformscope.stages.msm.lattice_kernels import lattice_functions_for

THREADS = {wp.float32: 512, wp.float64: 256}
"""Threads of a block on a GPU, for which the compiler saves registers."""


@functools.cache
def resident_kernels_for(dim: int, scalar: Any, width: int, window: int = 0) -> SimpleNamespace:
    """The kernels for lattices of `dim` = 2 or 3, scalar = wp.float32 or wp.float64; lanes of `width`, 1 on a GPU.

    `goals`, a single evaluation, is on a CPU alone (else None): a GPU has `lattice_kernels` for it.
    """
    on_cpu = width > 1
    numbers = wp.array(dtype=scalar)

    def kernel_in(name: str) -> Any:
        module = f"deformscope_{'lattice' if on_cpu else name}_{dim}d_{scalar.__name__}_{width}_{window}"
        wp.get_module(module).options.update(module_options(scalar))
        return functools.partial(wp.kernel, module=module, enable_backward=False, launch_bounds=THREADS[scalar])

    lattice = lattice_functions_for(dim, scalar, width, window)
    cluster = cluster_functions_for(dim, dim, scalar, width)
    newton = newton_functions_for(dim, scalar, width)
    Grid, Site, Fields, Motion = lattice.Grid, lattice.Site, lattice.Fields, lattice.Motion
    windows_fast, windows_middle, finish = lattice.windows_fast, lattice.windows_middle, lattice.finish
    fit_clusters, fit_changes = lattice.fit_clusters, lattice.fit_changes
    spread_slow, spread_middle = lattice.spread_slow, lattice.spread_middle
    Span, NewtonState, sums, put = newton.Span, newton.NewtonState, newton.sums, newton.put
    joined, longest_of = newton.joined, newton.longest_of
    inner_products, move, judge, begin = newton.inner_products, newton.move, newton.judge, newton.begin
    aim_at, reset_one, put_one = newton.aim, newton.reset, newton.put_at
    curvature, descend, conjugate, direct = newton.curvature, newton.descend, newton.conjugate, newton.direct

    @wp.func_native(
        """
    #if defined(__CUDA_ARCH__)
    __syncthreads();
    #endif
    """
    )
    def meet():
        """All threads of the block have come here, and see what the others wrote."""

    @wp.func(inline=False if on_cpu else None)
    def operate(
        grid: Grid,
        site: Site,
        rest: cluster.FitRest,
        kept: cluster.Kept,
        fields: Fields,
        motion: Motion,
        u: numbers,
        offset: int,
        before: numbers,
        before_offset: int,
        out: numbers,
        ran_away: Ints,
        changing: int,
        group: int,
        thread: int,
        threads: int,
    ):
        """All passes over a group: goals (with `changing` their derivative) of what is at `offset` of u, into out."""
        if wp.static(window == 0):
            for item in range(thread, grid.items_plane, threads):
                windows_fast(grid, fields, motion, u, offset, before, before_offset, group, item)
            meet()
            for item in range(thread, grid.items_windows, threads):
                windows_middle(grid, fields, group, item)
        else:
            for item in range(thread, grid.items_windows, threads):
                windows_fast(grid, fields, motion, u, offset, before, before_offset, group, item)
        meet()
        if changing != 0:
            for item in range(thread, grid.items_fit, threads):
                fit_changes(grid, site, rest, kept, fields, group, item)
        else:
            for item in range(thread, grid.items_fit, threads):
                fit_clusters(grid, site, rest, kept, fields, group, item)
        meet()
        if wp.static(dim == 3):
            for item in range(thread, grid.items_slow, threads):
                spread_slow(grid, fields, group, item)
            meet()
        if wp.static(window == 0):
            for item in range(thread, grid.items_spread, threads):
                spread_middle(grid, fields, group, item)
            meet()
        for item in range(thread, grid.items_plane, threads):
            finish(grid, fields, motion, u, offset, before, before_offset, out, ran_away, group, item)
        meet()

    goals = None
    if on_cpu:

        @kernel_in("goals")
        def goals(
            grid: Grid,
            site: Site,
            rest: cluster.FitRest,
            kept: cluster.Kept,
            fields: Fields,
            still: Motion,
            running: Ints,
            changing: int,
            u_in: numbers,
            out: numbers,
            nothing: Ints,
        ):
            """goal - u of every free particle; with `changing` J u - u where goals were last evaluated."""
            group = wp.tid()
            if running[group] != 0:
                operate(grid, site, rest, kept, fields, still, u_in, 0, u_in, 0, out, nothing, changing, group, 0, 1)

    steps_kernel = kernel_in("steps")

    @steps_kernel
    def steps(
        grid: Grid,
        site: Site,
        rest: cluster.FitRest,
        kept: cluster.Kept,
        fields: Fields,
        motion: Motion,
        count: int,
        swapped: int,
        threads: int,
        # In and out:
        pair: numbers,
        ran_away: Ints,
    ):
        """`count` time steps.

        The displacement is in the first half of the pair, the one before in the second; each step they change places,
        and with `swapped` they begin so.
        """
        index = wp.tid()
        group = index / threads
        thread = index - group * threads
        rows = wp.static(dim) * grid.stride
        for n in range(count):
            offset = ((n + swapped) % 2) * rows
            operate(
                grid, site, rest, kept, fields, motion, pair, offset, pair, rows - offset, pair, ran_away, 0, group,
                thread, threads,
            )  # fmt: skip

    relax_kernel = kernel_in("relax")

    @wp.func
    def keep(span: Span, parts: Doubles, row: int, groups: int, group: int, thread: int, v: sums):
        """The group's sums, of which there is one part."""
        if thread == 0:
            put(parts, (row * groups + group) * wp.static(width), v)

    @relax_kernel
    def relax(
        grid: Grid,
        site: Site,
        rest: cluster.FitRest,
        kept: cluster.Kept,
        fields: Fields,
        still: Motion,
        span: Span,
        state: NewtonState,
        groups: int,
        most: int,
        limit: int,
        threads: int,
        # In and out: the displacement and the direction, the residual and the direction's change, each as one field
        pair: numbers,
        pair_out: numbers,
        u: numbers,
        direction: numbers,
        residual: numbers,
        changed: numbers,
        step: numbers,
        rho: numbers,
        parts: Doubles,
        nothing: Ints,
    ):
        """Up to `limit` evaluations of a group's Newton steps, or of its linear solve."""
        index = wp.tid()
        group = index / threads
        thread = index - group * threads
        done = int(0)
        while done < limit and (state.outer_groups[group] != 0 or state.inner_groups[group] != 0):
            changing = state.inner_groups[group]
            offset = int(0)
            if changing != 0:
                offset = wp.static(dim) * grid.stride
            else:
                for block in range(thread, span.blocks, threads):
                    move(span, state, step, u, group, block)
            meet()
            operate(
                grid, site, rest, kept, fields, still, pair, offset, pair, 0, pair_out, nothing, changing, group,
                thread, threads,
            )  # fmt: skip
            if changing != 0:
                stiff, square = inner_products(span, direction, changed, direction, direction, group, thread, threads)
                keep(span, parts, 0, groups, group, thread, joined(stiff))
                keep(span, parts, 1, groups, group, thread, joined(square))
                if thread == 0:
                    curvature(span, state, parts, groups, group)
                meet()
                left, longest = descend(span, state, direction, changed, step, rho, group, thread, threads)
                keep(span, parts, 0, groups, group, thread, joined(left))
                keep(span, parts, 1, groups, group, thread, longest_of(longest))
                if thread == 0:
                    conjugate(span, state, parts, groups, most, group)
                meet()
                for block in range(thread, span.blocks, threads):
                    direct(span, state, rho, direction, group, block)
            else:
                own, along = inner_products(span, residual, residual, residual, step, group, thread, threads)
                keep(span, parts, 0, groups, group, thread, joined(own))
                keep(span, parts, 1, groups, group, thread, joined(along))
                if thread == 0:
                    judge(span, state, parts, groups, group)
                meet()
                if state.inner_groups[group] != 0:
                    for block in range(thread, span.blocks, threads):
                        begin(span, state, residual, rho, direction, step, group, block)
            meet()
            done += int(1)

    @relax_kernel
    def aim(
        span: Span,
        state: NewtonState,
        groups: int,
        threads: int,
        # In:
        right: numbers,
        # Out:
        rho: numbers,
        direction: numbers,
        step: numbers,
        parts: Doubles,
    ):
        """A linear solve begins, with its right-hand side as the residual."""
        index = wp.tid()
        group = index / threads
        thread = index - group * threads
        square, _same = inner_products(span, right, right, right, right, group, thread, threads)
        keep(span, parts, 0, groups, group, thread, joined(square))
        if thread == 0:
            aim_at(span, state, parts, groups, group)
        meet()
        for block in range(thread, span.blocks, threads):
            begin(span, state, right, rho, direction, step, group, block)

    @relax_kernel
    def reset(state: NewtonState, groups: int, abreast: int, reach: wp.float64, outer: int, inner: int):
        reset_one(state, groups, abreast, reach, outer, inner, wp.tid())

    @steps_kernel
    def put_at(places: Ints, values: numbers, stride: int, first_out: numbers, second_out: numbers):
        put_one(places, values, stride, first_out, second_out, wp.tid())

    return SimpleNamespace(**locals())
