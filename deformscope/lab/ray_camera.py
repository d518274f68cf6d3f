"""A simulated depth camera: rays cast into triangles and capsules, and the errors of a real camera.

It has the figures of a PrimeSense: 640x480 pixels, 570 px of focal length."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.solid import Capsule, PosedSolid
from deformscope_drivers.images import Intrinsics

NOTHING, TABLE, FOAM, ROBOT, CONTAINER = 0, 1, 2, 3, 4
"""Surface that a pixel's ray hit."""

NEAREST_M = 0.01
"""Distance from the plane of the camera below which triangles are searched in the whole picture."""
COLOR = np.array([[0, 0, 0], [92, 84, 76], [206, 196, 150], [70, 74, 82], [186, 152, 110]], dtype=np.float64)
"""Colour of each material, lit along the view; all foams look alike."""


@dataclass(frozen=True, slots=True)
class DepthViewConfig:
    """A camera and its pose; it has no errors: its driver's double adds them.

    width, height: [px]; focal_px: focal length at 640 pixels of width; smaller images show the same view; distance_m:
    distance from the middle of its view; elevation_deg: elevation of the camera above the table, as seen from there
    azimuth_deg: its direction around that, from the x axis towards y
    grazing_deg: surfaces of a container seen at a smaller angle than this have no depth"""

    width: int = 640
    height: int = 480
    focal_px: float = 570.0
    distance_m: float = 0.8
    elevation_deg: float = 45.0
    azimuth_deg: float = 90.0
    grazing_deg: float = 12.0

    @property
    def intrinsics(self) -> Intrinsics:
        """Focal lengths and centre of the camera [px]."""
        focal = self.focal_px * self.width / 640.0
        return Intrinsics(focal, focal, 0.5 * (self.width - 1), 0.5 * (self.height - 1))


@dataclass(frozen=True, slots=True)
class Rendered:
    """One exact picture. depth_m: (H, W) distance along the view [m], nan where there is nothing; color: (H, W, 3) RGB
    uint8; seen: (H, W) uint8, NOTHING, TABLE, FOAM or ROBOT; facing: (H, W) cosine between ray and surface normal"""

    depth_m: FloatArray
    color: npt.NDArray[np.uint8]
    seen: npt.NDArray[np.uint8]
    facing: FloatArray


class RayCamera:
    """A camera at a pose in a world.

    config; intrinsics: its projection; T_world_camera: (4, 4) its pose: x right, y down, z along the view"""

    def __init__(self, config: DepthViewConfig, T_world_camera: FloatArray) -> None:
        self.config = config
        self.intrinsics = config.intrinsics
        focal = self.intrinsics.fx_px
        self.T_world_camera = np.asarray(T_world_camera)
        column, row = np.meshgrid(np.arange(config.width), np.arange(config.height))
        across = (column - self.intrinsics.cx_px) / focal, (row - self.intrinsics.cy_px) / focal
        ray = np.stack([*across, np.ones(column.shape)], axis=-1) @ self.T_world_camera[:3, :3].T
        self.ray = ray  # (H, W, 3), a length of 1 along the view, so that hits come as depth
        self._length = np.linalg.norm(ray, axis=-1)
        eye = np.broadcast_to(self.T_world_camera[:3, 3], ray.shape)
        self._cast = np.concatenate([eye, ray], axis=-1).astype(np.float32)

    def points_m(self, depth_m: FloatArray) -> FloatArray:
        """(H, W, 3) places in the world of depths (H, W) along the view [m]."""
        return np.asarray(self.T_world_camera[:3, 3] + depth_m[..., None] * self.ray)

    def pixels(self, points_m: FloatArray) -> FloatArray:
        """(n, 2) columns and rows where places (n, 3) in the world appear."""
        inside = (points_m - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, :3]
        focal = np.array([self.intrinsics.fx_px, self.intrinsics.fy_px])
        return np.asarray(focal * inside[:, :2] / inside[:, 2:] + (self.intrinsics.cx_px, self.intrinsics.cy_px))

    def hits(
        self, meshes: list[tuple[FloatArray, npt.NDArray[np.uint32]]], part: tuple[slice, slice]
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """First hits of the rays of a part (h, w) of the picture: (h, w) depth [m], nan without one; cosine; index of
        the mesh. meshes: (n, 3) vertices in the camera's frame [m] and (m, 3) triangles of each"""
        import open3d as o3d

        world = o3d.t.geometry.RaycastingScene()
        for vertex, triangle in meshes:
            points = o3d.core.Tensor.from_numpy(vertex.astype(np.float32))
            world.add_triangles(points, o3d.core.Tensor.from_numpy(triangle))
        hit = world.cast_rays(o3d.core.Tensor.from_numpy(np.ascontiguousarray(self._cast[part])), nthreads=1)
        depth = hit["t_hit"].numpy().astype(np.float64)
        depth[~np.isfinite(depth)] = np.nan
        normal = hit["primitive_normals"].numpy().astype(np.float64)
        facing = np.where(np.isnan(depth), 0.0, (normal * self.ray[part]).sum(axis=-1) / self._length[part])
        return depth, facing, hit["geometry_ids"].numpy().astype(np.int64)

    def cover(self, capsule: Capsule, depth: FloatArray, seen: npt.NDArray[np.uint8], facing: FloatArray) -> None:
        """Draw a capsule of the robot into a picture (h, w), changed in place, where it is nearer. depth: depth along
        the view [m]; seen: index of each pixel's surface; facing: cosine between ray and surface normal"""
        part = self.window(capsule)
        if not depth[part].size:
            return
        entered = _enter(capsule, self.T_world_camera[:3, 3], self.ray[part], self._length[part])
        nearer = np.isfinite(entered) & ~(entered >= depth[part])  # also where there is nothing: nan
        at, ray = entered[nearer], self.ray[part][nearer]
        normal = _outward(capsule, self.T_world_camera[:3, 3] + at[:, None] * ray)
        depth[part][nearer] = at
        seen[part][nearer] = ROBOT
        facing[part][nearer] = (normal * ray).sum(axis=-1) / self._length[part][nearer]

    def cover_solids(
        self, solids: Sequence[PosedSolid], depth: FloatArray, seen: npt.NDArray[np.uint8], facing: FloatArray
    ) -> None:
        """Draw solids of the robot into a picture (h, w), changed in place, where they are nearer: see `cover`."""
        meshes = [(one.vertices_m, one.solid.triangles) for one in solids]
        corners = np.concatenate([vertices for vertices, _ in meshes])
        inside = (corners - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, 2] > NEAREST_M
        part = self.part(self.pixels(corners), 2.0) if inside.all() else (slice(None), slice(None))
        entered, cosine, _ = self.hits(meshes, part)
        nearer = np.nan_to_num(entered, nan=np.inf) < np.nan_to_num(depth[part], nan=np.inf)
        depth[part][nearer] = entered[nearer]
        seen[part][nearer] = ROBOT
        facing[part][nearer] = cosine[nearer]

    def window(self, capsule: Capsule) -> tuple[slice, slice]:
        """Rows and columns that hold every pixel of a capsule."""
        ends = np.stack([capsule.start_m, capsule.end_m])
        inside = (ends - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, :3]
        away = inside[:, 2]
        if (away < 4.0 * capsule.radius_m).any():
            return slice(None), slice(None)
        # a ball of radius r at depth z appears within f r / (z - r) (1 + tan^2) of its middle
        tangent = (inside[:, :2] ** 2).sum(axis=1) / away**2
        reach = self.intrinsics.fx_px * capsule.radius_m / (away - capsule.radius_m) * (1.0 + tangent) * 1.2 + 2.0
        return self.part(self.pixels(ends), reach[:, None])

    def part(self, pixel: FloatArray, around: float | FloatArray) -> tuple[slice, slice]:
        """Rows and columns that hold all of some pixels (n, 2), with a margin."""
        low = np.clip(np.floor((pixel - around).min(axis=0)), 0, None).astype(int)
        high = np.clip(np.ceil((pixel + around).max(axis=0)) + 1, 0, None).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])


