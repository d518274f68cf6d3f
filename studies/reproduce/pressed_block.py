"""A foam block under a flat clamp by finite elements at large strain, in the plane.

Nine-node quadrilaterals (quadratic: they do not lock), plane strain; the equilibrium is that of
`deformscope.lab.plateau_world`. The block is bonded to the ground; the clamp moves straight down and the foam under it
does not slip; the rest of the surface and both sides are free. Left and right mirror each other, so the right half is
computed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, LinearForm, MeshQuad, condense, solve
from skfem.element import DiscreteField
from skfem.helpers import grad

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.lab.plateau_world import LargeStrain, OgdenFoam, stress_and_tangent


@dataclass(frozen=True, slots=True)
class Block:
    """A rectangular block: width along x, height along y (up from the ground), thickness out of the plane [m]."""

    width_m: float
    height_m: float
    thickness_m: float


@dataclass(frozen=True, slots=True)
class PressedBlock:
    """The block at one depth of the clamp.

    force_n: force with which the clamp pushes down [N]; ground_n: force with which the ground pushes up
    nodes: (n, 2) rest positions [m] of the right half's nodes, x from the middle, y from the ground;
    displacement: (n, 2) [m]"""

    depth_m: float
    force_n: float
    ground_n: float
    nodes: FloatArray
    displacement: FloatArray
    interpolate: Callable[[FloatArray], FloatArray]

    def at(self, rest: FloatArray) -> FloatArray:
        """Displacement (k, 2) [m] at rest positions (k, 2) anywhere in the block."""
        side = np.where(rest[:, 0] < 0.0, -1.0, 1.0)
        moved = self.interpolate(np.column_stack([np.abs(rest[:, 0]), rest[:, 1]]))
        return np.asarray(moved * np.column_stack([side, np.ones(len(rest))]))


def press(
    law: OgdenFoam, block: Block, clamp_m: float, depths_m: Sequence[float], element_m: float = 0.005
) -> list[PressedBlock]:
    """Press the block to each of the rising depths of a clamp that is `clamp_m` wide and on its middle. element_m: size
    of the elements below the clamp; far from it they are twice as large"""
    if not (0.0 < clamp_m <= block.width_m and len(depths_m) and min(np.diff([0.0, *depths_m])) > 0.0):
        raise InputError("a clamp no wider than the block, and depths that rise from 0", f"{clamp_m:g} m, {depths_m}")
    half = _Half(law, block, clamp_m, element_m)
    found = []
    state, reached = half.basis.zeros(), 0.0
    for depth in depths_m:
        state = half.push(state, reached, depth)
        reached = depth
        found.append(half.result(state, depth))
    return found


class _Half(LargeStrain):
    """The right half of the block, meshed, with its boundary conditions."""

    def __init__(self, law: OgdenFoam, block: Block, clamp_m: float, element_m: float) -> None:
        self.law = law
        self.thickness = 2.0 * block.thickness_m  # both halves
        x = _graded(0.5 * clamp_m, 0.5 * block.width_m, element_m)
        y = np.linspace(0.0, block.height_m, max(2, round(block.height_m / element_m)) + 1)
        element = ElementQuad2()
        mesh = MeshQuad.init_tensor(x, y)
        self.basis: Any = Basis(mesh, ElementVector(element), intorder=4)
        self.scalar: Any = self.basis.with_element(element)
        near = 1e-9 * block.height_m
        place = self.basis.doflocs
        axis = np.zeros(self.basis.N, dtype=int)
        axis[1::2] = 1  # both displacements of a node are next to each other
        self.axis = axis
        bottom = place[1] < near
        self.clamped = (place[1] > block.height_m - near) & (place[0] < 0.5 * clamp_m + near)
        middle = (place[0] < near) & (axis == 0)
        self.bottom = bottom
        self.prescribed: IntArray = np.flatnonzero(bottom | self.clamped | middle)
        self.pushed: IntArray = np.flatnonzero(self.clamped & (axis == 1))
        self.free: IntArray = self.basis.complement_dofs(self.prescribed)

    def _begin(self, state: FloatArray, reached: float, depth: float) -> FloatArray:
        """The state (n,) [m] with the clamp moved to a depth [m], and the rest along with it as the tangent says."""
        force, tangent = self._assemble(state)
        step = np.zeros_like(state)
        step[self.pushed] = -depth - state[self.pushed]
        return np.asarray(state + solve(*condense(tangent, -force, x=step, D=self.prescribed)))

    def _gradient(self, state: FloatArray) -> FloatArray:
        """Deformation gradients (2, 2, elements, points)."""
        moved: FloatArray = self.basis.interpolate(state).grad
        return moved + np.eye(2)[:, :, None, None]

    def _smallest_volume(self, state: FloatArray) -> float:
        f = self._gradient(state)
        return float((f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]).min())

    def _energy(self, state: FloatArray) -> float:
        stretch = np.linalg.svd(np.moveaxis(self._gradient(state), (0, 1), (2, 3)), compute_uv=False)
        return float((self.law.energy(np.moveaxis(stretch, -1, 0)) * self.basis.dx).sum())

    def _assemble(self, state: FloatArray) -> tuple[FloatArray, Any]:
        """Internal forces (N,) [N/m of thickness] and their derivative."""
        f = np.moveaxis(self._gradient(state), (0, 1), (2, 3))
        stress, tangent = stress_and_tangent(self.law, f.reshape(-1, 2, 2))
        stress = np.moveaxis(stress.reshape(f.shape), (2, 3), (0, 1))
        tangent = np.moveaxis(tangent.reshape(*f.shape, 2, 2), (0, 1), (-2, -1))
        return _INNER_FORCE.assemble(self.basis, stress=stress), _STIFFNESS.assemble(self.basis, tangent=tangent)

    def result(self, state: FloatArray, depth: float) -> PressedBlock:
        """Forces [N] and displacements of a state (2 n,) [m] at a depth [m]."""
        force, _ = self._assemble(state)
        vertical = self.axis == 1
        moved = state.reshape(-1, 2)

        def interpolate(rest: FloatArray) -> FloatArray:
            probe = self.scalar.probes(rest.T)
            return np.asarray(probe @ moved)

        return PressedBlock(
            depth_m=depth,
            force_n=-self.thickness * float(force[self.clamped & vertical].sum()),
            ground_n=self.thickness * float(force[self.bottom & vertical].sum()),
            nodes=np.asarray(self.scalar.doflocs.T),
            displacement=moved,
            interpolate=interpolate,
        )


def _inner_force(v: DiscreteField, w: Mapping[str, FloatArray]) -> Any:
    return np.einsum("ij...,ij...->...", w["stress"], grad(v))


def _stiffness(u: DiscreteField, v: DiscreteField, w: Mapping[str, FloatArray]) -> Any:
    return np.einsum("ij...,ijkl...,kl...->...", grad(v), w["tangent"], grad(u), optimize=True)


_INNER_FORCE, _STIFFNESS = LinearForm(_inner_force), BilinearForm(_stiffness)


def _graded(edge: float, end: float, size: float) -> FloatArray:
    """(n,) element borders from 0 to `end` with one at `edge` [m]: `size` as far as two edges out, then twice that."""
    inner = np.linspace(0.0, edge, max(2, round(edge / size)) + 1)
    turn = min(2.0 * edge, end)
    near = np.linspace(edge, turn, max(2, round((turn - edge) / size)) + 1)
    far = np.linspace(turn, end, max(1, round((end - turn) / (2.0 * size))) + 1) if turn < end else near[-1:]
    return np.unique(np.concatenate([inner, near, far]))
