"""The visible edges of a rigid model, to draw over a camera's image (Thesis fig. 2.8)."""

from __future__ import annotations

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.squeeze.container import ContainerModel

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
