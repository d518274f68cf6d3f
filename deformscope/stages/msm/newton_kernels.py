"""Warp kernels of Newton's steps: one for each part of an iteration (see `newton_functions`)."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Ints, kernel_in, members
from deformscope.stages.msm.newton_functions import newton_functions_for


@functools.cache
def newton_kernels_for(dim: int, scalar: Any, width: int) -> SimpleNamespace:
    """A kernel for each part of an iteration, for fields of `dim` rows and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"newton_{dim}d_{scalar.__name__}_{width}", scalar)
    functions = newton_functions_for(dim, scalar, width)
    vecs = functions.vecs
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
