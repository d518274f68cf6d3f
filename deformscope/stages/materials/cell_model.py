"""Small deformations of a body whose stiffness differs from cell to cell, and their derivatives by each cell's.

The particles of a lattice are the corners of its cells, squares in the plane or cubes in space. The body's energy is
quadratic in the displacements u, with one factor exp(p) for each cell c:

    E = 1/2 u^T K u,    K = K_0 + sum_c exp(p_c) K_c

"elastic": K_c is the bilinear finite element of modulus 1 (plane stress in the plane), K_0 = 0, and p is the logarithm
of the modulus. The material may be stiffer along one direction, the same in all cells. "beta": the model's own energy
of 2^d clusters (design: sum of (1 - beta) E_rigid + beta E_affine). For small deformations the rigid part is that of
the strain e in addition to the affine part, (1 - beta) |e q|^2 + the squared residual of the best linear map. K_c is
the strain's, K_0 the resistance of a cell to other than linear deformations, p = log(1 - beta)."""

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError

Law = Literal["elastic", "beta"]

GAUSS = 0.5 / np.sqrt(3.0)
"""Distance of the quadrature's points from a cell's middle [cells]."""

NU_STEP = 1e-4
"""Steps of Poisson's ratio, and of the anisotropy's parameters, for the derivatives."""


def lattice_cells(shape: tuple[int, ...], cell: IntArray) -> IntArray:
    """(C, 2^d) particles at the corners of each cell that has all of them. cell: (K,) place of each
    particle in a lattice of `shape`"""
    index = np.full(int(np.prod(shape)), -1)
    index[cell] = np.arange(len(cell))
    grid, offsets = index.reshape(shape), product((0, 1), repeat=len(shape))
    parts = [tuple(slice(o, n - 1 + o) for o, n in zip(offset, shape, strict=True)) for offset in offsets]
    found = np.stack([grid[part].ravel() for part in parts], axis=1)
    return np.asarray(found[(found >= 0).all(axis=1)])


def elastic_cells(corner: FloatArray, nu: float, bent: FloatArray | None = None) -> FloatArray:
    """(C, m d, m d) stiffness of bilinear cells of modulus 1. corner: (C, m, d), m = 2^d; nu, bent: `elasticity`"""
    d = corner.shape[2]
    offset = np.array(list(product((-0.5, 0.5), repeat=d)))
    law = elasticity(d, nu, bent)
    total = np.zeros((len(corner), corner.shape[1] * d, corner.shape[1] * d))
    for point in offset * (2.0 * GAUSS):
        factor = 0.5 + 2.0 * offset * point  # (m, d) of each corner's shape function, along each axis
        local = np.stack([2.0 * offset[:, k] * np.prod(np.delete(factor, k, axis=1), axis=1) for k in range(d)], axis=1)
        jacobian = np.einsum("mi,cmj->cij", local, corner)
        gradient = np.einsum("mi,cji->cmj", local, np.linalg.inv(jacobian))
        strain = _strain(gradient)
        volume = np.abs(np.linalg.det(jacobian)) / len(offset)
        total += np.einsum("csa,st,ctb,c->cab", strain, law, strain, volume)
    return total


