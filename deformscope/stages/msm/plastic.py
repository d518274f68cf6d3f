"""A body that yields: the quasi-static states of a history of loads."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.stages.msm.materials import Plasticity
from deformscope.stages.msm.newton_functions import CONVERGED
from deformscope.stages.msm.reference import Volume
from deformscope.stages.msm.solver import TOLERANCE, Msm

ROUNDS = 200
"""Most rounds of flow and relaxation under one load."""


@dataclass(frozen=True, slots=True)
class Loaded:
    """Static states of B candidates under a load, after they have flown.

    position: (B, K, d) [m]; strain: (B, C) |S - I|_2 of each cluster when the load came, before any flow
    flowed: (B,) whether any cluster flowed under this load; converged: (B,) position is static for its S^p, and with an
    unlimited duration nothing flows any more; rounds: rounds of flow and relaxation"""

    position: FloatArray
    strain: FloatArray
    flowed: BoolArray
    converged: BoolArray
    rounds: int


class PlasticMsm:
    """B candidates of a body whose clusters yield (see `materials`), with their plastic deformations.

    body: any clusters and basis; it runs by index lists; size: B; law: law of plasticity, whose numbers can differ
    between candidates"""

    def __init__(self, body: Msm, law: Plasticity, size: int = 1) -> None:
        self.body = body.variant(plastic=True)
        self._bodies = {self.body.held.tobytes(): self.body}
        self.size = size
        self.law = law
        self._yield, self._creep, self._maximum = (
            np.broadcast_to(np.asarray(each, dtype=np.float64), (size,))
            for each in (law.yield_strain, law.creep, law.maximum)
        )
        self._plastic = np.broadcast_to(np.eye(body.dim), (size, body.cluster_count, body.dim, body.dim)).copy()
        self._position: FloatArray = np.broadcast_to(body.rest, (size, *body.rest.shape)).copy()

    @property
    def plastic(self) -> FloatArray:
        """S^p of every cluster, (B, C, d, d)."""
        return self._plastic.copy()

    def hold(self, held: IntArray | Sequence[int]) -> None:
        """Prescribe other particles from now on, as where a tool comes and goes: their indices (n,)."""
        key = np.asarray(held, dtype=np.int64).reshape(-1)
        if key.tobytes() not in self._bodies:
            self._bodies[key.tobytes()] = self.body.holding(key)
        self.body = self._bodies[key.tobytes()]

    def load(
        self,
        held_position: FloatArray,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "project",
        duration: float | None = None,
        settled: float = 1e-3,
        tolerance: float | None = None,
    ) -> Loaded:
        """The static states under a load that is held, from where the candidates are.

        duration: None = until the body rests. S^p flows, in each cluster just until its strain is the yield strain (or
        as close as det S^p = 1 allows), and the body relaxes. It ends when nothing flows by more than `settled` times
        the yield strain. Creep does not matter then. With a duration [s], S^p flows once by duration * creep of S - I,
        but not past the yield strain, and the body relaxes.

        held_position: (n, d) or (B, n, d) [m]; beta, theta, volume, tolerance: as in `Msm.relax`"""
        body, dim = self.body, self.body.dim
        if not body.free.any():
            raise ValueError("expected free particles; got a body whose particles are all held")
        held_u, beta_b, theta_b = self._parameters(held_position, beta, theta)
        method = body._method(*body._kind(theta_b, self.size, volume))
        method.set(beta_b, theta_b)
        operator = method.operator
        operator.put_plastic(self._plastic)
        share = np.ones(self.size) if duration is None else np.minimum(duration * self._creep, 1.0)
        operator.set_law(self._yield, share, self._maximum)
        u = body._displacements(self._position)
        u[:, body.held] = held_u
        limit = (TOLERANCE[body.precision] if tolerance is None else tolerance) * body.extent / body.scale
        most = max(4000, 40 * len(body.rest))
        ended = method.relax(u, limit, most)
        strain = np.zeros((self.size, body.cluster_count))
        flowed = np.zeros(self.size, dtype=bool)
        still = np.zeros(self.size, dtype=bool)
        rounds = 0
        for rounds in range(1, ROUNDS + 1):
            operator.flow(method.u)
            moved, before = operator.flowed()
            if rounds == 1:
                strain = before.copy()
            most_moved = moved.max(axis=1)
            flowed |= most_moved > 0.0
            still = most_moved <= settled * self._yield
            if not (most_moved > 0.0).any():
                break
            ended = method.relax(method.layout.get(method.u, dim), limit, most)
            if duration is not None or still.all():
                break
        self._plastic = operator.plastic()
        self._position = body.rest + method.layout.get(method.u, dim) * body.scale
        static = np.asarray(ended.state == CONVERGED)
        return Loaded(self._position.copy(), strain, flowed, static if duration is not None else static & still, rounds)

    def residual(
        self,
        position: FloatArray,
        beta: FloatArray | float,
        theta: FloatArray | float = 0.0,
        *,
        volume: Volume = "project",
        plastic: FloatArray | None = None,
    ) -> FloatArray:
        """goals(x) - x at positions (K, d) or (B, K, d), (B, K, d).

        plastic: S^p (C, d, d) or (B, C, d, d); default: this model's S^p.
        Its negative, times particle mass and cluster count, is the force on each particle per unit of stiffness."""
        body = self.body
        at = np.broadcast_to(np.asarray(position, dtype=np.float64), self._position.shape)
        _, beta_b, theta_b = self._parameters(at[:, body.held], beta, theta)
        kind, size, how = body._kind(theta_b, self.size, volume)
        method = body._method(kind, size, how)
        method.set(beta_b, theta_b)
        own = self._plastic if plastic is None else np.broadcast_to(plastic, self._plastic.shape)
        method.operator.put_plastic(own)
        method.put(body._displacements(at))
        method.evaluate()
        return np.asarray(method.layout.get(method.residual, body.dim) * body.scale)

    def start(self, position: FloatArray) -> None:
        """Put the particles at `position` (K, d) or (B, K, d); S^p is unchanged."""
        self._position = np.broadcast_to(position, self._position.shape).copy()

    def _parameters(
        self, held_position: FloatArray, beta: FloatArray | float, theta: FloatArray | float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Held displacements (B, h, d) in particle spacings, beta (B, ...) and theta (B,)."""
        held_u, beta_b, theta_b = self.body._candidates(held_position, beta, theta)
        if len(beta_b) not in (1, self.size):
            raise ValueError(f"expected {self.size} candidates, or one for all; got {len(beta_b)}")
        return held_u, np.broadcast_to(beta_b, (self.size, *beta_b.shape[1:])), np.broadcast_to(theta_b, (self.size,))
