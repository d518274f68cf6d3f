"""A slab that creeps: `SlabWorld` with a memory, in which all moduli relax by the same share.

    world = CreepingWorld(scene, Relaxation((0.3,), (1.0,)))
    world.at(0.01); world.press(tip, center_m)         # from rest, at a time [s]
    world.at(0.02); world.press(tip, center_m) # forces decay while the tip is at rest

The foam is a generalised Maxwell solid, E(t) = E0 (1 - sum g_i + sum g_i exp(-t / t_i)), with constant Poisson's ratio.
Then a touch depends only on the elastic stiffness K of the nodes that a tip may touch, and

    f = (1 - sum g_i) K u + sum_i q_i,      dq_i/dt = g_i K du/dt - q_i / t_i

holds for them exactly, those outside the tip included (their f is 0, and their dent recovers slowly). Over a step in
which u moves evenly this is f = A K u + h with a number A and a known h. Therefore each step is the complementarity
problem of an elastic press with compliance C / A.

Foam with a permanent share of every dent is pressed not from its rest but from its set: f = A K (u - u_p) + h, with u_p
at each node the same share of its greatest depth. On the approach the foam has a modulus that is lower by that share.
On the retract it has its full stiffness, and the tip leaves it at u_p.

Not modelled: foams of different relaxation within the reach of one touch (each touch creeps as the foam below the tip's
middle). The memory of a place is lost if the tip slides further than its mesh allows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.lab.scenes import Scene
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import Contact, Patch, SlabWorld


@dataclass(frozen=True, slots=True)
class Relaxation:
    """How a foam's modulus relaxes. shares: shares of the instantaneous modulus, by branch, together below 1; times_s:
    each branch's relaxation time; keeps: share of each dent that is permanent"""

    shares: tuple[float, ...] = ()
    times_s: tuple[float, ...] = ()
    keeps: float = 0.0

    def __post_init__(self) -> None:
        alike = len(self.shares) == len(self.times_s)
        if not (alike and min((*self.shares, *self.times_s, 1.0)) > 0.0 and sum(self.shares) < 1.0):
            raise InputError("shares above 0, together below 1, each with a time above 0 s", f"{self}")
        if not 0.0 <= self.keeps < 1.0:
            raise InputError("a permanent share of a dent, from 0 to below 1", f"{self.keeps}")

    @property
    def share(self) -> float:
        """Share of the modulus that relaxes, in all branches together."""
        return sum(self.shares)


class CreepingWorld(SlabWorld):
    """A scene's foam with a memory."""

    def __init__(self, scene: Scene, relaxation: Relaxation | Callable[[FloatArray], Relaxation]) -> None:
        """relaxation: relaxation of all foam, or of the foam at a place (2,) [m]"""
        super().__init__(scene)
        self._relaxation = relaxation if callable(relaxation) else lambda xy_m: relaxation
        self._now_s = 0.0
        self._step_s = 0.0
        self._memory: _Memory | None = None

    def at(self, time_s: float) -> None:
        """Set the time of the next press [s]. The last of several presses at one time counts. Without a press since the
        last time, nothing touched the foam."""
        if time_s < self._now_s:
            raise InputError("a time not before the last", f"{time_s:g} s after {self._now_s:g} s")
        if time_s > self._now_s:
            if self._memory is not None:
                self._memory.settle(self._step_s)
            self._step_s = time_s - self._now_s
            self._now_s = time_s

    def press(self, tip: RigidTip, center_m: FloatArray) -> Contact:
        """Like `SlabWorld.press`, center_m: (3,) [m]; the dent recovers when the tip has left the foam."""
        contact = super().press(tip, center_m)
        if contact.mesh_m is None and self._memory is not None:
            patch = self._memory.patch
            load_n = self._memory.moves_n(self._memory.untouched_n(self._step_s))
            node = np.flatnonzero(load_n)
            place = patch.candidate_m[node]
            return replace(contact, place_m=place, node_force_n=load_n[node], mesh_m=patch.xy_m, node=node)
        return contact

    def _push_out(self, patch: Patch, overlap: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._memory is None or self._memory.patch is not patch:
            self._memory = _Memory(patch, self._relaxation(patch.xy_m))
        return self._memory.press(overlap, self._step_s)


class _Memory:
    """Memory of one patch: the forces of its nodes without relaxation, K (u - u_p) (n,) [N]; each node's greatest depth
    and permanent part, u_p, (n,) [m]; K u_p [N]"""

    def __init__(self, patch: Patch, relaxation: Relaxation) -> None:
        self.patch = patch
        self._share, self._time_s = np.array(relaxation.shares), np.array(relaxation.times_s)
        self._elastic_n: FloatArray = np.zeros(len(patch.candidate_m))
        self._branch_n: FloatArray = np.zeros((len(self._share), len(patch.candidate_m)))
        self._next_n: FloatArray | None = None
        self._keeps = relaxation.keeps
        self._deepest_m, self._set_m, self._set_n = (np.zeros(len(patch.candidate_m)) for _ in range(3))
        self._compliance = cho_factor(patch.compliance) if self._keeps else None

    def press(self, overlap: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
        """(n,) forces after a step [N], and (n,) the elastic ones that move the surface as much."""
        stiff, known_n, _, _ = self._law(step_s)
        over = overlap - self._set_m + self.patch.compliance @ known_n / stiff
        force_n = self.patch.push_out(over, 1.0 / stiff)
        self._next_n = (force_n - known_n) / stiff
        return force_n, self.moves_n(self._next_n)

    def moves_n(self, elastic_n: FloatArray) -> FloatArray:
        """(n,) the forces that would move elastic foam equally, with its permanent set [N]."""
        return elastic_n + self._set_n

    def settle(self, step_s: float) -> None:
        """The step happens as it was pressed last, or with nothing on the foam."""
        _, _, left, even = self._law(step_s)
        next_n = self._next_n if self._next_n is not None else self.untouched_n(step_s)
        self._branch_n = left[:, None] * self._branch_n + (self._share * even)[:, None] * (next_n - self._elastic_n)
        self._elastic_n, self._next_n = next_n, None
        if self._compliance is not None:
            self._deepest_m = np.maximum(self._deepest_m, self.patch.compliance @ next_n + self._set_m)
            self._set_m = self._keeps * self._deepest_m
            self._set_n = cho_solve(self._compliance, self._set_m)

    def untouched_n(self, step_s: float) -> FloatArray:
        """(n,) the elastic forces after a step with nothing on the foam [N]."""
        stiff, known_n, _, _ = self._law(step_s)
        self._next_n = None
        return -known_n / stiff

    def _law(self, step_s: float) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """A and h (n,) of a step, each branch's remaining share over it, and its mean over it for a uniform load."""
        over = step_s / self._time_s
        left, even = np.exp(-over), np.where(over > 1e-9, -np.expm1(-over) / np.maximum(over, 1e-9), 1.0)
        stiff = float(1.0 - self._share.sum() + (self._share * even).sum())
        known_n = left @ self._branch_n - float((self._share * even).sum()) * self._elastic_n
        return stiff, known_n, left, even
