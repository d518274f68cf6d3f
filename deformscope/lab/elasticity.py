"""Small-strain linear elasticity of a box on hexahedra: a foam with a held part and a moved part.

    slab = ElasticBox(x, y, z, young=40e3, poisson=0.3)            # three axes of element corners [m]
    bottom, punch = slab.plane(2, z[0]), slab.plane(2, z[-1]) & (np.abs(slab.nodes[:, :2]) <= 0.01).all(axis=1)
    held = np.zeros((len(slab.nodes), 3), dtype=bool)
    held[bottom | punch] = True                                    # bonded; held[punch, 2] = True is without friction
    moved = np.zeros(held.shape)
    moved[punch, 2] = -0.004
    found = slab.hold(held).solve(moved)
    found.force[punch].sum(axis=0)                                 # what the punch exerts on the foam [N]
    slab.sample(found.displacement, points)                        # (n, 3) displacement anywhere inside [m]

scikit-fem gives mesh, shape functions and quadrature. Its assembly visits every pair of an element's unknowns
separately; here one matrix product per element does (0.2 s instead of 20 s for 2000 elements).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg, splu
from skfem import Basis, ElementHex1, ElementHex2, ElementHexS2, MeshHex

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError

Element = Literal["serendipity", "quadratic", "trilinear"]
PerElement = float | FloatArray | Callable[[FloatArray], FloatArray]
"""One number, one for each element (E,), or a function of the elements' centres (E, 3) that gives them."""

ELEMENTS: dict[Element, Any] = {"serendipity": ElementHexS2, "quadratic": ElementHex2, "trilinear": ElementHex1}

MOST_FACTORISED = 40_000
"""Number of unknowns up to which the equations are factorised (2 s, and 0.03 s for each right-hand side). Beyond,
conjugate gradients are faster: 100 000 unknowns of a slab take 3 s at nu = 0.3 and 8 s at 0.49, against 18 s."""

LEAF = 10
"""Number of nodes that nested dissection does not divide further."""

SOLVED_TO = 1e-10
"""Residual at which conjugate gradients stop, as a share of the right-hand side."""


@dataclass(frozen=True, slots=True)
class Solved:
    """A static state. displacement: (N, 3) displacement of every node [m]; force: (N, 3) force of the support on each
    node [N], zero at free nodes. Several displacements solved at once have a leading axis."""

    displacement: FloatArray
    force: FloatArray


