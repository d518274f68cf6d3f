"""Warp kernels of Newton's steps with conjugate gradients: one for each part of an iteration, and kernels that stay.

They take fields of particles in their layout (see `layout.py`), for any clusters. Sums over particles are taken in a
fixed order, so that runs repeat bit for bit. Candidates are independent: finished ones have steps of 0, and a group in
which all have ended is skipped.

Kernels that stay do all passes of a step, and all steps, or many evaluations of a relaxation, in one launch. A block of
threads keeps to one group of candidates and goes through its passes, meeting at a barrier after each. On a GPU that
saves the launches between passes, which cost more than a small body's work, and a pass's output is still cached when
the next reads it. On a CPU a block is one thread. There every launch, even of a single evaluation, uses the same module
with all passes, because compilation dominates the first start.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Doubles, Ints, Sized, lanes_for, rows_for
from deformscope.stages.msm.lattice_kernels import FAR, lattice_functions_for
from deformscope.stages.msm.members import kernel_in, members

THREADS = {wp.float32: 512, wp.float64: 256}
"""Threads of a block on a GPU that stay, for which the compiler saves registers."""

RUNNING, CONVERGED, DIVERGED, STALLED = 1, 0, -1, 2

REACH = 1.0
"""Spacings that no particle ever goes beyond in one Newton step: rotations are not straight."""

PATIENCE = 20
"""Number of Newton steps near rounding that do not halve the best residual, after which a candidate counts as
stalled."""

SHARP = 1e-2
"""Share to which a solve reduces its residual before its smallest curvature counts as the smallest."""


@functools.cache
def newton_functions_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """The functions for fields of `dim` rows and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    lanes = lanes_for(width, scalar)
    lane, own = lanes.lane, lanes.own
    vecs = rows_for(dim, width, scalar)
    load, store, add, scale, choose = vecs.load, vecs.store, vecs.add, vecs.scale, vecs.choose
    sums = wp.types.vector(length=width, dtype=wp.float64)
    sums_c = f"wp::vec_t<{width}, wp::float64>"
    each = f"for (int l = 0; l < {width}; ++l)"
    one = scalar(1.0)
    nought, unity, half, tenth = wp.float64(0.0), wp.float64(1.0), wp.float64(0.5), wp.float64(0.1)
    far, reach = wp.float64(FAR), wp.float64(REACH)
    double = scalar is wp.float64
    flat = wp.float64(1e-12 if double else 1e-7)
    sharp, positive = wp.float64(SHARP), wp.float64(1e-6)

    @wp.struct
    class Span:
        """How particles lie in a field, and their metric N_i m_i (0 where held), in which the goal map is symmetric.

        blocks: lanes' worths in a group; parts: a sum over a group has this number of parts, each by `threads` of a
        block
        """

        abreast: int
        blocks: int
        parts: int
        threads: int
        front: int
        group: int
        stride: int
        metric: numbers
        metric_total: wp.float64

    @wp.struct
    class NewtonState:
        """Memory of Newton's steps for each candidate (arrays of B), groups with work to do, and their fields.

        residual: also the right-hand side of a linear solve; changed: derivative of the goals along `direction`, less
        that; rho: residual of the linear solve; parts: parts of sums; groups: how many; most: steps of a linear solve
        """

        tolerance: Doubles  # of the distance to the static state [spacing]; first entry
        floor: Doubles  # residual that is but rounding [spacing]; first entry
        relative: Doubles  # reduction of a residual that ends a linear solve; first entry, 0: Newton
        state: Ints  # RUNNING...
        inner: Ints  # 1 while conjugate gradients run
        outer_groups: Ints
        inner_groups: Ints
        outers: Ints
        inners: Ints  # of this Newton step
        backs: Ints
        stalls: Ints
        total: Ints
        norm: Doubles
        best: Doubles
        first: Doubles
        error: Doubles
        square: Doubles  # squared norm of the inner residual
        target: Doubles  # at which the inner residual ends
        slope: Doubles  # along the step, where it began
        taken: Doubles  # share of the step that was taken
        farthest: Doubles  # spacings that no particle ever goes beyond in a step; first entry
        reach: Doubles  # the same in the next step
        longest: Doubles  # spacings that the farthest particle went
        least: Doubles  # smallest curvature met in this solve, and in the one before
        least_before: Doubles
        last: Ints
        sharp: Ints  # 1 if the last solve went far enough to have met the slowest modes
        by: numbers  # how far to go along the step
        length: numbers  # along the direction
        mix: numbers  # how much of the last direction to keep
        along: Doubles  # with a preconditioner: <rho, z> at the last direction
        plain: Ints  # 1 for a candidate that goes on without it
        applied: Ints  # how often it was applied
        patience: int  # directions of a solve after which a candidate goes on without it
        z: numbers  # it, applied to rho
        u: numbers
        step: numbers
        residual: numbers
        direction: numbers
        changed: numbers
        rho: numbers
        parts: Doubles
        groups: int
        most: int

    @wp.func
    def place_of(span: Span, group: int, block: int):
        """Begin of a lane's values in a field, and number of them that are the group's."""
        number = block * wp.static(width)
        return span.front + group * span.group + number, span.group - number

    @wp.func
    def metric_of(span: Span, number: int):
        """The metric of the lanes at a number of a group."""
        if span.abreast == 1:
            return own(span.metric, number, 1)
        return own(span.metric, number / span.abreast, 0)

    @wp.func
    def of_candidate(span: Span, values: numbers, group: int, offset: int):
        """A candidate's number in its lanes."""
        if span.abreast == 1:
            return own(values, offset + group, 0)
        return own(values, offset + group * span.abreast, 1)

    @wp.func
    def flagged(span: Span, flags: Ints, group: int):
        """1 in the lanes of the candidates whose flag is 1, else 0."""
        found = lane()
        for l in range(wp.static(width)):
            member = group
            if span.abreast > 1:
                member = group * span.abreast + l
            if flags[member] == 1:
                found[l] = one
        return found

    @wp.func_native(
        f"{sums_c} r = s; for (int i = 0; i < {dim}; ++i) {each}"
        " r.c[l] += wp::float64(m.c[l] * a.data[i][l] * b.data[i][l]); return r;"
    )
    def add_product(s: sums, m: lane, a: vecs.rows, b: vecs.rows) -> sums: ...

    @wp.func_native(
        f"{sums_c} r = s; {each} {{ wp::float64 q = 0; for (int i = 0; i < {dim}; ++i)"
        " q += wp::float64(a.data[i][l]) * wp::float64(a.data[i][l]); r.c[l] = q > r.c[l] ? q : r.c[l]; } return r;"
    )
    def longer(s: sums, a: vecs.rows) -> sums: ...

    @wp.func_native(f"{each} a.data[i + l] = v.c[l];")
    def put(a: Doubles, i: int, v: sums): ...

    @wp.func
    def keep(span: Span, parts_out: Doubles, row: int, item: int, v: sums):
        """The sums of a block as its part of a row."""
        if item % span.threads == 0:
            put(parts_out, (row * span.parts + item / span.threads) * wp.static(width), v)

    def together(name: str, join: str) -> Any:
        """Joins the sums of every thread of a block; on a CPU the block is the thread."""
        snippet = f"""
    {sums_c} r = s;
    #if defined(__CUDA_ARCH__)
    __shared__ double parts[32];
    double v = s.c[0];
    for (int offset = 16; offset > 0; offset >>= 1) {{
        const double other = __shfl_down_sync(0xffffffffu, v, offset);
        v = {join};
    }}
    __syncthreads();
    if ((threadIdx.x & 31) == 0) parts[threadIdx.x >> 5] = v;
    __syncthreads();
    v = parts[0];
    for (unsigned warp = 1; warp < (blockDim.x + 31) / 32; ++warp) {{
        const double other = parts[warp];
        v = {join};
    }}
    r.c[0] = v;
    #endif
    return r;"""

        @Sized(name).func_native(snippet)
        def joined_threads(s: sums) -> sums: ...

        return joined_threads

    joined = together(f"sum_{width}", "v + other")
    longest_of = together(f"max_{width}", "v > other ? v : other")

    @wp.func
    def fold(span: Span, parts: Doubles, row: int, groups: int, group: int, thread: int, largest: int):
        """Where a part is one number, the threads of a block make one part of all: their sum, or the largest."""
        if wp.static(width == 1):
            total = sums()
            first = (row * groups + group) * span.parts
            for part in range(first + thread, first + span.parts, span.threads):
                if largest != 0:
                    total[0] = wp.max(total[0], parts[part])
                else:
                    total[0] = total[0] + parts[part]
            if largest != 0:
                total = longest_of(total)
            else:
                total = joined(total)
            if thread == 0:
                parts[first] = total[0]

    @wp.func
    def collected(span: Span, parts: Doubles, row: int, groups: int, group: int, member: int, largest: int):
        """A candidate's sum over a group's particles, or the largest, from its parts (one, if `fold` could)."""
        total = wp.float64(0.0)
        first = (row * groups + group) * span.parts
        count = span.parts
        if wp.static(width == 1):
            count = int(1)
        for part in range(first, first + count):
            for l in range(wp.static(width)):
                if span.abreast == 1 or l == member:
                    value = parts[part * wp.static(width) + l]
                    if largest != 0:
                        total = wp.max(total, value)
                    else:
                        total += value
        return total

    @wp.func
    def inner_products(span: Span, a: numbers, b: numbers, c: numbers, d: numbers, group: int, part: int, parts: int):
        """<a, b> and <c, d> over every `parts`-th block of a group, from the `part`-th on."""
        first_sum = sums()
        second_sum = sums()
        for block in range(part, span.blocks, parts):
            at, _count = place_of(span, group, block)
            m = metric_of(span, block * wp.static(width))
            first_sum = add_product(first_sum, m, load(a, at, span.stride), load(b, at, span.stride))
            second_sum = add_product(second_sum, m, load(c, at, span.stride), load(d, at, span.stride))
        return first_sum, second_sum

    @wp.func
    def move(span: Span, newton: NewtonState, group: int, block: int):
        """Goes along the step."""
        at, count = place_of(span, group, block)
        by = of_candidate(span, newton.by, group, 0)
        new = add(load(newton.u, at, span.stride), one, scale(load(newton.step, at, span.stride), by))
        store(newton.u, at, span.stride, new, count)

    @wp.func
    def judge(span: Span, newton: NewtonState, group: int):
        """After a Newton step: has it gone too far, is this the static state, and how well to solve for the next step.

        The energy falls along the step as long as its slope <residual, step> is positive. If the slope at the end is
        clearly negative, the step is shortened to where the slope would vanish, and the next goes no farther. The
        remaining distance is (at most five times) the residual over the smallest curvature of the last solves, if they
        went far enough to find it. A mode with a restoring force of 2e-4 of its displacement has a residual 5000 times
        smaller than its error.
        """
        any_outer = int(0)
        any_inner = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.by[i] = scalar(0.0)
            newton.inner[i] = 0
            if newton.state[i] == wp.static(RUNNING):
                norm = wp.sqrt(collected(span, newton.parts, 0, newton.groups, group, member, 0) / span.metric_total)
                along = collected(span, newton.parts, 1, newton.groups, group, member, 0)
                newton.norm[i] = norm
                newton.total[i] = newton.total[i] + 1
                tolerance = newton.tolerance[0]
                least = wp.min(newton.least[i], newton.least_before[i])
                slope = newton.slope[i]
                taken = newton.taken[i]
                newton.error[i] = wp.float64(5.0) * norm / wp.max(least, flat)
                if not wp.isfinite(norm) or norm > far:
                    newton.state[i] = wp.static(DIVERGED)
                elif norm <= newton.floor[0]:
                    newton.state[i] = wp.static(STALLED)
                    if newton.outers[i] == 0 or newton.error[i] <= tolerance:
                        newton.state[i] = wp.static(CONVERGED)
                elif newton.outers[i] > 0 and taken * along < -half * slope and newton.backs[i] < 12:
                    share = slope / (slope - taken * along)
                    newton.by[i] = scalar(-(unity - share) * taken)
                    newton.taken[i] = taken * share
                    newton.slope[i] = slope * share
                    newton.backs[i] = newton.backs[i] + 1
                    newton.longest[i] = newton.longest[i] * share
                    newton.reach[i] = wp.max(newton.longest[i], wp.float64(1e-6))
                elif newton.outers[i] > 0 and newton.error[i] <= tolerance and newton.sharp[i] == 1:
                    newton.state[i] = wp.static(CONVERGED)
                else:
                    if newton.outers[i] == 0:
                        newton.first[i] = norm
                        newton.best[i] = norm
                    if norm < half * newton.best[i]:
                        newton.best[i] = norm
                        newton.stalls[i] = 0
                    elif norm <= wp.float64(1000.0) * newton.floor[0]:  # before, it may well rise
                        newton.stalls[i] = newton.stalls[i] + 1
                    if newton.stalls[i] > wp.static(PATIENCE):
                        newton.state[i] = wp.static(STALLED)
                    else:
                        forcing = wp.min(tenth, wp.sqrt(norm / newton.first[i]))
                        goal = forcing * norm
                        if newton.outers[i] > 0:
                            goal = wp.max(goal, tenth * tolerance * least)
                            if newton.error[i] <= wp.float64(10.0) * tolerance:
                                goal = wp.min(goal, sharp * norm)
                        newton.sharp[i] = 0
                        if goal <= sharp * norm:
                            newton.sharp[i] = 1
                        newton.target[i] = goal * goal * span.metric_total
                        newton.square[i] = norm * norm * span.metric_total
                        newton.inner[i] = 1
                        newton.inners[i] = 0
                        newton.last[i] = 0
                        if newton.outers[i] > 0 and newton.backs[i] == 0:  # a straight step held: try a longer one
                            newton.reach[i] = wp.min(wp.float64(2.0) * newton.reach[i], newton.farthest[0])
                        newton.backs[i] = 0
                        newton.slope[i] = nought
                        newton.outers[i] = newton.outers[i] + 1
                        newton.least_before[i] = newton.least[i]
                        newton.least[i] = wp.float64(1.0)
            if newton.state[i] == wp.static(RUNNING):
                any_outer = int(1)
            if newton.inner[i] == 1:
                any_inner = int(1)
        newton.outer_groups[group] = any_outer
        newton.inner_groups[group] = any_inner

    @wp.func
    def begin(span: Span, newton: NewtonState, group: int, block: int):
        """Conjugate gradients start at a step of 0, unless the last step is to be shortened first."""
        at, count = place_of(span, group, block)
        begins = flagged(span, newton.inner, group)
        keeps = lane(one) - begins
        r = choose(begins, load(newton.residual, at, span.stride))
        store(newton.rho, at, span.stride, r, count)
        store(newton.direction, at, span.stride, r, count)
        store(newton.step, at, span.stride, choose(keeps, load(newton.step, at, span.stride)), count)

    @wp.func
    def curvature(span: Span, newton: NewtonState, group: int):
        """How far to go along the direction p: to the minimum, by its curvature <p, (I - J) p>.

        Where the energy has negative curvature (a crushed cluster about to turn, a strut about to buckle) the solve
        ends with a step along that direction, as far as particles may move in one step. `judge` shortens it if that is
        too far.
        """
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.length[i] = scalar(0.0)
            if newton.inner[i] == 1:
                stiff = -collected(span, newton.parts, 0, newton.groups, group, member, 0)
                own_square = collected(span, newton.parts, 1, newton.groups, group, member, 0)
                if stiff > flat * own_square:
                    length = newton.square[i] / stiff
                    newton.length[i] = scalar(length)
                    newton.slope[i] = newton.slope[i] + length * newton.square[i]
                    newton.least[i] = wp.min(newton.least[i], stiff / own_square)
                elif own_square <= nought:  # nothing is asked for
                    newton.last[i] = 1
                else:
                    newton.last[i] = 1
                    length = reach / wp.sqrt(own_square / span.metric_total)
                    newton.length[i] = scalar(length)
                    newton.slope[i] = newton.slope[i] + length * newton.square[i]

    @wp.func
    def descend(span: Span, newton: NewtonState, group: int, part: int, parts: int):
        """Goes along the direction; the new squared residual, and the longest |step_i|^2, as for `inner_products`."""
        square_sum = sums()
        longest = sums()
        length = of_candidate(span, newton.length, group, 0)
        for block in range(part, span.blocks, parts):
            at, count = place_of(span, group, block)
            s = add(load(newton.step, at, span.stride), one, scale(load(newton.direction, at, span.stride), length))
            r = add(load(newton.rho, at, span.stride), one, scale(load(newton.changed, at, span.stride), length))
            store(newton.step, at, span.stride, s, count)
            store(newton.rho, at, span.stride, r, count)
            square_sum = add_product(square_sum, metric_of(span, block * wp.static(width)), r, r)
            longest = longer(longest, s)
        return square_sum, longest

    @wp.func
    def conjugate(span: Span, newton: NewtonState, group: int):
        """Ends the solve, or mixes the next direction.

        No particle goes farther in one step than steps have proved good.
        """
        any_inner = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.mix[i] = scalar(0.0)
            if newton.inner[i] == 1:
                fresh = collected(span, newton.parts, 0, newton.groups, group, member, 0)
                longest = wp.sqrt(collected(span, newton.parts, 1, newton.groups, group, member, 1))
                newton.total[i] = newton.total[i] + 1
                newton.inners[i] = newton.inners[i] + 1
                linear = newton.relative[0] > nought
                done = newton.last[i] == 1 or fresh <= newton.target[i] or newton.inners[i] >= newton.most
                if not linear and longest > newton.reach[i]:
                    done = True
                if not wp.isfinite(fresh):
                    done = True
                    newton.state[i] = wp.static(DIVERGED)
                newton.mix[i] = scalar(fresh / newton.square[i])
                newton.square[i] = fresh
                if done:
                    newton.inner[i] = 0
                    taken = unity
                    if not linear and longest > newton.reach[i]:
                        taken = newton.reach[i] / longest
                    newton.longest[i] = taken * longest
                    if fresh > newton.target[i]:
                        newton.sharp[i] = 0
                    newton.taken[i] = taken
                    if newton.state[i] == wp.static(RUNNING):
                        newton.by[i] = scalar(taken)
                    newton.slope[i] = newton.slope[i] * taken
                else:
                    any_inner = int(1)
        newton.inner_groups[group] = any_inner

    @wp.func
    def direct(span: Span, newton: NewtonState, group: int, block: int):
        """The next direction."""
        at, count = place_of(span, group, block)
        mix = of_candidate(span, newton.mix, group, 0)
        p = add(load(newton.rho, at, span.stride), one, scale(load(newton.direction, at, span.stride), mix))
        store(newton.direction, at, span.stride, p, count)

    @wp.func
    def mix_aided(span: Span, newton: NewtonState, group: int):
        """Weight of the last direction, with a preconditioner; a candidate continues without it (z = rho) once it is
        not positive there, or a solve takes more than `patience` directions."""
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.mix[i] = scalar(0.0)  # also of what ended: its direction may be 0 / 0
            if newton.inner[i] == 1:
                product = collected(span, newton.parts, 0, newton.groups, group, member, 0)
                square = collected(span, newton.parts, 1, newton.groups, group, member, 0)
                last = newton.along[i]
                if newton.inners[i] == 0:
                    last = nought
                if newton.plain[i] == 0:
                    if product >= positive * square and wp.isfinite(product) and newton.inners[i] < newton.patience:
                        newton.applied[i] = newton.applied[i] + 1
                    else:
                        newton.plain[i] = 1
                        last = nought
                if newton.plain[i] != 0:
                    product = square
                if last > nought:
                    newton.mix[i] = scalar(product / last)
                newton.square[i] = wp.max(product, wp.float64(1e-300))
                newton.along[i] = product

    @wp.func
    def direct_aided(span: Span, newton: NewtonState, group: int, block: int):
        """The next direction, with a preconditioner."""
        at, count = place_of(span, group, block)
        without = flagged(span, newton.plain, group)
        z = choose(lane(one) - without, load(newton.z, at, span.stride))
        p = add(choose(without, load(newton.rho, at, span.stride)), one, z)
        mix = of_candidate(span, newton.mix, group, 0)
        p = add(p, one, scale(load(newton.direction, at, span.stride), mix))
        store(newton.direction, at, span.stride, p, count)

    @wp.func
    def aim(span: Span, newton: NewtonState, group: int):
        """A linear solve ends at `relative` of its right-hand side."""
        for member in range(span.abreast):
            i = group * span.abreast + member
            square = wp.max(collected(span, newton.parts, 0, newton.groups, group, member, 0), wp.float64(1e-300))
            newton.square[i] = square
            newton.target[i] = square * newton.relative[0] * newton.relative[0]

    @wp.func
    def reset(span: Span, newton: NewtonState, reach: wp.float64, outer: int, inner: int, i: int):
        """Every candidate runs, from Newton's first step or (with `inner`) from a linear solve."""
        if i < newton.groups:
            newton.outer_groups[i] = outer
            newton.inner_groups[i] = inner
        if i < newton.groups * span.abreast:
            newton.state[i] = wp.static(RUNNING)
            newton.inner[i] = inner
            newton.outers[i] = 0
            newton.inners[i] = 0
            newton.backs[i] = 0
            newton.stalls[i] = 0
            newton.total[i] = 0
            newton.last[i] = 0
            newton.sharp[i] = 0
            newton.by[i] = scalar(0.0)
            newton.slope[i] = nought
            newton.taken[i] = nought
            newton.norm[i] = wp.float64(wp.inf)
            newton.error[i] = wp.float64(wp.inf)
            newton.least[i] = unity
            newton.least_before[i] = unity
            newton.reach[i] = reach

    def small_kernels(resetting: Any, putting: Any) -> tuple[Any, Any]:
        """The kernels of `reset`, and of `put_at` that puts vectors (component by component) at the places of two
        fields, by these decorators."""

        @resetting(name="reset")
        def reset_each(span: Span, newton: NewtonState, reach: wp.float64, outer: int, inner: int):
            reset(span, newton, reach, outer, inner, wp.tid())

        @putting
        def put_at(places: Ints, values: numbers, stride: int, first_out: numbers, second_out: numbers):
            i = wp.tid()
            for k in range(wp.static(dim)):
                value = values[k * places.shape[0] + i]
                first_out[places[i] + k * stride] = value
                second_out[places[i] + k * stride] = value

        return reset_each, put_at

    return members(
        *(Span, NewtonState, place_of, metric_of, of_candidate, flagged, add_product, put, keep, fold, collected),
        *(inner_products, move, judge, begin, curvature, descend, conjugate, direct, aim, reset, small_kernels),
        *(mix_aided, direct_aided),
        sums=sums,
        joined=joined,
        longest_of=longest_of,
    )


