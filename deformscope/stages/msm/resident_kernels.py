"""Warp kernels that stay: all passes of all steps, or many evaluations of a relaxation, in one launch.

A block of threads keeps to one group of candidates and goes through its passes, meeting at a barrier after each. On a
GPU that saves the launches between passes, which cost more than a small body's work, and a pass's output is still
cached when the next reads it. On a CPU a block is one thread. There every launch, even of a single evaluation, uses the
same module with all passes, because compilation dominates the first start."""

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Ints, kernel_in, members
from deformscope.stages.msm.lattice_kernels import lattice_functions_for
from deformscope.stages.msm.newton_functions import newton_functions_for

THREADS = {wp.float32: 512, wp.float64: 256}
"""Threads of a block on a GPU that stay, for which the compiler saves registers."""


@dataclass(frozen=True, eq=False)
class Resident:
    """What kernels that stay share: sizes, the functions of the passes and of Newton's steps, and two that all use."""

    dim: int
    scalar: Any
    width: int
    lattice: SimpleNamespace
    newton: SimpleNamespace
    meet: Any
    keep: Any

    @property
    def types(self) -> tuple[Any, Any, Any]:
        """Struct types: Passes, Span, NewtonState."""
        return self.lattice.Passes, self.newton.Span, self.newton.NewtonState


def resident_for(dim: int, scalar: Any, width: int, window: int) -> Resident:
    """Their common parts: see `resident_kernels_for`."""
    f = newton_functions_for(dim, scalar, width)
    NewtonState = f.NewtonState

    @wp.func_native(
        """
    #if defined(__CUDA_ARCH__)
    __syncthreads();
    #endif
    """
    )
    def meet():
        """All threads of the block wait here, and see each other's writes."""

    @wp.func
    def keep(newton: NewtonState, row: int, group: int, thread: int, v: f.sums):
        """The group's sums, of which there is one part."""
        if thread == 0:
            f.put(newton.parts, (row * newton.groups + group) * wp.static(width), v)

    lattice = lattice_functions_for(dim, scalar, width, window)
    return Resident(dim, scalar, width, lattice=lattice, newton=f, meet=meet, keep=keep)


def operate_for(given: Resident) -> Any:
    """The function of all passes."""
    dim, lattice, meet = given.dim, given.lattice, given.meet
    numbers, Passes = wp.array(dtype=given.scalar), lattice.Passes

    @wp.func(inline=False if given.width > 1 else None)
    def operate(
        passes: Passes,
        u: numbers,
        offset: int,
        before_offset: int,
        star_offset: int,
        out: numbers,
        changing: int,
        group: int,
        thread: int,
    ):
        """All passes over a group: goals (with `changing` their derivative) at `offset` of u, into out. before_offset,
        star_offset: in u, of the displacement one time step before, and of x*, or `offset`"""
        own = passes  # a copy, which nothing that is stored in a field can change
        grid = own.grid
        threads = own.threads
        if wp.static(not lattice.whole):
            for item in range(thread, grid.items_plane, threads):
                lattice.windows_fast(own, u, offset, u, before_offset, group, item)
            meet()
            for item in range(thread, grid.items_windows, threads):
                lattice.windows_middle(own, group, item)
            meet()
        if changing != 0:
            for item in range(thread, grid.items_fit, threads):
                lattice.fit_changes(own, u, star_offset, group, item)
        else:
            for item in range(thread, grid.items_fit, threads):
                lattice.fit_clusters(own, u, star_offset, group, item)
        meet()
        if wp.static(dim == 3 and not lattice.whole):
            for item in range(thread, grid.items_slow, threads):
                lattice.spread_slow(own, group, item)
            meet()
        if wp.static(not lattice.whole):
            for item in range(thread, grid.items_spread, threads):
                lattice.spread_middle(own, group, item)
            meet()
        for item in range(thread, grid.items_back, threads):
            lattice.finish(own, u, offset, u, before_offset, u, star_offset, out, group, item)
        meet()

    return operate


