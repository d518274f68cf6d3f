"""Lanes: `width` numbers that go through a computation side by side, as one vector of the processor.

A lane is a cell of the lattice or a candidate; the kernels do not care which. `LANES` fill a vector of the CPU, whose
compiler does not vectorize scalar kernels; width 1 is a plain number, for a GPU and for lists of indices. `Rows` are
small matrices of lanes, row by row. The native functions compute with whole vectors (`VectorC`), or in loops without
branches over the lanes, which compilers vectorize if they are short; they do not vectorize warp's own operators on
matrices.

Results depend on the width in their last digits: all lanes take as many of Newton's steps for their rotation as the
slowest one, and a static state's sums over particles are lane by lane.

At the end are the common parts of the kernel factories: the module of their kernels, and the names of their return
values."""

import functools
import os
import platform
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp
from numpy._core._multiarray_umath import __cpu_features__

from deformscope.errors import InputError

FORCE_BITS = "DEFORMSCOPE_VECTOR_BITS"
"""Environment variable that replaces the processor's own value, for tests: 256 or 512."""

_FORCED = os.environ.get(FORCE_BITS, "512" if __cpu_features__.get("AVX512F") else "256")


if _FORCED not in ("256", "512"):
    raise InputError(f"{FORCE_BITS} = 256 or 512", repr(_FORCED))
VECTOR_BITS = int(_FORCED)
"""Bits of a vector of this processor. Width of the vectors. With half of it a step takes 1.2 to 1.3 times as long."""

