"""Clusters as index lists with a beta along each axis or with S^p: their launches, over those of `general`."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import FloatArray
from deformscope.stages.msm.body import BodyRest, Parameters
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.general import GeneralArrays, GeneralBody, GeneralOperator
from deformscope.stages.msm.layout import Field, Layout, upload
from deformscope.stages.msm.material_kernels import material_kernels_for
from deformscope.stages.msm.materials import axis_weights
from deformscope.stages.msm.reference import Basis


class MaterialBody(GeneralBody):
    """A body of any clusters, whose candidates have a beta along each of `axes` (d, d), or whose clusters yield."""

    def __init__(
        self,
        rest: BodyRest,
        clusters: Clusters,
        basis: Basis,
        scalar: type[Any],
        device: str,
        *,
        axes: FloatArray | None,
        plastic: bool,
    ) -> None:
        super().__init__(rest, clusters, basis, scalar, device)
        self.axes, self.plastic = axes, plastic

    def operator(self, layout: Layout) -> MaterialOperator:
        return MaterialOperator(self, layout, self.arrays(layout.width))

    def weights(self, beta: FloatArray) -> FloatArray:
        """(B, C, 2, d, d) W over its trace, and C, of every cluster for betas (B, d) or (B, C, d): see `materials`."""
        if beta.ndim == 3:  # of each cluster: few of them differ
            distinct, kind = np.unique(beta.reshape(-1, self.dim), axis=0, return_inverse=True)
            return np.asarray(self.weights(distinct)[kind.reshape(beta.shape[:2]), np.arange(self.cluster_count)])
        arrays, d = self.rest_arrays, self.dim
        assert self.axes is not None
        found = np.zeros((len(beta), self.cluster_count, 2, d, d))
        for count in np.unique(arrays.span_count):
            some = np.flatnonzero(arrays.span_count == count)
            if count == 0:
                found[:, some, 0] = np.eye(d) / d
                continue
            # most clusters of a lattice are alike
            kinds = np.concatenate([arrays.a_qq[some], arrays.span[some]], axis=-1).reshape(len(some), -1)
            _, first, kind = np.unique(np.round(kinds, 12), axis=0, return_index=True, return_inverse=True)
            chosen = some[first]
            gram = arrays.a_qq[chosen]
            w, c = axis_weights(gram, arrays.span[chosen][:, :, :count], beta, self.axes)
            trace = np.trace(w, axis1=-2, axis2=-1)[..., None, None]
            # where nothing resists any rotation is as good: that of the moments
            w = np.where(trace > 0.0, w / np.where(trace > 0.0, trace, 1.0), gram)
            found[:, some] = np.stack([w, c], axis=2)[:, kind.reshape(-1)]
        return found


class MaterialOperator(GeneralOperator):
    """Goals of a `MaterialBody`, with S^p of its clusters."""

    def __init__(self, body: MaterialBody, layout: Layout, arrays: GeneralArrays) -> None:
        super().__init__(body, layout, arrays)
        self.material_body = body
        self.kernels = material_kernels_for(body.dim, body.terms, body.scalar, layout.width)
        material = self.kernels.Material()
        material.plastic, material.axes = int(body.plastic), int(body.axes is not None)
        material.strain = self.cluster_field(body.dim**2 if body.plastic else 1)
        self.material = material
        self.strain = material.strain
        self._moved, self._size = self.cluster_field(1), self.cluster_field(1)
        self._all = wp.full(layout.groups, 1, dtype=int, device=layout.device)
        self.law: Any = None

    def cluster_values(self, values: FloatArray) -> Field:
        """A beta for each cluster (B, C); along each axis (B, C or 1, d): W and C as the kernels read them."""
        if self.material_body.axes is None:
            return super().cluster_values(values)
        d = self.dim
        betas = values[:, 0] if values.shape[1] == 1 else values
        packed = self.material_body.weights(betas).reshape(len(values), -1, 2 * d * d)
        return self._pack(packed)

    def put_plastic(self, plastic: FloatArray) -> None:
        """S^p (B, C, d, d)."""
        d = self.dim
        self.strain.assign(self._pack((plastic - np.eye(d)).reshape(*plastic.shape[:2], d * d)))

    def plastic(self) -> FloatArray:
        """S^p (B, C, d, d)."""
        d = self.dim
        return self._cluster_fields(self.strain, d * d).reshape(-1, self.body.cluster_count, d, d) + np.eye(d)

    def set_law(self, yield_strain: FloatArray, share: FloatArray, maximum: FloatArray) -> None:
        """What `flow` goes by, (B,) each; share: of S - I that flows at once."""
        self.law = [self.layout.each(each) for each in (yield_strain, share, maximum)]

    def flow(self, u: Field, *, stop: bool) -> None:
        """S^p flows by the fits at displacements u."""
        self.launch(
            self.kernels.flow,
            self.body.cluster_count,
            [self.lists, self.arrays.rest, self.material, u, *self.law, int(stop), self._all],
            [self.strain, self._moved, self._size],
        )

    def flowed(self) -> tuple[FloatArray, FloatArray]:
        """Of the last flow, (B, C) each: the largest change of an entry of S^p, and |S - I|_2 before it."""
        return self._cluster_fields(self._moved, 1)[..., 0], self._cluster_fields(self._size, 1)[..., 0]

    def step(
        self, u: Field, before: Field, motion: object, parameters: Parameters, running: Field, ran_away: Field
    ) -> None:
        """One time step, and the flow of S^p by the fits that its goals were made of."""
        super().step(u, before, motion, parameters, running, ran_away)
        if self.law is not None:
            self.flow(self._star, stop=False)

    def _pack(self, values: FloatArray) -> Field:
        """(B, C, rows) as fields of clusters are laid out; the last candidate fills what is left of its group."""
        layout = self.layout
        rows = self.by_group(values).transpose(3, 0, 2, 1)
        host = np.zeros((values.shape[2], self.cluster_stride))
        host[:, : self.cluster_stride - layout.width] = rows.reshape(values.shape[2], -1)
        return upload(host, layout.scalar, layout.device)

    def _fit(
        self, kernel: wp.Kernel, u: Field, parameters: Parameters, running: Field, kept: object, what: int
    ) -> None:
        ours = self.kernels.fit_clusters if kernel is self.arrays.kernels.fit_clusters else self.kernels.fit_changes
        super()._fit(ours, u, parameters, running, kept, what)
