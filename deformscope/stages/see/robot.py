"""Which points belong to the robot, and which are false points between the robot and its background.

The robot is known from where the arm reports that it is, as capsules and as solids. A camera that triangulates mixes
depths at the edges of near objects: pixels there may have any depth between both."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from deformscope.arrays import BoolArray, FloatArray
from deformscope.solid import Capsule, PosedSolid
from deformscope.stages.see.pixel_labels import LabelArray, PixelLabel

EDGE_PX = 3
"""Largest distance from a jump of depth at which a pixel may be mixed: both of today's kinds of camera bleed over 2."""
JUMP_M = 0.02
"""Jump of depth between pixels: a surface that is seen obliquely changes by less."""
HOVER_M = 0.006
"""At jumps of depth, points this far above the surrounding surface are false."""
CELL_M = 0.01
"""Cell size of the grid of the surface's height."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedRobot:
    """The robot at one moment, in the frame of the points.

    capsules: its capsules, with margin_m around them; solids: its solids, with margin_m and solid_margin_m around them
    [m]; aligns: its solids include all its visible parts, so that they may first be aligned with the picture
    mixes: depths are mixed at its edges, and what hangs in the air there counts as the robot's"""

    capsules: Sequence[Capsule] = ()
    solids: Sequence[PosedSolid] = ()
    margin_m: float = 0.0
    solid_margin_m: float = 0.0
    aligns: bool = False
    mixes: bool = False


NO_ROBOT = PosedRobot()


def label_robot(points: FloatArray, robot: PosedRobot, depth_m: FloatArray, used: BoolArray) -> LabelArray:
    """(n,) `PixelLabel` of points: USED, or by which rule they are the robot's. depth_m: (H, W) depth image of the
    points [m]; used: (m,) which of the valid pixels, row by row, they are"""
    label = np.full(len(points), PixelLabel.USED, np.uint8)
    label[~outside_capsules(points, robot.capsules, margin_m=robot.margin_m)] = PixelLabel.ROBOT_CAPSULE
    left = np.flatnonzero(label == PixelLabel.USED)
    outside = outside_solids(points[left], robot.solids, margin_m=robot.solid_margin_m + robot.margin_m)
    label[left[~outside]] = PixelLabel.ROBOT_SOLID
    if robot.mixes:
        left = left[outside]
        mixed = at_jumps(depth_m)[measured(depth_m)][used]
        label[left[~standing(points[left], mixed[left])]] = PixelLabel.HANGING
    return label


def measured(depth_m: FloatArray) -> BoolArray:
    """(H, W) pixels that saw something."""
    return np.asarray(np.isfinite(depth_m) & (np.asarray(depth_m) > 0.0))


def outside_capsules(points: FloatArray, links: Sequence[Capsule], *, margin_m: float = 0.01) -> BoolArray:
    """(n,) points that lie outside every link by more than a margin [m]."""
    outside = np.ones(len(points), dtype=bool)
    if not len(points):
        return outside
    low, high = points.min(axis=0), points.max(axis=0)
    for link in links:
        ends, reach_m = np.array([link.start_m, link.end_m]), link.radius_m + margin_m
        if (ends.min(axis=0) - reach_m > high).any() or (ends.max(axis=0) + reach_m < low).any():
            continue
        along = np.asarray(link.end_m) - np.asarray(link.start_m)
        share = ((points - link.start_m) @ along / max(float(along @ along), 1e-30)).clip(0.0, 1.0)
        away = np.linalg.norm(points - link.start_m - share[:, None] * along, axis=1)
        outside &= away > link.radius_m + margin_m
    return outside


def outside_solids(points: FloatArray, solids: Sequence[PosedSolid], *, margin_m: float) -> BoolArray:
    """(n,) points that lie outside every solid by more than a margin [m]."""
    outside = np.ones(len(points), dtype=bool)
    if not solids or not len(points):
        return outside
    middle = np.array([one.ball[0] for one in solids])
    reach = np.array([one.ball[1] + margin_m for one in solids])
    low, high = points.min(axis=0), points.max(axis=0)
    away = np.linalg.norm(middle - np.clip(middle, low, high), axis=1)
    for number in np.flatnonzero(away <= reach).tolist():
        T, solid = solids[number].T_world_solid, solids[number].solid
        apart = points - middle[number]
        near = np.flatnonzero(outside & (np.einsum("ij,ij->i", apart, apart) <= reach[number] ** 2))
        if len(near):
            outside[near] = ~solid.near((points[near] - T[:3, 3]) @ T[:3, :3], margin_m)
    return outside


def at_jumps(depth_m: FloatArray) -> BoolArray:
    """(H, W) pixels within `EDGE_PX` of a jump of depth (H, W) [m]; 0 and NaN saw nothing, and are no jump."""
    import cv2

    depth = np.nan_to_num(depth_m, nan=0.0).astype(np.float32)
    adjacent = np.ones((3, 3), np.uint8)
    far = cv2.dilate(depth, adjacent)
    near = -cv2.dilate(np.where(depth > 0.0, -depth, -np.float32(np.inf)), adjacent)
    jump = ((far - near) > JUMP_M).astype(np.uint8)
    side = 2 * EDGE_PX - 1
    return np.asarray(cv2.dilate(jump, np.ones((side, side), np.uint8)) > 0)


def standing(points: FloatArray, mixed: BoolArray) -> BoolArray:
    """(n,) points that do not hang in the air. mixed: (n,) possibly of mixed depth; these count if they are at most
    `HOVER_M` above the mean of the others around them, as seen from above, or have none around them"""
    stands = np.ones(len(points), dtype=bool)
    if not mixed.any() or mixed.all():
        return stands
    import cv2

    low = points[:, :2].min(axis=0)
    column, row = (np.floor((points[:, :2] - low) / CELL_M).astype(np.int64)).T
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    cell = row * shape[1] + column
    sound = ~mixed
    count = np.bincount(cell[sound], minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    total = np.bincount(cell[sound], points[sound, 2], shape[0] * shape[1]).reshape(shape)
    height = np.full(shape, np.nan)
    for side in (3, 7, 15):
        # an unnormalised sum over the cells around, wider where there was nothing
        around = partial(cv2.boxFilter, ddepth=-1, ksize=(side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        counted, summed = around(count), around(total)
        wanted = np.isnan(height) & (counted > 0.5)
        height[wanted] = summed[wanted] / counted[wanted]
    above = points[mixed, 2] - height.ravel()[cell[mixed]]
    stands[mixed] = ~(above > HOVER_M)
    return stands
