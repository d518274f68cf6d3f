"""A body that is one cluster: its static state without its particles.

Every free particle of a static state lies at t + T q~_i. Therefore T (d, terms) and t represent all particles, and the
equations need only sums over them. With mass shares m_i, lengths in cluster radii, and

- G = sum_all m q~ q~^T; C = sum_held m (q~ - q~_held mean) (q~ - q~_held mean)^T; H = the same with p for the first
  factor; J = [I, 0], which picks the linear terms,
- modes b_j with b_i^T G b_j = [i = j], b_j^T C b_j = mu_j = 1 - lambda_j: the share of the mode that is held,

t follows from the held particles (t = mean p - T mean q~), and the goals are T itself when

    A~ = R J + sum_j (e L (G - C) b_j + H b_j - R J C b_j) b_j^T / (1 - beta lambda_j)     (fit, eq. 3.7, 3.14)
    T = beta A~ + e L + (1 - beta) R J                                                     (blend, eq. 3.13)
    e L = beta (A~_theta - A~)                                    (eq. 3.17, where L = J, or the projected volume)
    R = polar(T (G - C) J^T + H J^T)                                                       (eq. 3.9)

Everything linear is solved by the modes. The remaining unknowns are A = A~ J^T, of which e is a function, and R. The
equations are Y + R U + e N = A, and R^T (K + e V) + W without a turning part, with (d, d) matrices that are sums over
the modes. That is 5 unknowns in the plane and 12 in space, for any basis and number of particles; Newton's steps find
them. With theta = 0, e = 0 and R = polar(K): the first step only confirms it.

Flags are checked: `converged` takes a Newton step below the tolerance, goals that agree with the state by separately
evaluated equations, and for eq. 3.17, which has no energy, a state that its goals pull back to."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm import reduced_kernels as k
from deformscope.stages.msm.cluster_functions import VOLUMES
from deformscope.stages.msm.clusters import FLAT_MOMENT_RATIO, held_mask, single
from deformscope.stages.msm.reference import Basis, Volume, build_rest

SMALLEST_TOLERANCE = 2e-12
"""Share of a cluster's radius to which the numbers themselves determine a static state."""


@dataclass(frozen=True, slots=True)
class HeldMoments:
    """Held positions as a body's equations need them. position: (B, n, d) [m]; moments: (B, terms d + d d + d), H b_j,
    H J^T [radii] and the mean [m]."""

    position: FloatArray
    moments: FloatArray


@dataclass(frozen=True, slots=True)
class Equilibrium:
    """Static states of B candidates: free particle i at translation + transform q~_i (`OneCluster.basis`).

    transform: (B, d, terms) [m]; translation: (B, d) [m]; iterations: (B,) Newton's steps
    residual: (B,) root mean square of goal - place over all particles, from separately evaluated equations [m]
    error: (B,) length of the last Newton step [m]: how far the state before it was from the solution
    converged: (B,) both are below the tolerance; diverged: (B,) no stable state of eq. 3.17 was found: a body turned
    inside out has none, and diverges in time stepping"""

    transform: FloatArray
    translation: FloatArray
    residual: FloatArray
    error: FloatArray
    iterations: IntArray
    converged: BoolArray
    diverged: BoolArray


