"""Warp kernels that pack the particles of fields for copies between a GPU and its host."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import Doubles, Ints, kernel_in, members


@functools.cache
def packing_for(scalar: Any) -> SimpleNamespace:
    """Kernels between a field of `scalar` and packed float64 (B, K, rows), candidates one after another."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"packing_{scalar.__name__}", wp.float64)

    @kernel
    def pack(
        field: numbers,
        place: Ints,
        rows: int,
        front: int,
        group: int,
        stride: int,
        scale: wp.float64,
        origin: Doubles,
        out: Doubles,
    ):
        candidate, particle = wp.tid()
        at = front + candidate * group + place[particle]
        for row in range(rows):
            value = scale * wp.float64(field[at + row * stride])
            if origin:
                value += origin[particle * rows + row]
            out[(candidate * place.shape[0] + particle) * rows + row] = value

    @kernel
    def unpack(values: Doubles, own: int, place: Ints, rows: int, front: int, group: int, stride: int, field: numbers):
        """own: 1 where each candidate has values of its own, 0 where all share them"""
        candidate, particle = wp.tid()
        at = front + candidate * group + place[particle]
        for row in range(rows):
            given = values[(own * candidate * place.shape[0] + particle) * rows + row]
            field[at + row * stride] = scalar(given)

    return members(pack, unpack)
