"""A container on a table as a depth camera sees it, for tests: exact, or with a dent, a finger, noise and gaps."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.see.cloud import Intrinsics, axial_noise_m
from deformscope.stages.squeeze.container import ContainerModel, ModelRenderer

CAMERA = Intrinsics((570.0, 570.0), (319.5, 239.5))
SHAPE = (480, 640)
COLUMN, ROW = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
PIXELS = np.stack([COLUMN, ROW], axis=-1)
BOX = ContainerModel.box((0.12, 0.08, 0.2))
CYLINDER = ContainerModel.cylinder(0.045, 0.18)
NOISE = axial_noise_m(np.array(1.0)).item()


def looking(distance_m: float, elevation_deg: float, azimuth_deg: float) -> FloatArray:
    """(4, 4) T_camera_container of a camera that looks at the container's middle."""
    up, around = np.radians([elevation_deg, azimuth_deg])
    towards = -np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    right = np.cross(towards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(towards, right), towards])
    pose[:3, 3] = [0.0, 0.0, distance_m]
    return pose


def moved(pose: FloatArray, by_m: FloatArray, turn_deg: FloatArray) -> FloatArray:
    """A pose after a motion in the container's frame."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix()
    motion[:3, 3] = by_m
    return np.asarray(pose @ motion)


@dataclass(frozen=True)
class Squeezed:
    """depth_m: (H, W) with noise and gaps; dent_m: (H, W) true; finger: (H, W); tip_px: (2,) where it dents"""

    depth_m: FloatArray
    dent_m: FloatArray
    finger: BoolArray
    tip_px: FloatArray


def squeezed(
    model: ContainerModel,
    rest: FloatArray,
    pose: FloatArray,
    random: np.random.Generator,
    dent_m: float = 0.01,
    frayed: float = 0.0,
) -> Squeezed:
    """A finger that comes from above dents the container at the middle of what is seen of it; noise, steps of 1 mm and
    2 % of gaps. The table is where the container's foot was at rest. frayed: share of the pixels at jumps of depth
    that report what is on the other side, or something between both"""
    renderer = ModelRenderer(model, CAMERA)
    view, ray = renderer.render(pose, PIXELS), renderer.rays(PIXELS)
    on = np.isfinite(view.depth_m)
    up = rest[:3, 2]
    foot = rest[:3, 3] - up * model.size_m[2] / 2
    with np.errstate(divide="ignore"):
        table = (up @ foot) / (ray @ up)
    depth = np.where(on, view.depth_m, np.where(table > 0.0, table, np.nan))
    middle = np.rint(np.argwhere(on).mean(axis=0)).astype(int)
    point = ray * np.nan_to_num(view.depth_m)[..., None]
    away = np.linalg.norm(point - point[tuple(middle)], axis=-1)
    dent = np.where(on, dent_m * np.exp(-0.5 * (away / 0.02) ** 2), 0.0)
    finger = (np.abs(COLUMN - middle[1]) < 8) & (middle[0] > ROW)
    depth = np.where(finger, float(np.nanmin(view.depth_m)) - 0.04, depth + dent)
    far, near = (pick(depth, 3, mode="nearest") for pick in (maximum_filter, minimum_filter))
    edge = (far - near > 0.01) & (random.random(SHAPE) < frayed)
    depth = np.where(edge, near + (far - near) * np.clip(random.uniform(-0.5, 1.5, SHAPE), 0.0, 1.0), depth)
    facing = np.abs(np.einsum("hwi,hwi->hw", view.outward @ view.rotation.T, ray)) / np.linalg.norm(ray, axis=-1)
    steep = np.where(on, np.arccos(np.clip(facing, 0.0, 1.0)), 0.0)
    depth = np.round(depth + random.normal(size=SHAPE) * axial_noise_m(np.nan_to_num(depth, nan=1.0), steep), 3)
    depth[random.random(SHAPE) < 0.02] = np.nan
    return Squeezed(depth, dent, finger, middle[::-1].astype(np.float64))