class ElasticBox:
    """A box of hexahedra, linear elastic and isotropic.

    x, y, z: rising coordinates of the elements' corners along each axis [m], evenly spaced or not
    young: Young's modulus [Pa]; poisson: Poisson's ratio, 0 to below 0.5; both `PerElement`
    element: "serendipity" (20 nodes) and "quadratic" (27) do not lock when nearly incompressible, "trilinear" (8) does

    nodes: (N, 3) positions at rest of corners, and of the middles of edges, faces and elements where the element has
    nodes there [m]; corners: (nx ny nz,) nodes at corners, without those between them, last axis fastest; centres: (E,
    3) centres of the elements"""

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        z: FloatArray,
        *,
        young: PerElement,
        poisson: PerElement,
        element: Element = "serendipity",
    ) -> None:
        self.axes = tuple(np.asarray(axis, dtype=np.float64) for axis in (x, y, z))
        for axis in self.axes:
            if axis.ndim != 1 or axis.size < 2 or not (np.diff(axis) > 0.0).all():
                raise InputError("axes of two or more rising coordinates", str(axis.tolist())[:60])
        mesh = MeshHex.init_tensor(*self.axes)
        self._basis = Basis(mesh, ELEMENTS[element](), intorder=2 if element == "trilinear" else 4)
        self.nodes: FloatArray = np.ascontiguousarray(self._basis.doflocs.T)
        self.centres: FloatArray = mesh.p[:, mesh.t].mean(axis=1).T
        self.tolerance = 1e-6 * min(float(np.diff(axis).min()) for axis in self.axes)
        self._cell = np.empty([axis.size - 1 for axis in self.axes], dtype=np.int64)
        self._cell[self._cell_index(self.centres)] = np.arange(len(self.centres))
        grid = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, 3)
        place = self._basis.nodal_dofs[0]
        order, wanted = (np.lexsort(self._whole(points).T[::-1]) for points in (mesh.p.T, grid))
        self.corners: IntArray = np.empty(len(grid), dtype=np.int64)
        self.corners[wanted] = place[order]
        modulus, ratio = (self._per_element(value) for value in (young, poisson))
        if not ((modulus > 0.0).all() and np.isfinite(modulus).all()):
            raise InputError("a Young's modulus above 0", f"{modulus.min():g}")
        if not ((ratio >= 0.0) & (ratio < 0.5)).all():
            raise InputError("a Poisson's ratio from 0 to below 0.5", f"{ratio.min():g} to {ratio.max():g}")
        self.stiffness = stiffness_of(self._basis, modulus, ratio)

    def plane(self, axis: int, value: float) -> BoolArray:
        """(N,) the nodes whose coordinate along `axis` (0, 1, 2) is `value` [m]."""
        return np.asarray(np.abs(self.nodes[:, axis] - value) <= self.tolerance)

    def hold(self, held: BoolArray) -> "HeldBox":
        """The box with prescribed displacements where `held` (N, 3) is true; it can be solved for any values of
        them."""
        return HeldBox(self, held)

    def sample(self, displacement: FloatArray, points: FloatArray) -> FloatArray:
        """Displacement of material points inside, by the elements' shape functions. displacement: (N, 3) or (B, N, 3)
        [m]; points: (n, 3) at rest [m]; gives (n, 3) or (B, n, 3)"""
        points = np.asarray(points, dtype=np.float64)
        cell = self._cell[self._cell_index(points)]
        zero = np.zeros((3, 1))
        origin = self._basis.mapping.F(zero)[:, cell, 0]
        local = np.einsum("ijn,jn->in", self._basis.mapping.invDF(zero)[:, :, cell, 0], points.T - origin)
        found = np.zeros((*displacement.shape[:-2], len(points), 3))
        for number, nodes in enumerate(self._basis.element_dofs[:, cell]):
            value = self._basis.elem.lbasis(np.clip(local, 0.0, 1.0), number)[0]
            found += value[:, None] * displacement[..., nodes, :]
        return found

    def _cell_index(self, points: FloatArray) -> tuple[IntArray, ...]:
        """The element of each point (n, 3) along each axis."""
        index = []
        for axis, value in zip(self.axes, points.T, strict=True):
            if value.size and (value.min() < axis[0] - self.tolerance or value.max() > axis[-1] + self.tolerance):
                raise InputError(f"points within {axis[0]:g} to {axis[-1]:g}", f"{value.min():g} to {value.max():g}")
            index.append(np.clip(np.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2))
        return tuple(index)

    def _whole(self, points: FloatArray) -> IntArray:
        """Coordinates (n, 3) as whole numbers, so that rounding does not sort them."""
        whole: IntArray = np.rint((points - [axis[0] for axis in self.axes]) / self.tolerance).astype(np.int64)
        return whole

    def _per_element(self, value: PerElement) -> FloatArray:
        """(elements,) one number for each element."""
        given = np.asarray(value(self.centres) if callable(value) else value, dtype=np.float64)
        if given.ndim and given.shape != (len(self.centres),):
            raise InputError(f"one number, or {len(self.centres)}, one per element", str(given.shape))
        return np.broadcast_to(given, (len(self.centres),))


