"""Warp kernels of the multigrid preconditioner: transfers between two lattices, and a step of the smoother.

What goes from one lattice to another is plain numbers, place by place and candidate by candidate; smoothing goes
through fields in lanes.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.iteration_kernels import newton_functions_for
from deformscope.stages.msm.lanes import Doubles, Ints, lanes_for, rows_for
from deformscope.stages.msm.members import kernel_in, members


@wp.struct
class Cells:
    """Where a field keeps the cells of a lattice: see `layout.Layout`."""

    front: int
    group: int
    stride: int
    abreast: int
    cells_0: int
    cells_1: int
    cells_2: int


@wp.struct
class Transfer:
    """Linear interpolation between two lattices, or its transpose: of each plane of the target, axis after axis, the
    planes of the source, numbered so too, and their weights, from `begin` on."""

    begin: Ints
    plane: Ints
    weight: wp.array(dtype=wp.float32)


@functools.cache
def transfer_kernels_for(dim: int, scalar: Any) -> SimpleNamespace:
    """The kernels for fields of `dim` rows; `scalar` is that of the fields that are preconditioned."""
    numbers = wp.array(dtype=wp.float32)
    kernel = kernel_in(f"transfer_{dim}d_{scalar.__name__}", wp.float32)
    vec = wp.types.vector(length=dim, dtype=wp.float32)

    @wp.func
    def at(place: Cells, candidate: int, cell: int):
        group = candidate / place.abreast
        return place.front + group * place.group + cell * place.abreast + candidate - group * place.abreast

    def conversion(name: str, given: Any, wanted: Any) -> Any:
        """The kernel that makes a field one of another type, for another layout."""

        @kernel(name=name)
        def convert(source: Cells, target: Cells, values: wp.array(dtype=given), out: wp.array(dtype=wanted)):
            candidate, cell = wp.tid()
            i, o = at(source, candidate, cell), at(target, candidate, cell)
            for k in range(wp.static(dim)):
                out[o + k * target.stride] = wanted(values[i + k * source.stride])

        return convert

    @kernel
    def gather(
        transfer: Transfer,
        source: Cells,
        target: Cells,
        # In: two fields that are added, a weight of each cell of the source, and of each of the target
        values: numbers,
        more: numbers,
        source_weight: numbers,
        target_weight: numbers,
        # Out:
        out: numbers,
    ):
        candidate, cell = wp.tid()
        t0 = cell / (target.cells_1 * target.cells_2)
        rest = cell - t0 * target.cells_1 * target.cells_2
        t1 = target.cells_0 + rest / target.cells_2
        t2 = target.cells_0 + target.cells_1 + rest % target.cells_2
        total = vec()
        if target_weight[cell] > wp.float32(0.0):
            for a in range(transfer.begin[t0], transfer.begin[t0 + 1]):
                for b in range(transfer.begin[t1], transfer.begin[t1 + 1]):
                    w1 = transfer.weight[a] * transfer.weight[b]
                    line = (transfer.plane[a] * source.cells_1 + transfer.plane[b] - source.cells_0) * source.cells_2
                    for c in range(transfer.begin[t2], transfer.begin[t2 + 1]):
                        own = line + transfer.plane[c] - source.cells_0 - source.cells_1
                        w = w1 * transfer.weight[c] * source_weight[own]
                        i = at(source, candidate, own)
                        for k in range(wp.static(dim)):
                            total[k] += w * (values[i + k * source.stride] + more[i + k * source.stride])
        o = at(target, candidate, cell)
        for k in range(wp.static(dim)):
            out[o + k * target.stride] = target_weight[cell] * total[k]

    return members(gather, conversion("put_in", scalar, wp.float32), conversion("take_out", wp.float32, scalar))


@functools.cache
def smoother_for(dim: int, width: int) -> Any:
    """The kernel of a step of Chebyshev's iteration, for fields of float32 in lanes of `width`."""
    numbers = wp.array(dtype=wp.float32)
    rows, newton = rows_for(dim, width, wp.float32), newton_functions_for(dim, wp.float32, width)
    load, store, add, scale = rows.load, rows.store, rows.add, rows.scale
    of_candidate, Span = newton.of_candidate, newton.Span
    one = wp.float32(1.0)

    @kernel_in(f"smoother_{dim}d_{width}", wp.float32)
    def smooth(
        span: Span,
        running: Ints,
        begins: int,
        keep: wp.float32,
        gain: wp.float32,
        # In: 1 / largest eigenvalue of each candidate, the right-hand side, and what the last direction changed
        shrink: numbers,
        right: numbers,
        changed: numbers,
        # In and out:
        z: numbers,
        left: numbers,
        direction: numbers,
    ):
        """Goes on along the next direction; what is left is not yet that after it. With `begins` from z = 0."""
        group, block = wp.tid()
        if running[group] != 0:
            at = span.front + group * span.group + block * wp.static(width)
            count = span.group - block * wp.static(width)
            by = of_candidate(span, shrink, group, 0) * gain
            if begins != 0:
                r = load(right, at, span.stride)
                d = scale(r, by)
                store(z, at, span.stride, d, count)
            else:
                r = add(load(left, at, span.stride), one, load(changed, at, span.stride))
                d = add(scale(r, by), keep, load(direction, at, span.stride))
                store(z, at, span.stride, add(load(z, at, span.stride), one, d), count)
            store(left, at, span.stride, r, count)
            store(direction, at, span.stride, d, count)

    return smooth


