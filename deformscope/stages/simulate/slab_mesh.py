"""The slab below measured pokes as a mesh of tetrahedra, six in each cell of a regular grid."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import Observation
from deformscope.stages.msm.clusters import rank
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_fit import SeenPoke

REACH_SHARE, REACH_TIPS = 1.0, 0.45
"""The slab goes this many thicknesses, and tip sizes, beyond the pokes. With .6 of that its end moves the dent by 6.3 %
of the depth at a Poisson's ratio of .45 (`studies simulators --ends`)."""
FEWEST_LAYERS, MOST_VERTICES = 3, 20_000
FLAT = 2.0
"""Height of a cell over its width: the surface at a tip's edge asks for narrow cells, the depth does not."""
FILLED = 0.8
"""Cells per vertex of a layer, about."""
COARSEST = 0.7
"""Largest size of a cell, as a share of the tip's width: a ball passes between the vertices of larger ones."""
HOLE_SPACINGS = 3.0
"""A place of the slab this many spacings from all points of the surface is a hole in it."""


@dataclass(frozen=True, slots=True)
class SlabMesh:
    """A slab of tetrahedra, glued to the ground, in the frame of its surface; up is +z.

    axes: coordinates of the grid along x, y, z [m]; vertices: (n, 3), last axis fastest [m]; elements: (m, 4) vertices
    of each tetrahedron, of positive volume; material: (cx, cy, cz) number of each cell's material, from 0; held: (n,)
    vertices that are moved, without gravity, in place of the lowest, which are glued to the ground"""

    axes: tuple[FloatArray, FloatArray, FloatArray]
    vertices: FloatArray
    elements: IntArray
    material: IntArray
    held: BoolArray | None = None

    @property
    def cells(self) -> tuple[int, int, int]:
        """Cells along x, y, z."""
        x, y, z = (len(axis) - 1 for axis in self.axes)
        return x, y, z

    @property
    def size(self) -> FloatArray:
        """(3,) its sides [m]."""
        return np.array([axis[-1] - axis[0] for axis in self.axes])

    def element_material(self) -> IntArray:
        """(m,) material of each tetrahedron."""
        return np.tile(self.material.ravel(), len(self.elements) // self.material.size)

    def boxes(self) -> list[tuple[int, tuple[slice, slice, slice]]]:
        """Boxes of cells of one material that fill the slab: the material, and cells along x, y, z."""
        found, left = [], np.ones(self.material.shape, bool)
        while left.any():
            low = np.unravel_index(int(np.argmax(left)), left.shape)
            one, part = int(self.material[low]), [slice(int(at), int(at) + 1) for at in low]
            for axis, side in enumerate(part):
                while side.stop < left.shape[axis]:
                    wider = [*part[:axis], slice(side.start, side.stop + 1), *part[axis + 1 :]]
                    if not (left & (self.material == one))[tuple(wider)].all():
                        break
                    part, side = wider, wider[axis]
            left[tuple(part)] = False
            found.append((one, (part[0], part[1], part[2])))
        return found

    def outside(self) -> IntArray:
        """(f, 3) triangles of its surface, counterclockwise from outside."""
        faces = self.elements[:, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return np.asarray(faces[np.sort(first[count == 1])])

    def at_surface(self, values: FloatArray, places: FloatArray) -> FloatArray:
        """Values (p, 3) at places (p, 2) of its upper face, between those (n, 3) at its vertices; beyond it 0."""
        upper = values.reshape(*(len(axis) for axis in self.axes), -1)[:, :, -1]
        between = RegularGridInterpolator(self.axes[:2], upper, bounds_error=False, fill_value=0.0)
        return np.asarray(between(places))


def slab_mesh(axes: tuple[FloatArray, FloatArray, FloatArray], material: IntArray | None = None) -> SlabMesh:
    """The mesh of a grid; neighbouring cells are mirrored, so that it has no preferred diagonal."""
    shape = np.array([len(axis) for axis in axes])
    vertices = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    low = np.stack(np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    step = np.array([shape[1] * shape[2], shape[2], 1])
    elements = []
    for order in itertools.permutations(range(3)):
        corner, tetrahedron = np.zeros_like(low), []
        for axis in (None, *order):
            if axis is not None:
                corner[:, axis] = 1
            tetrahedron.append((low + (corner ^ (low & 1))) @ step)
        elements.append(np.stack(tetrahedron, axis=1))
    every = np.concatenate(elements)
    edges = vertices[every[:, 1:]] - vertices[every[:, :1]]
    turned = np.linalg.det(edges) < 0.0
    every[turned] = every[turned][:, [0, 1, 3, 2]]
    return SlabMesh(axes, vertices, every, np.zeros(shape - 1, np.int64) if material is None else material)


def block_of(seen: Observation) -> tuple[SlabMesh, IntArray]:
    """The block whose vertices are an observation's particles, and of each vertex the particle. Raises InputError for
    particles that are not a block of rows along x, y and z."""
    came, shape = "particles in other rows, or none", seen.shape or (0,)
    if seen.cell is not None and np.prod(shape) == len(seen.cell) and len(shape) == 3 and min(shape) > 1:
        particle = np.argsort(seen.cell)
        grid = seen.rest[particle].reshape(*shape, 3)
        x, y, z = (np.linspace(grid[..., at].min(), grid[..., at].max(), shape[at]) for at in range(3))
        if np.allclose((mesh := slab_mesh((x, y, z))).vertices, seen.rest[particle], atol=0.2 * np.diff(z)[0]):
            return mesh, particle
    elif rank(seen.rest) == 2:
        came = "a sheet, whose force shows modulus times thickness, not each"
    hint = "a block's pair; of pokes of a surface a model: deformscope calibrate beta ... --thickness-m 0.03 --save"
    raise InputError("a block of particles in rows along x, y and z", came, hint)


def slab_around(
    surface: MeasuredSurface,
    pokes: Sequence[SeenPoke],
    spacing: float | None,
    vertices: int,
    material: Callable[[FloatArray], IntArray] = lambda places: np.zeros(len(places), np.int64),
    beyond: float | None = None,
) -> SlabMesh:
    """The part of a flat slab around pokes, as far as it moves.

    spacing: size of its cells [m], None = so that it has about this number of vertices; material: at places (p, 2),
    through the whole thickness; beyond: how far it goes beyond a tip [m], None = as above. Raises InputError for a poke
    outside, a hole, cells too coarse for a tip, too many."""
    for poke in pokes:
        corners = poke.at[:2] + poke.tip.half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        if not surface.covers(np.vstack([poke.at[None, :2], corners])).all():
            low, high = surface.points[:, :2].min(axis=0), surface.points[:, :2].max(axis=0)
            span = f"x {low[0]:.3g} to {high[0]:.3g} m, y {low[1]:.3g} to {high[1]:.3g} m"
            raise InputError(f"pokes on the surface, {span}", f"one at ({poke.at[0]:.3g}, {poke.at[1]:.3g}) m")
    reach = [one.tip.half + (beyond or REACH_SHARE * surface.thickness + REACH_TIPS * one.tip.width) for one in pokes]
    places = np.stack([poke.at[:2] for poke in pokes])
    low = np.maximum((places - reach).min(axis=0), surface.points[:, :2].min(axis=0))
    high = np.minimum((places + reach).max(axis=0), surface.points[:, :2].max(axis=0))
    top = float(np.median(surface.points[:, 2]))
    sides = np.array([*(high - low), surface.thickness])
    level, solid = (FEWEST_LAYERS + 1) * sides[0] * sides[1], sides.prod() / FLAT
    fine = spacing or max(float(np.sqrt(level / (FILLED * vertices))), float(np.cbrt(solid / (FILLED * vertices))))
    narrow = COARSEST * min(poke.tip.width for poke in pokes)
    if fine > narrow:
        enough = np.ceil(max(level / narrow**2, solid / narrow**3) / FILLED)
        hint = f"--vertices {enough:.0f}, or pokes that are closer together"
        came = f"{1e3 * fine:.3g} mm"
        raise InputError(f"cells of at most {1e3 * narrow:.3g} mm, {COARSEST:g} of the tip's width", came, hint)
    count = [max(2, round(side / fine)) for side in sides[:2]]
    layers = max(FEWEST_LAYERS, round(surface.thickness / (FLAT * fine)))
    total = (count[0] + 1) * (count[1] + 1) * (layers + 1)
    if total > MOST_VERTICES:
        raise InputError(f"at most {MOST_VERTICES} vertices", f"{total}", "a larger --spacing-m")
    x, y = (np.linspace(low[i], high[i], count[i] + 1) for i in (0, 1))
    upper = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    away, _ = cKDTree(surface.points[:, :2]).query(upper)
    if (hole := int(np.argmax(away))) >= 0 and away[hole] > max(HOLE_SPACINGS * surface.spacing, fine):
        came = f"no points within {1e3 * away[hole]:.3g} mm of ({upper[hole, 0]:.3g}, {upper[hole, 1]:.3g}) m"
        raise InputError("a surface without a hole around the pokes", came, "pokes away from it")
    middle = np.meshgrid(*(0.5 * (one[1:] + one[:-1]) for one in (x, y)), indexing="ij")
    below = material(np.stack(middle, axis=-1).reshape(-1, 2)).reshape(*count, 1)
    return slab_mesh((x, y, np.linspace(top - surface.thickness, top, layers + 1)), np.repeat(below, layers, axis=2))