LANES = {wp.float32: VECTOR_BITS // 32, wp.float64: VECTOR_BITS // 64}
"""Numbers that a CPU's vector units take side by side."""

CPU_FLAGS = (
    "-march=native"
    + (f" -mprefer-vector-width={VECTOR_BITS} -mstackrealign" if platform.machine() in ("x86_64", "AMD64") else "")
    + " -mllvm=-inline-threshold=9000 -mllvm=-inline-cold-callsite-threshold=3000"
)
"""Compiler flags for modules of lanes. Compilers use half of an Intel processor's 512 bits by default. Warp's own flags
also cap the recursion of the vectorizer, which leaves most of the lanes scalar. Without the high threshold, matrices of
lanes go through memory at every call. The stack is aligned at 16 bytes only: most vectors held there would straddle two
cache lines (a step took 1.2 times as long on an AMD processor)."""

Ints, Doubles = wp.array(dtype=int), wp.array(dtype=wp.float64)
"""Types of arrays that kernels take."""


def module_options(scalar: Any) -> dict[str, Any]:
    """Options of a module of lanes. On a GPU divisions and roots of float32 have an error in the last digit. They are
    far quicker, and the error does not affect Newton's steps."""
    return {
        "enable_backward": False,
        "max_unroll": 3,
        "cpu_compiler_flags": CPU_FLAGS,
        "fast_math": scalar is wp.float32,
    }


@dataclass(frozen=True)
class VectorC:
    """C++ text for lanes as one value of a type V; on a GPU, where a lane is alone, a plain number.

    width: lanes; scalar: wp.float32 or wp.float64"""

    width: int
    scalar: Any

    @property
    def declared(self) -> str:
        """Types: V, Int of its size (results of comparisons); PLACES: each lane's index."""
        number = f"wp::{self.scalar.__name__}"
        if self.width == 1:
            return f"typedef {number} V; typedef int Int; const Int PLACES = 0;"
        shape = f"__attribute__((ext_vector_type({self.width}), aligned(alignof({number})), may_alias))"
        places = ", ".join(str(l) for l in range(self.width))
        return f"typedef {number} V {shape}; typedef decltype(V() < V()) Int; const Int PLACES = {{{places}}};"

    def at(self, place: str) -> str:
        """The lanes from a number on."""
        return place if self.width == 1 else f"(*(V*)&{place})"

    def all(self, mask: str) -> str:
        return mask if self.width == 1 else f"(__builtin_reduce_and({mask}) != 0)"

    def root(self, value: str) -> str:
        return f"wp::sqrt({value})" if self.width == 1 else f"__builtin_elementwise_sqrt({value})"


@functools.cache
def lanes_for(width: int, scalar: Any) -> SimpleNamespace:
    """Lanes of `width` numbers of type `scalar` (wp.float32 or wp.float64)."""
    numbers = wp.array(dtype=scalar)
    lane = wp.types.vector(length=width, dtype=scalar)
    vec = f"wp::vec_t<{width}, wp::{scalar.__name__}>"
    each = f"for (int l = 0; l < {width}; ++l)"
    c = VectorC(width, scalar)
    r = f"{c.declared} {vec} r; {c.at('r.c[0]')}"

    @wp.func_native(f"{r} = step == 0 ? (V)a.data[i] : {c.at('a.data[i]')}; return r;")
    def own(a: numbers, i: int, step: int) -> lane:
        """Each lane's own number, or with step 0 the one that all share."""

    @wp.func_native(f"{r} = {c.at('a.c[0]')} * {c.at('b.c[0]')}; return r;")
    def times(a: lane, b: lane) -> lane: ...

    @wp.func_native(f"wp::{scalar.__name__} r = a.c[0]; {each} r = a.c[l] < r ? a.c[l] : r; return r;")
    def least(a: lane) -> scalar: ...

    @wp.func_native(f"int r = 1; {each} r &= a.c[l] < limit; return r;")
    def below(a: lane, limit: scalar) -> int:
        """1 if every lane is below the limit (a lane that is not a number is not)."""

    return SimpleNamespace(lane=lane, own=own, times=times, least=least, below=below)


@functools.cache
def rows_for(count: int, width: int, scalar: Any) -> SimpleNamespace:
    """`count` rows of `width` lanes. Arrays hold them `stride` numbers apart (structure of arrays)."""
    numbers = wp.array(dtype=scalar)
    lanes = lanes_for(width, scalar)
    lane = lanes.lane
    rows = wp.types.matrix(shape=(count, width), dtype=scalar)
    vec = f"wp::vec_t<{width}, wp::{scalar.__name__}>"
    mat = f"wp::mat_t<{count}, {width}, wp::{scalar.__name__}>"
    sized = Sized(f"{count}x{width}")
    c = VectorC(width, scalar)
    each = f"for (int k = 0; k < {count}; ++k)"
    stored, one, of_m, of_n = c.at("a.data[i + k * stride]"), c.at("v.c[0]"), c.at("m.data[k][0]"), c.at("n.data[k][0]")
    of_v = c.at("v.data[k][0]")
    r = f"{c.declared} {mat} r; {each} {c.at('r.data[k][0]')}"

    @sized.func_native(f"{r} = {stored}; return r;")
    def load(a: numbers, i: int, stride: int) -> rows: ...

    @sized.func_native(
        f"{c.declared} if (count >= {width}) {{ {each} {stored} = {of_v}; }}"
        f" else {{ {each} {stored} = PLACES < (Int)count ? {of_v} : {stored}; }}"
    )
    def store(a: numbers, i: int, stride: int, v: rows, count: int):
        """Beyond `count` lanes the array keeps its values (on a CPU no other thread writes there meanwhile)."""

    @sized.func_native(f"{r} = step == 0 ? (V)a.data[i + k * stride] : {stored}; return r;")
    def own(a: numbers, i: int, stride: int, step: int) -> rows:
        """Each lane's own numbers, or with step 0 those that all share."""

    @sized.func_native(f"{c.declared} {vec} r; {c.at('r.c[0]')} = {of_m}; return r;")
    def row(m: rows, k: int) -> lane: ...

    @sized.func_native(f"{c.declared} {mat} r = m; {c.at('r.data[k][0]')} = {one}; return r;")
    def with_row(m: rows, k: int, v: lane) -> rows: ...

    @sized.func_native(f"{r} = {of_m} + (V)f * {of_n}; return r;")
    def add(m: rows, f: scalar, n: rows) -> rows:
        """m + f n."""

    @sized.func_native(f"{r} = {of_m} * {one}; return r;")
    def scale(m: rows, v: lane) -> rows:
        """Each lane of m times that of v."""

    @sized.func_native(f"{r} = {c.at('when.c[0]')} > (V)0 ? {of_m} : (V)0; return r;")
    def choose(when: lane, m: rows) -> rows:
        """m where `when` is positive, else 0 (for any m there)."""

    moving = {"load": load, "store": store, "own": own, "row": row, "with_row": with_row}
    return SimpleNamespace(rows=rows, add=add, scale=scale, choose=choose, **moving)


@functools.cache
def product_for(p: int, q: int, r: int, width: int, scalar: Any) -> Any:
    """The function (p x q) times (q x r), matrices of lanes by rows."""
    left = wp.types.matrix(shape=(p * q, width), dtype=scalar)
    right = wp.types.matrix(shape=(q * r, width), dtype=scalar)
    result = wp.types.matrix(shape=(p * r, width), dtype=scalar)
    sized = Sized(f"{p}x{q}x{r}x{width}")

    c = VectorC(width, scalar)
    terms = " + ".join(c.at(f"a.data[i * {q} + {k}][0]") + " * " + c.at(f"b.data[{k * r} + j][0]") for k in range(q))

    @sized.func_native(
        f"{c.declared} wp::mat_t<{p * r}, {width}, wp::{scalar.__name__}> m;"
        f" for (int i = 0; i < {p}; ++i) for (int j = 0; j < {r}; ++j)"
        f" {c.at(f'm.data[i * {r} + j][0]')} = {terms}; return m;"
    )
    def product(a: left, b: right) -> result: ...

    return product


class Sized:
    """`wp.func_native` for functions that exist in several sizes: each has its own name in the generated code."""

    def __init__(self, tag: str) -> None:
        self.tag = tag

    def func_native(self, snippet: str) -> Any:  # warp looks for a decorator of this name
        def register(function: Any) -> Any:
            function.__name__ = function.__qualname__ = f"{function.__name__}_{self.tag}"
            return wp.func_native(snippet)(function)

        return register


def kernel_in(name: str, scalar: Any, options: dict[str, Any] | None = None, **each: Any) -> Any:
    """The decorator for kernels of the module `deformscope_<name>`; each: keywords of each `wp.kernel`. options:
    options of the module, default those of lanes of `scalar`"""
    module = f"deformscope_{name}"
    wp.get_module(module).options.update(module_options(scalar) if options is None else options)

    def kernel(function: Any = None, *, name: str | None = None, **given: Any) -> Any:
        if function is None:
            return functools.partial(kernel, name=name, **given)
        function.__name__ = name or function.__name__
        return wp.kernel(name=name, module=module, enable_backward=False, **each, **given)(function)

    return kernel


def members(*made: Any, **named: Any) -> SimpleNamespace:
    """Kernels, functions and struct types by the names that they were defined with; others by the given names."""
    return SimpleNamespace(**{each.__name__: each for each in made}, **named)
