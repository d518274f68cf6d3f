"""Pose and projection of a camera, from views of a ChArUco board that the arm carries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.board import CharucoSpec, LensEstimate, SeenBoard, board_pose, lens
from deformscope.stages.setup.hand_eye import HandEye, hand_eye, jackknifed
from deformscope.stages.setup.transform import TransformEstimate


@dataclass(frozen=True, slots=True, eq=False)
class CameraEstimate:
    """mount: where camera and board are; lens: the fitted lens, None if it was given"""

    mount: HandEye
    lens: LensEstimate | None


@dataclass(frozen=True, slots=True)
class KnownLens:
    """Projection of a camera. focal_px, center_px: (x, y); distortion: OpenCV's k1, k2, p1, p2, k3"""

    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    distortion: tuple[float, ...] = ()


def camera_from_views(
    T_base_ee: FloatArray,
    views: Sequence[SeenBoard],
    size_px: tuple[int, int],
    board: CharucoSpec,
    known: KnownLens | None = None,
) -> CameraEstimate:
    """Camera, board and, unless it is known, the lens, from views with the arm's end (n, 4, 4) in each.

    If the lens is fitted too, the fit is repeated without each view, so that the camera's intervals include the lens's
    uncertainty. Raises InputError as `lens` and `hand_eye` do."""
    if len(T_base_ee) != len(views):
        raise InputError("a view for each pose", f"{len(views)} views, {len(T_base_ee)} poses")
    if known is not None:
        return CameraEstimate(hand_eye(T_base_ee, _poses(views, known, board)), None)
    whole, found = _all(T_base_ee, views, size_px, board)
    X, Y = whole.T_arm_camera, whole.T_ee_board
    off = []
    for index in range(len(views)):
        others = [*views[:index], *views[index + 1 :]]
        without, _ = _all(np.delete(T_base_ee, index, axis=0), others, size_px, board)
        off.append([*X.deviation(without.T_arm_camera.T), *Y.deviation(without.T_ee_board.T)])
    return CameraEstimate(jackknifed(X.T, Y.T, np.array(off), whole.off), found)


def _all(
    T_base_ee: FloatArray, views: Sequence[SeenBoard], size_px: tuple[int, int], board: CharucoSpec
) -> tuple[HandEye, LensEstimate]:
    found = lens(views, size_px, board)
    focal, center = (tuple(map(float, pair)) for pair in (found.focal_px, found.center_px))
    used = KnownLens((focal[0], focal[1]), (center[0], center[1]), tuple(map(float, found.distortion)))
    return hand_eye(T_base_ee, _poses(views, used, board)), found


def _poses(views: Sequence[SeenBoard], known: KnownLens, board: CharucoSpec) -> FloatArray:
    """(n, 4, 4) pose of the board in the camera's frame in each view [m]."""
    return np.array([board_pose(view, known.focal_px, known.center_px, known.distortion, board) for view in views])


def doubt_at(T_arm_camera: TransformEstimate, place_m: FloatArray) -> float:
    """How far off a place (3,) [m, base frame] may be seen: half its interval, along the direction of the widest."""
    arm_m = np.asarray(place_m, np.float64) - T_arm_camera.T[:3, 3]
    turned = -np.array([[0.0, -arm_m[2], arm_m[1]], [arm_m[2], 0.0, -arm_m[0]], [-arm_m[1], arm_m[0], 0.0]])
    J = np.hstack([np.eye(3), turned])
    spread = np.linalg.eigvalsh(J @ T_arm_camera.covariance @ J.T)[-1]
    whole = np.diag(T_arm_camera.covariance)
    return float(np.sqrt(max(spread, 0.0) / whole[0]) * T_arm_camera.half()[0]) if whole[0] > 0.0 else 0.0
