"""View of a depth camera on a slab on its table, with a robot in front of it: rays cast into triangles and capsules.

    view = DepthView(scene, DepthViewConfig(width=320, height=240))
    exact = view.render(world.displaced_m(contact, view.places_m), [Capsule(tip_m, wrist_m, 0.008)])
    exact.depth_m, exact.color, exact.seen                   # without noise; what each pixel fell on

The camera looks at the slab's middle from 0.8 m, at 45 degrees, across the long edge at y = 0.4 m unless set otherwise.
An arm should be opposite.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.lab import ray_camera
from deformscope.lab.scenes import Scene
from deformscope.solid import Capsule, PosedSolid

SPACING_M = 0.003
"""Distance between the vertices of the foam's surface."""

STILL_M = 1e-5
"""Least motion for which rays are cast again."""

CORNERS = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
"""A rectangle's two triangles."""

TABLE_M = 0.6
"""How far the table goes beyond the slab."""


class DepthView(ray_camera.RayCamera):
    """A camera in front of a scene.

    places_m: (n, 2) vertices of the slab's surface at rest, for which `render` takes displacements [m]"""

    def __init__(
        self,
        scene: Scene,
        config: ray_camera.DepthViewConfig | None = None,
        surface_from_camera: FloatArray | None = None,
    ) -> None:
        """surface_from_camera: (4, 4) its true pose, instead of that of its configuration"""
        config = config or ray_camera.DepthViewConfig()
        self.scene = scene
        middle = np.array([scene.size_m[0] / 2, scene.size_m[1] / 2, scene.thickness_m])
        looking = ray_camera.looking_at(middle, config.distance_m, config.elevation_deg, config.azimuth_deg)
        super().__init__(config, looking if surface_from_camera is None else surface_from_camera)
        axes = [np.linspace(0.0, side, round(side / SPACING_M) + 1) for side in scene.size_m]
        self.places_m: FloatArray = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        self._rest = np.column_stack([self.places_m, scene.foam_height_m(self.places_m)])
        self._grid = (len(axes[0]), len(axes[1]))
        self._still = self._all(self._rest)
        self._still_m = self.points_m(self._still.depth_m)

    def render(
        self, displaced_m: FloatArray | None = None, capsules: Sequence[Capsule] = (), solids: Sequence[PosedSolid] = ()
    ) -> ray_camera.Rendered:
        """The exact picture. displaced_m: (n, 3) displacement of the surface at `places_m` [m], None at rest; capsules,
        solids: the robot, surface frame"""
        if displaced_m is not None and np.shape(displaced_m) != self._rest.shape:
            raise InputError(f"displacements of shape {self._rest.shape}", str(np.shape(displaced_m)), "places_m")
        picture = self._still if displaced_m is None else self._dented(displaced_m)
        depth, seen, facing = picture.depth_m.copy(), picture.seen.copy(), picture.facing.copy()
        for capsule in capsules:
            self.cover(capsule, depth, seen, facing)
        if solids:
            self.cover_solids(solids, depth, seen, facing)
        color = self._still.color.copy()
        changed = (seen != self._still.seen) | (facing != self._still.facing)
        color[changed] = _shaded(seen[changed], facing[changed])
        return ray_camera.Rendered(depth, color, seen, facing)

    def _all(self, vertex: FloatArray) -> ray_camera.Rendered:
        """The picture of foam and table without the robot. vertex: (n, 3) vertex of the foam's surface in the world
        [m]"""
        foam, edge = _triangles(*self._grid)
        low, high = -TABLE_M, np.asarray(self.scene.size_m) + TABLE_M
        corners = np.array([[low, low, 0.0], [high[0], low, 0.0], [high[0], high[1], 0.0], [low, high[1], 0.0]])
        meshes = [(np.concatenate([vertex, vertex[edge] * (1.0, 1.0, 0.0)]), foam), (corners, CORNERS)]
        depth, facing, mesh = self.hits(meshes, (slice(None), slice(None)))
        seen = np.where(
            np.isnan(depth), ray_camera.NOTHING, np.where(mesh == 0, ray_camera.FOAM, ray_camera.TABLE)
        ).astype(np.uint8)
        return ray_camera.Rendered(depth, _shaded(seen, facing), seen, facing)

    def _dented(self, displaced: FloatArray) -> ray_camera.Rendered:
        """Like `_all` with the surface moved by displacements (n, 3) [m], but rays are cast again only where it moved,
        unless that is at its edge."""
        moved = (np.abs(displaced).max(axis=1) > STILL_M).reshape(self._grid)
        if not moved.any():
            return self._still
        box = [np.flatnonzero(moved.any(axis=1 - axis)) for axis in (0, 1)]
        low, high = ([int(one[end]) for one in box] for end in (0, -1))
        if min(low) <= 1 or any(high[i] >= self._grid[i] - 2 for i in (0, 1)):
            return self._all(self._rest + displaced)
        number = np.arange(len(self._rest)).reshape(self._grid)[low[0] - 1 : high[0] + 2, low[1] - 1 : high[1] + 2]
        corner_m = self._rest[number[[0, -1], [0, -1]], :2]
        vertex = (self._rest + displaced)[number.ravel()]
        part = self.part(self.pixels(np.concatenate([vertex, self._rest[number.ravel()]])), 2.0)
        depth, facing, _ = self.hits([(vertex, ray_camera.grid_triangles(*number.shape))], part)
        still, place = self._still.depth_m[part], self._still_m[part][..., :2]
        inside = (self._still.seen[part] == ray_camera.FOAM) & ((place > corner_m[0]) & (place < corner_m[1])).all(
            axis=-1
        )
        new = ~np.isnan(depth) & (inside | (depth < still))
        found = (self._still.depth_m.copy(), self._still.seen.copy(), self._still.facing.copy())
        for whole, value in zip(found, (depth, np.full(depth.shape, ray_camera.FOAM), facing), strict=True):
            whole[part] = np.where(new, value, whole[part])
        return ray_camera.Rendered(found[0], self._still.color, found[1], found[2])


def _shaded(seen: npt.NDArray[np.uint8], facing: FloatArray) -> npt.NDArray[np.uint8]:
    """(..., 3) RGB of pixels (...,) by what they show and the cosine between ray and surface normal."""
    return np.rint(ray_camera.COLOR[seen] * (0.35 + 0.65 * np.abs(facing))[..., None]).astype(np.uint8)


def _triangles(columns: int, rows: int) -> tuple[npt.NDArray[np.uint32], IntArray]:
    """(n, 3) triangles of a grid and of its sides, which reach down to a foot below each vertex of its edge; and the
    indices (e,) of these vertices, in a ring."""
    number = np.arange(columns * rows).reshape(columns, rows)
    edge = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    foot = number.size + np.arange(len(edge))
    after, foot_after = np.roll(edge, -1), np.roll(foot, -1)
    sides = np.concatenate([np.stack([edge, foot, foot_after], axis=-1), np.stack([edge, foot_after, after], axis=-1)])
    return np.concatenate([ray_camera.grid_triangles(columns, rows), sides.astype(np.uint32)]), edge
