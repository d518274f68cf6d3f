"""The MSM engine: rest data on a device, and the two ways to run it, over many candidates at once."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.msm import kernels as k
from deformscope.stages.msm import reference
from deformscope.stages.msm.clusters import Clusters, held_mask, spacing
from deformscope.stages.msm.reference import Basis

Precision = Literal["float32", "float64"]

TOLERANCE = {"float64": 1e-9, "float32": 1e-5}
"""Default tolerance of `relax`, as a share of the body's extent."""

CHECK_EVERY = 16
"""Iterations between looks at which candidates still run (a look waits for the device)."""


PARTICLES_AT_ONCE = 2_000_000
"""Particles of all candidates together that `relax` holds at once: at most some 2 GB; more are taken in turns."""


@dataclass(frozen=True, slots=True)
class Relaxed:
    """Static states of B candidates.

    position: (B, K, d) [m, or the unit of the rest shape]; residual: (B,) root mean square of goal - position;
    error: (B,) estimated distance from the static state, root mean square over particles (same unit)
    iterations: (B,); converged: (B,) `error` came below the tolerance; diverged: (B,) the state ran away (eq. 3.17
    with overlapping clusters can): its position is what was reached, and is to be thrown away
    """

    position: FloatArray
    residual: FloatArray
    error: FloatArray
    iterations: IntArray
    converged: BoolArray
    diverged: BoolArray


@dataclass(frozen=True, slots=True)
class Moving:
    """The state of time stepping, on the device, in units of the particle spacing.

    u: (B, K) displacements from rest; v: (B, K) velocities [spacing / s]; ran_away: (B,) 1 where `diverged`
    """

    u: Any
    v: Any
    ran_away: Any

    @property
    def diverged(self) -> BoolArray:
        """(B,) bodies of which a particle would have left by 10 000 spacings: not to be used."""
        return np.asarray(self.ran_away.numpy() != 0)


