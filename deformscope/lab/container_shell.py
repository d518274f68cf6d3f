"""The walls of a container: a finite element shell, factorised once for each kind of container, and its compliance for
loads.

Coordinates: s runs around the container (0 in the middle of the side at +x, growing towards +y), z upwards from the
bottom [m]. The container's own frame has its origin in the middle of the body, x along the squeeze, z upwards.

Elements are rectangles of class C1 (Bogner-Fox-Schmit), as products of one-dimensional cubic Hermite elements of
scikit-fem. Therefore every integral over the wall is a product of two integrals over lines. With w outwards, v along s
and u along z, the energy is Donnell's for shallow shells:

    1/2 int  D11 w_ss^2 + 2 D12 w_ss w_zz + D22 w_zz^2 + 4 D66 w_sz^2
           + A11 e_s^2 + 2 A12 e_s e_z + A22 e_z^2 + A66 g^2,     e_s = v_s + w / R, e_z = u_z, g = u_s + v_z

A box is four plates of it (1 / R = 0, where w alone is left), joined by slopes that continue around the corners. A
corner does not move, because the plate around it would have to stretch. A cylinder has all three fields. Bottom and lid
keep their rim round or square, and hinge there.

Not modelled: stiffening by large dents (von Karman), buckling, creases of a carton, creep; bottom and lid do not bend.
Instances of a kind differ by one factor on the whole stiffness (modulus times thickness cubed), so that one
factorisation serves them all."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from scipy.sparse import bmat, csr_array, kron
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementLineHermite, LinearForm, MeshLine
from skfem.element import DiscreteField

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.lab.container_constants import BOX_M, CARDBOARD, CYLINDER_M, PLASTIC, Wall

FINE_M, COARSE_M = 0.0075, 0.010
"""Sizes of elements where fingers press, and elsewhere along the height."""
FINE_HALF_M = 0.030
"""Range of the fingers' heights around the middle."""
PATCHES = (4, 4)
"""Number of patches along s and z on each pressed side, on which the filling acts."""
PATCH_HALF_M = 0.048
"""Distance that patches reach from the middle of the height."""


