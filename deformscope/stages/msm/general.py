"""Clusters as index lists on a device: their rest data, and the launches that make goals of displacements."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import FloatArray
from deformscope.stages.msm import general_kernels as k
from deformscope.stages.msm import reference
from deformscope.stages.msm.body import BodyRest, GoalScratch, Parameters, RestArrays, rest_struct
from deformscope.stages.msm.cluster_functions import GOAL, cluster_functions_for
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.layout import Layout, upload, widths
from deformscope.stages.msm.reference import Basis


class GeneralBody:
    """A body of any clusters and basis. Lengths in particle spacings."""

    def __init__(self, rest: BodyRest, clusters: Clusters, basis: Basis, scalar: Any, device: str) -> None:
        d = rest.position.shape[1]
        self.dim, self.scalar, self.device = d, scalar, device
        self.terms = d if basis == "linear" else {2: 5, 3: 9}[d]
        self.particle_count, self.cluster_count = len(rest.position), clusters.count
        self.rest = rest
        spec = reference.build_rest(rest.position, clusters, np.zeros(0, dtype=int), rest.mass, basis)
        share, weight, moment, row_basis = [], [], [], []
        count = clusters.count
        a_qq, span, root = np.zeros((3, count, d, d))
        span_count = np.zeros(count, dtype=np.int32)
        null, lift = np.zeros((2, count, d, self.terms))
        for c, cluster in enumerate(spec.clusters):
            m, r = cluster.mass[:, None], cluster.radius
            share.append(cluster.mass / cluster.mass.sum())
            # (u - centre) outer weight = A~ - [I, 0] for displacements in spacings; basis in cluster radii
            weight.append(m * cluster.q_basis @ cluster.inverse / r)
            row_basis.append(cluster.q_basis * r)
            norm = float(np.einsum("n,ni,ni->", cluster.mass, cluster.q, cluster.q)) or 1.0
            a_qq[c] = np.einsum("n,ni,nj->ij", cluster.mass, cluster.q, cluster.q) / norm
            moment.append(m * cluster.q / (norm * r))
            span[c, :, : cluster.span.shape[1]] = cluster.span
            span_count[c] = cluster.span.shape[1]
            determined = cluster.inverse @ np.einsum("n,ni,nj->ij", cluster.mass, cluster.q_basis, cluster.q_basis)
            null[c] = (np.eye(len(determined)) - determined.T)[:d]
            root[c], lift[c] = cluster.root, cluster.lift
        self.rest_arrays = RestArrays(a_qq, null, span, span_count, root, lift)
        order = np.argsort(clusters.members, kind="stable")
        cluster_of = np.repeat(np.arange(count), np.diff(clusters.offsets))
        self._lists: dict[str, Any] = {
            "offsets": upload(clusters.offsets, int, device),
            "members": upload(clusters.members, int, device),
            "share": upload(np.concatenate(share), scalar, device),
            "weight": upload(np.concatenate(weight), scalar, device),
            "moment": upload(np.concatenate(moment), scalar, device),
            "row_offsets": upload(np.concatenate([[0], np.cumsum(rest.counts)]), int, device),
            "row_clusters": upload(cluster_of[order], int, device),
            "row_basis": upload(np.concatenate(row_basis)[order], scalar, device),
        }
        self.member_basis = np.concatenate(row_basis)
        self.member_mass = rest.mass[clusters.members]
        self.members, self.offsets = clusters.members, clusters.offsets
        self._arrays: dict[int, _GeneralArrays] = {}

    def layout(self, candidates: int) -> Layout:
        width, abreast = widths(candidates, self.scalar, self.device, cells_in_lanes=False)
        groups = -(-candidates // abreast)
        group = self.particle_count * abreast
        count, place = self.particle_count, np.arange(self.particle_count)
        stride = groups * group + width
        return Layout(candidates, width, abreast, count, 0, group, stride, place, self.scalar, self.device)

    def operator(self, layout: Layout) -> GeneralOperator:
        return GeneralOperator(self, layout, self.arrays(layout.width))

    def arrays(self, width: int) -> _GeneralArrays:
        if width not in self._arrays:
            self._arrays[width] = _GeneralArrays(self, width)
        return self._arrays[width]

    def lists(self, struct: Any) -> Any:
        for name, value in self._lists.items():
            setattr(struct, name, value)
        return struct


class _GeneralArrays:
    """Rest data on the device, for lanes of one width."""

    def __init__(self, body: GeneralBody, width: int) -> None:
        self.kernels = k.general_kernels_for(body.dim, body.terms, body.scalar, width)
        functions = cluster_functions_for(body.dim, body.terms, body.scalar, width)
        self.rest = rest_struct(functions, body.rest_arrays, body.cluster_count, body.scalar, body.device)
        self.Kept, self.Motion = functions.Kept, self.kernels.Motion
        free = body.rest.free.astype(float)
        spare = 2 * width
        self.free = upload(free, body.scalar, body.device, spare)
        self.pull = upload(free / body.rest.counts, body.scalar, body.device, spare)
        self.metric = upload(body.rest.metric, body.scalar, body.device, spare)


class GeneralOperator(GoalScratch):
    """Goals of clusters given as lists, for the candidates of one layout, with their scratch."""

    def __init__(self, body: GeneralBody, layout: Layout, arrays: _GeneralArrays) -> None:
        clusters = body.cluster_count
        super().__init__(body, layout, arrays, layout.groups * clusters * layout.abreast + layout.width)
        lists = body.lists(arrays.kernels.Lists())
        lists.abreast, lists.particles, lists.clusters = layout.abreast, body.particle_count, clusters
        lists.particle_stride, lists.cluster_stride = layout.stride, self.cluster_stride
        self.lists = lists
        self.beta_stride = clusters * layout.abreast
        self.maps = self.cluster_field(self.dim + self.dim * body.terms)
        self.material: Any = 0
        self._star = layout.field(self.dim)
        self.threads = 0
        self.resident: Any = None

    def residual(
        self, u: Any, out: Any, parameters: Parameters, running: Any, kept: Any = None, what: int = GOAL
    ) -> None:
        """goal - u of every free particle into `out`; with `what` BY_BETA or BY_THETA the derivative of the goals.

        kept: where to leave what `change` needs (None: nowhere)
        """
        kept = self.unkept() if kept is None else kept
        self._fit(self.arrays.kernels.fit_clusters, u, parameters, running, kept, what)
        star = u if what == GOAL else self._zero()
        self._finish(star, star, self.still, running, out, self._nothing)

    def change(self, direction: Any, out: Any, parameters: Parameters, running: Any, kept: Any) -> None:
        """J p - p for a direction p of the free particles, where `residual` was last evaluated."""
        self._fit(self.arrays.kernels.fit_changes, direction, parameters, running, kept, GOAL)
        self._finish(direction, direction, self.still, running, out, self._nothing)

    def step(self, u: Any, before: Any, motion: Any, parameters: Parameters, running: Any, ran_away: Any) -> None:
        """One time step; `before` becomes the new displacement."""
        self._launch(
            self.arrays.kernels.predict,
            (self.layout.groups, self.body.particle_count),
            [self.lists, u, before, motion, self.arrays.free],
            [self._star],
        )
        self._fit(self.arrays.kernels.fit_clusters, self._star, parameters, running, self.unkept(), GOAL)
        self._finish(u, self._star, motion, running, before, ran_away)

    def cluster_values(self, values: FloatArray) -> Any:
        """(B, C) one value for each cluster, as the kernels read them."""
        layout = self.layout
        return upload(self.by_group(values).transpose(0, 2, 1), layout.scalar, layout.device, 2 * layout.width)

    def cluster_gradient(self, adjoint: Any) -> FloatArray:
        """(B, C) sum over each cluster's particles of m_i <adjoint_i, d goal_i / d beta_c>.

        The derivative of the goals by beta is what `residual` gave last.
        """
        body, d = self.body, self.dim
        maps = self._cluster_fields(self.maps, d + d * body.terms)[:, :, d:]
        maps = maps.reshape(*maps.shape[:2], body.terms, d)
        pull = self.layout.get(adjoint, d)[:, body.members] * body.member_mass[:, None]
        cluster_of = np.repeat(np.arange(body.cluster_count), np.diff(body.offsets))
        each = np.einsum("bmd,bmtd,mt->bm", pull, maps[:, cluster_of], body.member_basis)
        return np.asarray(np.add.reduceat(each, body.offsets[:-1], axis=1))

    def _cluster_fields(self, field: Any, rows: int) -> FloatArray:
        """(B, C, rows) of a field of clusters."""
        layout = self.layout
        host = np.asarray(field.numpy(), dtype=np.float64).reshape(rows, self.cluster_stride)
        body = host[:, : self.cluster_stride - layout.width].reshape(rows, layout.groups, -1, layout.abreast)
        return body.transpose(1, 3, 2, 0).reshape(-1, self.body.cluster_count, rows)[: layout.candidates]

    def _zero(self) -> Any:
        if not hasattr(self, "_zeros"):
            self._zeros = self.layout.field(self.dim)
        return self._zeros

    def _launch(self, kernel: Any, dim: tuple[int, ...], inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.layout.device)

    def _fit(self, kernel: Any, u: Any, parameters: Parameters, running: Any, kept: Any, what: int) -> None:
        self._launch(
            kernel,
            (self.layout.groups, self.body.cluster_count),
            [
                *(self.lists, self.arrays.rest, kept, self.material, u, parameters.beta, parameters.beta_stride),
                *(parameters.theta, parameters.volume, what, running),
            ],
            [self.maps],
        )

    def _finish(self, u: Any, star: Any, motion: Any, running: Any, out: Any, ran_away: Any) -> None:
        self._launch(
            self.arrays.kernels.finish,
            (self.layout.groups, self.body.particle_count),
            [self.lists, self.maps, u, star, motion, self.arrays.pull, running],
            [out, ran_away],
        )
