"""Functions of Newton's steps with conjugate gradients, over fields of particles in their layout (see `layout.py`).

Sums over particles are taken in a fixed order, so that runs repeat bit for bit. Candidates are independent: finished
ones have steps of 0, and a group in which all have ended is skipped."""

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Doubles, Ints, Sized, lanes_for, members, rows_for
from deformscope.stages.msm.lattice_kernels import FAR

RUNNING, CONVERGED, DIVERGED, STALLED = 1, 0, -1, 2

REACH = 1.0
"""Spacings that no particle ever goes beyond in one Newton step: rotations are not straight."""

PATIENCE = 20
"""Number of Newton steps near rounding that do not halve the best residual, after which a candidate counts as
stalled."""

SHARP = 1e-2
"""Share to which a solve reduces its residual before its smallest curvature counts as the smallest."""

NOUGHT, UNITY, HALF, TENTH = (wp.constant(wp.float64(each)) for each in (0.0, 1.0, 0.5, 0.1))


@functools.cache
def place_functions_for(scalar: Any, width: int) -> SimpleNamespace:
    """Where particles lie in a field, and a candidate's numbers in lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    lanes = lanes_for(width, scalar)
    lane, own, one = lanes.lane, lanes.own, scalar(1.0)

    @wp.struct
    class Span:
        """How particles lie in a field, and their metric N_i m_i (0 where held), in which the goal map is symmetric.

        blocks: lanes' worths in a group; parts: a sum over a group has this number of parts, each by `threads` of a
        block"""

        abreast: int
        blocks: int
        parts: int
        threads: int
        front: int
        group: int
        stride: int
        metric: numbers
        metric_total: wp.float64

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

    return members(Span, place_of, metric_of, of_candidate, flagged)


@functools.cache
def sum_functions_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """Sums over the particles of a group, for fields of `dim` rows; those of `place_functions_for` too."""
    numbers = wp.array(dtype=scalar)
    places, vecs, lane = place_functions_for(scalar, width), rows_for(dim, width, scalar), lanes_for(width, scalar).lane
    Span, place_of, metric_of = places.Span, places.place_of, places.metric_of
    sums = wp.types.vector(length=width, dtype=wp.float64)
    sums_c = f"wp::vec_t<{width}, wp::float64>"
    each = f"for (int l = 0; l < {width}; ++l)"

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
            first_sum = add_product(first_sum, m, vecs.load(a, at, span.stride), vecs.load(b, at, span.stride))
            second_sum = add_product(second_sum, m, vecs.load(c, at, span.stride), vecs.load(d, at, span.stride))
        return first_sum, second_sum

    made = members(*(add_product, longer, put, keep, fold, collected, inner_products), sums=sums, vecs=vecs)
    return SimpleNamespace(**vars(places), **vars(made), joined=joined, longest_of=longest_of)


@functools.cache
def newton_state_for(scalar: Any) -> Any:
    """The struct type of what Newton's steps remember, for fields of `scalar`."""
    numbers = wp.array(dtype=scalar)

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

    return NewtonState


@dataclass(frozen=True, eq=False)
class StepHelpers:
    """What the functions of a step share: functions of `sum_functions_for`; flat: share of a displacement's square that
    its curvature must exceed to count."""

    dim: int
    scalar: Any
    width: int
    functions: SimpleNamespace
    NewtonState: Any
    flat: Any


def judge_for(helpers: StepHelpers) -> Any:
    """The function that ends a Newton step."""
    scalar, flat, f = helpers.scalar, helpers.flat, helpers.functions
    Span, NewtonState = f.Span, helpers.NewtonState
    far, sharp = wp.float64(FAR), wp.float64(SHARP)

    @wp.func
    def judge(span: Span, newton: NewtonState, group: int):
        """After a Newton step: has it gone too far, is this the static state, and how well to solve for the next step.

        The energy falls along the step as long as its slope <residual, step> is positive. If the slope at the end is
        clearly negative, the step is shortened to where the slope would vanish, and the next goes no farther. The
        remaining distance is (at most five times) the residual over the smallest curvature of the last solves, if they
        went far enough to find it. A mode with a restoring force of 2e-4 of its displacement has a residual 5000 times
        smaller than its error."""
        any_outer = int(0)
        any_inner = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.by[i] = scalar(0.0)
            newton.inner[i] = 0
            if newton.state[i] == wp.static(RUNNING):
                norm = wp.sqrt(f.collected(span, newton.parts, 0, newton.groups, group, member, 0) / span.metric_total)
                along = f.collected(span, newton.parts, 1, newton.groups, group, member, 0)
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
                elif newton.outers[i] > 0 and taken * along < -HALF * slope and newton.backs[i] < 12:
                    share = slope / (slope - taken * along)
                    newton.by[i] = scalar(-(UNITY - share) * taken)
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
                    if norm < HALF * newton.best[i]:
                        newton.best[i] = norm
                        newton.stalls[i] = 0
                    elif norm <= wp.float64(1000.0) * newton.floor[0]:  # before, it may well rise
                        newton.stalls[i] = newton.stalls[i] + 1
                    if newton.stalls[i] > wp.static(PATIENCE):
                        newton.state[i] = wp.static(STALLED)
                    else:
                        forcing = wp.min(TENTH, wp.sqrt(norm / newton.first[i]))
                        goal = forcing * norm
                        if newton.outers[i] > 0:
                            goal = wp.max(goal, TENTH * tolerance * least)
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
                        newton.slope[i] = NOUGHT
                        newton.outers[i] = newton.outers[i] + 1
                        newton.least_before[i] = newton.least[i]
                        newton.least[i] = wp.float64(1.0)
            if newton.state[i] == wp.static(RUNNING):
                any_outer = int(1)
            if newton.inner[i] == 1:
                any_inner = int(1)
        newton.outer_groups[group] = any_outer
        newton.inner_groups[group] = any_inner

    return judge


