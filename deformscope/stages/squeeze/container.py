"""The rigid model of a container, and what a depth camera would see of it (Thesis ch. 2: the synthetic model)."""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.see.cloud import Intrinsics

SIDES = 256
"""Sides of the prism that represents a cylinder: enough that its facets give no hold against rotation."""


@dataclass(frozen=True, slots=True)
class ContainerModel:
    """A rigid container. Its frame: origin in the middle of its bounding box, z up, in its upright pose.

    vertices_m: (n, 3) [m]; triangles: (m, 3) indices, counterclockwise as seen from outside"""

    vertices_m: FloatArray
    triangles: IntArray

    @classmethod
    def box(cls, size_m: tuple[float, float, float]) -> Self:
        """size_m: along x, y, z [m]."""
        if min(size_m) <= 0.0 or not np.isfinite(size_m).all():
            raise InputError("a box's three sides above 0 m", str(size_m))
        return cls._shape("box", *size_m)

    @classmethod
    def cylinder(cls, radius_m: float, height_m: float) -> Self:
        """A cylinder about z."""
        if min(radius_m, height_m) <= 0.0 or not np.isfinite([radius_m, height_m]).all():
            raise InputError("a radius and a height above 0 m", f"{radius_m:g} m, {height_m:g} m")
        return cls._shape("cylinder", radius_m, height_m, SIDES, 1)

    @classmethod
    def mesh(cls, vertices_m: FloatArray, triangles: IntArray) -> Self:
        """A model from any closed mesh of (n, 3) vertices [m] and (m, 3) triangles; it is moved so that the middle of
        its bounding box is the origin."""
        vertices, faces = np.asarray(vertices_m, dtype=np.float64), np.asarray(triangles)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all() or not len(vertices):
            raise InputError("vertices (n, 3) [m], finite", f"shape {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError("triangles (m, 3) of these vertices", f"shape {faces.shape}")
        return cls(vertices - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)), faces.astype(np.int64))

    @classmethod
    def _shape(cls, name: str, *size: float) -> Self:
        import open3d as o3d

        mesh = getattr(o3d.geometry.TriangleMesh, f"create_{name}")(*size)
        return cls.mesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))

    @property
    def size_m(self) -> FloatArray:
        """(3,) of the bounding box [m]."""
        return np.asarray(np.ptp(self.vertices_m, axis=0))

    @property
    def radius_m(self) -> float:
        """Radius of the smallest ball about the origin that encloses the container [m]."""
        return float(np.linalg.norm(self.vertices_m, axis=1).max())


@dataclass(frozen=True, slots=True)
class ModelView:
    """View of a container in each of the requested pixels. depth_m: along the camera's axis [m], nan outside it
    outward: (..., 3) unit normals of its surface in its own frame; rotation: (3, 3) from the model's to the camera's
    frame"""

    depth_m: FloatArray
    outward: FloatArray
    rotation: FloatArray

    def normal(self, pixels: BoolArray) -> FloatArray:
        """(n, 3) unit normals at some of the pixels, camera frame."""
        return np.asarray(self.outward[pixels] @ self.rotation.T)

    def part(self, pixels: tuple[slice, slice]) -> "ModelView":
        """Some rows and columns of the view."""
        return ModelView(self.depth_m[pixels], self.outward[pixels], self.rotation)


class ModelRenderer:
    """Depth images of a rigid container, by casting rays (Open3D)."""

    def __init__(self, model: ContainerModel, camera: Intrinsics) -> None:
        """Raises InputError for a camera with distortion: undistort its images first."""
        if any(camera.distortion):
            raise InputError("a camera without distortion", f"coefficients {camera.distortion}", "undistort its images")
        import open3d as o3d

        self.model, self.camera = model, camera
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        vertices, triangles = model.vertices_m.astype(np.float32), model.triangles.astype(np.uint32)
        self._scene.add_triangles(self._tensor(vertices), self._tensor(triangles))
        first, second, third = np.moveaxis(model.vertices_m[model.triangles], 1, 0)
        normal = np.cross(second - first, third - first)
        self._outward = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        self._away_m = np.einsum("ij,ij->i", self._outward, first)

    def rays(self, pixels: FloatArray | IntArray) -> FloatArray:
        """(..., 3) along pixels (..., 2) as (column, row), camera frame, with a length of 1 along the axis."""
        ray = np.ones((*pixels.shape[:-1], 3))
        ray[..., :2] = (pixels - np.array(self.camera.centre_px)) / self.camera.focal_px
        return ray

    def render(
        self, T_camera_container: FloatArray, pixels: FloatArray | IntArray, ray: FloatArray | None = None
    ) -> ModelView:
        """View of the container at a pose (4, 4) in pixels (..., 2) as (column, row). ray: (..., 3) rays of the pixels,
        if known"""
        pose = np.asarray(T_camera_container, dtype=np.float64)
        ray = (self.rays(pixels) if ray is None else ray) @ pose[:3, :3]
        eye = -pose[:3, 3] @ pose[:3, :3]  # in the container's frame, which does not move
        cast = np.empty((*ray.shape[:-1], 6), dtype=np.float32)
        cast[..., :3], cast[..., 3:] = eye, ray
        hit = self._scene.cast_rays(self._tensor(cast), nthreads=1)
        known = np.isfinite(hit["t_hit"].numpy())
        # Which triangle is hit is Embree's; where, in float64: its last bit is another one on other processors.
        triangle = np.where(known, hit["primitive_ids"].numpy(), 0)
        outward = self._outward[triangle]
        depth, away_m = np.full(known.shape, np.nan), (self._away_m - self._outward @ eye)[triangle]
        np.divide(away_m, np.einsum("...i,...i", outward, ray), out=depth, where=known)
        return ModelView(depth, outward, pose[:3, :3])

    def window(self, T_camera_container: FloatArray, shape: tuple[int, int], margin_px: int = 0) -> tuple[int, ...]:
        """(left, top, right, bottom) of the part of an image (H, W) that may show the container, right and bottom
        excluded; empty if it is behind the camera or outside the image."""
        corner = self.model.vertices_m @ T_camera_container[:3, :3].T + T_camera_container[:3, 3]
        if (corner[:, 2] <= 0.0).any():
            return (0, 0, 0, 0)
        at = corner[:, :2] / corner[:, 2:] * self.camera.focal_px + self.camera.centre_px
        low = np.floor(at.min(axis=0)).astype(int) - margin_px
        high = np.ceil(at.max(axis=0)).astype(int) + 1 + margin_px
        left, top = np.clip(low, 0, (shape[1], shape[0]))
        right, bottom = np.clip(high, 0, (shape[1], shape[0]))
        return (int(left), int(top), int(right), int(bottom))


