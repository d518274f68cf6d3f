"""A body of material below a measured surface: a lattice of a few layers whose lowest one rests on the ground.

A single layer of particles only bends, so that it hardly determines beta or a force. With the material below it, the
same surface does. Up is +z."""

import functools
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import Delaunay

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.msm.clusters import spacing

FLAT_SHARE = 0.1
"""A surface within this share of a lattice spacing of a plane is treated as that plane: measurement noise would make
the lattice uneven, which costs speed without benefit."""

FEWEST_LAYERS = 2


@dataclass(frozen=True)
class MeasuredSurface:
    """A surface seen from above, with the same thickness of material everywhere below it.

    points: (n, 3) points [m], one height at each place; thickness: [m].
    Raises InputError with too few points, or several above each other."""

    points: FloatArray
    thickness: float

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3 or len(self.points) < 4:
            raise InputError("a surface of at least 4 points (n, 3)", f"shape {self.points.shape}")
        if not np.isfinite(self.points).all():
            raise InputError("finite surface points", "NaN or infinity", "drop those points")
        if not (np.isfinite(self.thickness) and self.thickness > 0.0):
            hint = "the depth of material below the surface [m]"
            raise InputError("a thickness above 0", f"{self.thickness:g}", hint)
        flat = np.sort(np.linalg.svd(self.points[:, :2] - self.points[:, :2].mean(axis=0), compute_uv=False))
        if flat[0] <= 1e-3 * flat[-1]:
            raise InputError("surface points that cover an area seen from above", "points above one line")
        if self.spacing < 0.05 * spacing(self.points):
            raise InputError("a surface with one height at each place", "points above each other", "the surface alone")

    @functools.cached_property
    def spacing(self) -> float:
        """Median distance of neighbouring points, seen from above [m]."""
        return spacing(self.points[:, :2])

    @functools.cached_property
    def _hull(self) -> Delaunay:
        return Delaunay(self.points[:, :2])

    def height(self, place: FloatArray, lattice_spacing: float) -> FloatArray:
        """Height [m] above each place (m, 2): of the plane where the surface is one, else between the points."""
        ones = np.ones((len(self.points), 1))
        plane, *_ = np.linalg.lstsq(np.hstack([self.points[:, :2], ones]), self.points[:, 2], rcond=None)
        off = self.points[:, 2] - self.points[:, :2] @ plane[:2] - plane[2]
        if float(np.sqrt(np.mean(off**2))) <= FLAT_SHARE * lattice_spacing:
            return np.asarray(place @ plane[:2] + plane[2])
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

        found = np.asarray(LinearNDInterpolator(self._hull, self.points[:, 2])(place))
        return np.where(np.isnan(found), NearestNDInterpolator(self.points[:, :2], self.points[:, 2])(place), found)

    def covers(self, place: FloatArray) -> BoolArray:
        """Whether each place (m, 2) lies above the surface, up to rounding."""
        middle = self.points[:, :2].mean(axis=0)
        return np.asarray(self._hull.find_simplex(middle + (place - middle) * (1.0 - 1e-9)) >= 0)


@dataclass(frozen=True, slots=True)
class FlatEdge:
    """The edge of a flat tip: outside it a surface falls as the root of the distance (Sneddon 1965), steeper than a
    lattice can.

    middle, half: (2,) middle and half of its footprint [m]"""

    middle: FloatArray
    half: FloatArray


