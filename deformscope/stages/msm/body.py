"""Common parts of lattice and general bodies: particles at rest, parameters of a launch, and rest data."""

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm.layout import Field, Layout, upload


@dataclass(frozen=True, slots=True)
class BodyRest:
    """Particles at rest, in particle spacings.

    position: (K, d); mass: (K,); free: (K,) bool; counts: (K,) clusters of each
    metric: (K,) N_i m_i over the mean mass, in which the goal map is symmetric; 0 where held
    slipping: (K,) particles that are held only along `held_axis`; -1: none"""

    position: FloatArray
    mass: FloatArray
    free: BoolArray
    counts: IntArray
    metric: FloatArray
    slipping: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    held_axis: int = -1


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters of all candidates on the device.

    beta_stride: 0, or with a beta for each cluster the numbers from one group of candidates to the next"""

    beta: Field
    theta: Field
    beta_stride: int
    volume: int


@dataclass(frozen=True, slots=True)
class RestArrays:
    """Rest data of C clusters (or of one, if all are equal): see `reference.RestCluster`.

    a_qq: (C, d, d) moments over their trace; null: (C, d, r); span: (C, d, d), columns beyond span_count (C,) are 0
    root: (C, d, d); lift: (C, d, r)"""

    a_qq: FloatArray
    null: FloatArray
    span: FloatArray
    span_count: IntArray
    root: FloatArray
    lift: FloatArray


def upload_rows(each: FloatArray, stride: int, scalar: Any, device: str) -> Field:
    """(n, ...) as rows of n on a device, `stride` numbers apart."""
    flat = each.reshape(len(each), -1).T
    return upload(np.pad(flat, ((0, 0), (0, stride - len(each)))), scalar, device)


def rest_struct(functions: SimpleNamespace, arrays: RestArrays, stride: int, scalar: Any, device: str) -> Any:
    """Rest data as `cluster_functions` reads it, rows `stride` numbers apart."""
    rest = functions.FitRest()
    n, d = arrays.a_qq.shape[:2]

    rows = functools.partial(upload_rows, stride=stride, scalar=scalar, device=device)
    rest.a_qq = rows(arrays.a_qq[:, *np.triu_indices(d)])
    rest.has_null = int(np.abs(arrays.null).max(initial=0.0) > 1e-12)
    rest.null_t = rows(arrays.null.transpose(0, 2, 1)) if rest.has_null else upload(np.zeros(1), scalar, device)
    spare = stride - n

    def matrices(each: FloatArray) -> Any:
        padded = np.pad(each, ((0, spare), (0, 0), (0, 0)))
        dtype = wp.types.matrix(shape=each.shape[1:], dtype=scalar)
        return wp.array(padded, dtype=dtype, device=device)

    rest.span_axes = matrices(arrays.span)
    rest.span_count = upload(np.pad(arrays.span_count, (0, spare)), int, device)
    rest.root, rest.lift = matrices(arrays.root), matrices(arrays.lift)
    rest.stride = stride
    return rest


class Operator(ABC):
    """Goals of a body's clusters for the candidates of one layout: fields, and stored values for the derivative.

    arrays: the body's, with the struct types `Motion` and `Kept`; cluster_stride: numbers between rows of a field of
    clusters; maps: the clusters' goal maps; beta_stride: see `Parameters`
    threads: number of threads of one group of candidates in the kernels `resident`; 0 without such kernels
    looks_ahead: whether a step leaves x* (eq. 3.1, 3.2) of the next one"""

    beta_stride: int

    def __init__(self, body: "Body", layout: Layout, arrays: Any, cluster_stride: int) -> None:
        self.body: Any = body
        self.layout, self.arrays, self.cluster_stride = layout, arrays, cluster_stride
        self.dim, self.metric = body.dim, arrays.metric
        self.threads, self.looks_ahead = 0, False
        self.resident: Any = None
        self.maps: Any = None
        self._nothing = layout.each(np.zeros(1), int)
        self.still = self.motion(1.0, 0.0, np.zeros(self.dim), stepping=False)
        self._kept: dict[int, Any] = {}

    def cluster_field(self, rows: int) -> Field:
        """`rows` rows of 0."""
        return wp.zeros(rows * self.cluster_stride, dtype=self.layout.scalar, device=self.layout.device)

    def motion(self, alpha: float, going_on: float, push: FloatArray, *, stepping: bool = True) -> Any:
        """Parameters of a time step: see `lattice_kernels.motion_for`. push: (d,) displacement by the acceleration in a
        step, in particle spacings"""
        motion = self.arrays.Motion()
        motion.stepping = int(stepping)
        motion.alpha, motion.going_on = alpha, going_on
        motion.push = upload(push, self.layout.scalar, self.layout.device)
        return motion

    def kept(self, volume: int) -> Any:
        """Stored values of `residual` for `change`."""
        if volume not in self._kept:
            d = self.dim
            kept = self.arrays.Kept()
            kept.turned = self.cluster_field(d * d)
            kept.compliance = self.cluster_field(6 if d == 3 else 1)
            kept.frame = self.cluster_field(2 * d * d + d + 1 if volume else 1)
            kept.stride = self.cluster_stride
            self._kept[volume] = kept
        return self._kept[volume]

    def unkept(self) -> Any:
        """Release arrays that only `residual` needs."""
        if -1 not in self._kept:
            kept = self.arrays.Kept()
            kept.turned = kept.compliance = kept.frame = self.maps
            kept.stride = 0
            self._kept[-1] = kept
        return self._kept[-1]

    def by_group(self, values: FloatArray) -> FloatArray:
        """(B, C, ...) as (groups, abreast, C, ...); the last candidate fills the rest of its group."""
        groups, abreast = self.layout.groups, self.layout.abreast
        filled = np.concatenate([values, np.repeat(values[-1:], groups * abreast - len(values), 0)])
        return filled.reshape(groups, abreast, *values.shape[1:])

    def launch(self, kernel: wp.Kernel, items: int, inputs: list[Any], outputs: list[Any] | None = None) -> None:
        """A kernel over a number of items of every group."""
        dim = (self.layout.groups, items)
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs or [], device=self.layout.device)

    @abstractmethod
    def residual(self, u: Field, out: Field, parameters: Parameters, running: Field, kept: object = None) -> None:
        """goal - u of every free particle into `out`. kept: place of the values for `change` (None: nowhere)"""

    @abstractmethod
    def change(self, direction: Field, out: Field, parameters: Parameters, running: Field, kept: object) -> None:
        """J p - p for a direction p of the free particles, where `residual` was last evaluated."""

    def look_ahead(self, state: Any, motion: object) -> None:
        """x* of the first step, for an operator that `looks_ahead`. state: `solver.Moving`"""
        raise TypeError("expected an operator that looks ahead")

    @abstractmethod
    def step(self, state: Any, motion: object, parameters: Parameters) -> None:
        """One time step of a `solver.Moving`: its `before` becomes the new displacement, and its `star` may become x*
        of the next step."""

    @abstractmethod
    def cluster_values(self, values: FloatArray) -> Field:
        """(B, C) one value for each cluster, as the kernels read them."""


class Body(ABC):
    """Rest data of a body on a device. Lengths in particle spacings."""

    def __init__(self, dim: int, scalar: type[Any], device: str) -> None:
        self.dim, self.device = dim, device
        self.scalar: Any = scalar
        self._arrays: dict[int, Any] = {}
        self.coarse: list[Any] = []  # levels of its preconditioner, once one was asked for
        self._there: Any = None

    def there(self, place: IntArray) -> Any:
        """Places of the particles on a GPU, None on a CPU."""
        if self._there is None and not self.device.startswith("cpu"):
            self._there = upload(place, int, self.device)
        return self._there

    def arrays(self, width: int) -> Any:
        """Rest data for lanes of one width."""
        if width not in self._arrays:
            self._arrays[width] = self._make_arrays(width)
        return self._arrays[width]

    @abstractmethod
    def _make_arrays(self, width: int) -> Any: ...

    @abstractmethod
    def layout(self, candidates: int, *, filled: bool = False) -> Layout:
        """filled: see `layout.widths`, where the lanes of a lattice may be its cells."""

    @abstractmethod
    def operator(self, layout: Layout) -> Operator: ...
