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

from deformscope.stages.msm.lanes import Doubles, Ints
from deformscope.stages.msm.lattice_kernels import lattice_functions_for
from deformscope.stages.msm.members import kernel_in, members
from deformscope.stages.msm.newton_functions import REACH, newton_functions_for

THREADS = {wp.float32: 512, wp.float64: 256}
"""Threads of a block on a GPU that stay, for which the compiler saves registers."""


@dataclass(frozen=True, eq=False)
class Resident:
    """What kernels that stay share: sizes, the functions of the passes and of Newton's steps, and two that all use."""

    dim: int
    scalar: Any
    width: int
    window: int
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
    return Resident(dim, scalar, width, window, lattice=lattice, newton=f, meet=meet, keep=keep)


def operate_for(given: Resident) -> Any:
    """The function of all passes."""
    dim, window, lattice, meet = given.dim, given.window, given.lattice, given.meet
    numbers, Passes = wp.array(dtype=given.scalar), lattice.Passes

    @wp.func(inline=False if given.width > 1 else None)
    def operate(
        passes: Passes,
        u: numbers,
        offset: int,
        before_offset: int,
        out: numbers,
        changing: int,
        group: int,
        thread: int,
    ):
        """All passes over a group: goals (with `changing` their derivative) at `offset` of u, into out. before_offset:
        in u, of the displacement one time step before"""
        own = passes  # a copy, which nothing that is stored in a field can change
        grid = own.grid
        threads = own.threads
        if wp.static(window == 0):
            for item in range(thread, grid.items_plane, threads):
                lattice.windows_fast(own, u, offset, u, before_offset, group, item)
            meet()
            for item in range(thread, grid.items_windows, threads):
                lattice.windows_middle(own, group, item)
        else:
            for item in range(thread, grid.items_windows, threads):
                lattice.windows_fast(own, u, offset, u, before_offset, group, item)
        meet()
        if changing != 0:
            for item in range(thread, grid.items_fit, threads):
                lattice.fit_changes(own, group, item)
        else:
            for item in range(thread, grid.items_fit, threads):
                lattice.fit_clusters(own, group, item)
        meet()
        if wp.static(dim == 3):
            for item in range(thread, grid.items_slow, threads):
                lattice.spread_slow(own, group, item)
            meet()
        if wp.static(window == 0):
            for item in range(thread, grid.items_spread, threads):
                lattice.spread_middle(own, group, item)
            meet()
        for item in range(thread, grid.items_plane, threads):
            lattice.finish(own, u, offset, u, before_offset, out, group, item)
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
            operate(passes, passes.pair, offset, 0, passes.pair_out, changing, group, thread)
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


def aim_for(given: Resident) -> Any:
    """The function that begins a linear solve."""
    f, meet, keep = given.newton, given.meet, given.keep
    Span, NewtonState = f.Span, f.NewtonState

    @wp.func
    def aim_at(span: Span, newton: NewtonState, group: int, thread: int, threads: int):
        """A linear solve begins, with its right-hand side as the residual."""
        right = newton.residual
        square, _same = f.inner_products(span, right, right, right, right, group, thread, threads)
        keep(newton, 0, group, thread, f.joined(square))
        if thread == 0:
            f.aim(span, newton, group)
        meet()
        for block in range(thread, span.blocks, threads):
            f.begin(span, newton, group, block)

    return aim_at


@functools.cache
def beta_search_for(scalar: Any) -> Any:
    """The struct type of a search for beta, for fields of `scalar`."""
    numbers = wp.array(dtype=scalar)

    @wp.struct
    class BetaSearch:
        """One candidate's search for the beta of least error.

        target: the observed displacement; seen: (places,) 1 where it is; most: evaluations; limit: iterations of a
        state; tolerance: tolerance of beta; spread, share: tolerance of the search's states, and of the last one;
        relative: tolerance of their derivatives; found: beta, evaluations, whether the last step was below the
        tolerance, and the start of the next launch: bounds of beta, beta and slope before, and whether it is done
        turn: evaluations of a launch, after which the host can interrupt the search"""

        target: numbers
        seen: numbers
        most: int
        limit: int
        turn: int
        tolerance: wp.float64
        spread: wp.float64
        share: wp.float64
        relative: wp.float64
        found: Doubles

    return BetaSearch


def search_functions_for(given: Resident) -> tuple[Any, Any]:
    """The functions of one evaluation of a search for beta."""
    dim, scalar, width, f, meet = given.dim, given.scalar, given.width, given.newton, given.meet
    Span, NewtonState, BetaSearch = f.Span, f.NewtonState, beta_search_for(scalar)

    @wp.func
    def slopes(span: Span, newton: NewtonState, search: BetaSearch, thread: int, threads: int):
        """Slope of the summed distance along d state / d beta (`step`), and a curvature that never overshoots."""
        slope = f.sums()
        curvature = f.sums()
        for block in range(thread, span.blocks, threads):
            at, count = f.place_of(span, 0, block)
            for l in range(wp.min(count, wp.static(width))):
                if search.seen[block * wp.static(width) + l] > scalar(0.0):
                    square = wp.float64(1e-18)
                    along = wp.float64(0.0)
                    longer = wp.float64(0.0)
                    for i in range(wp.static(dim)):
                        here = at + i * span.stride + l
                        away = wp.float64(newton.u[here]) - wp.float64(search.target[here])
                        moved = wp.float64(newton.step[here])
                        square += away * away
                        along += away * moved
                        longer += moved * moved
                    distance = wp.sqrt(square)
                    slope[0] = slope[0] + along / distance
                    curvature[0] = curvature[0] + longer / distance
        return f.joined(slope), f.joined(curvature)

    @wp.func
    def anew(span: Span, newton: NewtonState, tolerance: wp.float64, relative: wp.float64, outer: int, thread: int):
        """Newton's steps (`outer`) or a linear solve of the one candidate begin."""
        if thread == 0:
            newton.tolerance[0] = tolerance
            newton.relative[0] = relative
            reach = wp.float64(wp.inf)
            if outer == 1:
                reach = wp.float64(REACH)
            f.reset(span, newton, reach, outer, 1 - outer, 0)
        meet()

    return slopes, anew


