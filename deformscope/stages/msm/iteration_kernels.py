"""Warp kernels of the two methods for a static state: Newton's steps with conjugate gradients; Anderson acceleration.

They take fields of particles as they lie (see `layout.py`), whatever the clusters. Sums over particles are
taken in a fixed order, so that runs repeat bit for bit. Candidates are independent: what has ended gets steps of
0, and a group in which all have ended is skipped.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Doubles, Ints, Sized, lanes_for, module_options, rows_for
from deformscope.stages.msm.lattice_kernels import FAR

MEMORY = 8
"""Earlier iterates that Anderson's acceleration combines."""

RUNNING, CONVERGED, DIVERGED, STALLED = 1, 0, -1, 2

REACH = 1.0
"""Spacings that no particle ever goes beyond in one Newton step: rotations are not straight."""

PATIENCE = 20
"""Newton steps near rounding without half the best residual so far, after which a candidate has stalled."""

SHARP = 1e-2
"""To what share a solve reduces its residual before the smallest curvature that it met counts as the smallest."""


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
    sharp = wp.float64(SHARP)

    @wp.struct
    class Span:
        """How particles lie in a field, and their metric N_i m_i (0 where held), in which the goal map is symmetric.

        blocks: lanes' worths in a group; parts: a sum over a group is taken in so many, each by `threads` of a block
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
        """What Newton's steps keep of each candidate (arrays of B), and which groups have work to do."""

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
        base = span.front + group * span.group
        for block in range(part, span.blocks, parts):
            number = block * wp.static(width)
            m = metric_of(span, number)
            first_sum = add_product(
                first_sum, m, load(a, base + number, span.stride), load(b, base + number, span.stride)
            )
            second_sum = add_product(
                second_sum, m, load(c, base + number, span.stride), load(d, base + number, span.stride)
            )
        return first_sum, second_sum

    @wp.func
    def move(span: Span, newton: NewtonState, step_in: numbers, u: numbers, group: int, block: int):
        """Goes along the step."""
        at = span.front + group * span.group + block * wp.static(width)
        count = span.group - block * wp.static(width)
        by = of_candidate(span, newton.by, group, 0)
        new = add(load(u, at, span.stride), one, scale(load(step_in, at, span.stride), by))
        store(u, at, span.stride, new, count)

    @wp.func
    def judge(span: Span, newton: NewtonState, parts: Doubles, groups: int, group: int):
        """After a Newton step: has it gone too far, is this the static state, and how well to solve for the next step.

        The energy falls along the step as long as its slope <residual, step> is positive; where the slope at the end is
        clearly negative, the step is shortened to where the slope would vanish, and the next goes no farther. The
        distance that is left is (at most five times) the residual over the smallest curvature that the last solves
        met, if they went far enough to meet it: a mode that pulls back by 2e-4 of its displacement has a residual 5000
        times smaller than its error.
        """
        any_outer = int(0)
        any_inner = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.by[i] = scalar(0.0)
            newton.inner[i] = 0
            if newton.state[i] == wp.static(RUNNING):
                norm = wp.sqrt(collected(span, parts, 0, groups, group, member, 0) / span.metric_total)
                along = collected(span, parts, 1, groups, group, member, 0)
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
    def begin(
        span: Span,
        newton: NewtonState,
        residual_in: numbers,
        rho_out: numbers,
        direction_out: numbers,
        step_out: numbers,
        group: int,
        block: int,
    ):
        """Conjugate gradients start at a step of 0, unless the last step is to be shortened first."""
        at = span.front + group * span.group + block * wp.static(width)
        count = span.group - block * wp.static(width)
        begins = lane()
        for l in range(wp.static(width)):
            member = group
            if span.abreast > 1:
                member = group * span.abreast + l
            begins[l] = scalar(newton.inner[member])
        keeps = lane(one) - begins
        r = choose(begins, load(residual_in, at, span.stride))
        store(rho_out, at, span.stride, r, count)
        store(direction_out, at, span.stride, r, count)
        store(step_out, at, span.stride, choose(keeps, load(step_out, at, span.stride)), count)

    @wp.func
    def curvature(span: Span, newton: NewtonState, parts: Doubles, groups: int, group: int):
        """How far to go along the direction p: to the minimum, by its curvature <p, (I - J) p>.

        Where the energy curves down (a crushed cluster about to turn, a strut about to buckle) the solve ends with a
        step along that direction as far as particles may go at once; `judge` shortens it where that is too far.
        """
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.length[i] = scalar(0.0)
            if newton.inner[i] == 1:
                stiff = -collected(span, parts, 0, groups, group, member, 0)
                own_square = collected(span, parts, 1, groups, group, member, 0)
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
    def descend(
        span: Span,
        newton: NewtonState,
        direction_in: numbers,
        change_in: numbers,
        step: numbers,
        rho: numbers,
        group: int,
        part: int,
        parts: int,
    ):
        """Goes along the direction; the new squared residual, and the longest |step_i|^2, as for `inner_products`."""
        square_sum = sums()
        longest = sums()
        base = span.front + group * span.group
        length = of_candidate(span, newton.length, group, 0)
        for block in range(part, span.blocks, parts):
            number = block * wp.static(width)
            at = base + number
            count = span.group - number
            s = add(load(step, at, span.stride), one, scale(load(direction_in, at, span.stride), length))
            r = add(load(rho, at, span.stride), one, scale(load(change_in, at, span.stride), length))
            store(step, at, span.stride, s, count)
            store(rho, at, span.stride, r, count)
            square_sum = add_product(square_sum, metric_of(span, number), r, r)
            longest = longer(longest, s)
        return square_sum, longest

    @wp.func
    def conjugate(span: Span, newton: NewtonState, parts: Doubles, groups: int, most: int, group: int):
        """Ends the solve, or mixes the next direction.

        No particle goes farther in one step than steps have proved good.
        """
        any_inner = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.mix[i] = scalar(0.0)
            if newton.inner[i] == 1:
                fresh = collected(span, parts, 0, groups, group, member, 0)
                longest = wp.sqrt(collected(span, parts, 1, groups, group, member, 1))
                newton.total[i] = newton.total[i] + 1
                newton.inners[i] = newton.inners[i] + 1
                linear = newton.relative[0] > nought
                done = newton.last[i] == 1 or fresh <= newton.target[i] or newton.inners[i] >= most
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
    def direct(span: Span, newton: NewtonState, rho_in: numbers, direction: numbers, group: int, block: int):
        """The next direction."""
        at = span.front + group * span.group + block * wp.static(width)
        count = span.group - block * wp.static(width)
        mix = of_candidate(span, newton.mix, group, 0)
        p = add(load(rho_in, at, span.stride), one, scale(load(direction, at, span.stride), mix))
        store(direction, at, span.stride, p, count)

    @wp.func
    def aim(span: Span, newton: NewtonState, parts: Doubles, groups: int, group: int):
        """A linear solve ends at `relative` of its right-hand side."""
        for member in range(span.abreast):
            i = group * span.abreast + member
            square = wp.max(collected(span, parts, 0, groups, group, member, 0), wp.float64(1e-300))
            newton.square[i] = square
            newton.target[i] = square * newton.relative[0] * newton.relative[0]

    @wp.func
    def reset(newton: NewtonState, groups: int, abreast: int, reach: wp.float64, outer: int, inner: int, i: int):
        """Every candidate runs, from Newton's first step or (with `inner`) from a linear solve."""
        if i < groups:
            newton.outer_groups[i] = outer
            newton.inner_groups[i] = inner
        if i < groups * abreast:
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
            newton.error[i] = wp.float64(wp.inf)
            newton.least[i] = unity
            newton.least_before[i] = unity
            newton.reach[i] = reach

    @wp.func
    def put_at(places: Ints, values: numbers, stride: int, first_out: numbers, second_out: numbers, i: int):
        """Puts vectors (component by component) at the places of two fields."""
        for k in range(wp.static(dim)):
            value = values[k * places.shape[0] + i]
            first_out[places[i] + k * stride] = value
            second_out[places[i] + k * stride] = value

    return SimpleNamespace(**locals())


