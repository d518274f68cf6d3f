"""How the depth around a fingertip differs from that of the rigid container: the visual feature (Thesis ch. 2).

The sign is the thesis's: data minus model. A dent is positive, a wall that bulges towards the camera negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from deformscope.arrays import BoolArray, FloatArray
from deformscope.capsule import Capsule
from deformscope.errors import InputError
from deformscope.stages.see.cloud import Intrinsics
from deformscope.stages.see.robot import beside_capsules
from deformscope.stages.squeeze.container import ModelRenderer

SIDE_PX = 61
SMALL = 11
LARGEST_M = 0.04
"""A pixel whose depth differs by more from the model is not the container's wall."""
HAND_MARGIN_M = 0.008
"""Around the capsules that stand for the fingers: their covers, and edges that the camera frays."""


@dataclass(frozen=True, slots=True)
class DepthChange:
    """Depth of the data minus depth of the rigid model around a pixel.

    change_m: (61, 61) [m], NaN where nothing was measured; small_m: (11, 11) means of its blocks without those pixels
    center_px: (2,) column and row of its middle; width_m: how wide it is on the container's surface [m]
    missing: share of pixels without a measurement; filled_m, small_filled_m: as features, without NaN
    """

    change_m: FloatArray
    small_m: FloatArray
    center_px: FloatArray
    width_m: float
    missing: float

    @property
    def filled_m(self) -> FloatArray:
        """(3721,) row by row; a missing pixel has the value of the nearest measured one."""
        return filled(self.change_m).ravel()

    @property
    def small_filled_m(self) -> FloatArray:
        """(121,) row by row; a block without a measurement has the value of the nearest one that has."""
        return filled(self.small_m).ravel()


def depth_change(
    renderer: ModelRenderer,
    T_camera_container: FloatArray,
    depth_m: FloatArray,
    fingertip_m: FloatArray,
    *,
    excluded: BoolArray | None = None,
    side_px: int = SIDE_PX,
) -> DepthChange:
    """The patch around a fingertip (3,) [m], camera frame, in a depth image (H, W) [m]; 0 and NaN saw nothing.

    excluded: (H, W) pixels of the hand. Parts of the patch beside the image or beside the container are missing.
    Raises InputError where the fingertip is behind the camera or nothing of the patch was measured.
    """
    if side_px % 2 == 0:
        raise InputError("an odd number of pixels, so that the patch has a middle", str(side_px))
    tip = np.asarray(fingertip_m, dtype=np.float64)
    if not tip[2] > 0.0:
        raise InputError("a fingertip before the camera", f"{tip[2]:.3f} m along its axis", "check T_camera_hand")
    camera = renderer.camera
    center = np.rint(tip[:2] / tip[2] * camera.focal_px + camera.centre_px)
    offset = np.arange(side_px) - side_px // 2
    column, row = np.meshgrid(offset + int(center[0]), offset + int(center[1]))
    high, wide = depth_m.shape
    within = (column >= 0) & (column < wide) & (row >= 0) & (row < high)
    at = np.clip(row, 0, high - 1), np.clip(column, 0, wide - 1)
    model = renderer.render(T_camera_container, np.stack([column, row], axis=-1)).depth_m
    data = np.asarray(depth_m, dtype=np.float64)[at]
    with np.errstate(invalid="ignore"):
        change = data - model
        seen = within & (data > 0.0) & (np.abs(change) < LARGEST_M)
    if excluded is not None:
        seen &= ~excluded[at]
    if not seen.any():
        raise InputError("the container around the fingertip", "no pixel of it", "check T_camera_hand and the camera")
    change = np.where(seen, change, np.nan)
    on = float(np.nanmedian(np.where(seen, model, np.nan)))
    return DepthChange(
        change, _block_means(change), center, side_px * on / float(np.mean(camera.focal_px)), float(np.mean(~seen))
    )


def hand_pixels(
    depth_m: FloatArray, camera: Intrinsics, links: Sequence[Capsule], margin_m: float = HAND_MARGIN_M
) -> BoolArray:
    """(H, W) pixels whose points lie in the hand's links, camera frame, or within a margin of them [m]."""
    depth = np.asarray(depth_m, dtype=np.float64)
    covered = np.zeros(depth.shape, dtype=bool)
    for link in links:
        part = _window(link, camera, margin_m, (depth.shape[0], depth.shape[1]))
        row, column = np.nonzero(np.isfinite(depth[part]) & (depth[part] > 0.0))
        row, column = row + part[0].start, column + part[1].start
        z = depth[row, column]
        pixel = np.column_stack([column, row])
        point = np.column_stack([(pixel - camera.centre_px) / camera.focal_px * z[:, None], z])
        covered[row, column] |= ~beside_capsules(point, [link], margin_m=margin_m)
    return covered


def _window(link: Capsule, camera: Intrinsics, margin_m: float, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of an image (H, W) in which a link can be seen: all of them where it is beside the camera."""
    ends, reach = np.stack([link.start_m, link.end_m]), link.radius_m + margin_m
    if (ends[:, 2] <= 2.0 * reach).any():
        return slice(0, shape[0]), slice(0, shape[1])
    found = []
    for axis in (1, 0):
        across = ends[:, [axis, 2]]
        middle, half = np.arctan2(*across.T), np.arcsin(reach / np.linalg.norm(across, axis=1))
        low, high = np.tan((middle - half).min()), np.tan((middle + half).max())
        first, last = np.array([low, high]) * camera.focal_px[axis] + camera.centre_px[axis]
        found.append(slice(max(int(first), 0), min(max(int(last) + 2, 0), shape[1 - axis])))
    return found[0], found[1]


def around(center_px: FloatArray, shape: tuple[int, int], radius_px: float) -> BoolArray:
    """(H, W) pixels within a distance of a pixel (column, row): where a finger dents the wall, which is not rigid."""
    column, row = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    return np.asarray(np.hypot(column - center_px[0], row - center_px[1]) <= radius_px)


def _block_means(change: FloatArray) -> FloatArray:
    edge = np.rint(np.linspace(0, len(change), SMALL + 1)).astype(int)
    count = np.add.reduceat(np.add.reduceat(np.isfinite(change), edge[:-1], axis=0, dtype=int), edge[:-1], axis=1)
    total = np.add.reduceat(np.add.reduceat(np.nan_to_num(change), edge[:-1], axis=0), edge[:-1], axis=1)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def filled(values: FloatArray) -> FloatArray:
    """The same, a missing value (NaN) that of the nearest measured one; at least one has to be measured."""
    nearest = distance_transform_edt(~np.isfinite(values), return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
