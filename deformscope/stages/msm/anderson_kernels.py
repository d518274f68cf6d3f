"""Warp kernels of Anderson's acceleration, over fields as `newton_functions` takes them."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Doubles, Ints, kernel_in, members, rows_for
from deformscope.stages.msm.lattice_kernels import FAR
from deformscope.stages.msm.newton_functions import CONVERGED, DIVERGED, RUNNING, STALLED, sum_functions_for

MEMORY = 8
"""Earlier iterates that Anderson's acceleration combines."""


@functools.cache
def anderson_kernels_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """A kernel for each part of an iteration, for fields of `dim` rows and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"anderson_{dim}d_{scalar.__name__}_{width}", scalar)
    vecs = rows_for(dim, width, scalar)
    load, store, add, scale, choose = vecs.load, vecs.store, vecs.add, vecs.scale, vecs.choose
    history = wp.types.matrix(shape=(MEMORY, MEMORY), dtype=wp.float64)
    history_vec = wp.types.vector(length=MEMORY, dtype=wp.float64)
    one = scalar(1.0)
    nought, unity = wp.float64(0.0), wp.float64(1.0)
    far, growth = wp.float64(FAR), wp.float64(1e2)
    ridge = wp.float64(1e-14 if scalar is wp.float64 else 1e-8)
    functions = sum_functions_for(dim, scalar, width)
    Span, sums, place_of, metric_of = functions.Span, functions.sums, functions.place_of, functions.metric_of
    of_candidate, add_product = functions.of_candidate, functions.add_product
    fold, joined, keep = functions.fold, functions.joined, functions.keep

    @wp.struct
    class AndersonState:
        """Memory of Anderson's acceleration for each candidate, and for fields: the iterates, and their changes."""

        tolerance: Doubles  # of the distance to the static state [spacing]; first entry
        floor: Doubles  # residual that is but rounding [spacing]; first entry
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
        u: numbers
        u_last: numbers
        du: numbers
        residual: numbers
        residual_last: numbers
        dr: numbers
        parts: Doubles  # of sums
        sides: int  # groups of candidates

    @wp.func
    def sum_of(span: Span, anderson: AndersonState, row: int, group: int, member: int):
        """A candidate's sum over a group's particles."""
        return functions.collected(span, anderson.parts, row, anderson.sides, group, member, 0)

    @kernel
    def remember(span: Span, anderson: AndersonState):
        """Keep the change of iterate and of residual since the last iteration in this iteration's slot."""
        group, block = wp.tid()
        if anderson.groups[group] == 0:
            return
        at, count = place_of(span, group, block)
        u = load(anderson.u, at, span.stride)
        r = load(anderson.residual, at, span.stride)
        k = anderson.count[group]
        if k > 0:
            slot = at + ((k - 1) % wp.static(MEMORY)) * wp.static(dim) * span.stride
            store(anderson.du, slot, span.stride, add(u, -one, load(anderson.u_last, at, span.stride)), count)
            store(anderson.dr, slot, span.stride, add(r, -one, load(anderson.residual_last, at, span.stride)), count)
        store(anderson.u_last, at, span.stride, u, count)
        store(anderson.residual_last, at, span.stride, r, count)

    @kernel
    def history_products(span: Span, anderson: AndersonState):
        """Parts of the newest residual change with each, of each with the residual; last the residual and the step."""
        group, what, item = wp.tid()
        if anderson.groups[group] == 0:
            return
        rows = wp.static(dim) * span.stride
        newest = (wp.max(anderson.count[group] - 1, 0) % wp.static(MEMORY)) * rows
        first_sum = sums()
        second_sum = sums()
        for block in range(item, span.blocks, span.parts * span.threads):
            at, _count = place_of(span, group, block)
            m = metric_of(span, block * wp.static(width))
            r = load(anderson.residual, at, span.stride)
            if what == wp.static(MEMORY):
                first_sum = add_product(first_sum, m, r, r)
                du = load(anderson.du, at + newest, span.stride)
                second_sum = add_product(second_sum, m, du, du)
            else:
                dr = load(anderson.dr, at + what * rows, span.stride)
                first_sum = add_product(first_sum, m, dr, load(anderson.dr, at + newest, span.stride))
                second_sum = add_product(second_sum, m, dr, r)
        keep(span, anderson.parts, 2 * what * anderson.sides + group, item, joined(first_sum))
        keep(span, anderson.parts, (2 * what + 1) * anderson.sides + group, item, joined(second_sum))

    @kernel
    def accelerate(span: Span, anderson: AndersonState):
        """Anderson's weights of the remembered changes: least squares of the residual over them, slightly damped.

        The remaining distance is estimated from the path over the last quarter of all iterations, because accelerated
        steps are as long as the error that they remove. It is also estimated from the residual over the smallest
        restoring slope so far. An estimate at the end of a stretch may come after the residual has reached rounding,
        where changes do not show the slope. When the residual has grown far above its best, the memory is dropped and a
        plain step follows."""
        group, thread = wp.tid()
        if anderson.groups[group] == 0:
            return
        for row in range(wp.static(2 * MEMORY + 2)):
            fold(span, anderson.parts, row, anderson.sides, group, thread, 0)
        if thread > 0:
            return
        k = anderson.count[group]
        any_running = int(0)
        for member in range(span.abreast):
            i = group * span.abreast + member
            for slot in range(wp.static(MEMORY)):
                anderson.gamma[slot * anderson.stride + i] = scalar(0.0)
            if anderson.state[i] == wp.static(RUNNING):
                norm = wp.sqrt(sum_of(span, anderson, wp.static(2 * MEMORY), group, member) / span.metric_total)
                anderson.norm[i] = norm
                anderson.total[i] = anderson.total[i] + 1
                if k > 0:
                    step = sum_of(span, anderson, wp.static(2 * MEMORY + 1), group, member)
                    newest_row = 2 * ((k - 1) % wp.static(MEMORY))
                    change = sum_of(span, anderson, newest_row, group, member)
                    anderson.path[i] = anderson.path[i] + wp.sqrt(step / span.metric_total)
                    if step > nought:
                        anderson.least[i] = wp.min(anderson.least[i], wp.sqrt(change / step))
                done = anderson.total[i]
                least = wp.min(anderson.least[i], anderson.least_before[i])
                left = wp.float64(10.0) * norm / wp.max(least, wp.float64(1e-12))
                if not wp.isfinite(norm) or norm > far:
                    anderson.state[i] = wp.static(DIVERGED)
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
                        both = sum_of(span, anderson, 2 * j, group, member)
                        g[j, newest] = both
                        g[newest, j] = both
                    rhs[j] = sum_of(span, anderson, 2 * j + 1, group, member)
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
    def advance(span: Span, anderson: AndersonState):
        """The accelerated step."""
        group, block = wp.tid()
        if anderson.groups[group] == 0:
            return
        at, count = place_of(span, group, block)
        runs = functions.flagged(span, anderson.state, group)  # RUNNING is 1
        moved = load(anderson.residual, at, span.stride)
        for slot in range(wp.static(MEMORY)):
            w = of_candidate(span, anderson.gamma, group, slot * anderson.stride)
            row = at + slot * wp.static(dim) * span.stride
            moved = add(moved, -one, scale(load(anderson.du, row, span.stride), w))
            moved = add(moved, -one, scale(load(anderson.dr, row, span.stride), w))
        store(anderson.u, at, span.stride, add(load(anderson.u, at, span.stride), one, choose(runs, moved)), count)

    return members(AndersonState, remember, history_products, accelerate, advance)