class OneCluster:
    """A body of particles that are all one cluster (Thesis 5.1), reduced to its moments.

    rest: (K, d) positions at rest [m], d = 2 or 3; held: (n,) indices of the particles whose position is prescribed;
    mass: (K,), default 1 each; basis: "linear" (also rigid, with beta = 0) or "quadratic"; device: "cpu", "cuda:0"...

    basis: (K, terms) q~ of every particle, in cluster radii; radius [m]

    Calls share scratch: one thread at a time."""

    def __init__(
        self,
        rest: FloatArray,
        held: IntArray,
        *,
        mass: FloatArray | None = None,
        basis: Basis = "quadratic",
        device: str = "cpu",
    ) -> None:
        self.rest = np.ascontiguousarray(rest, dtype=np.float64)
        self.held = np.asarray(held, dtype=np.int64).reshape(-1)
        self.free = ~held_mask(len(self.rest), self.held)
        self.device = device
        mass = np.ones(len(self.rest)) if mass is None else np.asarray(mass, dtype=np.float64)
        (cluster,) = build_rest(self.rest, single(len(self.rest)), self.held, mass / mass.sum(), basis).clusters
        self.basis, self.radius = cluster.q_basis, cluster.radius
        self.dim, self.terms = self.rest.shape[1], self.basis.shape[1]
        m, d = cluster.mass, self.dim
        gram = (self.basis.T * m) @ self.basis
        held_q, held_m = self.basis[self.held], m[self.held]
        held_mean = np.average(held_q, axis=0, weights=held_m) if len(self.held) else np.zeros(self.terms)
        away = held_q - held_mean
        held_gram = (away.T * held_m) @ away
        moment, axes = np.linalg.eigh(gram)
        determined = moment > FLAT_MOMENT_RATIO * moment[-1]
        white = axes[:, determined] / np.sqrt(moment[determined])
        share, turn = np.linalg.eigh(white.T @ held_gram @ white)
        mode = np.zeros((self.terms, self.terms))  # columns; those of undetermined terms stay 0
        mode[:, : len(share)] = white @ turn
        shares = np.ones(self.terms)
        shares[: len(share)] = np.clip(share, 0.0, 1.0)
        # (n, terms + d): what a held position gives to each H b_j and H J^T
        self._weights = held_m[:, None] * away @ np.hstack([mode, np.eye(self.terms)[:, :d]]) / self.radius
        self._mass, self._fit_weights = m, m[:, None] * self.basis @ white @ white.T / self.radius
        self._mean_weights = held_m / (held_m.sum() or 1.0)
        self._rest_mean = np.average(self.rest, axis=0, weights=m)

        self._k = kk = k.reduced_kernels_for(d, self.terms)

        def rest_data(volume: Volume) -> Any:
            body = kk.ReducedBody()
            free_gram, linear = gram - held_gram, np.eye(d, self.terms)
            lift = linear if volume == "scale" else cluster.lift
            span = np.zeros((d, d))
            span[:, : cluster.span.shape[1]] = cluster.span

            def rows(values: FloatArray, dtype: type[Any] = kk.basis_vec) -> Any:
                return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

            body.mode = rows(mode.T)
            body.free_mode = rows((free_gram @ mode).T)
            body.lifted_mode = rows((lift @ free_gram @ mode).T, kk.vec)
            body.held_mode = rows((held_gram @ mode)[:d].T, kk.vec)
            body.share = rows(shares, wp.float64)
            body.free_q = rows(free_gram[:d])
            body.null = rows(linear - gram[:d] @ white @ white.T)
            body.gram = rows(gram)
            body.lift = rows(lift)
            body.lift_free = kk.square(*(lift @ free_gram[:, :d]).ravel())
            body.root = kk.square(*cluster.root.ravel())
            body.volume = VOLUMES[volume]
            body.held_mean = kk.basis_vec(*held_mean)
            body.a_qq = kk.square(*gram[:d, :d].ravel())
            body.span_axes = kk.square(*span.ravel())
            body.span_count = cluster.span.shape[1]
            body.radius = self.radius
            return body

        self._bodies = {volume: rest_data(volume) for volume in VOLUMES}
        self._work: dict[tuple[int, Volume], _Work] = {}

    def hold(self, held_position: FloatArray) -> HeldMoments:
        """Held positions (n, d) or (B, n, d) [m], reduced to their moments."""
        n, d = len(self.held), self.dim
        position = np.asarray(held_position, dtype=np.float64).reshape(-1 if n else 1, n, d)
        mean = self._mean_weights @ position if n else self._rest_mean[None]
        moments = self._weights.T @ (position - mean[:, None])  # (B, terms + d, d): by modes, then H J^T
        moments[:, self.terms :] = moments[:, self.terms :].transpose(0, 2, 1).copy()
        return HeldMoments(position, np.concatenate([moments.reshape(len(moments), -1), mean], axis=1))

    def relax(
        self,
        held: HeldMoments,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "scale",
        start: FloatArray | None = None,
        tolerance: float = 1e-10,
        max_iterations: int = 200,
    ) -> Equilibrium:
        """The static states, one candidate for each beta, theta and held pose.

        A body that the held particles leave free to turn turns as little as possible from its start, and one without
        held particles does not move. With theta > 0 Newton's steps begin at the start. If they converge to no valid
        state, the state is the one that follows from theta = 0 without a jump.

        beta, theta: a number or (B,); start: positions (K, d) or (B, K, d) [m], default rest; tolerance: tolerance of
        `residual` and `error`, as a share of the cluster's radius, at least `SMALLEST_TOLERANCE`"""
        starts = 1 if start is None else start.size // self.rest.size
        size = max(np.size(beta), np.size(theta), len(held.moments), starts)
        tolerance = max(tolerance, SMALLEST_TOLERANCE)
        work = self._filled(size, held, beta, theta, tolerance, max_iterations, volume)
        if start is not None:
            begin = np.asarray(start, dtype=np.float64).reshape(-1, *self.rest.shape)
            mean = self._mass @ begin
            fit = (self._fit_weights.T @ (begin - mean[:, None])).transpose(0, 2, 1)
            work.row[:, k.STARTED] = True
            work.start[:] = fit.reshape(len(begin), -1)
            if not len(self.held):
                work.held[:, -self.dim :] = mean  # nothing else says where the body is
        result = work.run()
        state = result[:, k.STATE]
        split = k.TRANSFORM + self.dim * self.terms
        return Equilibrium(
            transform=result[:, k.TRANSFORM : split].reshape(-1, self.dim, self.terms),
            translation=result[:, split:],
            residual=result[:, k.RESIDUAL],
            error=result[:, k.ERROR],
            iterations=result[:, k.ITERATIONS].astype(np.int64),
            converged=state == k.CONVERGED,
            diverged=state == k.DIVERGED,
        )

    def positions(self, equilibrium: Equilibrium, held: HeldMoments) -> FloatArray:
        """Positions (B, K, d) [m] of all particles; held ones have their prescribed positions."""
        out: FloatArray = self.basis @ equilibrium.transform.transpose(0, 2, 1)
        out += equilibrium.translation[:, None]
        out[:, self.held] = held.position
        return out

    def _filled(
        self,
        size: int,
        held: HeldMoments,
        beta: FloatArray | float,
        theta: FloatArray | float,
        tolerance: float,
        max_iterations: int,
        volume: Volume,
    ) -> "_Work":
        """The rows of `size` candidates, in scratch that calls of one size share. beta, theta: (B,), or one for all"""
        work = self._work.get((size, volume))
        if work is None:
            work = self._work[size, volume] = _Work(self, self._bodies[volume], size)
        row = work.row
        row[:, k.BETA] = beta
        row[:, k.THETA] = theta
        row[:, k.TOLERANCE : k.HELD] = (tolerance, max_iterations, False)
        work.held[:] = held.moments
        return work


class _Work:
    """Rows in and results out for `size` candidates, and the launches on them, recorded once."""

    def __init__(self, body: OneCluster, rest: object, size: int) -> None:
        self.body = body
        self.row_in = self._zeros(size, body._k.row_width)
        self.row: FloatArray = self.row_in.numpy()  # on the CPU the array itself
        split = body._k.row_width - body.dim * body.terms
        self.held, self.start = self.row[:, k.HELD : split], self.row[:, split:]
        self.out = self._zeros(size, body._k.result_width)
        inputs = [rest, self.row_in]  # recorded, a launch costs a fifth
        self.launch = wp.launch(body._k.relax, size, inputs, [self.out], device=body.device, record_cmd=True)

    def run(self) -> FloatArray:
        """(B, result_width) static states of the rows, laid out as by `reduced_kernels`."""
        if self.body.device != "cpu":
            self.row_in.assign(self.row)
        self.launch.launch()
        return np.array(self.out.numpy())

    def _zeros(self, *shape: int) -> Any:
        return wp.zeros(shape, dtype=wp.float64, device=self.body.device)