@functools.cache
def newton_kernels_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """A kernel for each part of an iteration, for fields of `dim` rows and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"newton_{dim}d_{scalar.__name__}_{width}", scalar)
    vecs = rows_for(dim, width, scalar)
    functions = newton_functions_for(dim, scalar, width)
    Span, NewtonState, fold = functions.Span, functions.NewtonState, functions.fold

    def kernel_of(function: Any, *, outer: bool = False, sums: bool = True, largest: int = 0) -> Any:
        """The kernel that uses two sums over each group that runs (`largest`: the second is the largest), or else over
        each lane's values; outer: number of Newton's steps."""

        @kernel(name=function.__name__)
        def run(span: Span, newton: NewtonState):
            group, item = wp.tid()
            runs = newton.inner_groups[group]
            if wp.static(outer):
                runs = newton.outer_groups[group]
            if runs != 0:
                if wp.static(sums):
                    fold(span, newton.parts, 0, newton.groups, group, item, 0)
                    fold(span, newton.parts, 1, newton.groups, group, item, largest)
                    if item == 0:
                        function(span, newton, group)
                else:
                    function(span, newton, group, item)

        return run

    @kernel
    def inner_products(span: Span, newton: NewtonState, running: Ints, a: numbers, b: numbers, c: numbers, d: numbers):
        """Parts of <a, b> and of <c, d>."""
        group, item = wp.tid()
        if running[group] != 0:
            first_sum, second_sum = functions.inner_products(span, a, b, c, d, group, item, span.parts * span.threads)
            functions.keep(span, newton.parts, group, item, functions.joined(first_sum))
            functions.keep(span, newton.parts, newton.groups + group, item, functions.joined(second_sum))

    @kernel
    def add_step(span: Span, newton: NewtonState):
        """u += step, of every group."""
        group, block = wp.tid()
        at, count = functions.place_of(span, group, block)
        moved = vecs.add(vecs.load(newton.u, at, span.stride), scalar(1.0), vecs.load(newton.step, at, span.stride))
        vecs.store(newton.u, at, span.stride, moved, count)

    @kernel
    def descend(span: Span, newton: NewtonState):
        group, item = wp.tid()
        if newton.inner_groups[group] != 0:
            square_sum, longest = functions.descend(span, newton, group, item, span.parts * span.threads)
            functions.keep(span, newton.parts, group, item, functions.joined(square_sum))
            functions.keep(span, newton.parts, newton.groups + group, item, functions.longest_of(longest))

    f = functions
    return members(
        *(inner_products, add_step, descend, kernel_of(f.move, outer=True, sums=False)),
        *f.small_kernels(kernel, kernel),
        *(kernel_of(each, sums=False) for each in (f.begin, f.direct, f.direct_aided)),
        *(kernel_of(each) for each in (f.mix_aided, f.curvature, f.aim)),
        *(kernel_of(f.judge, outer=True), kernel_of(f.conjugate, largest=1)),
    )


@functools.cache
def resident_kernels_for(dim: int, scalar: Any, width: int, window: int = 0) -> SimpleNamespace:
    """Kernels that stay, for lattices of `dim` = 2 or 3, scalar = wp.float32 or wp.float64; lanes of `width`, 1 on a
    GPU.

    `goals`, a single evaluation, exists only on a CPU: a GPU has `lattice_kernels` for it.
    """
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
    lattice = lattice_functions_for(dim, scalar, width, window)
    Passes = lattice.Passes
    vecs = rows_for(dim, width, scalar)
    newton_f = newton_functions_for(dim, scalar, width)
    Span, NewtonState, inner_products = newton_f.Span, newton_f.NewtonState, newton_f.inner_products

    @wp.func_native(
        """
    #if defined(__CUDA_ARCH__)
    __syncthreads();
    #endif
    """
    )
    def meet():
        """All threads of the block wait here, and see each other's writes."""

    @wp.func(inline=False if on_cpu else None)
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
        `swapped` they start swapped.
        """
        index = wp.tid()
        group = index / passes.threads
        rows = wp.static(dim) * passes.grid.stride
        pair = passes.pair
        for n in range(count):
            offset = ((n + swapped) % 2) * rows
            operate(passes, pair, offset, rows - offset, pair, 0, group, index - group * passes.threads)

    @wp.func
    def keep(newton: NewtonState, row: int, group: int, thread: int, v: newton_f.sums):
        """The group's sums, of which there is one part."""
        if thread == 0:
            newton_f.put(newton.parts, (row * newton.groups + group) * wp.static(width), v)

    @wp.func(inline=False if on_cpu else None)
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
                    newton_f.move(span, newton, group, block)
            meet()
            operate(passes, passes.pair, offset, 0, passes.pair_out, changing, group, thread)
            if changing != 0:
                p = newton.direction
                stiff, square = inner_products(span, p, newton.changed, p, p, group, thread, threads)
                keep(newton, 0, group, thread, newton_f.joined(stiff))
                keep(newton, 1, group, thread, newton_f.joined(square))
                if thread == 0:
                    newton_f.curvature(span, newton, group)
                meet()
                left, longest = newton_f.descend(span, newton, group, thread, threads)
                keep(newton, 0, group, thread, newton_f.joined(left))
                keep(newton, 1, group, thread, newton_f.longest_of(longest))
                if thread == 0:
                    newton_f.conjugate(span, newton, group)
                meet()
                for block in range(thread, span.blocks, threads):
                    newton_f.direct(span, newton, group, block)
            else:
                r = newton.residual
                own, along = inner_products(span, r, r, r, newton.step, group, thread, threads)
                keep(newton, 0, group, thread, newton_f.joined(own))
                keep(newton, 1, group, thread, newton_f.joined(along))
                if thread == 0:
                    newton_f.judge(span, newton, group)
                meet()
                if newton.inner_groups[group] != 0:
                    for block in range(thread, span.blocks, threads):
                        newton_f.begin(span, newton, group, block)
            meet()
            done += int(1)

    @wp.func
    def aim_at(span: Span, newton: NewtonState, group: int, thread: int, threads: int):
        """A linear solve begins, with its right-hand side as the residual."""
        right = newton.residual
        square, _same = inner_products(span, right, right, right, right, group, thread, threads)
        keep(newton, 0, group, thread, newton_f.joined(square))
        if thread == 0:
            newton_f.aim(span, newton, group)
        meet()
        for block in range(thread, span.blocks, threads):
            newton_f.begin(span, newton, group, block)

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

    @wp.struct
    class BetaSearch:
        """One candidate's search for the beta of least error.

        target: the observed displacement; seen: (places,) 1 where it is; most: evaluations; limit: iterations of a
        state; tolerance: tolerance of beta; spread, share: tolerance of the search's states, and of the last one;
        relative: tolerance of their derivatives; found: beta, evaluations, whether the last step was below the
        tolerance, and the start of the next launch: bounds of beta, beta and slope before, and whether it is done
        turn: evaluations of a launch, after which the host can interrupt the search
        """

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

    @wp.func
    def slopes(span: Span, newton: NewtonState, search: BetaSearch, thread: int, threads: int):
        """Slope of the summed distance along d state / d beta (`step`), and a curvature that never overshoots."""
        slope = newton_f.sums()
        curvature = newton_f.sums()
        for block in range(thread, span.blocks, threads):
            at, count = newton_f.place_of(span, 0, block)
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
        return newton_f.joined(slope), newton_f.joined(curvature)

    @wp.func
    def anew(span: Span, newton: NewtonState, tolerance: wp.float64, relative: wp.float64, outer: int, thread: int):
        """Newton's steps (`outer`) or a linear solve of the one candidate begin."""
        if thread == 0:
            newton.tolerance[0] = tolerance
            newton.relative[0] = relative
            reach = wp.float64(wp.inf)
            if outer == 1:
                reach = wp.float64(REACH)
            newton_f.reset(span, newton, reach, outer, 1 - outer, 0)
        meet()

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
                    at, count = newton_f.place_of(span, 0, block)
                    along = vecs.load(newton.step, at, span.stride)
                    moved = vecs.add(vecs.load(newton.u, at, span.stride), scalar(new - beta), along)
                    vecs.store(newton.u, at, span.stride, moved, count)
                    vecs.store(newton.step, at, span.stride, vecs.rows(), count)
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

    small = newton_f.small_kernels(relax_kernel, steps_kernel)
    made = members(BetaSearch, steps, relax, aim, follow, *small)
    if on_cpu:
        made.goals = goals
    return made