@dataclass(frozen=True, slots=True)
class Layers:
    """A lattice of particles below a surface.

    rest: (K, 3) [m]; shape: columns along x and y, layers (last axis fastest, the highest layer last); cell: (K,)
    top, bottom: indices of the highest and the lowest layer, column by column; spacing: along x and y [m]"""

    rest: FloatArray
    shape: tuple[int, int, int]
    cell: IntArray
    top: IntArray
    bottom: IntArray
    spacing: float
    origin: FloatArray

    def interpolation(self, place: FloatArray, edge: FlatEdge | None = None) -> tuple[csr_array, BoolArray]:
        """Weights (m, K) that take values at particles to values at places (m, 2) of the top layer, and where these lie
        between four columns that are there (m,). Bilinear; from a flat tip's edge to the next column as the root of the
        distance. The lattice ends less than a cell before the material: there the outermost columns' values hold."""
        across: FloatArray = (np.asarray(place) - self.origin) / self.spacing
        ends = np.clip(across, 0.0, np.array(self.shape[:2]) - 1.0)
        across = np.asarray(np.where(np.abs(across - ends) < 1.0 - 1e-9, ends, across), dtype=np.float64)
        low = np.floor(across + 1e-9).astype(np.int64)
        share = np.clip(across - low, 0.0, 1.0)
        if edge is not None:
            share = self._steepened(edge, low, share)
        particle = np.full(self.shape, -1, dtype=np.int64)
        particle.reshape(-1)[self.cell] = np.arange(len(self.cell))
        upper = particle[:, :, -1]
        rows, columns, weights = [], [], []
        inside = np.ones(len(low), dtype=bool)
        for dx, dy in ((0, 0), (0, 1), (1, 0), (1, 1)):
            x, y = low[:, 0] + dx, low[:, 1] + dy
            weight = np.where(dx, share[:, 0], 1.0 - share[:, 0]) * np.where(dy, share[:, 1], 1.0 - share[:, 1])
            there = (x >= 0) & (y >= 0) & (x < self.shape[0]) & (y < self.shape[1])
            at = np.full(len(low), -1, dtype=np.int64)
            at[there] = upper[x[there], y[there]]
            counts = weight > 1e-9
            inside &= ~counts | (at >= 0)
            used = np.flatnonzero(counts & (at >= 0))
            rows.append(used)
            columns.append(at[used])
            weights.append(weight[used])
        entries = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
        return csr_array(entries, shape=(len(low), len(self.rest))), inside

    def _steepened(self, edge: FlatEdge, low: IntArray, share: FloatArray) -> FloatArray:
        """Shares (m, 2) of the way across cells (m, 2), those that the tip's edge crosses stretched."""
        middle, half = ((value / self.spacing) for value in (edge.middle - self.origin, edge.half * (1.0 + 1e-6)))
        first = low - middle  # of the cell, from the tip's middle
        near_edge = np.abs(first + share) <= half + 1.0
        found = share.copy()
        for axis in range(2):
            here = near_edge[:, 1 - axis]
            for sign in (1.0, -1.0):  # on the far side as on the near one, looked at in a mirror
                near = first[:, axis] if sign > 0.0 else -first[:, axis] - 1.0
                crossed = here & (near <= half[axis]) & (near + 1.0 > half[axis])
                begins = half[axis] - near[crossed]
                along = share[crossed, axis] if sign > 0.0 else 1.0 - share[crossed, axis]
                root = np.sqrt(np.maximum(along - begins, 0.0) / (1.0 - begins))
                found[crossed, axis] = root if sign > 0.0 else 1.0 - root
        return found


def below(
    surface: MeasuredSurface, *, spacing: float, centre: FloatArray | None = None, reach: float | None = None
) -> Layers:
    """The lattice of material below a surface, `spacing` [m] apart along x and y.

    centre: (2,) place of a column, default the lowest corner of the surface
    reach: extent of the lattice from `centre` along x and y [m], default the whole surface. The layers divide the
    thickness evenly, at about `spacing`; there are at least two."""
    low, high = surface.points[:, :2].min(axis=0), surface.points[:, :2].max(axis=0)
    at = low if centre is None else np.asarray(centre, dtype=np.float64)
    far = np.inf if reach is None else reach
    if ((at < low - spacing) | (at > high + spacing)).any():
        wanted = f"a place within ({low[0]:.3g}, {low[1]:.3g}) to ({high[0]:.3g}, {high[1]:.3g}) m"
        raise InputError(wanted, f"({at[0]:.3g}, {at[1]:.3g})", "a place on the surface")
    first = np.ceil((np.maximum(low, at - far) - at) / spacing - 1e-6).astype(np.int64)
    last = np.floor((np.minimum(high, at + far) - at) / spacing + 1e-6).astype(np.int64)
    count = last - first + 1
    if (count < 2).any():
        wide, long = np.ptp(surface.points[:, :2], axis=0)
        wanted, came = "a surface of at least two lattice spacings a side", f"{wide:g} x {long:g} m at a spacing of"
        raise InputError(wanted, f"{came} {spacing:g} m", "a smaller --spacing-m, or a place on the surface")
    axes = [at[i] + spacing * np.arange(first[i], last[i] + 1) for i in range(2)]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    layers = max(FEWEST_LAYERS, round(surface.thickness / spacing) + 1)
    depth = surface.thickness * np.arange(layers - 1, -1, -1) / (layers - 1)
    there = np.flatnonzero(surface.covers(place))
    if not there.size:
        raise InputError("a place on the surface", "one outside it")
    height = surface.height(place[there], spacing)
    rest = np.empty((len(there), layers, 3))
    rest[:, :, :2] = place[there, None]
    rest[:, :, 2] = height[:, None] - depth
    cell = (there[:, None] * layers + np.arange(layers)).reshape(-1)
    column = np.arange(len(there)) * layers
    return Layers(
        rest=rest.reshape(-1, 3),
        shape=(int(count[0]), int(count[1]), layers),
        cell=cell,
        top=column + layers - 1,
        bottom=column,
        spacing=spacing,
        origin=np.array([axes[0][0], axes[1][0]]),
    )