def beta_cells(corner: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(C, m d, m d) twice: of the strain, times 1 - beta, and of the residual of the best linear map. corner: (C, m,
    d)"""
    count, m, d = corner.shape
    q = corner - corner.mean(axis=1, keepdims=True)
    moment = np.einsum("cmi,cmj->cij", q, q)
    slope = np.einsum("cmi,cij->cmj", q, np.linalg.inv(moment))  # F - 1 = sum_m u_m slope_m^T
    change = np.zeros((count, m, d, m, d))  # e q of each particle by each displacement
    for k, j in product(range(d), repeat=2):
        symmetric = 0.5 * np.einsum("cn,cm->cmn", slope[:, :, j], q[:, :, j])
        change[:, :, k, :, k] += symmetric
        change[:, :, k, :, j] += 0.5 * np.einsum("cn,cm->cmn", slope[:, :, k], q[:, :, j])
    flat = change.reshape(count, m * d, m * d)
    strain = np.einsum("cka,ckb->cab", flat, flat)
    linear = np.einsum("cmi,cni->cmn", q, slope) + 1.0 / m
    left = np.einsum("cmn,ij->cminj", np.eye(m) - linear, np.eye(d)).reshape(count, m * d, m * d)
    return strain, np.einsum("cka,ckb->cab", left, left)


def elasticity(d: int, nu: float, bent: FloatArray | None = None) -> FloatArray:
    """(3, 3) or (6, 6) stresses of strains (engineering shear) at Young's modulus 1; plane stress for d = 2.

    bent: (m,) upper triangle of a symmetric matrix that is added to the law's logarithm, in a basis in which turning
    the axes is a rotation (Mandel: shear times sqrt 2). The material is anisotropic, and positive definite for any
    numbers"""
    if d == 2:
        law = np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]]) / (1.0 - nu**2)
    else:
        shear = 0.5 / (1.0 + nu)
        law = np.zeros((6, 6))
        law[:3, :3] = nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        law += np.diag([2.0 * shear] * 3 + [shear] * 3)
    if bent is None:
        return law
    size = len(law)
    mandel = np.where(np.arange(size) < d, 1.0, np.sqrt(2.0))
    value, vector = np.linalg.eigh(law * np.outer(mandel, mandel))
    added = np.zeros((size, size))
    added[np.triu_indices(size)] = bent
    value, vector = np.linalg.eigh((vector * np.log(value)) @ vector.T + added + np.triu(added, 1).T)
    return np.asarray((vector * np.exp(value)) @ vector.T / np.outer(mandel, mandel))


def directional_modulus(law: FloatArray, along: FloatArray) -> FloatArray:
    """(n,) Young's modulus along directions (n, d) of unit length. law: as in `elasticity`"""
    d = along.shape[1]
    pairs = [(i, i) for i in range(d)] + [(i, j) for i in range(d) for j in range(i + 1, d)]
    stress = np.stack([along[:, i] * along[:, j] for i, j in pairs], axis=1)
    return np.asarray(1.0 / np.einsum("ns,st,nt->n", stress, np.linalg.inv(law), stress))


def _strain(gradient: FloatArray) -> FloatArray:
    """(C, s, m d) strains of displacements, shear last. gradient: (C, m, d) gradient of the shape functions"""
    count, m, d = gradient.shape
    pairs = [(i, j) for i in range(d) for j in range(i + 1, d)]
    strain = np.zeros((count, d + len(pairs), m, d))
    for i in range(d):
        strain[:, i, :, i] = gradient[:, :, i]
    for row, (i, j) in enumerate(pairs, start=d):
        strain[:, row, :, i], strain[:, row, :, j] = gradient[:, :, j], gradient[:, :, i]
    return strain.reshape(count, -1, m * d)


@dataclass(frozen=True, slots=True)
class CellState:
    """A static state. moved: (K, d); slope: (K d, C) derivative by each cell's p; by_nu: (K d,), zero for "beta"
    by_bent: (K d, m) derivative by the anisotropy's parameters, (K d, 0) without any
    response: (K d, n d) response of every displacement to the held ones; force: (K, d) force of the body's support"""

    moved: FloatArray
    slope: FloatArray
    by_nu: FloatArray
    by_bent: FloatArray
    response: FloatArray
    force: FloatArray


class CellModel:
    """A body of cells, some of whose particles are held. rest: (K, d); cells: (C, 2^d); held: (n,)"""

    def __init__(self, rest: FloatArray, cells: IntArray, held: IntArray, law: Law = "elastic") -> None:
        self.count, self.d = rest.shape
        self.law: Law = law
        spacing = float(np.median(np.linalg.norm(rest[cells[:, 1]] - rest[cells[:, 0]], axis=1)))
        self.corner = rest[cells] / spacing
        self.dof = (cells[:, :, None] * self.d + np.arange(self.d)).reshape(len(cells), -1)
        used = np.zeros(self.count, dtype=bool)
        used[cells] = True
        if not used.all():
            raise InputError("particles that are corners of whole cells", f"{int((~used).sum())} that are of none")
        self.fixed = (held[:, None] * self.d + np.arange(self.d)).ravel()
        self.free = np.setdiff1d(np.arange(rest.size), self.fixed)
        self._fixed_cells = beta_cells(self.corner) if law == "beta" else None

    def state(
        self, p: FloatArray, moved: FloatArray, nu: float = 0.3, bent: FloatArray | None = None, *, slopes: bool = True
    ) -> CellState:
        """Displacements and their derivatives. p: (C,); moved: (K, d), read where held; both at any scale; nu, bent:
        `elasticity`"""
        each = self._cells(nu, bent)
        base = 0.0 if self._fixed_cells is None else self._fixed_cells[1]
        rows = np.repeat(self.dof, self.dof.shape[1], axis=1).ravel()
        columns = np.tile(self.dof, (1, self.dof.shape[1])).ravel()
        values = (np.exp(p)[:, None, None] * each + base).ravel()
        whole = csc_array((values, (rows, columns)), shape=(self.count * self.d, self.count * self.d))
        factors = splu(whole[np.ix_(self.free, self.free)].tocsc())
        u = np.zeros(self.count * self.d)
        u[self.fixed] = moved.ravel()[self.fixed]
        coupling = whole[np.ix_(self.free, self.fixed)]
        u[self.free] = factors.solve(-(coupling @ u[self.fixed]))
        force = np.zeros(u.size)
        force[self.fixed] = (whole @ u)[self.fixed]
        none = np.zeros((0, 0))
        plain = CellState(u.reshape(-1, self.d), none, none, none, none, force.reshape(-1, self.d))
        if not slopes:
            return plain
        response = np.zeros((u.size, self.fixed.size))
        response[self.free] = factors.solve(-coupling.toarray())
        response[self.fixed, np.arange(self.fixed.size)] = 1.0
        loads = np.exp(p)[:, None] * np.einsum("cab,cb->ca", each, u[self.dof])
        each_load = np.zeros((u.size, len(loads)))
        each_load[self.dof, np.arange(len(loads))[:, None]] = loads
        slope = self._solved(factors, each_load)
        own = np.append(nu, [] if bent is None else bent)
        by_own: FloatArray = np.zeros((u.size, len(own)))
        if self.law == "elastic":
            load = np.zeros(by_own.shape)
            for at, step in enumerate(NU_STEP * np.eye(len(own))):
                ahead, behind = ((one[0], None if bent is None else one[1:]) for one in (own + step, own - step))
                change = (self._cells(*ahead) - self._cells(*behind)) / (2.0 * NU_STEP)
                np.add.at(load[:, at], self.dof, np.exp(p)[:, None] * np.einsum("cab,cb->ca", change, u[self.dof]))
            by_own = self._solved(factors, load)
        return replace(plain, slope=slope, by_nu=by_own[:, 0], by_bent=by_own[:, 1:], response=response)

    def _cells(self, nu: float, bent: FloatArray | None) -> FloatArray:
        """Stiffness of each cell's particles (C or 1, 2^d d, 2^d d) at modulus 1."""
        return elastic_cells(self.corner, nu, bent) if self._fixed_cells is None else self._fixed_cells[0]

    def _solved(self, factors: object, load: FloatArray) -> FloatArray:
        """Displacements (K d, ...) of loads (K d, ...) with factors of the free unknowns' matrix; 0 where held."""
        found = np.zeros(load.shape)
        found[self.free] = -factors.solve(load[self.free])  # type: ignore[attr-defined]
        return found