# The visible edges of a rigid model, to draw over a camera's image (Thesis fig. 2.8)

SHARP_COSINE = 0.85
"""Faces whose normals differ by more meet in a visible edge."""


def outline_px(model: ContainerModel, camera: Intrinsics, T_camera_container: FloatArray) -> FloatArray:
    """(n, 2, 2) both ends, as (column, row), of the model's sharp edges on faces towards the camera, and of its
    silhouette; none if a part of it is behind the camera."""
    corners = model.vertices_m @ T_camera_container[:3, :3].T + T_camera_container[:3, 3]
    if (corners[:, 2] <= 0.0).any():
        return np.zeros((0, 2, 2))
    faces = model.triangles
    normal = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]])
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    towards = np.einsum("ij,ij->i", normal, corners[faces].mean(axis=1)) < 0.0
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    of_face = np.tile(np.arange(len(faces)), 3)
    # meshes may repeat a corner for each of its faces
    _, first, at = np.unique(np.round(corners, 7), axis=0, return_index=True, return_inverse=True)
    places, ends = corners[first], np.sort(np.ravel(at)[sides], axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, of_face = ends[order], of_face[order]
    pairs = np.flatnonzero((ends[1:] == ends[:-1]).all(axis=1))
    one, other = of_face[pairs], of_face[pairs + 1]
    sharp = np.einsum("ij,ij->i", normal[one], normal[other]) < SHARP_COSINE
    seen = (towards[one] != towards[other]) | (sharp & (towards[one] | towards[other]))
    pixels = places[:, :2] / places[:, 2:] * camera.focal_px + camera.centre_px
    return np.asarray(pixels[ends[pairs[seen]]])


# Walls that bulge or are pressed in, by a container's content, by the air in it, or by fingers.
#
# A wall does not move at the container's edges, where another one holds it, and moves most in its middle. A tracker of
# rigid bodies would follow it; so the bulge of each visible wall is estimated together with the pose

BULGE_M = 0.003
"""Prior standard deviation of the bulge of a wall's middle. Chosen: a carton's walls."""
CREASE_DEG = 30.0
"""Least angle between neighbouring pixels of different walls; a round wall turns less."""
LEAST_PIXELS = 150
"""Fewest pixels of a wall: a smaller one is treated as rigid."""
MOST = 4
"""Most walls that are used: the largest ones."""
LEVEL_M = 0.01
"""Smallest slope of a wall's height: less is rounding of the rendering."""


def bulge_shapes(view: ModelView, height_m: FloatArray) -> FloatArray:
    """(H, W, 2 k) motion of the k largest walls of a rendering (H, W) along their normals per unit motion of their
    middle, and per unit difference between below and above, as under a liquid's pressure. The shape of a bulge is 0 at
    the edges and on other walls.

    height_m: (H, W) height of each pixel's point, container frame. A wall that is only partly in the image counts as
    rigid"""
    seen = np.isfinite(view.depth_m)
    inner = seen & ~_creases(view.outward, seen)
    _, label, size, _ = cv2.connectedComponentsWithStats(inner.astype(np.uint8), connectivity=4)
    beyond = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])  # their edges are not seen
    large = np.flatnonzero(size[:, cv2.CC_STAT_AREA] >= LEAST_PIXELS)
    walls = sorted(set(large) - {0, *beyond}, key=lambda wall: -size[wall, cv2.CC_STAT_AREA])
    away = cv2.distanceTransform(inner.astype(np.uint8), cv2.DIST_L2, 3).astype(np.float64)
    shapes = np.zeros((*seen.shape, 2 * min(len(walls), MOST)))
    for number, wall in enumerate(walls[:MOST]):
        own = label == wall
        share, height = np.where(own, away, 0.0) / away[own].max(), height_m[own]
        low, high = height.min(), height.max()
        above = np.where(own, 2.0 * height_m - low - high, 0.0) / max(high - low, LEVEL_M)
        shapes[..., 2 * number] = share * (2.0 - share)
        shapes[..., 2 * number + 1] = shapes[..., 2 * number] * above
    return shapes


def _creases(normal: FloatArray, seen: BoolArray) -> BoolArray:
    """(H, W) pixels next to one of another wall."""
    found = np.zeros(seen.shape, dtype=bool)
    least = np.cos(np.radians(CREASE_DEG))
    for axis in (0, 1):
        first = tuple(slice(None, -1) if one == axis else slice(None) for one in (0, 1))
        second = tuple(slice(1, None) if one == axis else slice(None) for one in (0, 1))
        apart = np.einsum("hwi,hwi->hw", normal[first], normal[second]) < least
        apart &= seen[first] & seen[second]
        found[first] |= apart
        found[second] |= apart
    return found
