"""What lattice and general bodies share: the particles at rest, the parameters of a launch, and rest data for fits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm.layout import Layout, upload


@dataclass(frozen=True, slots=True)
class BodyRest:
    """Particles at rest, in particle spacings.

    position: (K, d); mass: (K,); free: (K,) bool; counts: (K,) clusters of each
    metric: (K,) N_i m_i over the mean mass, in which the goal map is symmetric; 0 where held
    """

    position: FloatArray
    mass: FloatArray
    free: BoolArray
    counts: IntArray
    metric: FloatArray


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters of all candidates on the device.

    beta_stride: 0, or with a beta for each cluster the numbers from one group of candidates to the next
    """

    beta: Any
    theta: Any
    beta_stride: int
    volume: int


@dataclass(frozen=True, slots=True)
class RestArrays:
    """Rest data of C clusters (or of one that stands for all): see `reference.RestCluster`.

    a_qq: (C, d, d) moments over their trace; untold: (C, d, r); span: (C, d, d), columns beyond span_count (C,) are 0
    root: (C, d, d); lift: (C, d, r)
    """

    a_qq: FloatArray
    untold: FloatArray
    span: FloatArray
    span_count: IntArray
    root: FloatArray
    lift: FloatArray


def rest_struct(functions: Any, arrays: RestArrays, stride: int, scalar: Any, device: str) -> Any:
    """Rest data as `cluster_functions` reads it, rows `stride` numbers apart."""
    import warp as wp

    rest = functions.rest()
    n, d = arrays.a_qq.shape[:2]

    def rows(each: FloatArray) -> Any:
        return upload(np.pad(each.reshape(n, -1).T, ((0, 0), (0, stride - n))), scalar, device)

    rest.a_qq = rows(arrays.a_qq[:, *np.triu_indices(d)])
    rest.some_untold = int(np.abs(arrays.untold).max(initial=0.0) > 1e-12)
    rest.untold_t = rows(arrays.untold.transpose(0, 2, 1)) if rest.some_untold else upload(np.zeros(1), scalar, device)
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


class Operator(Protocol):
    """Goals of a body's clusters for the candidates of one layout."""

    body: Any
    layout: Layout
    dim: int
    metric: Any
    beta_stride: int
    resident: Any

    @property
    def threads(self) -> int:
        """Threads that keep to one group of candidates in a kernel that stays; 0 where there is none."""
        ...

    def motion(self, alpha: float, going_on: float, push: FloatArray) -> Any: ...

    def kept(self, volume: int) -> Any: ...

    def residual(
        self, u: Any, out: Any, parameters: Parameters, running: Any, kept: Any = None, what: int = 0
    ) -> None: ...

    def change(self, direction: Any, out: Any, parameters: Parameters, running: Any, kept: Any) -> None: ...

    def step(self, u: Any, before: Any, motion: Any, parameters: Parameters, running: Any, ran_away: Any) -> None: ...

    def stay_stepping(
        self, pair: Any, swapped: bool, motion: Any, parameters: Parameters, steps: int, ran_away: Any
    ) -> None: ...

    def stay_relaxing(
        self, parameters: Parameters, kept: Any, span: Any, state: Any, most: int, limit: int, arrays: list[Any]
    ) -> Any: ...

    def cluster_values(self, values: FloatArray) -> Any: ...

    def cluster_gradient(self, adjoint: Any) -> FloatArray: ...


class Body(Protocol):
    """Rest data of a body on a device."""

    dim: int
    scalar: Any
    device: str

    def layout(self, candidates: int) -> Layout: ...

    def operator(self, layout: Layout) -> Any: ...
