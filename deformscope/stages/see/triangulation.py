"""Triangles between particles, to show a value over a body: its area in the plane, its skin in space."""

from itertools import combinations

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from deformscope.arrays import BoolArray, FloatArray, IntArray

REACH = 1.5
"""Triangles whose longest edge is this many times the typical one bridge a hole or a notch; they are left out."""

SLIVER = 0.05
"""Triangles of less area at rest than this share of the typical one lie along an edge, and span no part of the body."""

FLAT = 0.25
"""Largest thickness of a particle's neighbours on a surface, as a share of their extent in the plane."""

FOLDED = 0.2
"""A surface whose points come closer than this share of their spacing when seen from above is folded."""

AROUND = 13


def spacing_of(position: FloatArray) -> float:
    """The typical distance between neighbours among (K, d) positions; 0 for fewer than two."""
    finite = np.asarray(position[np.isfinite(position).all(axis=1)], dtype=np.float64)
    if len(finite) < 2:
        return 0.0
    distance, _ = cKDTree(finite).query(finite, k=2)
    return float(np.median(distance[:, 1]))


def is_surface(rest: FloatArray) -> bool:
    """Whether particles (K, 3) are one layer: a sheet, or the measured skin of something."""
    if len(rest) <= AROUND:
        return bool(np.linalg.svd(rest - rest.mean(axis=0), compute_uv=False)[-1] < 1e-6)
    _, near = cKDTree(rest).query(rest[:: max(1, len(rest) // 400)], k=AROUND)
    spread = np.linalg.svd(rest[near] - rest[near].mean(axis=1, keepdims=True), compute_uv=False)
    return bool(np.median(spread[:, 2] / spread[:, 1]) < FLAT)


def triangulate(rest: FloatArray) -> IntArray:
    """(t, 3) indices of triangles between particles (K, d): over the area in the plane; in space over a surface, or
    over the skin of a volume. Holes stay open. Triangles of a surface; empty with too few particles, or for a folded
    surface."""
    nothing: IntArray = np.zeros((0, 3), dtype=np.int64)
    if len(rest) < 3:
        return nothing
    try:
        plane = rest
        if surface := rest.shape[1] == 3 and is_surface(rest):
            middle = rest - rest.mean(axis=0)
            plane = middle @ np.linalg.svd(middle, full_matrices=False)[2][:2].T
            if spacing_of(plane) < FOLDED * spacing_of(rest):
                return nothing
        simplices = Delaunay(plane).simplices
        simplices = simplices[_whole(simplices, rest)]
        if rest.shape[1] == 2 or surface:
            return np.asarray(simplices)
        faces = np.concatenate([np.delete(simplices, corner, axis=1) for corner in range(4)])
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return np.asarray(faces[first[count == 1]])
    except (QhullError, ValueError):  # all on a line
        return nothing


def raster(rest: FloatArray, place: FloatArray, value: FloatArray, cells: int) -> tuple[FloatArray, FloatArray, float]:
    """Values (K,) between particles with rest positions (K, 2) and present positions `place` (K, 2), on square cells.

    Returns values (rows, columns), NaN outside the body and in its holes, the corner (2,) of the first cell, and the
    cells' side. cells: along the longer side"""
    low, high = place.min(axis=0), place.max(axis=0)
    side = float((high - low).max()) / cells or 1.0
    columns, rows = np.maximum(np.ceil((high - low) / side - 1e-9).astype(int), 1)
    grid = np.full((rows, columns), np.nan)
    if len(place) < 3:
        return grid, low, side
    try:
        cut = Delaunay(place)
    except (QhullError, ValueError):
        return grid, low, side
    x, y = (low[axis] + (np.arange(count) + 0.5) * side for axis, count in ((0, columns), (1, rows)))
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = cut.find_simplex(at)
    hit = np.flatnonzero((inside >= 0) & _whole(cut.simplices, rest)[inside])
    transform = cut.transform[inside[hit]]
    two = np.einsum("nij,nj->ni", transform[:, :2], at[hit] - transform[:, 2])
    weight = np.column_stack([two, 1.0 - two.sum(axis=1)])
    grid.ravel()[hit] = np.sum(weight * value[cut.simplices[inside[hit]]], axis=1)
    return grid, low, side


def _whole(simplices: IntArray, rest: FloatArray) -> BoolArray:
    """(s,) which of the simplices (s, d + 1) bridge nothing, by their edges at rest (K, d)."""
    corners = rest[simplices]
    pairs = list(combinations(range(simplices.shape[1]), 2))
    edge = np.max([np.linalg.norm(corners[:, a] - corners[:, b], axis=1) for a, b in pairs], axis=0)
    whole = edge <= REACH * np.median(edge)
    if simplices.shape[1] == 3:
        one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        squares = np.sum(one**2, axis=1) * np.sum(other**2, axis=1) - np.sum(one * other, axis=1) ** 2
        area = np.sqrt(np.maximum(squares, 0.0))
        whole &= area > SLIVER * np.median(area)
    return np.asarray(whole)