def _enter(capsule: Capsule, eye: FloatArray, ray: FloatArray, length: FloatArray) -> FloatArray:
    """First hits of rays (..., 3) from `eye` on a capsule: (...,) multiples of the ray, inf without one. length: (...,)
    of the rays"""
    square = length**2
    best = np.full(length.shape, np.inf)
    direction, along = _axis(capsule)
    if along > 0.0:
        slope, start = ray @ direction, float((eye - capsule.start_m) @ direction)
        apart = (eye - capsule.start_m) - start * direction  # across the axis: no part of a ray along it counts
        reach = _nearest_root(square - slope**2, ray @ apart, float(apart @ apart) - capsule.radius_m**2)
        meets = np.isfinite(reach)
        place = start + np.where(meets, reach, 0.0) * slope
        best = np.where(meets & (place >= 0.0) & (place <= along), reach, np.inf)
    for end in (capsule.start_m, capsule.end_m):
        apart = eye - end
        best = np.minimum(best, _nearest_root(square, ray @ apart, float(apart @ apart) - capsule.radius_m**2))
    return best


def _outward(capsule: Capsule, point_m: FloatArray) -> FloatArray:
    """(n, 3) outward normals at places (n, 3) of a capsule's surface [m]."""
    direction, along = _axis(capsule)
    middle = np.clip((point_m - capsule.start_m) @ direction, 0.0, along)[:, None] * direction
    return np.asarray((point_m - capsule.start_m - middle) / capsule.radius_m)


def _axis(capsule: Capsule) -> tuple[FloatArray, float]:
    """(3,) direction from end to end, and their distance [m]; both 0 for a ball."""
    axis = capsule.end_m - capsule.start_m
    along = float(np.linalg.norm(axis))
    return (axis / along, along) if along > 1e-9 else (np.zeros(3), 0.0)


def _nearest_root(a: FloatArray, half_b: FloatArray, c: float) -> FloatArray:
    """The smaller root above 0 of a t^2 + 2 b t + c for a, b of one shape (...,), inf where there is none; the eye is
    outside: c > 0."""
    inside = half_b**2 - a * c
    meets: BoolArray = (inside >= 0.0) & (half_b < 0.0) & (a > 0.0)
    root = np.full(meets.shape, np.inf)
    root[meets] = c / (-half_b[meets] + np.sqrt(inside[meets]))  # c / q, the form without cancellation
    return root


def looking_at(middle: FloatArray, distance: float, elevation_deg: float, azimuth_deg: float) -> FloatArray:
    """(4, 4) pose of a camera above a place that it faces, its x axis level."""
    up, around = np.deg2rad([elevation_deg, azimuth_deg])
    view = -np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(view, right), view])
    pose[:3, 3] = middle - distance * view
    return pose


def grid_triangles(columns: int, rows: int) -> npt.NDArray[np.uint32]:
    """(m, 3) triangles between the vertices of a grid, last axis fastest."""
    number = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    both = [np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))]
    return np.concatenate(both).astype(np.uint32)