def iterate_for(given: Resident, operate: Any) -> Any:
    """The function of Newton's steps and their linear solves."""
    dim, f, meet, keep = given.dim, given.newton, given.meet, given.keep
    Passes, Span, NewtonState = given.types

    @wp.func(inline=False if given.width > 1 else None)
    def iterate(passes: Passes, span: Span, newton: NewtonState, limit: int, group: int, thread: int):
        """Up to `limit` evaluations of a group's Newton steps, or of its linear solve."""
        threads = passes.threads
        done = int(0)
        while done < limit and (newton.outer_groups[group] != 0 or newton.inner_groups[group] != 0):
            changing = newton.inner_groups[group]
            offset = int(0)
            if changing != 0:
                offset = wp.static(dim) * passes.grid.stride
            else:
                for block in range(thread, span.blocks, threads):
                    f.move(span, newton, group, block)
            meet()
            operate(passes, passes.pair, offset, 0, offset, passes.pair_out, changing, group, thread)
            if changing != 0:
                p = newton.direction
                stiff, square = f.inner_products(span, p, newton.changed, p, p, group, thread, threads)
                keep(newton, 0, group, thread, f.joined(stiff))
                keep(newton, 1, group, thread, f.joined(square))
                if thread == 0:
                    f.curvature(span, newton, group)
                meet()
                left, longest = f.descend(span, newton, group, thread, threads)
                keep(newton, 0, group, thread, f.joined(left))
                keep(newton, 1, group, thread, f.longest_of(longest))
                if thread == 0:
                    f.conjugate(span, newton, group)
                meet()
                for block in range(thread, span.blocks, threads):
                    f.direct(span, newton, group, block)
            else:
                r = newton.residual
                own, along = f.inner_products(span, r, r, r, newton.step, group, thread, threads)
                keep(newton, 0, group, thread, f.joined(own))
                keep(newton, 1, group, thread, f.joined(along))
                if thread == 0:
                    f.judge(span, newton, group)
                meet()
                if newton.inner_groups[group] != 0:
                    for block in range(thread, span.blocks, threads):
                        f.begin(span, newton, group, block)
            meet()
            done += int(1)

    return iterate


@functools.cache
def resident_kernels_for(dim: int, scalar: Any, width: int, window: int = 0) -> SimpleNamespace:
    """Kernels that stay, for lattices of `dim` = 2 or 3, scalar = wp.float32 or wp.float64; lanes of `width`, 1 on a
    GPU.

    `goals`, a single evaluation, exists only on a CPU: a GPU has `lattice_kernels` for it."""
    on_cpu = width > 1
    numbers = wp.array(dtype=scalar)
    steps_kernel, relax_kernel = (
        kernel_in(
            f"{'lattice' if on_cpu else name}_{dim}d_{scalar.__name__}_{width}_{window}",
            scalar,
            launch_bounds=THREADS[scalar],
        )
        for name in ("steps", "relax")
    )
    given = resident_for(dim, scalar, width, window)
    Passes, Span, NewtonState = given.types
    operate = operate_for(given)
    whole, look_ahead, meet = given.lattice.whole, given.lattice.look_ahead, given.meet
    iterate = iterate_for(given, operate)

    if on_cpu:

        @relax_kernel
        def goals(passes: Passes, running: Ints, changing: int, u_in: numbers, out: numbers):
            """goal - u of every free particle; with `changing` J u - u where goals were last evaluated."""
            group = wp.tid()
            if running[group] != 0:
                operate(passes, u_in, 0, 0, 0, out, changing, group, 0)

    @steps_kernel
    def steps(passes: Passes, count: int, swapped: int):
        """`count` time steps.

        The displacement is in the first part of the pair, the one before in the second, x* in the third; each step
        swaps the first two, and with `swapped` they start swapped."""
        index = wp.tid()
        group = index / passes.threads
        thread = index - group * passes.threads
        rows = wp.static(dim) * passes.grid.stride
        pair = passes.pair
        if wp.static(whole):
            offset = swapped * rows
            for item in range(thread, passes.grid.items_plane, passes.threads):
                look_ahead(passes, pair, offset, pair, rows - offset, pair, 2 * rows, group, item)
            meet()
        for n in range(count):
            offset = ((n + swapped) % 2) * rows
            operate(passes, pair, offset, rows - offset, 2 * rows, pair, 0, group, thread)

    @relax_kernel
    def relax(passes: Passes, span: Span, newton: NewtonState, limit: int):
        index = wp.tid()
        group = index / passes.threads
        iterate(passes, span, newton, limit, group, index - group * passes.threads)

    small = given.newton.small_kernels(relax_kernel, steps_kernel)
    made = members(steps, relax, *small)
    if on_cpu:
        made.goals = goals
    return made
