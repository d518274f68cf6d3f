"""Where the numbers of all candidates lie: fields are structures of arrays, candidates abreast or one after another."""

import weakref
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm.lanes import LANES
from deformscope.stages.msm.layout_kernels import packing_for

Field: TypeAlias = "wp.array[Any]"
"""Numbers on a device, of a scalar type that is chosen at run time."""

ABREAST_FROM = 4
"""Number of candidates from which a CPU's lanes hold candidates, not the cells of one candidate."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A field has rows (components) `stride` numbers apart. In a row, groups of candidates begin at `front` and are
    `group` numbers apart. A group is a sequence of places, each with `abreast` candidates.

    width: lanes; abreast: 1 (the lanes are places) or `width` (the lanes are candidates); places: number of places in a
    group; place: (K,) place of each particle; there: the same on a GPU, where it packs what is copied, else None"""

    candidates: int
    width: int
    abreast: int
    places: int
    front: int
    group: int
    stride: int
    place: IntArray
    scalar: Any
    device: str
    there: Any = None

    @property
    def groups(self) -> int:
        return -(-self.candidates // self.abreast)

    @property
    def blocks(self) -> int:
        """Lanes' worths of numbers in a group."""
        return -(-self.group // self.width)

    def field(self, rows: int) -> Field:
        """`rows` rows of 0."""
        return wp.zeros(rows * self.stride, dtype=self.scalar, device=self.device)

    def put(self, values: FloatArray, into: Field) -> None:
        """(B or 1, K, d) into a field's particles; the last candidate fills the rest of its group."""
        d = values.shape[2]
        if self.there is not None:
            given: Any = wp.array(np.ascontiguousarray(values, np.float64).reshape(-1), device=self.device)
            wp.launch(
                packing_for(self.scalar).unpack,
                (self.candidates, len(self.place)),
                [given, int(len(values) > 1), self.there, d, self.front, self.group, self.stride],
                [into],
                device=self.device,
            )
            return
        host = np.zeros((d, self.stride), dtype=_dtype(self.scalar))
        body = host[:, self.front : self.front + self.groups * self.group].reshape(d, self.groups, -1, self.abreast)
        filled = np.broadcast_to(values, (self.candidates, *values.shape[1:]))
        more = self.groups * self.abreast - self.candidates
        if more:
            filled = np.concatenate([filled, np.repeat(filled[-1:], more, axis=0)])
        body[:, :, self.place, :] = filled.reshape(self.groups, self.abreast, -1, d).transpose(3, 0, 2, 1)
        into.assign(host.reshape(-1))

    def get(self, field: Field, rows: int, place: IntArray | None = None) -> FloatArray:
        """The particles of a field, or values at other places (K,): (B, K, rows) float64."""
        if self.there is not None and place is None:
            out = wp.empty(self.candidates * len(self.place) * rows, dtype=wp.float64, device=self.device)
            self._pack(field, rows, out)
            return np.asarray(out.numpy().reshape(-1, len(self.place), rows))
        place = self.place if place is None else place
        host = field.numpy().reshape(rows, self.stride)
        body = host[:, self.front : self.front + self.groups * self.group].reshape(rows, self.groups, -1, self.abreast)
        found = np.array(body[:, :, place].transpose(1, 3, 2, 0), dtype=np.float64, order="C")
        return found.reshape(-1, len(place), rows)[: self.candidates]

    def _pack(self, field: Field, rows: int, out: Field, scale: float = 1.0, origin: Any = None) -> None:
        """origin (K, rows) + scale * the particles of a field, into float64 on the device."""
        wp.launch(
            packing_for(self.scalar).pack,
            (self.candidates, len(self.place)),
            [field, self.there, rows, self.front, self.group, self.stride, wp.float64(scale), origin],
            [out],
            device=self.device,
        )

    def each(self, values: FloatArray, dtype: type[Any] | None = None) -> Field:
        """One number for each candidate, (B,); the last one is repeated to the end."""
        filled = np.full(self.groups * self.abreast + self.width, values[-1], dtype=np.float64)
        filled[: len(values)] = values
        dtype = self.scalar if dtype is None else dtype
        return wp.array(filled.astype(_dtype(dtype)), dtype=dtype, device=self.device)

    def refill(self, array: Field, values: FloatArray) -> None:
        """Numbers of the candidates, (B,), into the arrays of `each`."""
        if self.device.startswith("cpu"):
            view = array.numpy()
            view[: len(values)] = values
            view[len(values) :] = values[-1]
        elif (values == values[-1]).all():
            array.fill_(values[-1])  # without a copy, for which the device would be waited for
        else:
            array.assign(self.each(values))


def widths(
    candidates: int, scalar: type[Any], device: str, *, cells_in_lanes: bool, filled: bool = False
) -> tuple[int, int]:
    """Width and candidates abreast for a device: plain numbers on a GPU, lanes on a CPU. filled: only widths whose
    lanes the candidates fill: fewer candidates take as long as many, and all as long as the slowest"""
    if not device.startswith("cpu"):
        return 1, 1
    width = LANES[scalar]
    if candidates >= (width if filled else ABREAST_FROM):
        return width, width
    return (width, 1) if cells_in_lanes else (1, 1)


def upload(values: FloatArray | IntArray | BoolArray, dtype: type[Any], device: str, spare: int = 0) -> Field:
    """Numbers (rows, ...) on a device, flat, row by row; `spare` more at the end, for lanes that reach over it."""
    host = np.zeros(np.size(values) + spare, dtype=_dtype(dtype))
    host[: np.size(values)] = np.ravel(values)
    return wp.array(host, dtype=dtype, device=device)


class HostCopies:
    """Float64 copies on the host of positions of particles, which a GPU packs, in pinned memory that is used again once
    an array is gone. rest: (K, d)"""

    KEPT = 2

    def __init__(self, layout: Layout, rest: FloatArray, scale: float) -> None:
        self._layout, self._rest, self._scale = layout, rest, scale
        if layout.there is not None:
            self._packed = wp.empty(layout.candidates * rest.size, dtype=wp.float64, device=layout.device)
            self._origin = upload(rest, wp.float64, layout.device)
        self._free: list[Field] = []

    def take(self, field: Field) -> FloatArray:
        """(B, K, d): rest + scale * the particles of a field."""
        layout, rows = self._layout, self._rest.shape[1]
        if layout.there is None:
            return self._rest + layout.get(field, rows) * self._scale
        layout._pack(field, rows, self._packed, self._scale, self._origin)
        size = self._packed.shape[0]
        host = self._free.pop() if self._free else wp.empty(size, dtype=wp.float64, device="cpu", pinned=True)
        wp.copy(host, self._packed)
        wp.synchronize_stream(wp.get_stream(layout.device))
        found: FloatArray = host.numpy()
        weakref.finalize(found, self._take_back, host).atexit = False
        return found.reshape(-1, len(layout.place), rows)

    def _take_back(self, host: Field) -> None:
        if len(self._free) < self.KEPT:
            self._free.append(host)


def _dtype(scalar: type[Any]) -> Any:
    return {wp.float32: np.float32, wp.float64: np.float64, int: np.int32}[scalar]