def follow_kernel_for(given: Resident, operate: Any, iterate: Any, aim_at: Any) -> Any:
    """The kernel of the search for beta."""
    dim, scalar, width, window = given.dim, given.scalar, given.width, given.window
    f, meet, keep = given.newton, given.meet, given.keep
    slopes, anew = search_functions_for(given)
    BetaSearch = beta_search_for(scalar)
    Passes, Span, NewtonState = given.types

    @kernel_in(f"follow_{dim}d_{scalar.__name__}_{width}_{window}", scalar, launch_bounds=THREADS[scalar])
    def follow(passes: Passes, by_beta: Passes, span: Span, newton: NewtonState, search: BetaSearch):
        """`fit.fit_beta`, some evaluations of it. by_beta: passes that make the derivative of the goals."""
        thread = wp.tid()
        threads = passes.threads
        beta = search.found[0]
        evaluations = int(search.found[1])
        settled = int(search.found[2])
        low = search.found[3]
        high = search.found[4]
        beta_before = search.found[5]
        slope_before = search.found[6]
        last = int(0)
        end = evaluations + search.turn
        while last == 0 and evaluations < end:
            if evaluations == search.most or settled != 0:
                last = 1
            spread = search.spread
            if last != 0:
                spread = search.share
            if thread == 0:
                passes.fields.beta[0] = scalar(beta)
            anew(span, newton, spread, wp.float64(0.0), 1, thread)
            iterate(passes, span, newton, search.limit, 0, thread)
            if last == 0:
                operate(by_beta, passes.pair, 0, 0, passes.pair_out, 0, 0, thread)
                anew(span, newton, wp.float64(0.0), search.relative, 0, thread)
                aim_at(span, newton, 0, thread, threads)
                meet()
                iterate(passes, span, newton, newton.most, 0, thread)
                slope_sums, curvature_sums = slopes(span, newton, search, thread, threads)
                keep(newton, 0, 0, thread, slope_sums)
                keep(newton, 1, 0, thread, curvature_sums)
                meet()
                slope = newton.parts[0]
                curvature = newton.parts[wp.static(width) * newton.groups]
                evaluations += int(1)
                if slope < wp.float64(0.0):
                    low = wp.max(low, beta)
                else:
                    high = wp.min(high, beta)
                step = wp.float64(0.0)
                if curvature > wp.float64(0.0):
                    step = -slope / curvature
                if evaluations > 1 and slope != slope_before:
                    secant = -slope * (beta - beta_before) / (slope - slope_before)
                    if secant * slope < wp.float64(0.0):
                        step = secant
                tenth = wp.float64(0.1)
                new = wp.clamp(beta + step, low + tenth * (beta - low), high - tenth * (high - beta))
                if wp.abs(new - beta) <= search.tolerance:
                    settled = int(1)
                for block in range(thread, span.blocks, threads):
                    at, count = f.place_of(span, 0, block)
                    along = f.vecs.load(newton.step, at, span.stride)
                    moved = f.vecs.add(f.vecs.load(newton.u, at, span.stride), scalar(new - beta), along)
                    f.vecs.store(newton.u, at, span.stride, moved, count)
                    f.vecs.store(newton.step, at, span.stride, f.vecs.rows(), count)
                meet()
                beta_before = beta
                slope_before = slope
                beta = new
        if thread == 0:
            search.found[0] = beta
            search.found[1] = wp.float64(evaluations)
            search.found[2] = wp.float64(settled)
            search.found[3] = low
            search.found[4] = high
            search.found[5] = beta_before
            search.found[6] = slope_before
            search.found[7] = wp.float64(last)

    return follow


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
    operate, aim_at = operate_for(given), aim_for(given)
    iterate = iterate_for(given, operate)

    if on_cpu:

        @relax_kernel
        def goals(passes: Passes, running: Ints, changing: int, u_in: numbers, out: numbers):
            """goal - u of every free particle; with `changing` J u - u where goals were last evaluated."""
            group = wp.tid()
            if running[group] != 0:
                operate(passes, u_in, 0, 0, out, changing, group, 0)

    @steps_kernel
    def steps(passes: Passes, count: int, swapped: int):
        """`count` time steps.

        The displacement is in the first half of the pair, the one before in the second; each step swaps them, and with
        `swapped` they start swapped."""
        index = wp.tid()
        group = index / passes.threads
        rows = wp.static(dim) * passes.grid.stride
        pair = passes.pair
        for n in range(count):
            offset = ((n + swapped) % 2) * rows
            operate(passes, pair, offset, rows - offset, pair, 0, group, index - group * passes.threads)

    @relax_kernel
    def relax(passes: Passes, span: Span, newton: NewtonState, limit: int):
        index = wp.tid()
        group = index / passes.threads
        iterate(passes, span, newton, limit, group, index - group * passes.threads)

    @relax_kernel
    def aim(span: Span, newton: NewtonState, threads: int):
        index = wp.tid()
        group = index / threads
        aim_at(span, newton, group, index - group * threads, threads)

    small = given.newton.small_kernels(relax_kernel, steps_kernel)
    follow = follow_kernel_for(given, operate, iterate, aim_at)
    made = members(beta_search_for(scalar), steps, relax, aim, follow, *small)
    if on_cpu:
        made.goals = goals
    return made
