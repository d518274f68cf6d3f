"""The MSM engine: rest data on a device, and two methods for many candidates at once."""

import copy
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.msm import multigrid
from deformscope.stages.msm.body import Body, BodyRest, Operator, Parameters
from deformscope.stages.msm.cluster_functions import NONE, VOLUMES
from deformscope.stages.msm.clusters import Clusters, LatticeClusters, held_mask
from deformscope.stages.msm.general import GeneralBody
from deformscope.stages.msm.iteration import Anderson, Ended, Newton
from deformscope.stages.msm.lattice import LatticeBody, lattice_edges
from deformscope.stages.msm.layout import Field, HostCopies, upload
from deformscope.stages.msm.materials import AxisBeta
from deformscope.stages.msm.newton_functions import CONVERGED, DIVERGED
from deformscope.stages.msm.newton_kernels import newton_kernels_for
from deformscope.stages.msm.reduced import OneCluster
from deformscope.stages.msm.reference import Basis, Volume

Precision = Literal["float32", "float64"]

TOLERANCE = {"float64": 1e-9, "float32": 3e-5}
"""Default tolerance of `relax`, as a share of the body's extent."""

PARTICLES_AT_ONCE = 2_000_000
"""Particles of all candidates together that `relax` holds at once: at most some 2 GB; more are taken in turns."""

KEPT_NUMBERS = 2_000_000
"""Largest number of particles of all candidates for which the scratch of a method is reused by the next call."""

MOVES = 200
"""Moves that held particles make at most in time stepping; of more steps, several pass at each place."""

RESUMED_ITERATIONS = 32_000
"""Least number of iterations for a second beginning. Largest number of iterations of a resumed search. It starts near
its solution, but at beta .95 to .99 pressed bodies, with weak restoring forces, need up to 13 000."""

TRIED_STEPS = 3000
"""Time steps within which a body that eq. 3.17 leaves no stable state has run away."""

KEPT_CALLS = 16
"""Parameters, motions and recorded steps that a state of time stepping keeps on the device for the next call."""


@dataclass(frozen=True, slots=True)
class Relaxed:
    """Static states of B candidates.

    position: (B, K, d) [m, or the unit of the rest shape]; residual: (B,) root mean square of goal - position;
    error: (B,) estimated distance from the static state, root mean square over particles (same unit)
    iterations: (B,) evaluations of goals or of their derivative; converged: (B,) `error` came below the tolerance;
    diverged: (B,) the state diverged (eq. 3.17 with overlapping clusters can): its position is the last one, and is
    useless; smoothed: (B,) evaluations besides, in float32, on the finest level of a large lattice's preconditioner
    unaided: (B,) the preconditioner did not help: plain conjugate gradients continued
    out_of_time: (B,) the time limit came first: `position`, `residual` and `error` are the last ones"""

    position: FloatArray
    residual: FloatArray
    error: FloatArray
    iterations: IntArray
    converged: BoolArray
    diverged: BoolArray
    smoothed: IntArray
    unaided: BoolArray
    out_of_time: BoolArray

    @property
    def settled(self) -> FloatArray:
        """`position` (B, K, d), NaN where it did not converge."""
        return np.asarray(np.where(self.converged[:, None, None], self.position, np.nan))


