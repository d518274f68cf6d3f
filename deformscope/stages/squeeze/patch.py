"""Difference of the depth around a fingertip from that of the rigid container: the visual feature (Thesis ch. 2).

The sign is the thesis's: data minus model. A dent is positive, a wall that bulges towards the camera negative."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter
from scipy.sparse import csc_array, diags_array, kronsum
from scipy.sparse.linalg import spsolve

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.solid import Capsule
from deformscope.stages.see.cloud import Intrinsics, axial_noise_m
from deformscope.stages.see.robot import outside_capsules
from deformscope.stages.squeeze.container import BULGE_M, ModelRenderer, ModelView
from deformscope.stages.squeeze.track import FLATTEST, JUMP_M

SIDE_PX = 61
SMALL = 11
CLOSED_M = 0.03
"""Largest closing of the fingertips after the first contact: `over_squeeze_m` in [squeeze]."""
SURE = 5.0
"""Limits in standard deviations of noise, and of the walls' bulge, beyond which a pixel is not the wall."""
OUTLINE_PX = 2
"""Distance in pixels from an outline, of the model or of the hand, within which a camera may see either side, or a
value between them: outlines are seen within 1.5 px (`track.EDGE_NOISE_PX`)."""
LOCAL_PX = 5
"""Side of the window whose median a pixel is compared with."""
LEAST_SEEN = 0.1
"""Smallest measured share of the patch, from which the rest is filled. Chosen."""
HAND_MARGIN_M = 0.008
"""Around the capsules that stand for the fingers: their covers, and edges that the camera frays."""


@dataclass(frozen=True, slots=True)
class DepthChange:
    """Depth of the data minus depth of the rigid model around a pixel.

    change_m: (61, 61) [m], NaN where nothing was measured; small_m: (11, 11) means of its blocks without those pixels
    center_px: (2,) column and row of its middle; width_m: how wide it is on the container's surface [m]
    missing: share of pixels without a measurement of the wall; noise_m: deviation of a measured pixel, root mean square
    small_filled_m: the coarse map as features, without NaN"""

    change_m: FloatArray
    small_m: FloatArray
    center_px: FloatArray
    width_m: float
    missing: float
    noise_m: float

    @property
    def small_filled_m(self) -> FloatArray:
        """(121,) row by row; blocks without a measurement as in `filled`."""
        return filled(self.small_m).ravel()


