"""Warp kernels of the multigrid preconditioner: transfers between two lattices, and a step of the smoother.

Values from one lattice to another are plain numbers, place by place and candidate by candidate; smoothing goes through
fields in lanes."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Ints, rows_for
from deformscope.stages.msm.members import kernel_in, members
from deformscope.stages.msm.newton_functions import sum_functions_for


@wp.struct
class Cells:
    """Places of a lattice's cells in a field: see `layout.Layout`."""

    front: int
    group: int
    stride: int
    abreast: int
    cells_0: int
    cells_1: int
    cells_2: int


@wp.struct
class Transfer:
    """Linear interpolation between two lattices, or its transpose. For each plane of the target, axis after axis, it
    has the planes of the source and their weights, starting at `begin`."""

    begin: Ints
    plane: Ints
    weight: wp.array(dtype=wp.float32)


@functools.cache
def transfer_kernels_for(dim: int, scalar: Any) -> SimpleNamespace:
    """The kernels for fields of `dim` rows; `scalar` is that of the fields that are preconditioned."""
    numbers = wp.array(dtype=wp.float32)
    kernel = kernel_in(f"transfer_{dim}d_{scalar.__name__}", wp.float32)

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
        candidate, row, cell = wp.tid()
        t0 = cell / (target.cells_1 * target.cells_2)
        rest = cell - t0 * target.cells_1 * target.cells_2
        t1 = target.cells_0 + rest / target.cells_2
        t2 = target.cells_0 + target.cells_1 + rest % target.cells_2
        total = wp.float32(0.0)
        if target_weight[cell] > wp.float32(0.0):
            # planes of the source follow each other: their numbers are not loaded one by one
            c0 = transfer.begin[t2]
            many = transfer.begin[t2 + 1] - c0
            plane = transfer.plane[c0] - source.cells_0 - source.cells_1
            last = source.cells_2 - 1
            for a in range(transfer.begin[t0], transfer.begin[t0 + 1]):
                for b in range(transfer.begin[t1], transfer.begin[t1 + 1]):
                    w1 = transfer.weight[a] * transfer.weight[b]
                    line = (transfer.plane[a] * source.cells_1 + transfer.plane[b] - source.cells_0) * source.cells_2
                    for c in range(many):
                        own = line + wp.min(plane + c, last)
                        i = at(source, candidate, own) + row * source.stride
                        total += w1 * transfer.weight[c0 + c] * source_weight[own] * (values[i] + more[i])
        out[at(target, candidate, cell) + row * target.stride] = target_weight[cell] * total

    return members(gather, conversion("put_in", scalar, wp.float32), conversion("take_out", wp.float32, scalar))


@functools.cache
def smoother_for(dim: int, width: int) -> Any:
    """The kernel of a step of Chebyshev's iteration, for fields of float32 in lanes of `width`."""
    numbers = wp.array(dtype=wp.float32)
    rows, newton = rows_for(dim, width, wp.float32), sum_functions_for(dim, wp.float32, width)
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
        """Continues along the next direction; the residual is not yet that after it. With `begins` from z = 0."""
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