class Moving:
    """The state of time stepping, on the device: displacements now and one step before, for B bodies.

    held: indices of the held particles, their places in memory, and their displacements (B or 1, h, d)"""

    def __init__(self, operator: Operator) -> None:
        self.last_dt = 0.0
        self.operator: Any = operator
        self.layout = operator.layout
        self.parts = 3 if operator.looks_ahead else 2  # x* of the next step is the third
        self.pair = self.layout.field(self.parts * operator.dim)
        self.swapped = False
        self.ran_away = self.layout.each(np.zeros(1), int)
        self.running = wp.full(self.layout.groups, 1, dtype=int, device=self.layout.device)
        self.held: tuple[Any, Any, Any] = (None, None, None)
        self._kept: dict[Any, Any] = {}

    def kept(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        """The stored result of `make` for this key."""
        if key not in self._kept:
            if len(self._kept) >= KEPT_CALLS:
                self._kept.clear()
            self._kept[key] = make()
        return self._kept[key]

    @property
    def u(self) -> Field:
        return self._part(int(self.swapped))

    @property
    def before(self) -> Field:
        return self._part(int(not self.swapped))

    @property
    def star(self) -> Field:
        return self._part(self.parts - 1)

    def _part(self, index: int) -> Field:
        rows = self.pair.shape[0] // self.parts
        part: Field = self.pair[index * rows : (index + 1) * rows]
        return part

    @property
    def diverged(self) -> BoolArray:
        """(B,) bodies in which a particle would have moved by 10 000 spacings: they must not be used."""
        return np.asarray(self.ran_away.numpy()[: self.layout.candidates] != 0)


class Msm:
    """A body of particles in overlapping clusters, ready to be simulated for many candidates at once.

    rest: (K, d) positions at rest, d = 2 or 3; clusters: which particles form clusters; held: (n,) indices of the
    particles whose position is prescribed; mass: (K,), default 1 each; basis: "linear" (also rigid, with beta = 0) or
    "quadratic"; slipping: the held particles that are held along one axis alone, and that axis: static states of more
    than one cluster find their lateral positions; precision: precision of the state; device: "cpu", "cuda:0"...

    One candidate is one beta, one theta and one set of held positions. Arguments with a leading axis of B are B
    candidates; others are shared. Windows of an even lattice with a linear basis are summed axis by axis, at a cost
    that does not grow with their width. Other clusters are gathered particle by particle; a body of one cluster relaxes
    in the unknowns of that cluster."""

    def __init__(
        self,
        rest: FloatArray,
        clusters: Clusters,
        held: IntArray | Sequence[int],
        *,
        mass: FloatArray | None = None,
        basis: Basis = "linear",
        slipping: tuple[IntArray, int] | None = None,
        precision: Precision = "float64",
        device: str = "cpu",
    ) -> None:
        self.rest = np.ascontiguousarray(rest, dtype=np.float64)
        self.dim = self.rest.shape[1]
        self.precision = precision
        self.device = device
        self.scale = clusters.spacing(self.rest)
        self.extent = float(max(np.ptp(along) for along in self.rest.T))
        self.cluster_count = clusters.count
        self._scalar = wp.float64 if precision == "float64" else wp.float32
        self._basis = basis
        self.mass = np.ones(len(self.rest)) if mass is None else np.asarray(mass, np.float64)
        self._clusters = clusters
        self._hold(held, slipping)
        self._scratch: dict[Any, Any] = {}
        self._axes: FloatArray | None = None
        self._plastic = False
        self._variants: dict[bytes, Msm] = {}

    @functools.cached_property
    def _body(self) -> Body:
        return self._build(self._scalar)

    @functools.cached_property
    def _double(self) -> Body:
        """The body in float64: for eq. 3.17, which has no energy, and whose error float32 cannot judge."""
        return self._body if self._scalar is wp.float64 else self._build(wp.float64)

    def variant(self, *, axes: FloatArray | None = None, plastic: bool = False) -> "Msm":
        """This body with index lists, for `materials`: betas along `axes` (d, d), or clusters that yield."""
        if axes is not None and self._basis != "linear":
            raise ValueError("expected a linear basis with a beta along each axis; got a quadratic one")
        made = self._alike()
        made._axes, made._plastic = axes, plastic
        return made

    def holding(self, held: IntArray | Sequence[int]) -> "Msm":
        """This body with the positions of other particles (n,) prescribed."""
        made = self._alike()
        made._hold(held)
        return made

    def _alike(self) -> "Msm":
        made = copy.copy(self)
        for name in ("_body", "_double", "_one"):
            made.__dict__.pop(name, None)
        made._scratch, made._variants = {}, {}
        return made

    def _hold(self, held: IntArray | Sequence[int], slipping: tuple[IntArray, int] | None = None) -> None:
        self.held = np.asarray(held, dtype=np.int64).reshape(-1)
        self.free, self._held_rest = ~held_mask(len(self.rest), self.held), self.rest[self.held]
        some, axis = (np.zeros(0, dtype=np.int64), -1) if slipping is None else slipping
        slips = held_mask(len(self.rest), some)
        self.free |= slips
        counts = self._clusters.cluster_counts()
        metric = counts * self.mass
        metric /= self.mass.mean()
        metric[~self.free] = 0.0
        place = self.rest / self.scale
        self._particles = BodyRest(place, self.mass, self.free, counts, metric, slipping=slips, held_axis=axis)

    def _along(self, beta: AxisBeta, theta: FloatArray | float) -> "Msm":
        """The variant for betas along these axes, reused by the next call. theta: (B,) or one, all 0"""
        axes = np.asarray(beta.axes)
        if len(axes) != self.dim:
            raise ValueError(f"expected betas along {self.dim} axes; got {len(axes)}")
        if np.any(theta):
            raise ValueError("expected theta = 0 with a beta along each axis")
        if self._axes is not None or self._plastic:
            raise ValueError("expected a body without a material of its own")
        key = axes.tobytes()
        if key not in self._variants:
            self._variants[key] = self.variant(axes=axes)
        return self._variants[key]

    def _build(self, scalar: type[Any]) -> Body:
        plain = self._axes is None and not self._plastic
        if plain and self._basis == "linear" and isinstance(self._clusters, LatticeClusters):
            edges = lattice_edges(self._particles.position, self._clusters)
            if edges is not None and (self.dim == 3 or len(self._clusters.shape) == 2):
                return LatticeBody(self._particles, self._clusters, edges, scalar, self.device)
        how: Any = {"axes": self._axes, "plastic": self._plastic}
        return GeneralBody(self._particles, self._clusters, self._basis, scalar, self.device, **how)

    @functools.cached_property
    def _one(self) -> OneCluster | None:
        """The body as one cluster, if it is one."""
        if self._axes is not None or self._plastic:
            return None
        if self._clusters.count != 1 or len(self._clusters.members) != len(self.rest):
            return None
        mass = self._particles.mass
        return OneCluster(self.rest, self.held, mass=mass, basis=self._basis, device=self.device)

    @property
    def slips(self) -> bool:
        """Whether some particles are held along one axis alone."""
        return self._particles.held_axis >= 0

    @property
    def counts(self) -> IntArray:
        """(K,) clusters that each particle belongs to, N_i of Thesis eq. 3.15."""
        return self._particles.counts

    # -- candidates ------------------------------------------------------------------------------------------------

    def _candidates(
        self, held_position: FloatArray, beta: FloatArray | float, theta: FloatArray | float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Held displacements (B or 1, n, d) in spacings, beta (B,) or (B, C), theta (B,)."""
        if isinstance(beta, AxisBeta):
            raise ValueError("expected one beta, or one for each cluster: relax and residual alone take an AxisBeta")
        shape = (-1 if len(self.held) else 1, len(self.held), self.dim)
        held_position = np.asarray(held_position, dtype=np.float64).reshape(shape)
        held_u = (held_position - self._held_rest) / self.scale
        beta, theta = np.atleast_1d(np.asarray(beta, np.float64)), np.atleast_1d(np.asarray(theta, np.float64))
        if beta.ndim == 2 and self._axes is None and beta.shape[1] != self.cluster_count:
            raise ValueError(f"expected a beta for each of {self.cluster_count} clusters; got {beta.shape[1]}")
        (size,) = np.broadcast_shapes(beta.shape[:1], theta.shape, held_u.shape[:1])
        return held_u, np.broadcast_to(beta, (size, *beta.shape[1:])), np.broadcast_to(theta, (size,))

    def _displacements(self, position: FloatArray | None) -> FloatArray:
        """(B or 1, K, d) in spacings."""
        if position is None:
            return np.zeros((1, *self.rest.shape))
        return (np.asarray(position, np.float64).reshape(-1, *self.rest.shape) - self.rest) / self.scale

    def _method(self, kind: type[Newton] | type[Anderson], size: int, volume: int) -> Any:
        """A method, with its scratch; those of the last few calls are reused."""
        key = (kind, size, volume)
        # a large lattice in float64, because float32 does not resolve its slow modes from rounding
        large = isinstance(self._body, LatticeBody) and len(self.rest) > multigrid.LEAST
        body = self._double if kind is Anderson or large else self._body
        method = self._scratch.pop(key, None)
        if method is None:
            method = kind(body, self._particles, size, volume)
            method.copies = HostCopies(method.layout, self.rest, self.scale)
        if size * len(self.rest) <= KEPT_NUMBERS:
            self._scratch[key] = method
            while len(self._scratch) > 4:
                del self._scratch[next(iter(self._scratch))]
        return method

    # -- relax -----------------------------------------------------------------------------------------------------

    def relax(
        self,
        held_position: FloatArray,
        beta: FloatArray | float | AxisBeta,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "scale",
        start: FloatArray | None = None,
        tolerance: float | None = None,
        max_iterations: int | None = None,
        progress: Callable[[int, int], None] | None = None,
        limit_s: float = np.inf,
    ) -> Relaxed:
        """The static states; no dt, alpha or velocity enters.

        With theta = 0, and with the volume conserved by projection, they are minima of an energy, found by Newton's
        steps (conjugate gradients); eq. 3.17 has no energy, so there the goal map is accelerated (Anderson), in float64
        always. Both stop when the estimated distance from the static state is small enough. One cluster of all
        particles is solved in its own few unknowns.

        A symmetric start stays symmetric, as in time stepping: a strut pressed along its axis stays straight where it
        would buckle. With eq. 3.17 and strong compression a static state can have clusters turned inside out: check the
        picture, or use volume="project".

        held_position: (n, d) or (B, n, d); theta: a number or (B,)
        beta: a number, (B,), (B, C) for each cluster, or `AxisBeta` (linear basis, theta = 0)
        volume: "scale" (eq. 3.17) or "project" (stable): see `reference`; start: (K, d) or (B, K, d), default rest
        tolerance: largest estimated distance from the static state, as a share of the body's extent
        max_iterations: default 4000, or 40 a particle where that is more (long thin bodies bend slowly). By default,
        candidates that do not converge with eq. 3.17 start again at the state without conservation
        progress: called with (candidates done, candidates) now and then, also within one long solve
        limit_s: after this time, checked every few iterations, candidates that still run end as `out_of_time`"""
        if isinstance(beta, AxisBeta):
            found: Relaxed = self._along(beta, theta).relax(
                held_position,
                beta.value[:, None, :],
                start=start,
                tolerance=tolerance,
                max_iterations=max_iterations,
                progress=progress,
                limit_s=limit_s,
            )
            return found
        until = time.monotonic() + limit_s
        held_u, beta_b, theta_b = self._candidates(held_position, beta, theta)
        origin = self._displacements(start)
        size = max(len(beta_b), len(origin))
        beta_b, theta_b = (np.broadcast_to(each, (size, *each.shape[1:])) for each in (beta_b, theta_b))
        if not self.free.any():
            return self._all_held(held_position, size)
        share = TOLERANCE[self.precision] if tolerance is None else tolerance
        most = _most_iterations(len(self.rest)) if max_iterations is None else max_iterations
        if self._one is not None:
            how: Any = {"volume": volume, "start": start, "tolerance": share, "max_iterations": most}
            return self._relax_one(held_position, beta_b.reshape(size, -1)[:, 0], theta_b, **how)
        at_once = max(1, PARTICLES_AT_ONCE // len(self.rest))
        parts = []
        for first in range(0, size, at_once):
            some = slice(first, min(first + at_once, size))
            count = some.stop - first
            u = np.zeros((count, *self.rest.shape))
            if start is not None:
                u[:] = origin[some] if len(origin) > 1 else origin
            u[:, self.held] = held_u[some] if len(held_u) > 1 else held_u
            method = self._method(*self._kind(theta_b[some], count, volume))
            method.set(beta_b[some], theta_b[some])
            note = None if progress is None else lambda done, before=first: progress(before + done, size)
            ended = method.relax(u, share * self.extent / self.scale, most, note, until)
            parts.append(self._relaxed(method.copies.take(method.u), ended))
        found = parts[0]
        if len(parts) > 1:
            found = Relaxed(*(np.concatenate([getattr(part, name) for part in parts]) for name in Relaxed.__slots__))
        if volume == "scale" and max_iterations is None:
            self._resume(found, held_position, beta_b, theta_b, start, share, progress, until)
        return found

    def _resume(
        self,
        found: Relaxed,
        held_position: FloatArray,
        beta: FloatArray,
        theta: FloatArray,
        start: FloatArray | None,
        tolerance: float,
        progress: Callable[[int, int], None] | None,
        until: float,
    ) -> None:
        """Has candidates that neither converged nor ran away by eq. 3.17 begin at the state without conservation.

        From there the stable state that the pressed body comes to is near. Where that fails and time steps run away
        from there, the candidate has diverged."""
        rows = np.flatnonzero(~(found.converged | found.diverged | found.out_of_time) & (theta > 0.0))
        if not len(rows):
            return
        size, (count, dim) = len(theta), self.rest.shape
        held = np.reshape(held_position, (-1 if len(self.held) else 1, len(self.held), dim))
        held = np.broadcast_to(held, (size, *held.shape[1:]))[rows]
        if start is not None:
            start = np.broadcast_to(start, (size, count, dim))[rows]
        beta, theta = beta[rows], theta[rows]
        note = None if progress is None else lambda done, _of: progress(size - len(rows) + done, size)
        free = self.relax(held, beta, start=start, tolerance=tolerance, limit_s=until - time.monotonic())
        again = self.relax(
            held,
            beta,
            theta,
            start=free.position,
            tolerance=tolerance,
            max_iterations=max(RESUMED_ITERATIONS, _most_iterations(count)),
            progress=note,
            limit_s=until - time.monotonic(),
        )
        if not (again.converged | again.out_of_time).all() and not self.slips and time.monotonic() < until:
            state = self.start(len(rows), free.position)
            self.advance(state, held, beta, theta, steps=TRIED_STEPS)
            again.diverged[:] |= ~(again.converged | again.out_of_time) & state.diverged
        nearer = ~again.out_of_time | (again.error < found.error[rows])  # the first solve may have come further
        again.iterations[:] += found.iterations[rows] + free.iterations
        again.smoothed[:] += free.smoothed
        for name in Relaxed.__slots__:
            taken = nearer if name in ("position", "residual", "error") else np.ones(len(rows), dtype=bool)
            getattr(found, name)[rows[taken]] = getattr(again, name)[taken]

    @staticmethod
    def _kind(theta: FloatArray, size: int, volume: Volume) -> tuple[type[Newton] | type[Anderson], int, int]:
        """The method for theta (B,): its class, how many candidates, and how volume is conserved."""
        if not theta.any():
            return Newton, size, NONE
        return (Newton if volume == "project" else Anderson), size, VOLUMES[volume]

    def _relaxed(self, position: FloatArray, ended: Ended) -> Relaxed:
        """The states at positions (B, K, d), in the unit of `rest`."""
        return Relaxed(
            position=position,
            residual=ended.norm * self.scale,
            error=ended.error * self.scale,
            iterations=ended.total,
            converged=ended.state == CONVERGED,
            diverged=ended.state == DIVERGED,
            smoothed=ended.smoothed,
            unaided=ended.unaided,
            out_of_time=ended.out_of_time,
        )

    def _relax_one(
        self, held_position: FloatArray, beta: FloatArray, theta: FloatArray, *, tolerance: float, **how: Any
    ) -> Relaxed:
        """`relax` of one cluster. how: for `OneCluster.relax`"""
        one = self._one
        assert one is not None
        held = one.hold(np.asarray(held_position, dtype=np.float64))
        found = one.relax(held, beta, theta, tolerance=tolerance * self.extent / one.radius, **how)
        position = one.positions(found, held)
        few = (found.residual, found.error, found.iterations, found.converged, found.diverged)
        no = np.zeros_like(found.converged)
        return Relaxed(position, *few, np.zeros_like(found.iterations), no, no.copy())

    def _all_held(self, held_position: FloatArray, size: int) -> Relaxed:
        """The states where every particle is prescribed. held_position: (B, h, d)"""
        position = np.broadcast_to(self.rest, (size, *self.rest.shape)).copy()
        position[:, self.held] = held_position
        none = np.zeros(size)
        yes = np.ones(size, dtype=bool)
        count = np.zeros(size, dtype=int)
        return Relaxed(position, none, none.copy(), count, yes, ~yes, count.copy(), ~yes, ~yes)

    # -- time stepping ---------------------------------------------------------------------------------------------

    def start(self, size: int = 1, position: FloatArray | None = None) -> Moving:
        """B bodies at rest without velocity, or at `position` (K, d) or (B, K, d)."""
        if self.slips:
            raise ValueError("expected no slipping particles in time stepping; got some")
        state = Moving(self._body.operator(self._body.layout(size)))
        if position is not None:
            u = self._displacements(position)
            state.layout.put(u, state.u)
            state.layout.put(u, state.before)
        return state

    def step(
        self,
        state: Moving,
        held_position: FloatArray,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "scale",
        alpha: float = 1.0,
        dt: float = 2e-3,
        acceleration: Sequence[float] | None = None,
        steps: int = 1,
        held_from: FloatArray | None = None,
    ) -> FloatArray:
        """The positions (B, K, d) after `advance`, whose arguments it takes."""
        how: Any = {"volume": volume, "alpha": alpha, "dt": dt, "acceleration": acceleration}
        self.advance(state, held_position, beta, theta, **how, steps=steps, held_from=held_from)
        return self.positions(state)

    def positions(self, state: Moving) -> FloatArray:
        """Positions (B, K, d) of the particles of stepped bodies."""
        copies: HostCopies = state.kept(("copies",), lambda: HostCopies(state.layout, self.rest, self.scale))
        return copies.take(state.u)

    def advance(
        self,
        state: Moving,
        held_position: FloatArray,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "scale",
        alpha: float = 1.0,
        dt: float = 2e-3,
        acceleration: Sequence[float] | None = None,
        steps: int = 1,
        held_from: FloatArray | None = None,
    ) -> None:
        """Time stepping as in the thesis (Algorithm 1 with eq. 3.11): moves `state` on, which stays on the device; on a
        GPU it returns before the steps are taken.

        dt [s]; acceleration: f_ext / m, (d,) [m/s^2]. Without it, dt does not change the motion (alpha = 1).
        held_from: (n, d) or (B, n, d), whence the held particles go to held_position evenly over the steps; without it
        they are there from the first step on"""
        held_u, beta_b, theta_b = self._candidates(held_position, beta, theta)
        if len(beta_b) not in (1, state.layout.candidates):
            raise ValueError(f"expected candidates for {state.layout.candidates} bodies or for one; got {len(beta_b)}")
        conserved = VOLUMES[volume] if theta_b.any() else NONE
        stepping = _Stepping(self, state, held_u, beta_b, theta_b, conserved, alpha, dt, acceleration)
        if held_from is None:
            stepping.run(steps)
        else:
            stepping.run_moving(steps, self._candidates(held_from, beta, theta)[0], held_u)

    def residual(
        self,
        position: FloatArray,
        beta: FloatArray | float | AxisBeta,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "scale",
    ) -> FloatArray:
        """goals(x) - x at the given positions (K, d) or (B, K, d), 0 at held particles: (B, K, d)."""
        if isinstance(beta, AxisBeta):
            return self._along(beta, theta).residual(position, beta.value[:, None, :])
        method = self._at(np.asarray(position, dtype=np.float64).reshape(-1, *self.rest.shape), beta, theta, volume)
        return np.asarray(method.layout.get(method.residual, self.dim) * self.scale)

    def _at(self, position: FloatArray, beta: FloatArray | float, theta: FloatArray | float, volume: Volume) -> Newton:
        """Newton's method, evaluated at positions (B, K, d)."""
        _, beta_b, theta_b = self._candidates(position[:, self.held], beta, theta)
        _, size, how = self._kind(theta_b, max(len(position), len(beta_b)), volume)
        method: Newton = self._method(Newton, size, how)
        method.set(np.broadcast_to(beta_b, (size, *beta_b.shape[1:])), np.broadcast_to(theta_b, (size,)))
        method.layout.put(self._displacements(position), method.u)
        method.evaluate()
        return method

    def reaction(self, position: FloatArray, beta: FloatArray | float, theta: FloatArray | float = 0.0) -> FloatArray:
        """Force of each particle on its support, per unit of the body's stiffness k [m]: (B, K, d).

        It is the gradient of the energy: m_i (x_i - goal_i), summed over the particle's clusters. Volume is conserved
        by projection, since eq. 3.17 has no energy. At a static state the reaction is 0 at the free particles.
        position: (K, d) or (B, K, d)"""
        pull = self._unheld.residual(position, beta, theta, volume="project")
        return -pull * (self._particles.counts * self._particles.mass)[:, None]

    @functools.cached_property
    def _unheld(self) -> "Msm":
        """The same body with nothing held: there the goals of held particles are computed too."""
        return self.holding([]) if len(self.held) else self


class _Stepping:
    """Time steps of one state with fixed parameters. Each step's result takes the place of the displacements before, so
    that where steps are recorded they are so two at a time."""

    def __init__(
        self,
        body: Msm,
        state: Moving,
        held_u: FloatArray,
        beta: FloatArray,
        theta: FloatArray,
        volume: int,
        alpha: float,
        dt: float,
        acceleration: Sequence[float] | None,
    ) -> None:
        self.state, self.dt = state, dt
        operator, size = state.operator, state.layout.candidates
        push = np.zeros(body.dim) if acceleration is None else np.asarray(acceleration) / body.scale
        push = push * dt**2
        self.motion = state.kept((alpha, push.tobytes()), lambda: operator.motion(alpha, 1.0, push))
        going_on = dt / state.last_dt if state.last_dt else 1.0
        self.first = self.motion if dt == state.last_dt else operator.motion(alpha, going_on, push)
        beta = np.array(np.broadcast_to(beta, (size, *beta.shape[1:])))  # the caller's may change
        theta = np.array(np.broadcast_to(theta, (size,)))
        self.parameters = self._parameters(beta, theta, volume)
        held, self.places, now = state.held
        if len(body.held):
            if held is not body.held:
                layout = self.state.layout
                c = np.arange(layout.candidates)[:, None]
                places = layout.front + layout.group * (c // layout.abreast) + layout.place[body.held] * layout.abreast
                places += c % layout.abreast
                self.places, now = upload(places, int, layout.device), None
            if not np.array_equal(now, held_u):
                self._hold(held_u)
            state.held = body.held, self.places, held_u

    def _parameters(self, beta: FloatArray, theta: FloatArray, volume: int) -> Parameters:
        """Those of the last call that are on the device, with the values of this one."""
        state, operator, layout = self.state, self.state.operator, self.state.layout
        stride = operator.beta_stride if beta.ndim > 1 else 0
        values: Any = operator.cluster_values if stride else layout.each
        found, last = state.kept(
            (stride, volume),
            lambda: (Parameters(values(beta), layout.each(theta), stride, volume), {"beta": beta, "theta": theta}),
        )
        if not (np.array_equal(last["beta"], beta) and np.array_equal(last["theta"], theta)):
            found.beta.assign(values(beta))
            found.theta.assign(layout.each(theta))
            last.update(beta=beta, theta=theta)
        return found  # type: ignore[no-any-return]

    def _hold(self, held_u: FloatArray) -> None:
        """Put the held displacements (B, h, d), in particle spacings, into the state now and before."""
        state, layout, operator = self.state, self.state.layout, self.state.operator
        kernels = (
            operator.resident if operator.threads else newton_kernels_for(operator.dim, layout.scalar, layout.width)
        )
        held_u = np.broadcast_to(held_u, (layout.candidates, *held_u.shape[1:]))
        values = upload(held_u.reshape(-1, held_u.shape[2]).T, layout.scalar, layout.device)
        inputs, outputs = [self.places, values, layout.stride], [state.u, state.before]
        wp.launch(kernels.put_at, len(self.places), inputs, outputs, device=layout.device)

    def run_moving(self, steps: int, before: FloatArray, after: FloatArray) -> None:
        """The next `steps` steps, on which the held particles' displacements go from `before` to `after`, (B, h, d)."""
        if self.places is None:
            self.run(steps)
            return
        moves = min(steps, MOVES)
        for move in range(moves):
            self._hold(before + (move + 1) / moves * (after - before))
            self.run(steps * (move + 1) // moves - steps * move // moves)
        self.state.held = (*self.state.held[:2], None)

    def run(self, steps: int) -> None:
        """The next `steps` steps."""
        if steps > 0:
            self.state.last_dt = self.dt
            self._run(self.first, 1 if self.first is not self.motion else steps)
            self._run(self.motion, steps - 1 if self.first is not self.motion else 0)
            self.first = self.motion

    def _run(self, motion: object, steps: int) -> None:
        state, operator = self.state, self.state.operator
        if operator.threads and steps:
            operator.stay_stepping(state.pair, state.swapped, motion, self.parameters, steps, state.ran_away)
            state.swapped ^= bool(steps % 2)
            return
        if steps and operator.looks_ahead:
            graph, _in_use = state.kept(
                ("ahead", id(motion), state.swapped), lambda: (self._recorded(self._look_ahead, motion), motion)
            )
            wp.capture_launch(graph)
        if steps > 1:
            key = id(motion), id(self.parameters), state.swapped
            graph, *_in_use = state.kept(key, lambda: (self._recorded(self._two, motion), motion, self.parameters))
            for _ in range(steps // 2):
                wp.capture_launch(graph)
        if steps % 2:
            self._one(motion)

    def _recorded(self, launches: Callable[[object], None], motion: object) -> Any:
        with wp.ScopedCapture(device=self.state.layout.device) as capture:
            launches(motion)
        return capture.graph

    def _look_ahead(self, motion: object) -> None:
        self.state.operator.look_ahead(self.state, motion)

    def _two(self, motion: object) -> None:
        self._one(motion)
        self._one(motion)

    def _one(self, motion: object) -> None:
        state = self.state
        state.operator.step(state, motion, self.parameters)
        state.swapped = not state.swapped


def _most_iterations(particle_count: int) -> int:
    return max(4000, 40 * particle_count)


def pick_device(choice: Literal["auto", "cpu", "cuda"]) -> str:
    """The warp device for a choice; `auto` is the GPU where there is one."""
    if choice == "cpu" or (choice == "auto" and not wp.is_cuda_available()):
        return "cpu"
    if not wp.is_cuda_available():
        raise InputError("a CUDA device", "none that warp can use on this machine", "--device cpu")
    return "cuda:0"