def depth_change(
    renderer: ModelRenderer,
    T_camera_container: FloatArray,
    depth_m: FloatArray,
    fingertip_m: FloatArray,
    *,
    excluded: BoolArray | None = None,
    closed_m: float = CLOSED_M,
) -> DepthChange:
    """The patch around a fingertip (3,) [m], camera frame, in a depth image (H, W) [m]; 0 and NaN saw nothing.

    excluded: (H, W) pixels of the hand; closed_m: distance that the fingers have closed since first contact. Missing
    are pixels outside the image or the container, within OUTLINE_PX of an outline, at grazing angles, farther from the
    model than a wall can be, or far from the pixels around it. A wall is pressed in by `closed_m` at most, and bulges
    by `SURE` times `BULGE_M` at most. Raises InputError where the fingertip is behind the camera or less than
    LEAST_SEEN of the patch was measured."""
    tip = np.asarray(fingertip_m, dtype=np.float64)
    if not tip[2] > 0.0:
        raise InputError("a fingertip before the camera", f"{tip[2]:.3f} m along its axis", "check T_camera_hand")
    camera = renderer.camera
    center = np.rint(tip[:2] / tip[2] * camera.focal_px + camera.centre_px)
    offset = np.arange(-OUTLINE_PX, SIDE_PX + OUTLINE_PX) - SIDE_PX // 2
    column, row = np.meshgrid(offset + int(center[0]), offset + int(center[1]))
    high, wide = depth_m.shape
    within = (column >= 0) & (column < wide) & (row >= 0) & (row < high)
    at = np.clip(row, 0, high - 1), np.clip(column, 0, wide - 1)
    pixels = np.stack([column, row], axis=-1)
    view = renderer.render(T_camera_container, pixels)
    wall, cosine = _wall(view, renderer.rays(pixels), None if excluded is None else excluded[at])
    inner = (slice(OUTLINE_PX, -OUTLINE_PX),) * 2
    model, cosine = view.depth_m[inner], cosine[inner]
    noise = axial_noise_m(model, np.arccos(cosine))
    data = np.asarray(depth_m, dtype=np.float64)[at][inner]
    with np.errstate(invalid="ignore"):
        change = np.where((within & wall)[inner] & (data > 0.0), data - model, np.nan)
        inward = change * cosine
        change[(inward > closed_m + BULGE_M + SURE * noise) | (inward < -SURE * (BULGE_M + noise))] = np.nan
        windows = sliding_window_view(np.pad(change, LOCAL_PX // 2, constant_values=np.nan), (LOCAL_PX, LOCAL_PX))
        local = median_of(np.moveaxis(windows.reshape(*change.shape, -1), -1, 0))
        change[np.abs(change - local) > SURE * noise] = np.nan
    seen = np.isfinite(change)
    if seen.mean() < LEAST_SEEN:
        least = f"{LEAST_SEEN:.0%} of the container around the fingertip measured"
        raise InputError(least, f"{seen.mean():.1%}", "check T_camera_hand and the camera")
    width_m = SIDE_PX * float(np.median(model[seen])) / float(np.mean(camera.focal_px))
    deviation = float(np.sqrt(np.mean(noise[seen] ** 2)))
    return DepthChange(change, _block_means(change), center, width_m, float(np.mean(~seen)), deviation)


def _wall(view: ModelView, ray: FloatArray, hand: BoolArray | None) -> tuple[BoolArray, FloatArray]:
    """Pixels (n, n) that see the wall whole, away from outlines, and the cosine of ray (n, n, 3) and wall."""
    known = np.isfinite(view.depth_m)
    normal = np.where(known[..., None], view.outward, 1.0) @ view.rotation.T
    cosine = np.clip(np.abs(np.einsum("ijk,ijk->ij", normal, ray)) / np.linalg.norm(ray, axis=-1), 0.0, 1.0)
    far, near = (np.where(known, view.depth_m, beyond) for beyond in (-np.inf, np.inf))
    edge = ~known | (maximum_filter(far, 3) - minimum_filter(near, 3) > JUMP_M)
    if hand is not None:
        edge |= hand
    around = np.ones((2 * OUTLINE_PX + 1,) * 2, bool)
    return ~binary_dilation(edge, around) & (cosine > FLATTEST), cosine


def median_of(values: FloatArray) -> FloatArray:
    """(...) medians of (k, ...) over the first axis without NaN; NaN where there is nothing else."""
    ranked = np.sort(values, axis=0)  # NaN last
    count = np.isfinite(ranked).sum(axis=0)
    low, high = (
        np.take_along_axis(ranked, np.maximum(at, 0)[None], axis=0)[0] for at in ((count - 1) // 2, count // 2)
    )
    return np.where(count > 0, 0.5 * (low + high), np.nan)


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
        covered[row, column] |= ~outside_capsules(point, [link], margin_m=margin_m)
    return covered


def _window(link: Capsule, camera: Intrinsics, margin_m: float, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of an image (H, W) that may show a link: all of them if it is next to the camera."""
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
    covered = np.zeros(shape, dtype=bool)
    low = np.clip(np.floor(center_px - radius_px).astype(int), 0, shape[::-1])
    high = np.clip(np.ceil(center_px + radius_px).astype(int) + 1, 0, shape[::-1])
    aside, down = np.arange(low[0], high[0]) - center_px[0], np.arange(low[1], high[1]) - center_px[1]
    covered[low[1] : high[1], low[0] : high[0]] = np.hypot(aside, down[:, None]) <= radius_px
    return covered


def _block_means(change: FloatArray) -> FloatArray:
    """(SMALL, SMALL) means over blocks of an image (h, w) without NaN."""
    edge = np.rint(np.linspace(0, len(change), SMALL + 1)).astype(int)
    count = np.add.reduceat(np.add.reduceat(np.isfinite(change), edge[:-1], axis=0, dtype=int), edge[:-1], axis=1)
    total = np.add.reduceat(np.add.reduceat(np.nan_to_num(change), edge[:-1], axis=0), edge[:-1], axis=1)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def filled(values: FloatArray) -> FloatArray:
    """The map (n, m) with missing values (NaN) replaced by a membrane through the measured ones, of which there must be
    at least one. The new values are within the range of the measured ones, and each is the mean of its neighbours
    (Laplace's equation)."""
    found, known = values.ravel().copy(), np.isfinite(values).ravel()
    if not known.all():
        membrane = _membrane(*values.shape)[~known]
        found[~known] = spsolve(membrane[:, ~known], -membrane[:, known] @ found[known])
    return found.reshape(values.shape)


@cache
def _membrane(rows: int, columns: int) -> csc_array:
    """The Laplacian of a grid with free edges, last axis fastest."""
    across, down = (
        diags_array([-np.ones(n - 1), np.r_[1.0, np.full(n - 2, 2.0), 1.0], -np.ones(n - 1)], offsets=[-1, 0, 1])
        for n in (columns, rows)
    )
    return csc_array(kronsum(across, down))
