"""The rigid model of a container, and what a depth camera would see of it (Thesis ch. 2: the synthetic model)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

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

    def part(self, pixels: tuple[slice, slice]) -> ModelView:
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