class HeldBox:
    """A box with some displacements prescribed, ready to be solved for any values of them (`ElasticBox.hold`)."""

    def __init__(self, box: ElasticBox, held: BoolArray) -> None:
        held = np.asarray(held, dtype=bool)
        if held.shape != box.nodes.shape:
            raise InputError(f"held of shape {box.nodes.shape}, one entry per node and component", str(held.shape))
        place = (box.nodes - box.nodes.mean(axis=0)) / float(np.ptp(box.nodes, axis=0).max())
        turns = np.stack([np.cross(axis, place) for axis in np.eye(3)], axis=-1)  # small ones; and translations
        if np.linalg.matrix_rank(np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=-1)[held]) < 6:
            raise InputError("a box held against every rigid motion", "one that is free to move", "hold more nodes")
        self.box, self.held = box, held
        self._free = np.flatnonzero(~held.ravel())
        self._free = self._free[dissected(box.nodes[self._free // 3], box.axes)]
        own = box.stiffness[self._free]
        self._coupling = own[:, np.flatnonzero(held.ravel())]
        self._own = own[:, self._free]
        self._factors = None
        if 0 < len(self._free) <= MOST_FACTORISED:
            # already in an order of little fill-in, and positive definite, so that no row is exchanged
            options = {"SymmetricMode": True}
            self._factors = splu(self._own.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options=options)

    def solve(self, displacement: FloatArray, load: FloatArray | None = None) -> Solved:
        """The static state. displacement: (N, 3) or (B, N, 3) [m], read where `held`; load: (N, 3) forces on the nodes
        that are free [N]"""
        displacement = np.asarray(displacement, dtype=np.float64)
        single = displacement.ndim == 2
        every = displacement.reshape(-1, self.held.size)
        given = np.where(self.held.ravel(), every, 0.0)
        right = -(self._coupling @ given[:, self.held.ravel()].T)
        if load is not None:
            right += np.where(self.held, 0.0, load).ravel()[self._free, None]
        given[:, self._free] = self._solve(right).T
        force = (self.box.stiffness @ given.T).T
        if load is not None:
            force -= np.where(self.held, 0.0, load).ravel()
        force[:, self._free] = 0.0
        shape = self.held.shape if single else (-1, *self.held.shape)
        return Solved(given.reshape(shape), force.reshape(shape))

    def _solve(self, right: FloatArray) -> FloatArray:
        """(n, k) solutions of the free unknowns for right-hand sides (n, k)."""
        if not len(self._free):
            return right
        if self._factors is not None:
            return np.asarray(self._factors.solve(np.ascontiguousarray(right)))
        diagonal = self._own.diagonal()
        jacobi = LinearOperator(self._own.shape, matvec=lambda r: np.ravel(r) / diagonal)
        columns = []
        for one in right.T:
            solved, failed = cg(self._own, one, rtol=SOLVED_TO, maxiter=20_000, M=jacobi)
            if failed:
                raise InputError(
                    "elastic equations that can be solved", "no convergence", "a coarser or less thin mesh"
                )
            columns.append(solved)
        return np.stack(columns, axis=1)


def stiffness_of(basis: Basis, young: FloatArray, poisson: FloatArray) -> csr_array:
    """K of 3 N unknowns, node by node: the integral of lambda tr(e) tr(e') + 2 mu e : e'. basis: scalar elements with N
    nodes; young, poisson: (E,) Young's modulus and Poisson's ratio of each element, [Pa] and a ratio"""
    lame = (young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)))[:, None, None, None, None]
    shear = (0.5 * young / (1.0 + poisson))[:, None, None, None, None]
    weight = basis.dx
    count, at = weight.shape
    functions = len(basis.basis)
    slope = np.empty((count, at, functions, 3))
    for number, (function, *_) in enumerate(basis.basis):
        slope[:, :, number] = np.moveaxis(np.broadcast_to(function.grad, (3, count, at)), 0, -1)
    slope = slope.reshape(count, at, 3 * functions)
    product = np.swapaxes(slope * weight[:, :, None], 1, 2) @ slope
    product = product.reshape(count, functions, 3, functions, 3)  # of d_i a and d_j b
    local = lame * product + shear * np.swapaxes(product, 2, 4)
    trace = np.einsum("eaibi->eab", product) * shear[:, :, :, 0, 0]
    for i in range(3):
        local[:, :, i, :, i] += trace
    place = (3 * basis.element_dofs.T[:, :, None] + np.arange(3)).reshape(count, -1).astype(np.int32)
    row, column = np.broadcast_arrays(place[:, :, None], place[:, None, :])
    size = 3 * basis.N
    return csr_array((local.ravel(), (row.ravel(), column.ravel())), shape=(size, size))


def dissected(nodes: FloatArray, axes: tuple[FloatArray, ...]) -> IntArray:
    """An order of unknowns with little fill-in: nested dissection by planes of the mesh (George 1973).

    nodes: (n, 3) node of each unknown. Elements do not cross a plane of corners, so that both sides of a plane depend
    on each other only through its nodes."""
    apart = 1e-6 * min(float(np.diff(axis).min()) for axis in axes)
    # an odd number for a plane of corners, an even one between two: however wide, elements count alike
    pairs = zip(axes, nodes.T, strict=True)
    plane = np.column_stack([np.searchsorted(axis, x - apart) + np.searchsorted(axis, x + apart) for axis, x in pairs])

    def parted(some: IntArray) -> list[IntArray]:
        """The nodes at indices (n,) in the order of elimination: parts on both sides of a plane of nodes, then that
        plane."""
        low, high = plane[some].min(axis=0, initial=plane.max(initial=0)), plane[some].max(axis=0, initial=0)
        d = int(np.argmax(high - low))
        cut = (low[d] + high[d]) // 2 | 1
        if len(some) <= 3 * LEAF or not low[d] < cut < high[d]:
            return [some]
        along = plane[some, d]
        return [*parted(some[along < cut]), *parted(some[along > cut]), some[along == cut]]

    return np.concatenate(parted(np.arange(len(nodes))))
