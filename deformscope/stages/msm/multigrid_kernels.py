"""Warp kernels of the multigrid preconditioner: transfers between two lattices, and a step of the smoother.

Values from one lattice to another are plain numbers, place by place and candidate by candidate; smoothing goes through
fields in lanes."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Ints, kernel_in, members, rows_for
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


@wp.func
def at(place: Cells, candidate: int, cell: int):
    group = candidate / place.abreast
    return place.front + group * place.group + cell * place.abreast + candidate - group * place.abreast


PLANE_C = """
    const int line = source.cells_2 * source.abreast, area = source.cells_1 * line;
    const int from = source.front + group * source.group + row * source.stride;
    const int first = target.front + group * target.group + row * target.stride;
    const wp::float32* __restrict weight = transfer.weight.data;
    const int* __restrict begin = transfer.begin.data;
    wp::float32* __restrict across = work.data;
    wp::float32* __restrict along = work.data + area;
    for (int x = 0; x < area; ++x) across[x] = 0;
    for (int a = begin[plane]; a < begin[plane + 1]; ++a) {
        const int at = transfer.plane.data[a] * area;
        const wp::float32* __restrict v = values.data + from + at;
        const wp::float32* __restrict m = more.data + from + at;
        const wp::float32* __restrict own = source_weight.data + at;
        const wp::float32 w = weight[a];
        for (int x = 0; x < area; ++x) across[x] += w * own[x] * (v[x] + m[x]);
    }
    for (int t1 = 0; t1 < target.cells_1; ++t1) {
        const int row_1 = target.cells_0 + t1;
        for (int x = 0; x < line; ++x) along[x] = 0;
        for (int b = begin[row_1]; b < begin[row_1 + 1]; ++b) {
            const wp::float32* __restrict v = across + (transfer.plane.data[b] - source.cells_0) * line;
            const wp::float32 w = weight[b];
            for (int x = 0; x < line; ++x) along[x] += w * v[x];
        }
        for (int t2 = 0; t2 < target.cells_2; ++t2) {
            const int row_2 = target.cells_0 + target.cells_1 + t2;
            const int cell = ((plane * target.cells_1 + t1) * target.cells_2 + t2) * target.abreast;
            for (int l = 0; l < target.abreast; ++l) {
                const wp::float32 own = target_weight.data[cell + l];
                wp::float32 total = 0;
                for (int c = begin[row_2]; c < begin[row_2 + 1]; ++c) {
                    const int at = transfer.plane.data[c] - source.cells_0 - source.cells_1;
                    total += weight[c] * along[at * source.abreast + l];
                }
                out.data[first + cell + l] = own > 0 ? own * total : 0;
            }
        }
    }
"""
"""One plane of the target of a transfer, row `row` of the fields of a group of candidates."""


@functools.cache
def gather_kernel_for(rows_each: int, most: int) -> Any:
    """The kernel of a transfer on a GPU, whose threads take `rows_each` rows of the fields: each plane of the target
    has at most `most` planes of the source, which follow each other. Values along a line are loaded together, else a
    small lattice waits for each."""
    numbers = wp.array(dtype=wp.float32)
    kernel = kernel_in(f"gather_{rows_each}_{most}", wp.float32)
    weights = wp.types.vector(length=most, dtype=wp.float32)
    rows = wp.types.vector(length=rows_each, dtype=wp.float32)

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
        candidate, part, cell = wp.tid()
        t0 = cell / (target.cells_1 * target.cells_2)
        rest = cell - t0 * target.cells_1 * target.cells_2
        t1 = target.cells_0 + rest / target.cells_2
        t2 = target.cells_0 + target.cells_1 + rest % target.cells_2
        total = rows()
        if target_weight[cell] > wp.float32(0.0):
            begin = transfer.begin[t2]
            end = transfer.begin[t2 + 1]
            weight = weights()
            for c in range(wp.static(most)):
                weight[c] = wp.where(begin + c < end, transfer.weight[wp.min(begin + c, end - 1)], wp.float32(0.0))
            begin_0 = transfer.begin[t0]
            begin_1 = transfer.begin[t1]
            first_0 = transfer.plane[begin_0] - begin_0
            first_1 = transfer.plane[begin_1] - begin_1 - source.cells_0
            first = transfer.plane[begin] - source.cells_0 - source.cells_1
            last = source.cells_2 - 1
            for a in range(begin_0, transfer.begin[t0 + 1]):
                for b in range(begin_1, transfer.begin[t1 + 1]):
                    both = transfer.weight[a] * transfer.weight[b]
                    line = ((first_0 + a) * source.cells_1 + first_1 + b) * source.cells_2
                    for c in range(wp.static(most)):
                        own = line + wp.min(first + c, last)
                        i = at(source, candidate, own) + part * wp.static(rows_each) * source.stride
                        for k in range(wp.static(rows_each)):
                            value = values[i + k * source.stride] + more[i + k * source.stride]
                            total[k] += both * weight[c] * source_weight[own] * value
        o = at(target, candidate, cell) + part * wp.static(rows_each) * target.stride
        for k in range(wp.static(rows_each)):
            out[o + k * target.stride] = target_weight[cell] * total[k]

    return gather


@functools.cache
def transfer_kernels_for(dim: int, scalar: Any) -> SimpleNamespace:
    """The kernels for fields of `dim` rows; `scalar` is that of the fields that are preconditioned."""
    numbers = wp.array(dtype=wp.float32)
    kernel = kernel_in(f"transfer_{dim}d_{scalar.__name__}", wp.float32)

    def conversion(name: str, given: Any, wanted: Any) -> Any:
        """The kernel that makes a field one of another type, for another layout."""

        @kernel(name=name)
        def convert(source: Cells, target: Cells, values: wp.array(dtype=given), out: wp.array(dtype=wanted)):
            candidate, cell = wp.tid()
            i, o = at(source, candidate, cell), at(target, candidate, cell)
            for k in range(wp.static(dim)):
                out[o + k * target.stride] = wanted(values[i + k * source.stride])

        return convert

    @wp.func_native(PLANE_C)
    def one_plane(
        transfer: Transfer,
        source: Cells,
        target: Cells,
        group: int,
        row: int,
        plane: int,
        values: numbers,
        more: numbers,
        source_weight: numbers,
        target_weight: numbers,
        work: numbers,
        out: numbers,
    ): ...

    @kernel
    def gather_planes(
        transfer: Transfer,
        source: Cells,
        target: Cells,
        # In: as `gather_kernel_for`, but weights of each candidate's cells; work: a plane and a line of the source
        values: numbers,
        more: numbers,
        source_weight: numbers,
        target_weight: numbers,
        work: numbers,
        # Out:
        out: numbers,
    ):
        """A transfer on a CPU: axis after axis, each over whole lines. Its threads follow each other: they share
        `work`."""
        group, row, plane = wp.tid()
        one_plane(transfer, source, target, group, row, plane, values, more, source_weight, target_weight, work, out)

    conversions = conversion("put_in", scalar, wp.float32), conversion("take_out", wp.float32, scalar)
    return members(gather_planes, *conversions)


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
