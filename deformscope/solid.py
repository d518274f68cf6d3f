"""The shape of a link, a gripper or a mount as triangles, to find which points of a camera show the robot and not the
surface."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray

# The shape that represents a link of the arm or a stick, to find which points of a camera show the robot and not the
# surface


@dataclass(frozen=True, slots=True)
class Capsule:
    """All within `radius_m` of the line from start_m (3,) to end_m (3,) [m]; where both are the same, a ball."""

    start_m: FloatArray
    end_m: FloatArray
    radius_m: float


def outside_m(points_m: FloatArray, half_m: FloatArray, *, round: bool = False) -> FloatArray:
    """(...) distance of points (..., 3) from a box of half its sides (3,) around the origin, or from the upright
    cylinder in it; below 0 within [m]."""
    off = np.abs(points_m)
    if round:
        off = np.stack([np.hypot(off[..., 0], off[..., 1]), off[..., 2]], axis=-1)
    off = off - (half_m[1:] if round else half_m)
    return np.asarray(np.linalg.norm(np.maximum(off, 0.0), axis=-1) + np.minimum(off.max(axis=-1), 0.0))


def moved(capsules: Iterable[Capsule], T: FloatArray) -> list[Capsule]:
    """The capsule in another frame. T: (4, 4) from the capsules' frame to the new one"""
    found = []
    for one in capsules:
        start_m, end_m = np.stack([one.start_m, one.end_m]) @ T[:3, :3].T + T[:3, 3]
        found.append(Capsule(start_m, end_m, one.radius_m))
    return found


@dataclass(frozen=True, eq=False)
class Solid:
    """A surface of triangles; it must be closed to determine which points are inside.

    vertices_m: (n, 3) [m], rounded to float32, as they are recorded; triangles: (m, 3) uint32"""

    vertices_m: FloatArray
    triangles: npt.NDArray[np.uint32]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_m", np.asarray(self.vertices_m, np.float32).astype(np.float64))
        object.__setattr__(self, "triangles", np.asarray(self.triangles, np.uint32))

    def __reduce__(self) -> tuple[Any, ...]:
        return Solid, (self.vertices_m, self.triangles)

    def moved(self, T: FloatArray) -> "Solid":
        """The solid in another frame, T (4, 4)."""
        return Solid(self.vertices_m @ T[:3, :3].T + T[:3, 3], self.triangles)

    @cached_property
    def ball(self) -> tuple[FloatArray, float]:
        """A ball around it: middle (3,) and radius [m]."""
        middle = 0.5 * (self.vertices_m.min(axis=0) + self.vertices_m.max(axis=0))
        return middle, float(np.linalg.norm(self.vertices_m - middle, axis=1).max())

    @cached_property
    def _rays(self) -> Any:
        import open3d as o3d

        rays = o3d.t.geometry.RaycastingScene(nthreads=1)
        vertices = o3d.core.Tensor.from_numpy(self.vertices_m.astype(np.float32))
        rays.add_triangles(vertices, o3d.core.Tensor.from_numpy(self.triangles.astype(np.uint32)))
        return rays

    def closest(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The nearest points (n, 3) of its surface to points (n, 3) [m], and the normals (n, 3) there."""
        import open3d as o3d

        queries = o3d.core.Tensor.from_numpy(np.ascontiguousarray(points_m, np.float32))
        found = self._rays.compute_closest_points(queries, nthreads=1)
        foot, normal = (found[name].numpy().astype(np.float64) for name in ("points", "primitive_normals"))
        return foot, normal

    def near(self, points_m: FloatArray, within_m: float) -> BoolArray:
        """(n,) whether points (n, 3) are inside of it, or no farther from it than this [m]."""
        import open3d as o3d

        queries = o3d.core.Tensor.from_numpy(np.ascontiguousarray(points_m, np.float32))
        return np.asarray(self._rays.compute_signed_distance(queries, nthreads=1).numpy() <= within_m)


@dataclass(frozen=True, slots=True, eq=False)
class PosedSolid:
    """A solid and its pose: T_world_solid (4, 4)."""

    T_world_solid: FloatArray
    solid: Solid

    @property
    def ball(self) -> tuple[FloatArray, float]:
        """A ball around it: middle (3,) and radius [m]."""
        middle, radius = self.solid.ball
        return self.T_world_solid[:3, :3] @ middle + self.T_world_solid[:3, 3], radius

    @property
    def vertices_m(self) -> FloatArray:
        """Vertices (n, 3) in the world [m]."""
        return np.asarray(self.solid.vertices_m @ self.T_world_solid[:3, :3].T + self.T_world_solid[:3, 3])


def merged(solids: Sequence[PosedSolid]) -> Solid:
    """One surface of all solids at their poses; it does not determine which points are inside of several."""
    first = np.cumsum([0, *(len(one.solid.vertices_m) for one in solids)])
    triangles = [one.solid.triangles + np.uint32(number) for one, number in zip(solids, first, strict=False)]
    return Solid(np.concatenate([one.vertices_m for one in solids]), np.concatenate(triangles))