def curvature_for(helpers: StepHelpers) -> Any:
    """The function that ends the evaluation of a derivative along the direction."""
    scalar, flat, f = helpers.scalar, helpers.flat, helpers.functions
    Span, NewtonState, reach = f.Span, helpers.NewtonState, wp.float64(REACH)

    @wp.func
    def curvature(span: Span, newton: NewtonState, group: int):
        """How far to go along the direction p: to the minimum, by its curvature <p, (I - J) p>.

        Where the energy has negative curvature (a crushed cluster about to turn, a strut about to buckle) the solve
        ends with a step along that direction, as far as particles may move in one step. `judge` shortens it if that is
        too far."""
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.length[i] = scalar(0.0)
            if newton.inner[i] == 1:
                stiff = -f.collected(span, newton.parts, 0, newton.groups, group, member, 0)
                own_square = f.collected(span, newton.parts, 1, newton.groups, group, member, 0)
                if stiff > flat * own_square:
                    length = newton.square[i] / stiff
                    newton.length[i] = scalar(length)
                    newton.slope[i] = newton.slope[i] + length * newton.square[i]
                    newton.least[i] = wp.min(newton.least[i], stiff / own_square)
                elif own_square <= NOUGHT:  # nothing is asked for
                    newton.last[i] = 1
                else:
                    newton.last[i] = 1
                    length = reach / wp.sqrt(own_square / span.metric_total)
                    newton.length[i] = scalar(length)
                    newton.slope[i] = newton.slope[i] + length * newton.square[i]

    return curvature


def conjugate_for(helpers: StepHelpers) -> tuple[Any, Any]:
    """The functions that mix the next direction, without a preconditioner and with one."""
    scalar, f, NewtonState = helpers.scalar, helpers.functions, helpers.NewtonState
    Span, positive = f.Span, wp.float64(1e-6)

    @wp.func
    def conjugate(span: Span, newton: NewtonState, group: int):
        """Ends the solve, or mixes the next direction.

        No particle goes farther in one step than steps have proved good."""
        any_inner = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.mix[i] = scalar(0.0)
            if newton.inner[i] == 1:
                fresh = f.collected(span, newton.parts, 0, newton.groups, group, member, 0)
                longest = wp.sqrt(f.collected(span, newton.parts, 1, newton.groups, group, member, 1))
                newton.total[i] = newton.total[i] + 1
                newton.inners[i] = newton.inners[i] + 1
                linear = newton.relative[0] > NOUGHT
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
                    taken = UNITY
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
    def mix_aided(span: Span, newton: NewtonState, group: int):
        """Weight of the last direction, with a preconditioner; a candidate continues without it (z = rho) once it is
        not positive there, or a solve takes more than `patience` directions."""
        for member in range(span.abreast):
            i = group * span.abreast + member
            newton.mix[i] = scalar(0.0)  # also of what ended: its direction may be 0 / 0
            if newton.inner[i] == 1:
                product = f.collected(span, newton.parts, 0, newton.groups, group, member, 0)
                square = f.collected(span, newton.parts, 1, newton.groups, group, member, 0)
                last = newton.along[i]
                if newton.inners[i] == 0:
                    last = NOUGHT
                if newton.plain[i] == 0:
                    if product >= positive * square and wp.isfinite(product) and newton.inners[i] < newton.patience:
                        newton.applied[i] = newton.applied[i] + 1
                    else:
                        newton.plain[i] = 1
                        last = NOUGHT
                if newton.plain[i] != 0:
                    product = square
                if last > NOUGHT:
                    newton.mix[i] = scalar(product / last)
                newton.square[i] = wp.max(product, wp.float64(1e-300))
                newton.along[i] = product

    return conjugate, mix_aided