@dataclass(frozen=True, slots=True)
class ContainerShape:
    """A container's undeformed outer form, in its frame.

    kind; half_m: half its size along x, y, z [m] (a cylinder's radius twice); wall"""

    kind: Literal["box", "cylinder"]
    half_m: tuple[float, float, float]
    wall: Wall

    @property
    def perimeter_m(self) -> float:
        return 4.0 * (self.half_m[0] + self.half_m[1]) if self.kind == "box" else 2.0 * np.pi * self.half_m[0]

    @property
    def height_m(self) -> float:
        return 2.0 * self.half_m[2]

    @property
    def area_m2(self) -> float:
        """Area of the container's cross-section [m2]."""
        x, y, _ = self.half_m
        return 4.0 * x * y if self.kind == "box" else float(np.pi * x * x)

    @property
    def volume_m3(self) -> float:
        return self.area_m2 * self.height_m

    @property
    def wall_mass_kg(self) -> float:
        area = self.perimeter_m * self.height_m + 2.0 * self.area_m2
        return area * self.wall.thickness_m * self.wall.density_kg_m3

    def place(self, s_m: FloatArray, z_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (..., 3) of the wall and its outward normals there."""
        s_m, z_m = np.broadcast_arrays(np.asarray(s_m, np.float64), np.asarray(z_m, np.float64))
        x_m, y_m, half_z = self.half_m
        up = z_m - half_z
        none = np.zeros(s_m.shape)
        if self.kind == "cylinder":
            around = s_m / x_m
            normal = np.stack([np.cos(around), np.sin(around), none], axis=-1)
            return np.concatenate([x_m * normal[..., :2], up[..., None]], axis=-1), normal
        along = np.mod(s_m + y_m, self.perimeter_m) - y_m  # from -y on
        sides = [along < y_m, along < y_m + 2 * x_m, along < 3 * y_m + 2 * x_m]
        middle = 2.0 * (x_m + y_m)
        place_x = np.select(sides, [none + x_m, x_m - (along - y_m), none - x_m], along - 3 * y_m - 2 * x_m - x_m)
        place_y = np.select(sides, [along, none + y_m, middle - along], none - y_m)
        normal_x = np.select(sides, [none + 1, none, none - 1], none)
        normal_y = np.select(sides, [none, none + 1, none], none - 1)
        return np.stack([place_x, place_y, up], axis=-1), np.stack([normal_x, normal_y, none], axis=-1)

    def depth_m(self, points_m: FloatArray, side: int) -> FloatArray:
        """(n,) depth of points (n, 3) inside of the undeformed wall of one pressed side. side: 1 at +x, -1 at -x"""
        if self.kind == "cylinder":
            return np.asarray(self.half_m[0] - np.hypot(points_m[:, 0], points_m[:, 1]))
        return np.asarray(self.half_m[0] - side * points_m[:, 0])

    def under(self, points_m: FloatArray, side: int) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """For points (n, 3) that press on one side: s and z, outward normals (n, 3), and whether there is a wall."""
        x_m, y_m, half_z = self.half_m
        z_m = points_m[:, 2] + half_z
        on_wall = (z_m > 0.0) & (z_m < self.height_m)
        normal = np.zeros(points_m.shape)
        if self.kind == "cylinder":
            around = np.arctan2(points_m[:, 1], points_m[:, 0])
            normal[:, 0], normal[:, 1] = np.cos(around), np.sin(around)
            return x_m * around, z_m, normal, on_wall & (normal[:, 0] * side > 0.5)
        normal[:, 0] = side
        s_m = points_m[:, 1] if side > 0 else 2.0 * (x_m + y_m) - points_m[:, 1]
        return s_m, z_m, normal, on_wall & (np.abs(points_m[:, 1]) < y_m)


BOX = ContainerShape("box", (BOX_M[0] / 2, BOX_M[1] / 2, BOX_M[2] / 2), CARDBOARD)
CYLINDER = ContainerShape("cylinder", (CYLINDER_M[0], CYLINDER_M[0], CYLINDER_M[1] / 2), PLASTIC)
SHAPES = {"box": BOX, "cylinder": CYLINDER}


class Shell:
    """The elastic wall of a shape. Displacements and loads are positive inwards.

    s_m, z_m: nodes of its mesh; patch_area_m2: (p,) and patch_z_m: (p,) of the patches that a filling acts on, those of
    the side at +x first; patch_rows: (p, unknowns) load of a unit pressure on each"""

    def __init__(self, shape: ContainerShape) -> None:
        self.shape = shape
        # (n,) nodes along the perimeter [m], finer where fingers press
        if shape.kind == "cylinder":
            half = shape.perimeter_m / 2
            low, first, second, third = -FINE_HALF_M, FINE_HALF_M, half - FINE_HALF_M, half + FINE_HALF_M
        else:
            low, first, second, third = _corners(shape)
        fine, coarse = round((first - low) / FINE_M), round((second - first) / (1.5 * FINE_M))
        end = low + shape.perimeter_m
        parts = [(low, first, fine), (first, second, coarse), (second, third, fine), (third, end, coarse)]
        self.s_m, self.z_m = (
            np.concatenate([np.linspace(a, b, count, endpoint=False) for a, b, count in parts]),
            _upwards(shape),
        )
        self._along, self._up = _Line(self.s_m, shape.perimeter_m), _Line(self.z_m)
        self._fields = 1 if shape.kind == "box" else 3
        self._size = self._along.size * self._up.size
        stiffness = _stiffness(shape, self._along, self._up)
        free = np.concatenate([np.flatnonzero(one) + i * self._size for i, one in enumerate(self._free_fields())])
        self._free: IntArray = free
        own = stiffness[free][:, free].tocsc()
        # positive definite: no row is exchanged, and the order is that of least fill-in
        self._factors = splu(own, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self.patch_rows, self.patch_area_m2, self.patch_z_m = self._filled_patches()
        self.volume_row: FloatArray = np.kron(self._along.integral, self._up.integral)

    def rows(self, s_m: FloatArray, z_m: FloatArray) -> csr_array:
        """(n, unknowns) matrix whose product with a field is its values at (n,) points."""
        along, up = self._along.at(s_m), self._up.at(z_m)
        row = np.repeat(np.arange(len(along.cells)), 16)
        column = (along.cells[:, :, None] * self._up.size + up.cells[:, None, :]).reshape(len(row))
        value = (along.values[:, :, None] * up.values[:, None, :]).reshape(len(row))
        return csr_array((value, (row, column)), shape=(len(along.cells), self._size))

    def pressure_row(self, low_m: float, high_m: float, slope: bool = False) -> FloatArray:
        """(unknowns,) load of a unit pressure on the wall between two heights; with slope, of one that grows from 0 at
        high_m by 1 per metre downwards."""
        weight = (lambda z: high_m - z) if slope else np.ones_like
        return np.kron(self._along.integral, self._up.weighted(low_m, high_m, weight))

    def solve(self, loads: FloatArray) -> FloatArray:
        """Fields (unknowns, n) under loads (unknowns, n), inwards."""
        whole = np.zeros((self._fields * self._size, loads.shape[1]))
        whole[: self._size] = loads
        whole[self._free] = self._factors.solve(np.ascontiguousarray(whole[self._free]))
        whole[np.setdiff1d(np.arange(len(whole)), self._free)] = 0.0
        return whole[: self._size]

    def at_nodes(self, field: FloatArray) -> FloatArray:
        """(nodes along s, nodes along z) values of a field (unknowns,)."""
        return np.asarray(field.reshape(self._along.size, self._up.size)[::2, ::2])

    @cached_property
    def filling_compliance(self) -> tuple[FloatArray, FloatArray]:
        """(unknowns, p + 1) fields of unit pressures on the patches and of one on the whole wall; (p + 1, p + 1) their
        mutual effects: integrals over patches and whole wall."""
        rows = np.vstack([self.patch_rows, self.volume_row])
        fields = self.solve(rows.T)
        return fields, rows @ fields

    def _free_fields(self) -> list[BoolArray]:
        """Masks (n,) of the unknowns that are not held, of w, v and u; of w alone for a box."""
        along, up = self._along.size, self._up.size
        w = np.ones((along, up), dtype=bool)
        w[:, [0, up - 2]] = False  # the rims
        if self.shape.kind == "box":
            corners = [np.argmin(np.abs(self.s_m - corner)) for corner in _corners(self.shape)]
            w[2 * np.array(corners)] = False
            return [w.ravel()]
        u = np.ones((along, up), dtype=bool)
        u[:, 0] = False  # the bottom
        return [w.ravel(), w.ravel(), u.ravel()]

    def _filled_patches(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x_m, y_m, half_z = self.shape.half_m
        reach = y_m if self.shape.kind == "box" else 0.5 * np.pi * x_m * 0.8
        s_edges = np.linspace(-reach, reach, PATCHES[0] + 1)
        z_edges = half_z + np.linspace(-PATCH_HALF_M, PATCH_HALF_M, PATCHES[1] + 1)
        rows, area, height = [], [], []
        for start in (0.0, self.shape.perimeter_m / 2):
            for s_low, s_high in pairwise(start + s_edges):
                for z_low, z_high in pairwise(z_edges):
                    along = self._along.weighted(s_low, s_high, np.ones_like)
                    rows.append(np.kron(along, self._up.weighted(z_low, z_high, np.ones_like)))
                    area.append((s_high - s_low) * (z_high - z_low))
                    height.append(0.5 * (z_low + z_high))
        return np.array(rows), np.array(area), np.array(height)


@lru_cache(maxsize=4)
def shell_of(shape: ContainerShape) -> Shell:
    """The shell of a shape, factorised once."""
    return Shell(shape)


@dataclass(frozen=True, slots=True)
class _Values:
    """cells: (n, 4) unknowns that differ from 0 at points; values: (n, 4) values of their functions there."""

    cells: IntArray
    values: FloatArray


class _Line:
    """Cubic Hermite elements on a line: value and slope at each node, in turn. size: how many unknowns"""

    def __init__(self, nodes_m: FloatArray, period_m: float | None = None) -> None:
        ends = nodes_m if period_m is None else np.append(nodes_m, nodes_m[0] + period_m)
        self._ends, self._period = ends, period_m
        basis = Basis(MeshLine(ends), ElementLineHermite(), intorder=6)
        self.size = 2 * len(nodes_m)
        number = np.empty(basis.N, dtype=np.int64)  # scikit-fem's unknowns -> ours
        order = np.argsort(basis.mesh.p[0])
        for slot in (0, 1):
            number[basis.nodal_dofs[slot, order]] = (2 * np.arange(len(ends)) + slot) % self.size
        self._fold = csr_array((np.ones(basis.N), (number, np.arange(basis.N))), shape=(self.size, basis.N))
        self.mass = self._folded(BilinearForm(lambda u, v, _: u * v).assemble(basis))
        self.slope_slope = self._folded(BilinearForm(lambda u, v, _: _d(u) * _d(v)).assemble(basis))
        self.bend_bend = self._folded(BilinearForm(lambda u, v, _: _dd(u) * _dd(v)).assemble(basis))
        self.bend_value = self._folded(BilinearForm(lambda u, v, _: u * _dd(v)).assemble(basis))  # rows: bend
        self.slope_value = self._folded(BilinearForm(lambda u, v, _: u * _d(v)).assemble(basis))  # rows: slope
        self.integral: FloatArray = self._fold @ LinearForm(lambda v, _: v).assemble(basis)

    def _folded(self, matrix: csr_array) -> csr_array:
        return csr_array(self._fold @ csr_array(matrix) @ self._fold.T)

    def at(self, points_m: FloatArray) -> _Values:
        """The functions at points (n,)."""
        points = np.asarray(points_m, np.float64)
        if self._period is not None:
            points = np.mod(points - self._ends[0], self._period) + self._ends[0]
        cell = np.clip(np.searchsorted(self._ends, points, side="right") - 1, 0, len(self._ends) - 2)
        length = np.diff(self._ends)[cell]
        x = (points - self._ends[cell]) / length
        values = [1 - 3 * x**2 + 2 * x**3, length * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, length * (x**3 - x**2)]
        return _Values((2 * cell[:, None] + np.arange(4)) % self.size, np.stack(values, axis=-1))

    def weighted(self, low_m: float, high_m: float, weight: object) -> FloatArray:
        """(size,) integrals of the functions times a weight of the place, between two places."""
        assert callable(weight)
        inside = self._ends[(self._ends > low_m) & (self._ends < high_m)]
        if self._period is not None:  # breaks of the next turn too
            around = np.concatenate([self._ends, self._ends + self._period])
            inside = np.unique(around[(around > low_m) & (around < high_m)])
        breaks = np.concatenate([[low_m], inside, [high_m]])
        point, share = np.polynomial.legendre.leggauss(4)
        middle, half = 0.5 * (breaks[1:] + breaks[:-1]), 0.5 * np.diff(breaks)
        places = (middle[:, None] + half[:, None] * point).ravel()
        found = self.at(places)
        amount = (half[:, None] * share).ravel() * weight(places)
        total = np.zeros(self.size)
        np.add.at(total, found.cells, found.values * amount[:, None])
        return total


def _d(u: DiscreteField) -> Any:
    return u.grad[0]


def _dd(u: DiscreteField) -> Any:
    return u.hess[0, 0]


def _corners(shape: ContainerShape) -> tuple[float, float, float, float]:
    x_m, y_m, _ = shape.half_m
    return -y_m, y_m, y_m + 2 * x_m, 3 * y_m + 2 * x_m


def _upwards(shape: ContainerShape) -> FloatArray:
    """(n,) nodes along the height [m], finer around the middle."""
    half = shape.half_m[2]
    outer = round((half - FINE_HALF_M) / COARSE_M)
    inner = round(2 * FINE_HALF_M / FINE_M)
    return np.concatenate(
        [
            np.linspace(0.0, half - FINE_HALF_M, outer, endpoint=False),
            np.linspace(half - FINE_HALF_M, half + FINE_HALF_M, inner, endpoint=False),
            np.linspace(half + FINE_HALF_M, 2 * half, outer + 1),
        ]
    )


def _stiffness(shape: ContainerShape, along: _Line, up: _Line) -> csr_array:
    """The stiffness matrix of the fields w, v, u one after the other; for a box, of w alone."""
    wall = shape.wall
    young_1, young_2 = wall.young_pa
    other = wall.poisson * young_2 / young_1
    plane = np.array([young_1, wall.poisson * young_2, young_2]) / (1.0 - wall.poisson * other)
    bend_11, bend_12, bend_22 = plane * wall.thickness_m**3 / 12.0
    twist = wall.shear_pa * wall.thickness_m**3 / 12.0
    mixed = kron(along.bend_value, up.bend_value.T)
    w_w = (
        bend_11 * kron(along.bend_bend, up.mass)
        + bend_12 * (mixed + mixed.T)
        + bend_22 * kron(along.mass, up.bend_bend)
        + 4.0 * twist * kron(along.slope_slope, up.slope_slope)
    )
    if shape.kind == "box":
        return csr_array(w_w)
    stretch_11, stretch_12, stretch_22 = plane * wall.thickness_m
    shear = wall.shear_pa * wall.thickness_m
    radius = shape.half_m[0]
    w_w = w_w + stretch_11 / radius**2 * kron(along.mass, up.mass)
    v_v = stretch_11 * kron(along.slope_slope, up.mass) + shear * kron(along.mass, up.slope_slope)
    u_u = stretch_22 * kron(along.mass, up.slope_slope) + shear * kron(along.slope_slope, up.mass)
    v_w = stretch_11 / radius * kron(along.slope_value, up.mass)
    u_w = stretch_12 / radius * kron(along.mass, up.slope_value)
    u_v = stretch_12 * kron(along.slope_value.T, up.slope_value) + shear * kron(along.slope_value, up.slope_value.T)
    return csr_array(bmat([[w_w, v_w.T, u_w.T], [v_w, v_v, u_v.T], [u_w, u_v, u_u]]))