class Msm:
    """A body of particles in overlapping clusters, ready to be simulated for many candidates in one launch.

    rest: (K, d) positions at rest, d = 2 or 3; clusters: which particles belong together; held: (n,) indices of the
    particles whose position is prescribed; mass: (K,), default 1 each; basis: "linear" (also rigid, with beta = 0) or
    "quadratic"; precision: of the state; device: "cpu", "cuda:0"...

    One candidate is one beta, one theta and one set of held positions. Whatever has a leading axis of B runs as B
    candidates; the rest is shared.
    """

    def __init__(
        self,
        rest: FloatArray,
        clusters: Clusters,
        held: IntArray | Sequence[int],
        *,
        mass: FloatArray | None = None,
        basis: Basis = "linear",
        precision: Precision = "float64",
        device: str = "cpu",
    ) -> None:
        self.rest = np.ascontiguousarray(rest, dtype=np.float64)
        self.held = np.asarray(held, dtype=np.int64).reshape(-1)
        self.dim = self.rest.shape[1]
        self.precision = precision
        self.device = device
        self.scale = spacing(self.rest)
        self.extent = float(np.ptp(self.rest, axis=0).max())
        terms = weight_terms(self.dim, basis)
        scalar = wp.float64 if precision == "float64" else wp.float32
        self._k = k.kernels_for(self.dim, terms, scalar)
        self._upload(clusters, np.ones(len(self.rest)) if mass is None else np.asarray(mass, np.float64), basis)

    def _upload(self, clusters: Clusters, mass: FloatArray, basis: Basis) -> None:
        """Rest data of every cluster, dimensionless, and the transposed lists that particles gather through."""
        d, kk = self.dim, self._k
        rest = reference.build_rest(self.rest / self.scale, clusters, self.held, mass, basis)
        share, weight, moment, row_basis = [], [], [], []
        a_qq = np.zeros((clusters.count, d, d))
        span = np.zeros((clusters.count, d, d))
        span_count = np.zeros(clusters.count, dtype=np.int32)
        untold = np.zeros((clusters.count, d, weight_terms(d, basis)))
        for c, cluster in enumerate(rest.clusters):
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
            told = cluster.inverse @ np.einsum("n,ni,nj->ij", cluster.mass, cluster.q_basis, cluster.q_basis)
            untold[c] = (np.eye(len(told)) - told.T)[:d]
        order = np.argsort(clusters.members, kind="stable")
        cluster_of = np.repeat(np.arange(clusters.count), np.diff(clusters.offsets))
        count = clusters.cluster_counts()
        held_row = np.full(len(self.rest), -1, dtype=np.int32)
        held_row[self.held] = np.arange(len(self.held))
        self.free = ~held_mask(len(self.rest), self.held)

        def dev(values: FloatArray | IntArray, dtype: Any) -> Any:
            return wp.array(values, dtype=dtype, device=self.device)

        self._offsets = dev(clusters.offsets, dtype=int)
        self._members = dev(clusters.members, dtype=int)
        self._share = dev(np.concatenate(share), dtype=kk.scalar)
        self._weight = dev(np.concatenate(weight), dtype=kk.basis_vec)
        self._a_qq = dev(a_qq, dtype=kk.moment)
        self._moment = dev(np.concatenate(moment), dtype=kk.vec)
        self._span = dev(span, dtype=kk.moment)
        self._span_count = dev(span_count, dtype=int)
        self._untold = dev(untold, dtype=kk.transform)
        self._row_offsets = dev(np.concatenate([[0], np.cumsum(count)]).astype(np.int32), dtype=int)
        self._row_clusters = dev(cluster_of[order].astype(np.int32), dtype=int)
        self._row_basis = dev(np.concatenate(row_basis)[order], dtype=kk.basis_vec)
        metric = count * mass / mass.mean()  # in which the goal map is symmetric: N_i m_i
        self._metric = dev(metric, dtype=kk.scalar)
        self._held_row = dev(held_row, dtype=int)
        self._metric_total = float(metric[self.free].sum()) or 1.0
        self.cluster_count = clusters.count

    # -- candidates ------------------------------------------------------------------------------------------------

    def _candidates(
        self, held_position: FloatArray, *parameters: FloatArray | float
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Held displacements (B, n, d) in spacings, and every parameter as (B,)."""
        held_position = np.asarray(held_position, dtype=np.float64)
        shape = (-1 if len(self.held) else 1, len(self.held), self.dim)
        held_position = held_position.reshape(shape)
        arrays = [np.atleast_1d(np.asarray(p, dtype=np.float64)) for p in parameters]
        (size,) = np.broadcast_shapes(*[a.shape for a in arrays], held_position.shape[:1])
        held_u = (held_position - self.rest[self.held]) / self.scale
        held_u = np.broadcast_to(held_u, (size, *held_u.shape[1:]))
        if not len(self.held):
            held_u = np.zeros((size, 1, self.dim))  # warp takes no empty arrays; no particle reads it
        return held_u, [np.broadcast_to(a, (size,)) for a in arrays]

    def _positions(self, u: Any) -> FloatArray:
        return self.rest + np.asarray(u.numpy(), dtype=np.float64) * self.scale

    def _displacements(self, position: FloatArray, size: int) -> Any:
        u = np.broadcast_to((np.asarray(position) - self.rest) / self.scale, (size, *self.rest.shape))
        return wp.array(np.ascontiguousarray(u), dtype=self._k.vec, device=self.device)

    def _scalars(self, values: FloatArray) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=self._k.scalar, device=self.device)

    def _launch_goals(self, u: Any, beta: Any, theta: Any, running: Any, work: _Work) -> None:
        size = u.shape[0]
        wp.launch(
            self._k.fit_clusters,
            dim=(size, self.cluster_count),
            inputs=[
                *(self._offsets, self._members, self._share, self._weight, self._moment, self._a_qq),
                *(self._span, self._span_count, self._untold, u, beta, theta, running),
            ],
            outputs=[work.transform, work.centre, work.turned, work.compliance],
            device=self.device,
        )
        self._launch_means(u, running, work, work.residual)

    def _launch_means(self, u: Any, running: Any, work: _Work, out: Any) -> None:
        wp.launch(
            self._k.goals,
            dim=u.shape,
            inputs=[
                *(self._row_offsets, self._row_clusters, self._row_basis, self._held_row),
                *(u, work.transform, work.centre, running),
            ],
            outputs=[out],
            device=self.device,
        )

    # -- relax -----------------------------------------------------------------------------------------------------

    def relax(
        self,
        held_position: FloatArray,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        start: FloatArray | None = None,
        tolerance: float | None = None,
        max_iterations: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Relaxed:
        """The static states; no dt, alpha or velocity enters.

        With theta = 0 they are minima of an energy, found by conjugate gradients with exact curvature; eq. 3.17 has no
        energy, so with theta the goal map is accelerated (Anderson). Both stop on an estimate of the distance to go.

        A start that is symmetric stays so, as it does in time stepping: a strut pressed along its axis stays straight
        where it would rather buckle. With theta and strong compression a static state can have clusters turned inside
        out: look at the picture.

        held_position: (n, d) or (B, n, d); beta, theta: a number or (B,); start: (K, d) or (B, K, d), default rest
        tolerance: on the estimated distance from the static state, as a share of the body's extent
        max_iterations: default 4000, or 40 a particle where that is more (long thin bodies bend slowly)
        progress: called with (candidates done, candidates) now and then
        """
        held_u, (beta_b, theta_b) = self._candidates(held_position, beta, theta)
        size = len(beta_b)
        if not self.free.any():
            return self._all_held(held_position, size)
        share = TOLERANCE[self.precision] if tolerance is None else tolerance
        most = max(4000, 40 * len(self.rest)) if max_iterations is None else max_iterations
        origin = np.broadcast_to(self.rest if start is None else start, (size, *self.rest.shape))
        at_once = max(1, PARTICLES_AT_ONCE // len(self.rest))
        parts = []
        for first in range(0, size, at_once):
            some = slice(first, first + at_once)
            note = None if progress is None else functools.partial(_offset, progress, first, size)
            parts.append(self._relax(held_u[some], beta_b[some], theta_b[some], origin[some], share, most, note))
        if len(parts) == 1:
            return parts[0]
        fields = [f.name for f in dataclasses.fields(Relaxed)]
        return Relaxed(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in fields})

    def _relax(
        self,
        held: FloatArray,
        beta: FloatArray,
        theta: FloatArray,
        start: FloatArray,
        tolerance: float,
        max_iterations: int,
        progress: Callable[[int], None] | None,
    ) -> Relaxed:
        """As many candidates as fit into memory at once."""
        size = len(beta)
        u = self._displacements(start, size)
        held_u: Any = wp.array(np.ascontiguousarray(held), dtype=self._k.vec, device=self.device)
        beta_d, theta_d = self._scalars(beta), self._scalars(theta)
        wanted = tolerance * self.extent / self.scale
        work: _Minimising | _Accelerating
        if theta.any():
            work = _Accelerating(self, size)
            iterate = functools.partial(self._accelerate, u, beta_d, theta_d, work, wanted)
        else:
            work = _Minimising(self, size)
            iterate = functools.partial(self._minimise, u, beta_d, theta_d, work, wanted)
        wp.launch(
            self._k.predict,
            dim=u.shape,
            inputs=[u, work.u_last, self._held_row, held_u, self._k.vec(), self._k.scalar(0.0)],
            outputs=[u],
            device=self.device,
        )
        iterate()  # loads the kernels, so that the capture below records launches only
        with wp.ScopedCapture(device=self.device) as capture:
            iterate()
        done = 1
        while done < max_iterations and (still := int(np.count_nonzero(work.running.numpy() == k.RUNNING))):
            if progress is not None:
                progress(size - still)
            for _ in range(min(CHECK_EVERY, max_iterations - done)):
                wp.capture_launch(capture.graph)
                done += 1
        state = work.running.numpy()
        return Relaxed(
            position=self._positions(u),
            residual=work.norm.numpy() * self.scale,
            error=work.error.numpy() * self.scale,
            iterations=work.total.numpy(),
            converged=state == k.CONVERGED,
            diverged=state == k.DIVERGED,
        )

    def _minimise(self, u: Any, beta: Any, theta: Any, work: _Minimising, tolerance: float) -> None:
        """One iteration of nonlinear conjugate gradients on the energy (theta = 0): launches only."""
        running, size, chunks = work.running, u.shape[0], work.chunks
        own, cross = work.own_part, work.cross_part
        launch = functools.partial(wp.launch, device=self.device)
        self._launch_goals(u, beta, theta, running, work)
        launch(
            self._k.residual_products,
            dim=(size, chunks),
            inputs=[self._metric, work.residual, work.residual_last, running, u.shape[1]],
            outputs=[own, cross],
        )
        launch(
            self._k.conjugate,
            dim=size,
            inputs=[own, cross, chunks, wp.float64(self._metric_total), work.own_last, work.fresh, running],
            outputs=[work.mix, work.norm, work.total],
        )
        launch(
            self._k.direct,
            dim=u.shape,
            inputs=[work.residual, work.mix, running],
            outputs=[work.direction, work.residual_last],
        )
        launch(
            self._k.fit_changes,
            dim=(size, self.cluster_count),
            inputs=[
                *(self._offsets, self._members, self._share, self._weight, self._moment, self._untold),
                *(work.direction, work.turned, work.compliance, beta, running),
            ],
            outputs=[work.transform, work.centre],
        )
        self._launch_means(work.direction, running, work, work.stiff)
        launch(
            self._k.curvature_products,
            dim=(size, chunks),
            inputs=[self._metric, work.residual, work.direction, work.stiff, running, u.shape[1]],
            outputs=[own, cross, work.step_part, work.longest_part],
        )
        launch(
            self._k.choose_step,
            dim=size,
            inputs=[
                *(own, cross, work.step_part, work.longest_part, chunks),
                *(wp.float64(self._metric_total), wp.float64(tolerance)),
                *(work.path, work.mark, work.total, work.fresh, running),
            ],
            outputs=[work.step, work.error],
        )
        launch(self._k.take_step, dim=u.shape, inputs=[work.direction, work.step, running], outputs=[u])

    def _accelerate(self, u: Any, beta: Any, theta: Any, work: _Accelerating, tolerance: float) -> None:
        """One iteration of Anderson's acceleration: launches only, so that it can be captured."""
        running, size, chunks = work.running, u.shape[0], work.chunks
        self._launch_goals(u, beta, theta, running, work)
        wp.launch(
            self._k.remember,
            dim=u.shape,
            inputs=[u, work.residual, work.iteration, running],
            outputs=[work.u_last, work.residual_last, work.du, work.dr],
            device=self.device,
        )
        wp.launch(
            self._k.products,
            dim=(size, k.MEMORY + 1, chunks),
            inputs=[self._metric, work.residual, work.du, work.dr, work.iteration, running, u.shape[1]],
            outputs=[work.gram_part, work.rhs_part, work.step_part],
            device=self.device,
        )
        wp.launch(
            self._k.accelerate,
            dim=size,
            inputs=[
                *(work.gram_part, work.rhs_part, work.step_part, chunks),
                *(wp.float64(self._metric_total), wp.float64(tolerance)),
                *(work.gram, work.path, work.mark, work.iteration, work.best, running),
            ],
            outputs=[work.gamma, work.norm, work.error, work.total],
            device=self.device,
        )
        wp.launch(
            self._k.advance,
            dim=u.shape,
            inputs=[work.residual, work.du, work.dr, work.gamma, work.iteration, self._held_row, running],
            outputs=[u],
            device=self.device,
        )

    def _all_held(self, held_position: FloatArray, size: int) -> Relaxed:
        position = np.broadcast_to(self.rest, (size, *self.rest.shape)).copy()
        position[:, self.held] = held_position
        none = np.zeros(size)
        yes = np.ones(size, dtype=bool)
        return Relaxed(position, none, none.copy(), np.zeros(size, dtype=int), yes, ~yes)

    # -- time stepping ---------------------------------------------------------------------------------------------

    def start(self, size: int = 1, position: FloatArray | None = None) -> Moving:
        """B bodies at rest without velocity, or at `position` (K, d) or (B, K, d)."""
        u = self._displacements(self.rest if position is None else position, size)
        return Moving(u, wp.zeros_like(u), wp.zeros(size, dtype=int, device=self.device))

    def step(
        self,
        state: Moving,
        held_position: FloatArray,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        alpha: float = 1.0,
        dt: float = 2e-3,
        acceleration: Sequence[float] | None = None,
        steps: int = 1,
    ) -> FloatArray:
        """Time stepping as in the thesis (Algorithm 1 with eq. 3.11): moves `state` on and returns (B, K, d).

        dt [s]; acceleration: f_ext / m, (d,) [m/s^2]. Without it, dt does not change the motion (alpha = 1).
        """
        held_u, (beta_b, theta_b) = self._candidates(held_position, beta, theta)
        size = state.u.shape[0]
        if len(beta_b) not in (1, size):
            raise ValueError(f"expected candidates for {size} bodies or for one; got {len(beta_b)}")
        beta_d = self._scalars(np.broadcast_to(beta_b, size))
        theta_d = self._scalars(np.broadcast_to(theta_b, size))
        held_d: Any = wp.array(
            np.ascontiguousarray(np.broadcast_to(held_u, (size, *held_u.shape[1:]))),
            dtype=self._k.vec,
            device=self.device,
        )
        push = np.zeros(self.dim) if acceleration is None else np.asarray(acceleration) / self.scale
        work = _Work(self, size)

        def advance() -> None:
            wp.launch(
                self._k.predict,
                dim=state.u.shape,
                inputs=[state.u, state.v, self._held_row, held_d, self._k.vec(*push), self._k.scalar(dt)],
                outputs=[work.u_last],
                device=self.device,
            )
            self._launch_goals(work.u_last, beta_d, theta_d, work.running, work)
            wp.launch(
                self._k.integrate,
                dim=state.u.shape,
                inputs=[state.u, work.u_last, work.residual, self._k.scalar(alpha), self._k.scalar(dt)],
                outputs=[state.u, state.v, state.ran_away],
                device=self.device,
            )

        if steps > 0:
            advance()
        if steps > 1:
            with wp.ScopedCapture(device=self.device) as capture:
                advance()
            for _ in range(steps - 1):
                wp.capture_launch(capture.graph)
        return self._positions(state.u)

    def residual(self, position: FloatArray, beta: FloatArray | float, theta: FloatArray | float = 0.0) -> FloatArray:
        """goals(x) - x at the given positions (K, d) or (B, K, d), 0 at held particles: (B, K, d)."""
        position = np.asarray(position, dtype=np.float64).reshape(-1, *self.rest.shape)
        _, (beta_b, theta_b) = self._candidates(position[:, self.held], beta, theta)
        u = self._displacements(position, len(beta_b))
        work = _Work(self, len(beta_b))
        self._launch_goals(u, self._scalars(beta_b), self._scalars(theta_b), work.running, work)
        return np.asarray(work.residual.numpy(), dtype=np.float64) * self.scale


def pick_device(choice: Literal["auto", "cpu", "cuda"]) -> str:
    """The warp device for a choice; `auto` is the GPU where there is one."""
    if choice == "cpu" or (choice == "auto" and not wp.is_cuda_available()):
        return "cpu"
    if not wp.is_cuda_available():
        raise InputError("a CUDA device", "none that warp can use on this machine", "--device cpu")
    return "cuda:0"


def _offset(progress: Callable[[int, int], None], before: int, size: int, done: int) -> None:
    progress(before + done, size)


def weight_terms(dim: int, basis: Basis) -> int:
    """Terms of the basis: d, or 5 in the plane and 9 in space (eq. 3.14)."""
    return dim if basis == "linear" else {2: 5, 3: 9}[dim]


class _Work:
    """Scratch arrays for the goals of `size` candidates."""

    def __init__(self, body: Msm, size: int) -> None:
        count, kk = len(body.rest), body._k
        self.zeros = functools.partial(wp.zeros, device=body.device)
        self.transform = self.zeros((size, body.cluster_count), dtype=kk.transform)
        self.centre = self.zeros((size, body.cluster_count), dtype=kk.vec)
        self.residual = self.zeros((size, count), dtype=kk.vec)
        self.u_last = self.zeros((size, count), dtype=kk.vec)
        self.turned = self.zeros((size, body.cluster_count), dtype=kk.moment)
        self.compliance = self.zeros((size, body.cluster_count), dtype=kk.moment)
        self.running = wp.full(size, k.RUNNING, dtype=int, device=body.device)


class _Relaxing(_Work):
    """What both ways to a static state keep: the last residual, the path since the last mark, and the tallies."""

    def __init__(self, body: Msm, size: int) -> None:
        super().__init__(body, size)
        self.chunks = -(-len(body.rest) // k.CHUNK)
        self.residual_last = self.zeros((size, len(body.rest)), dtype=body._k.vec)
        self.step_part = self.zeros((size, self.chunks), dtype=wp.float64)
        self.path = self.zeros(size, dtype=wp.float64)
        self.mark = wp.full(size, 8, dtype=int, device=body.device)
        self.norm = self.zeros(size, dtype=wp.float64)
        self.error = self.zeros(size, dtype=wp.float64)
        self.total = self.zeros(size, dtype=int)


class _Minimising(_Relaxing):
    """Scratch of conjugate gradients."""

    def __init__(self, body: Msm, size: int) -> None:
        super().__init__(body, size)
        vectors = (size, len(body.rest))
        self.own_part = self.zeros((size, self.chunks), dtype=wp.float64)
        self.cross_part = self.zeros((size, self.chunks), dtype=wp.float64)
        self.longest_part = self.zeros((size, self.chunks), dtype=wp.float64)
        self.own_last = self.zeros(size, dtype=wp.float64)
        self.fresh = wp.full(size, 1, dtype=int, device=body.device)
        self.mix = self.zeros(size, dtype=body._k.scalar)
        self.step = self.zeros(size, dtype=body._k.scalar)
        self.direction = self.zeros(vectors, dtype=body._k.vec)
        self.stiff = self.zeros(vectors, dtype=body._k.vec)


class _Accelerating(_Relaxing):
    """Scratch of Anderson's acceleration."""

    def __init__(self, body: Msm, size: int) -> None:
        super().__init__(body, size)
        history = (size, k.MEMORY, len(body.rest))
        self.du = self.zeros(history, dtype=body._k.vec)
        self.dr = self.zeros(history, dtype=body._k.vec)
        self.gram_part = self.zeros((size, k.MEMORY + 1, self.chunks), dtype=wp.float64)
        self.rhs_part = self.zeros((size, k.MEMORY + 1, self.chunks), dtype=wp.float64)
        self.gram = self.zeros(size, dtype=body._k.history)
        self.gamma = self.zeros(size, dtype=body._k.history_vec)
        self.iteration = self.zeros(size, dtype=int)
        self.best = wp.full(size, np.inf, dtype=wp.float64, device=body.device)