def beginnings_for(helpers: StepHelpers) -> tuple[Any, Any]:
    """The functions with which a linear solve and all candidates begin."""
    scalar, f, NewtonState = helpers.scalar, helpers.functions, helpers.NewtonState
    Span = f.Span

    @wp.func
    def aim(span: Span, newton: NewtonState, group: int):
        """A linear solve ends at `relative` of its right-hand side."""
        for member in range(span.abreast):
            i = group * span.abreast + member
            square = wp.max(f.collected(span, newton.parts, 0, newton.groups, group, member, 0), wp.float64(1e-300))
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
            newton.slope[i] = NOUGHT
            newton.taken[i] = NOUGHT
            newton.norm[i] = wp.float64(wp.inf)
            newton.error[i] = wp.float64(wp.inf)
            newton.least[i] = UNITY
            newton.least_before[i] = UNITY
            newton.reach[i] = reach

    return aim, reset


def motions_for(helpers: StepHelpers) -> SimpleNamespace:
    """The functions that each change a block's fields."""
    scalar, width, f, NewtonState = helpers.scalar, helpers.width, helpers.functions, helpers.NewtonState
    vecs, lane, Span, one = f.vecs, lanes_for(width, scalar).lane, f.Span, scalar(1.0)

    @wp.func
    def move(span: Span, newton: NewtonState, group: int, block: int):
        """Goes along the step."""
        at, count = f.place_of(span, group, block)
        by = f.of_candidate(span, newton.by, group, 0)
        new = vecs.add(
            vecs.load(newton.u, at, span.stride), one, vecs.scale(vecs.load(newton.step, at, span.stride), by)
        )
        vecs.store(newton.u, at, span.stride, new, count)

    @wp.func
    def begin(span: Span, newton: NewtonState, group: int, block: int):
        """Conjugate gradients start at a step of 0, unless the last step is to be shortened first."""
        at, count = f.place_of(span, group, block)
        begins = f.flagged(span, newton.inner, group)
        keeps = lane(one) - begins
        r = vecs.choose(begins, vecs.load(newton.residual, at, span.stride))
        vecs.store(newton.rho, at, span.stride, r, count)
        vecs.store(newton.direction, at, span.stride, r, count)
        vecs.store(newton.step, at, span.stride, vecs.choose(keeps, vecs.load(newton.step, at, span.stride)), count)

    @wp.func
    def descend(span: Span, newton: NewtonState, group: int, part: int, parts: int):
        """Goes along the direction; the new squared residual, and the longest |step_i|^2, as for `inner_products`."""
        square_sum = f.sums()
        longest = f.sums()
        length = f.of_candidate(span, newton.length, group, 0)
        for block in range(part, span.blocks, parts):
            at, count = f.place_of(span, group, block)
            s = vecs.add(
                vecs.load(newton.step, at, span.stride),
                one,
                vecs.scale(vecs.load(newton.direction, at, span.stride), length),
            )
            r = vecs.add(
                vecs.load(newton.rho, at, span.stride),
                one,
                vecs.scale(vecs.load(newton.changed, at, span.stride), length),
            )
            vecs.store(newton.step, at, span.stride, s, count)
            vecs.store(newton.rho, at, span.stride, r, count)
            square_sum = f.add_product(square_sum, f.metric_of(span, block * wp.static(width)), r, r)
            longest = f.longer(longest, s)
        return square_sum, longest

    @wp.func
    def direct(span: Span, newton: NewtonState, group: int, block: int):
        """The next direction."""
        at, count = f.place_of(span, group, block)
        mix = f.of_candidate(span, newton.mix, group, 0)
        p = vecs.add(
            vecs.load(newton.rho, at, span.stride), one, vecs.scale(vecs.load(newton.direction, at, span.stride), mix)
        )
        vecs.store(newton.direction, at, span.stride, p, count)

    @wp.func
    def direct_aided(span: Span, newton: NewtonState, group: int, block: int):
        """The next direction, with a preconditioner."""
        at, count = f.place_of(span, group, block)
        without = f.flagged(span, newton.plain, group)
        z = vecs.choose(lane(one) - without, vecs.load(newton.z, at, span.stride))
        p = vecs.add(vecs.choose(without, vecs.load(newton.rho, at, span.stride)), one, z)
        mix = f.of_candidate(span, newton.mix, group, 0)
        p = vecs.add(p, one, vecs.scale(vecs.load(newton.direction, at, span.stride), mix))
        vecs.store(newton.direction, at, span.stride, p, count)

    return members(move, begin, descend, direct, direct_aided)


@functools.cache
def newton_functions_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """The functions for fields of `dim` rows and lanes of `width`, those of sums too."""
    functions, NewtonState = sum_functions_for(dim, scalar, width), newton_state_for(scalar)
    flat = wp.float64(1e-12 if scalar is wp.float64 else 1e-7)
    helpers = StepHelpers(dim, scalar, width, functions, NewtonState, flat)
    numbers, Span, (aim, reset) = wp.array(dtype=scalar), functions.Span, beginnings_for(helpers)

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

    made = members(NewtonState, judge_for(helpers), curvature_for(helpers), *conjugate_for(helpers), aim, reset)
    motions = vars(motions_for(helpers))
    return SimpleNamespace(**vars(functions), **vars(made), **motions, small_kernels=small_kernels)