@functools.cache
def iteration_kernels_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """A kernel for each part of an iteration, for fields of `dim` rows and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    module = f"deformscope_iteration_{dim}d_{scalar.__name__}_{width}"
    wp.get_module(module).options.update(module_options(scalar))
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
    lanes = lanes_for(width, scalar)
    lane = lanes.lane
    vecs = rows_for(dim, width, scalar)
    load, store, add, scale, choose = vecs.load, vecs.store, vecs.add, vecs.scale, vecs.choose
    history = wp.types.matrix(shape=(MEMORY, MEMORY), dtype=wp.float64)
    history_vec = wp.types.vector(length=MEMORY, dtype=wp.float64)
    one = scalar(1.0)
    nought, unity = wp.float64(0.0), wp.float64(1.0)
    far, growth = wp.float64(FAR), wp.float64(1e2)
    ridge = wp.float64(1e-14 if scalar is wp.float64 else 1e-8)
    functions = newton_functions_for(dim, scalar, width)
    Span, NewtonState, sums, put = functions.Span, functions.NewtonState, functions.sums, functions.put
    metric_of, of_candidate, add_product = functions.metric_of, functions.of_candidate, functions.add_product
    collected, fold, joined = functions.collected, functions.fold, functions.joined

    @wp.struct
    class AndersonState:
        """What Anderson's acceleration keeps of each candidate."""

        tolerance: Doubles  # of the distance to the static state [spacing]; first entry
        floor: Doubles  # residual that is but rounding [spacing]; first entry
        relative: Doubles  # reduction of a residual that ends a linear solve; first entry, 0: goals
        target: Doubles  # at which the residual of a linear solve ends
        state: Ints
        groups: Ints
        count: Ints  # iterations of a group
        known: Ints  # remembered changes that count
        total: Ints
        mark: Ints
        path: Doubles
        norm: Doubles
        best: Doubles
        error: Doubles
        least: Doubles  # smallest |dr| / |du| met since the last mark, and in the stretch before
        least_before: Doubles
        gram: wp.array(dtype=history)
        gamma: numbers  # weights of the remembered changes, slot by slot
        stride: int

    @wp.func
    def keep(span: Span, parts_out: Doubles, row: int, item: int, v: sums):
        """The sums of a block as its part of a row."""
        if item % span.threads == 0:
            put(parts_out, (row * span.parts + item / span.threads) * wp.static(width), v)

    @kernel
    def inner_products(
        span: Span, running: Ints, groups: int, a: numbers, b: numbers, c: numbers, d: numbers, parts_out: Doubles
    ):
        """Parts of <a, b> and of <c, d>."""
        group, item = wp.tid()
        if running[group] != 0:
            first_sum, second_sum = functions.inner_products(span, a, b, c, d, group, item, span.parts * span.threads)
            keep(span, parts_out, group, item, joined(first_sum))
            keep(span, parts_out, groups + group, item, joined(second_sum))

    @kernel
    def move(span: Span, newton: NewtonState, step_in: numbers, u: numbers):
        group, block = wp.tid()
        if newton.outer_groups[group] != 0:
            functions.move(span, newton, step_in, u, group, block)

    @kernel
    def judge(span: Span, newton: NewtonState, parts: Doubles, groups: int):
        group, thread = wp.tid()
        if newton.outer_groups[group] != 0:
            fold(span, parts, 0, groups, group, thread, 0)
            fold(span, parts, 1, groups, group, thread, 0)
            if thread == 0:
                functions.judge(span, newton, parts, groups, group)

    @kernel
    def begin(
        span: Span,
        newton: NewtonState,
        residual_in: numbers,
        rho_out: numbers,
        direction_out: numbers,
        step_out: numbers,
    ):
        group, block = wp.tid()
        if newton.inner_groups[group] != 0:
            functions.begin(span, newton, residual_in, rho_out, direction_out, step_out, group, block)

    @kernel
    def curvature(span: Span, newton: NewtonState, parts: Doubles, groups: int):
        group, thread = wp.tid()
        if newton.inner_groups[group] != 0:
            fold(span, parts, 0, groups, group, thread, 0)
            fold(span, parts, 1, groups, group, thread, 0)
            if thread == 0:
                functions.curvature(span, newton, parts, groups, group)

    @kernel
    def descend(
        span: Span,
        newton: NewtonState,
        groups: int,
        direction_in: numbers,
        change_in: numbers,
        step: numbers,
        rho: numbers,
        parts_out: Doubles,
    ):
        group, item = wp.tid()
        if newton.inner_groups[group] != 0:
            square_sum, longest = functions.descend(
                span, newton, direction_in, change_in, step, rho, group, item, span.parts * span.threads
            )
            keep(span, parts_out, group, item, joined(square_sum))
            keep(span, parts_out, groups + group, item, functions.longest_of(longest))

    @kernel
    def conjugate(span: Span, newton: NewtonState, parts: Doubles, groups: int, most: int):
        group, thread = wp.tid()
        if newton.inner_groups[group] != 0:
            fold(span, parts, 0, groups, group, thread, 0)
            fold(span, parts, 1, groups, group, thread, 1)
            if thread == 0:
                functions.conjugate(span, newton, parts, groups, most, group)

    @kernel
    def direct(span: Span, newton: NewtonState, rho_in: numbers, direction: numbers):
        group, block = wp.tid()
        if newton.inner_groups[group] != 0:
            functions.direct(span, newton, rho_in, direction, group, block)

    @kernel
    def aim(span: Span, newton: NewtonState, parts: Doubles, groups: int):
        group, thread = wp.tid()
        fold(span, parts, 0, groups, group, thread, 0)
        if thread == 0:
            functions.aim(span, newton, parts, groups, group)

    @kernel
    def reset(newton: NewtonState, groups: int, abreast: int, reach: wp.float64, outer: int, inner: int):
        functions.reset(newton, groups, abreast, reach, outer, inner, wp.tid())

    @kernel
    def remember(
        span: Span,
        anderson: AndersonState,
        # In:
        u_in: numbers,
        residual_in: numbers,
        # Out:
        u_last: numbers,
        residual_last: numbers,
        du_out: numbers,
        dr_out: numbers,
    ):
        """Keep the change of iterate and of residual since the last iteration in this iteration's slot."""
        group, block = wp.tid()
        if anderson.groups[group] == 0:
            return
        at = span.front + group * span.group + block * wp.static(width)
        count = span.group - block * wp.static(width)
        u = load(u_in, at, span.stride)
        r = load(residual_in, at, span.stride)
        k = anderson.count[group]
        if k > 0:
            slot = at + ((k - 1) % wp.static(MEMORY)) * wp.static(dim) * span.stride
            store(du_out, slot, span.stride, add(u, -one, load(u_last, at, span.stride)), count)
            store(dr_out, slot, span.stride, add(r, -one, load(residual_last, at, span.stride)), count)
        store(u_last, at, span.stride, u, count)
        store(residual_last, at, span.stride, r, count)

    @kernel
    def history_products(
        span: Span,
        anderson: AndersonState,
        groups: int,
        # In:
        residual_in: numbers,
        du_in: numbers,
        dr_in: numbers,
        # Out:
        parts_out: Doubles,
    ):
        """Parts of the newest residual change with each, of each with the residual; last the residual and the step."""
        group, what, item = wp.tid()
        if anderson.groups[group] == 0:
            return
        base = span.front + group * span.group
        rows = wp.static(dim) * span.stride
        newest = (wp.max(anderson.count[group] - 1, 0) % wp.static(MEMORY)) * rows
        first_sum = sums()
        second_sum = sums()
        for block in range(item, span.blocks, span.parts * span.threads):
            number = block * wp.static(width)
            at = base + number
            m = metric_of(span, number)
            r = load(residual_in, at, span.stride)
            if what == wp.static(MEMORY):
                first_sum = add_product(first_sum, m, r, r)
                du = load(du_in, at + newest, span.stride)
                second_sum = add_product(second_sum, m, du, du)
            else:
                dr = load(dr_in, at + what * rows, span.stride)
                first_sum = add_product(first_sum, m, dr, load(dr_in, at + newest, span.stride))
                second_sum = add_product(second_sum, m, dr, r)
        keep(span, parts_out, 2 * what * groups + group, item, joined(first_sum))
        keep(span, parts_out, (2 * what + 1) * groups + group, item, joined(second_sum))

    @kernel
    def accelerate(span: Span, anderson: AndersonState, parts: Doubles, groups: int):
        """Anderson's weights of the remembered changes: least squares of the residual over them, slightly damped.

        The distance still to go is judged by the path over the last quarter of all iterations, since accelerated steps
        are as long as the error that they remove, and by the residual over the smallest pull back that they met. A
        linear solve ends on its residual as a share of the right-hand side: an estimate that waits for the end of a
        stretch can come after the residual has reached rounding, where changes say nothing of the pull back. When the
        residual has grown far above its best, the memory is dropped and a plain step follows.
        """
        group, thread = wp.tid()
        if anderson.groups[group] == 0:
            return
        for row in range(wp.static(2 * MEMORY + 2)):
            fold(span, parts, row, groups, group, thread, 0)
        if thread > 0:
            return
        k = anderson.count[group]
        any_running = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            for slot in range(wp.static(MEMORY)):
                anderson.gamma[slot * anderson.stride + i] = scalar(0.0)
            if anderson.state[i] == wp.static(RUNNING):
                norm = wp.sqrt(
                    collected(span, parts, wp.static(2 * MEMORY), groups, group, member, 0) / span.metric_total
                )
                anderson.norm[i] = norm
                anderson.total[i] = anderson.total[i] + 1
                if k == 0:  # a linear solve starts at 0, where its residual is the right-hand side
                    anderson.target[i] = anderson.relative[0] * norm
                else:
                    step = collected(span, parts, wp.static(2 * MEMORY + 1), groups, group, member, 0)
                    newest_row = 2 * ((k - 1) % wp.static(MEMORY))
                    change = collected(span, parts, newest_row, groups, group, member, 0)
                    anderson.path[i] = anderson.path[i] + wp.sqrt(step / span.metric_total)
                    if step > nought:
                        anderson.least[i] = wp.min(anderson.least[i], wp.sqrt(change / step))
                done = anderson.total[i]
                least = wp.min(anderson.least[i], anderson.least_before[i])
                left = wp.float64(10.0) * norm / wp.max(least, wp.float64(1e-12))
                if not wp.isfinite(norm) or norm > far:
                    anderson.state[i] = wp.static(DIVERGED)
                elif norm <= anderson.target[i]:
                    anderson.state[i] = wp.static(CONVERGED)
                elif norm <= anderson.floor[0]:
                    anderson.error[i] = left
                    anderson.state[i] = wp.static(STALLED)
                    if k == 0 or left <= anderson.tolerance[0]:
                        anderson.state[i] = wp.static(CONVERGED)
                elif done >= anderson.mark[i]:
                    anderson.error[i] = wp.max(anderson.path[i], left)
                    anderson.mark[i] = done + wp.max(done / 3, 8)
                    anderson.path[i] = nought
                    anderson.least_before[i] = anderson.least[i]
                    anderson.least[i] = unity
                    if anderson.error[i] <= anderson.tolerance[0]:
                        anderson.state[i] = wp.static(CONVERGED)
            if anderson.state[i] == wp.static(RUNNING):
                any_running = int(1)
                norm = anderson.norm[i]
                known = anderson.known[i]
                if k > 0:
                    known = wp.min(known + 1, wp.static(MEMORY))
                g = anderson.gram[i]
                rhs = history_vec()
                newest = wp.max(k - 1, 0) % wp.static(MEMORY)
                for j in range(wp.static(MEMORY)):
                    if k > 0:
                        both = collected(span, parts, 2 * j, groups, group, member, 0)
                        g[j, newest] = both
                        g[newest, j] = both
                    rhs[j] = collected(span, parts, 2 * j + 1, groups, group, member, 0)
                anderson.gram[i] = g
                if norm > growth * anderson.best[i]:
                    anderson.best[i] = norm
                    known = int(0)
                anderson.best[i] = wp.min(anderson.best[i], norm)
                anderson.known[i] = known
                # scaled to a unit diagonal (the changes shrink by orders as it converges); Cholesky with a small ridge
                unit = history_vec()
                for j in range(wp.static(MEMORY)):
                    age = (newest - j + wp.static(MEMORY)) % wp.static(MEMORY)
                    if age < known and g[j, j] > nought:
                        unit[j] = unity / wp.sqrt(g[j, j])
                low = history()
                for j in range(wp.static(MEMORY)):
                    for m in range(j + 1):
                        value = g[j, m] * unit[j] * unit[m]
                        if j == m:
                            value = unity + ridge
                        for n in range(m):
                            value -= low[j, n] * low[m, n]
                        if j == m:
                            low[j, j] = wp.sqrt(wp.max(value, ridge))
                        else:
                            low[j, m] = value / low[m, m]
                y = history_vec()
                for j in range(wp.static(MEMORY)):
                    value = rhs[j] * unit[j]
                    for m in range(j):
                        value -= low[j, m] * y[m]
                    y[j] = value / low[j, j]
                for back in range(wp.static(MEMORY)):
                    j = wp.static(MEMORY - 1) - back
                    value = y[j]
                    for m in range(j + 1, wp.static(MEMORY)):
                        value -= low[m, j] * y[m]
                    y[j] = value / low[j, j]
                for j in range(wp.static(MEMORY)):
                    anderson.gamma[j * anderson.stride + i] = scalar(y[j] * unit[j])
        anderson.count[group] = k + 1
        anderson.groups[group] = any_running

    @kernel
    def advance(
        span: Span,
        anderson: AndersonState,
        # In:
        residual_in: numbers,
        du_in: numbers,
        dr_in: numbers,
        # Out:
        u: numbers,
    ):
        """The accelerated step."""
        group, block = wp.tid()
        if anderson.groups[group] == 0:
            return
        at = span.front + group * span.group + block * wp.static(width)
        count = span.group - block * wp.static(width)
        runs = lane()
        for l in range(wp.static(width)):
            member = group
            if span.abreast > 1:
                member = group * span.abreast + l
            if anderson.state[member] == wp.static(RUNNING):
                runs[l] = one
        moved = load(residual_in, at, span.stride)
        for slot in range(wp.static(MEMORY)):
            w = of_candidate(span, anderson.gamma, group, slot * anderson.stride)
            row = at + slot * wp.static(dim) * span.stride
            moved = add(moved, -one, scale(load(du_in, row, span.stride), w))
            moved = add(moved, -one, scale(load(dr_in, row, span.stride), w))
        store(u, at, span.stride, add(load(u, at, span.stride), one, choose(runs, moved)), count)

    @kernel
    def add_field(
        span: Span,
        running: Ints,
        # In:
        field_in: numbers,
        # In and out:
        total: numbers,
    ):
        """total += field."""
        group, block = wp.tid()
        if running[group] == 0:
            return
        at = span.front + group * span.group + block * wp.static(width)
        count = span.group - block * wp.static(width)
        store(total, at, span.stride, add(load(total, at, span.stride), one, load(field_in, at, span.stride)), count)

    @kernel
    def put_at(places: Ints, values: numbers, stride: int, first_out: numbers, second_out: numbers):
        functions.put_at(places, values, stride, first_out, second_out, wp.tid())

    return SimpleNamespace(**locals())