@functools.cache
def aided_kernels_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """What conjugate gradients do otherwise with a preconditioner."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"aided_{dim}d_{scalar.__name__}_{width}", scalar)
    rows, newton = rows_for(dim, width, scalar), newton_functions_for(dim, scalar, width)
    lane = lanes_for(width, scalar).lane
    load, store, add, scale, choose = rows.load, rows.store, rows.add, rows.scale, rows.choose
    of_candidate, fold, collected = newton.of_candidate, newton.fold, newton.collected
    Span, NewtonState = newton.Span, newton.NewtonState
    one, nought, small = scalar(1.0), wp.float64(0.0), wp.float64(1e-6)

    @kernel
    def mix(span: Span, state: NewtonState, patience: int, along: Doubles, plain: Ints, applied: Ints):
        """How much of the last direction to keep.

        A candidate goes on without the preconditioner (z = residual) once that is not positive there, or a solve takes
        more than `patience` directions.

        along: <residual, z> at the last direction; plain: whether a candidate goes without; applied: preconditionings
        """
        group, thread = wp.tid()
        if state.inner_groups[group] == 0:
            return
        fold(span, state.parts, 0, state.groups, group, thread, 0)
        fold(span, state.parts, 1, state.groups, group, thread, 0)
        if thread > 0:
            return
        for member in range(span.abreast):
            i = group * span.abreast + member
            if state.inner[i] == 1:
                product = collected(span, state.parts, 0, state.groups, group, member, 0)
                square = collected(span, state.parts, 1, state.groups, group, member, 0)
                last = along[i]
                if state.inners[i] == 0:
                    last = nought
                if plain[i] == 0:
                    if product >= small * square and wp.isfinite(product) and state.inners[i] < patience:
                        applied[i] = applied[i] + 1
                    else:
                        plain[i] = 1
                        last = nought
                if plain[i] != 0:
                    product = square
                state.mix[i] = scalar(0.0)
                if last > nought:
                    state.mix[i] = scalar(product / last)
                state.square[i] = product
                along[i] = product

    @kernel
    def direct(span: Span, state: NewtonState, plain: Ints, z_in: numbers):
        """The next direction."""
        group, block = wp.tid()
        if state.inner_groups[group] != 0:
            at, count = newton.place_of(span, group, block)
            without = newton.flagged(span, plain, group)
            z = choose(lane(one) - without, load(z_in, at, span.stride))
            p = add(choose(without, load(state.rho, at, span.stride)), one, z)
            p = add(p, one, scale(load(state.direction, at, span.stride), of_candidate(span, state.mix, group, 0)))
            store(state.direction, at, span.stride, p, count)

    return members(mix, direct)
