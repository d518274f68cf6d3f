"""Warp kernels of the multigrid preconditioner: transfers between two lattices, and a step of the smoother.

What goes from one lattice to another is plain numbers, place by place and candidate by candidate; smoothing goes
through fields in lanes.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.iteration_kernels import newton_functions_for
from deformscope.stages.msm.lanes import Doubles, Ints, lanes_for, module_options, rows_for


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
    """Linear interpolation from a coarse lattice, axis after axis: that of axis 0 first.

    parent, ahead: of each fine plane, the coarse plane before it and how far beyond that it lies (of 1); first, last:
    of each coarse plane, the fine ones that interpolate from it; fine_1, coarse_1...: where axis 1 begins in these
    """

    parent: Ints
    ahead: wp.array(dtype=wp.float32)
    first: Ints
    last: Ints
    fine_1: int
    fine_2: int
    coarse_1: int
    coarse_2: int


@functools.cache
def transfer_kernels_for(dim: int, scalar: Any) -> SimpleNamespace:
    """The kernels for fields of `dim` rows; `scalar` is that of the fields that are preconditioned."""
    numbers = wp.array(dtype=wp.float32)
    module = f"deformscope_transfer_{dim}d_{scalar.__name__}"
    wp.get_module(module).options.update(module_options(wp.float32))
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
    vec = wp.types.vector(length=dim, dtype=wp.float32)
    one = wp.float32(1.0)

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

    put_in, take_out = conversion("put_in", scalar, wp.float32), conversion("take_out", wp.float32, scalar)

    @wp.func
    def weight(transfer: Transfer, offset: int, fine: int, coarse: int):
        """How much of a coarse plane goes to a fine one."""
        t = transfer.ahead[offset + fine]
        if transfer.parent[offset + fine] == coarse:
            return one - t
        return t

    @kernel
    def restrict(
        transfer: Transfer,
        fine: Cells,
        coarse: Cells,
        # In: two fields that are added, a weight of each fine cell, and of each coarse one
        values: numbers,
        more: numbers,
        fine_weight: numbers,
        coarse_weight: numbers,
        # Out:
        out: numbers,
    ):
        """The transpose of the interpolation, of a field times a weight."""
        candidate, cell = wp.tid()
        i0 = cell / (coarse.cells_1 * coarse.cells_2)
        rest = cell - i0 * coarse.cells_1 * coarse.cells_2
        i1 = rest / coarse.cells_2
        i2 = rest - i1 * coarse.cells_2
        total = vec()
        if coarse_weight[cell] > wp.float32(0.0):
            for f0 in range(transfer.first[i0], transfer.last[i0] + 1):
                w0 = weight(transfer, 0, f0, i0)
                for f1 in range(transfer.first[transfer.coarse_1 + i1], transfer.last[transfer.coarse_1 + i1] + 1):
                    w1 = w0 * weight(transfer, transfer.fine_1, f1, i1)
                    for f2 in range(transfer.first[transfer.coarse_2 + i2], transfer.last[transfer.coarse_2 + i2] + 1):
                        own = (f0 * fine.cells_1 + f1) * fine.cells_2 + f2
                        w = w1 * weight(transfer, transfer.fine_2, f2, i2) * fine_weight[own]
                        i = at(fine, candidate, own)
                        for k in range(wp.static(dim)):
                            total[k] += w * (values[i + k * fine.stride] + more[i + k * fine.stride])
        o = at(coarse, candidate, cell)
        for k in range(wp.static(dim)):
            out[o + k * coarse.stride] = coarse_weight[cell] * total[k]

    @kernel
    def prolong(
        transfer: Transfer,
        fine: Cells,
        coarse: Cells,
        # In:
        values: numbers,
        changed: numbers,
        free: numbers,
        # In and out:
        z: numbers,
        left: numbers,
        # Out:
        direction: numbers,
    ):
        """Adds the coarse correction, which is the next direction; what is left takes what the last one changed."""
        candidate, cell = wp.tid()
        if free[cell] <= wp.float32(0.0):
            return
        f0 = cell / (fine.cells_1 * fine.cells_2)
        rest = cell - f0 * fine.cells_1 * fine.cells_2
        f1 = rest / fine.cells_2
        f2 = rest - f1 * fine.cells_2
        total = vec()
        for a in range(2):
            i0 = wp.min(transfer.parent[f0] + a, coarse.cells_0 - 1)
            w0 = weight(transfer, 0, f0, transfer.parent[f0] + a)
            for b in range(2):
                p1 = transfer.parent[transfer.fine_1 + f1] + b
                i1 = wp.min(p1, coarse.cells_1 - 1)
                w1 = w0 * weight(transfer, transfer.fine_1, f1, p1)
                for c in range(2):
                    p2 = transfer.parent[transfer.fine_2 + f2] + c
                    i2 = wp.min(p2, coarse.cells_2 - 1)
                    w = w1 * weight(transfer, transfer.fine_2, f2, p2)
                    i = at(coarse, candidate, (i0 * coarse.cells_1 + i1) * coarse.cells_2 + i2)
                    for k in range(wp.static(dim)):
                        total[k] += w * values[i + k * coarse.stride]
        o = at(fine, candidate, cell)
        for k in range(wp.static(dim)):
            here = o + k * fine.stride
            direction[here] = total[k]
            z[here] = z[here] + total[k]
            left[here] = left[here] + changed[here]

    return SimpleNamespace(**locals())


@functools.cache
def smoother_for(dim: int, width: int) -> Any:
    """The kernel of a step of Chebyshev's iteration, for fields of float32 in lanes of `width`."""
    numbers = wp.array(dtype=wp.float32)
    module = f"deformscope_smoother_{dim}d_{width}"
    wp.get_module(module).options.update(module_options(wp.float32))
    rows, newton = rows_for(dim, width, wp.float32), newton_functions_for(dim, wp.float32, width)
    load, store, add, scale = rows.load, rows.store, rows.add, rows.scale
    of_candidate, Span = newton.of_candidate, newton.Span
    one = wp.float32(1.0)

    @wp.kernel(module=module, enable_backward=False)
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
    module = f"deformscope_aided_{dim}d_{scalar.__name__}_{width}"
    wp.get_module(module).options.update(module_options(scalar))
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
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
            without = lane()
            for l in range(wp.static(width)):
                member = group
                if span.abreast > 1:
                    member = group * span.abreast + l
                without[l] = scalar(plain[member])
            p = add(
                choose(without, load(state.rho, at, span.stride)),
                one,
                choose(lane(one) - without, load(z_in, at, span.stride)),
            )
            p = add(p, one, scale(load(state.direction, at, span.stride), of_candidate(span, state.mix, group, 0)))
            store(state.direction, at, span.stride, p, count)

    return SimpleNamespace(**locals())
