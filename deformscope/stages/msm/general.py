"""Clusters as index lists on a device: their rest data, and the launches that make goals of displacements.

With a beta along each axis or with S^p they have a material: see `materials`."""

import functools
from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import FloatArray
from deformscope.stages.msm import general_kernels as k
from deformscope.stages.msm import reference
from deformscope.stages.msm.body import Body, BodyRest, Operator, Parameters, RestArrays, rest_struct
from deformscope.stages.msm.cluster_functions import cluster_functions_for
from deformscope.stages.msm.clusters import Clusters
from deformscope.stages.msm.layout import Field, Layout, upload, widths
from deformscope.stages.msm.materials import axis_weights
from deformscope.stages.msm.reference import Basis


class GeneralBody(Body):
    """A body of any clusters and basis, whose candidates may have a beta along each of `axes` (d, d), or yield."""

    def __init__(
        self,
        rest: BodyRest,
        clusters: Clusters,
        basis: Basis,
        scalar: type[Any],
        device: str,
        *,
        axes: FloatArray | None = None,
        plastic: bool = False,
    ) -> None:
        self.axes, self.plastic = axes, plastic
        d = rest.position.shape[1]
        super().__init__(d, scalar, device)
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
        self.lists: dict[str, Any] = {
            "offsets": upload(clusters.offsets, int, device),
            "members": upload(clusters.members, int, device),
            "share": upload(np.concatenate(share), scalar, device),
            "weight": upload(np.concatenate(weight), scalar, device),
            "moment": upload(np.concatenate(moment), scalar, device),
            "row_offsets": upload(np.concatenate([[0], np.cumsum(rest.counts)]), int, device),
            "row_clusters": upload(cluster_of[order], int, device),
            "row_basis": upload(np.concatenate(row_basis)[order], scalar, device),
        }

    def layout(self, candidates: int, *, filled: bool = False) -> Layout:
        width, abreast = widths(candidates, self.scalar, self.device, cells_in_lanes=False)
        groups = -(-candidates // abreast)
        group = self.particle_count * abreast
        count, place = self.particle_count, np.arange(self.particle_count)
        stride = groups * group + width
        where = place, self.scalar, self.device, self.there(place)
        return Layout(candidates, width, abreast, count, 0, group, stride, *where)

    def operator(self, layout: Layout) -> "GeneralOperator":
        return GeneralOperator(self, layout, self.arrays(layout.width))

    def _make_arrays(self, width: int) -> "GeneralArrays":
        return GeneralArrays(self, width)

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


class GeneralArrays:
    """Rest data on the device, for lanes of one width."""

    def __init__(self, body: GeneralBody, width: int) -> None:
        material = body.plastic or body.axes is not None
        self.kernels = k.general_kernels_for(body.dim, body.terms, body.scalar, width, material)
        functions = cluster_functions_for(body.dim, body.terms, body.scalar, width)
        self.rest = rest_struct(functions, body.rest_arrays, body.cluster_count, body.scalar, body.device)
        self.Kept, self.Motion = functions.Kept, self.kernels.Motion
        free = body.rest.free.astype(float)
        spare = 2 * width
        self.free = upload(free, body.scalar, body.device, spare)
        self.pull = upload(free / body.rest.counts, body.scalar, body.device, spare)
        self.sides = self.free if body.rest.held_axis < 0 else upload(~body.rest.slipping, body.scalar, body.device)
        self.metric = upload(body.rest.metric, body.scalar, body.device, spare)


class GeneralOperator(Operator):
    """Goals of clusters given as lists, with S^p of those that yield."""

    def __init__(self, body: GeneralBody, layout: Layout, arrays: GeneralArrays) -> None:
        clusters = body.cluster_count
        super().__init__(body, layout, arrays, layout.groups * clusters * layout.abreast + layout.width)
        lists = arrays.kernels.Lists()
        for name, value in body.lists.items():
            setattr(lists, name, value)
        lists.abreast, lists.particles, lists.clusters = layout.abreast, body.particle_count, clusters
        lists.particle_stride, lists.cluster_stride = layout.stride, self.cluster_stride
        self.lists = lists
        self.beta_stride = clusters * layout.abreast
        self.maps = self.cluster_field(self.dim + self.dim * body.terms)
        self.strain = self.cluster_field(body.dim**2 if body.plastic else 1)
        self.law: Any = None
        self._star = layout.field(self.dim)

    def residual(self, u: Field, out: Field, parameters: Parameters, running: Field, kept: object = None) -> None:
        kept = self.unkept() if kept is None else kept
        self._fit(self.arrays.kernels.fit_clusters, u, parameters, running, kept)
        self._finish(u, u, self.still, running, out, self._nothing)

    def change(self, direction: Field, out: Field, parameters: Parameters, running: Field, kept: object) -> None:
        self._fit(self.arrays.kernels.fit_changes, direction, parameters, running, kept)
        self._finish(direction, direction, self.still, running, out, self._nothing)

    def step(self, state: Any, motion: object, parameters: Parameters) -> None:
        u, before, star = state.u, state.before, self._star
        predicted = [self.lists, u, before, motion, self.arrays.free]
        self.launch(self.arrays.kernels.predict, self.body.particle_count, predicted, [star])
        self._fit(self.arrays.kernels.fit_clusters, star, parameters, state.running, self.unkept())
        self._finish(u, star, motion, state.running, before, state.ran_away)

    def cluster_values(self, values: FloatArray) -> Field:
        """A beta for each cluster (B, C) as the kernels read them; along each axis (B, C or 1, d): W and C."""
        layout, d = self.layout, self.dim
        if self.body.axes is None:
            return upload(self.by_group(values).transpose(0, 2, 1), layout.scalar, layout.device, 2 * layout.width)
        betas = values[:, 0] if values.shape[1] == 1 else values
        return self._pack(self.body.weights(betas).reshape(len(values), -1, 2 * d * d))

    def put_plastic(self, plastic: FloatArray) -> None:
        """S^p (B, C, d, d)."""
        self.strain.assign(self._pack((plastic - np.eye(self.dim)).reshape(*plastic.shape[:2], -1)))

    def plastic(self) -> FloatArray:
        """S^p (B, C, d, d)."""
        d = self.dim
        return self._cluster_fields(self.strain, d * d).reshape(-1, self.body.cluster_count, d, d) + np.eye(d)

    def set_law(self, yield_strain: FloatArray, share: FloatArray, maximum: FloatArray) -> None:
        """Parameters of `flow`, (B,) each; share: share of S - I that flows at once."""
        self.law = [self.layout.each(each) for each in (yield_strain, share, maximum)]

    @functools.cached_property
    def _flowed(self) -> tuple[Field, Field, Field]:
        every_group = wp.full(self.layout.groups, 1, dtype=int, device=self.layout.device)
        return self.cluster_field(1), self.cluster_field(1), every_group

    def flow(self, u: Field) -> None:
        """S^p flows by the fits at displacements u, and stops at the yield strain."""
        moved, size, every_group = self._flowed
        inputs = [self.lists, self.arrays.rest, u, *self.law, 1, every_group]
        self.launch(self.arrays.kernels.flow, self.body.cluster_count, inputs, [self.strain, moved, size])

    def flowed(self) -> tuple[FloatArray, FloatArray]:
        """Plastic flow of the last step, (B, C) each: largest change of an entry of S^p, and |S - I|_2 before it."""
        moved, size = (self._cluster_fields(each, 1)[..., 0] for each in self._flowed[:2])
        return moved, size

    def _pack(self, values: FloatArray) -> Field:
        """(B, C, rows) in the layout of cluster fields; the last candidate fills the rest of its group."""
        layout = self.layout
        rows = self.by_group(values).transpose(3, 0, 2, 1)
        host = np.zeros((values.shape[2], self.cluster_stride))
        host[:, : self.cluster_stride - layout.width] = rows.reshape(values.shape[2], -1)
        return upload(host, layout.scalar, layout.device)

    def _cluster_fields(self, field: Field, rows: int) -> FloatArray:
        """(B, C, rows) of a field of clusters."""
        layout = self.layout
        host = np.asarray(field.numpy(), dtype=np.float64).reshape(rows, self.cluster_stride)
        body = host[:, : self.cluster_stride - layout.width].reshape(rows, layout.groups, -1, layout.abreast)
        return body.transpose(1, 3, 2, 0).reshape(-1, self.body.cluster_count, rows)[: layout.candidates]

    def _fit(self, kernel: wp.Kernel, u: Field, parameters: Parameters, running: Field, kept: object) -> None:
        given = self.arrays.kernels.Given()
        given.beta, given.theta, given.beta_stride = parameters.beta, parameters.theta, parameters.beta_stride
        given.volume, given.strain = parameters.volume, self.strain
        given.plastic, given.axes = int(self.body.plastic), int(self.body.axes is not None)
        inputs = [self.lists, self.arrays.rest, kept, given, u, running]
        self.launch(kernel, self.body.cluster_count, inputs, [self.maps])

    def _finish(self, u: Field, star: Field, motion: object, running: Field, out: Field, ran_away: Field) -> None:
        arrays = self.arrays
        self.launch(
            arrays.kernels.finish,
            self.body.particle_count,
            [self.lists, self.maps, u, star, motion, arrays.pull, arrays.sides, self.body.rest.held_axis, running],
            [out, ran_away],
        )
