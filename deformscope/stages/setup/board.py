"""A ChArUco board: its picture to print, its corners in images, and the lens and the board's pose that they give."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from deformscope.arrays import FloatArray, ImageArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.setup.transform import half_widths, rigid

MARKER_SHARE = 0.75
"""Share of a square that its marker fills."""
SQUARE_PX = 120
"""Side of a square of the printed board [px]."""
FEWEST_CORNERS = 6
FEWEST_VIEWS = 6
BENDING = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
"""Only k1 and k2 of the lens are fitted: a dozen views of a board do not determine the others."""
LEAST_TILT_DEG = 4.0
"""Smallest tilt of the board over the views [degrees, RMS]: 15 degrees each way have 5 or more, one way up to 3.4."""
WIDEST = 0.1
"""Largest half interval of a focal length, as a share of it: if all views show the board from the front, they do not
separate distance and focal length."""
LENSES = (0.25, 8.0)
"""Plausible focal lengths, as a share of the image's width: a fit without information leaves this range."""


@dataclass(frozen=True, slots=True)
class CharucoSpec:
    """columns, rows: squares; square_m: side of one [m]; markers of OpenCV's 4x4 dictionary"""

    columns: int = 5
    rows: int = 4
    square_m: float = 0.05

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 12 and 3 <= self.rows <= 8 and self.square_m > 0.0):
            raise InputError("3 to 12 columns, 3 to 8 rows, squares above 0 m", f"{self}")

    @property
    def corners_m(self) -> FloatArray:
        """((columns - 1) (rows - 1), 3) inner corners in the board's frame, by number; z away from whoever sees it."""
        return np.asarray(_charuco(self).getChessboardCorners(), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoard:
    """number: (n,) number of the corners that were seen; px: (n, 2) where"""

    number: IntArray
    px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LensEstimate:
    """focal_px, center_px: (2,); distortion: (5,) OpenCV's k1, k2, p1, p2, k3
    half_px: (4,) half intervals of fx, fy, cx, cy; left_over_px: root mean square of the residuals"""

    focal_px: FloatArray
    center_px: FloatArray
    distortion: FloatArray
    half_px: FloatArray
    left_over_px: float


@cache
def _charuco(board: CharucoSpec) -> Any:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    sides = (board.columns, board.rows)
    return cv2.aruco.CharucoBoard(sides, board.square_m, MARKER_SHARE * board.square_m, markers)


def board_image(board: CharucoSpec) -> npt.NDArray[np.uint8]:
    """(H, W) the board to print, a margin of half a square around it."""
    size = ((board.columns + 1) * SQUARE_PX, (board.rows + 1) * SQUARE_PX)
    return np.asarray(_charuco(board).generateImage(size, marginSize=SQUARE_PX // 2, borderBits=1), np.uint8)


def find_board(image: ImageArray, board: CharucoSpec) -> SeenBoard | None:
    """The board's corners in an image (H, W) or (H, W, 3); None where fewer than six are seen."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found: Any = cv2.aruco.CharucoDetector(_charuco(board)).detectBoard(np.ascontiguousarray(grey))
    corners, numbers = found[:2]  # None where there are none, whatever the stubs say
    if numbers is None or len(numbers) < FEWEST_CORNERS:
        return None
    return SeenBoard(np.asarray(numbers, np.int64).reshape(-1), np.asarray(corners, np.float64).reshape(-1, 2))


def lens(views: Sequence[SeenBoard], size_px: tuple[int, int], board: CharucoSpec) -> LensEstimate:
    """Focal lengths, principal point and distortion from views of the board. size_px: (width, height) size of the
    images. Raises InputError for too few views, or a board that was not tilted."""
    if len(views) < FEWEST_VIEWS:
        raise InputError(f"{FEWEST_VIEWS} views of the board or more", str(len(views)), "12, tilted each way")
    objects = [board.corners_m[view.number].astype(np.float32) for view in views]
    images = [view.px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    found = cv2.calibrateCameraExtended(objects, images, size_px, None, None, flags=BENDING)  # type: ignore[call-overload]
    left_over, camera, distortion, turns, _, sd = found[:6]
    count = sum(2 * len(view.px) for view in views) - 6 * len(views) - 6
    half = half_widths(np.diag(np.asarray(sd, np.float64).reshape(-1)[:4] ** 2), count)
    matrix = np.asarray(camera, np.float64)
    focal = matrix[[0, 1], [0, 1]]
    unknown, share = float((half[:2] / focal).max()), focal / size_px[0]
    # Along the direction in which the board's normals vary least. The standard deviations leave out what nothing
    # determines: they are 2 px for focal lengths that are nine times too long.
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilt_deg = np.degrees(np.linalg.svd(normals - normals.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(normals)))
    if tilt_deg < LEAST_TILT_DEG or unknown > WIDEST or (share < LENSES[0]).any() or (share > LENSES[1]).any():
        came = f"tilts of {tilt_deg:.1f} degrees (RMS), and a focal length of {focal[0]:.0f} px within {half[0]:.0f} px"
        raise InputError("views of the board that is tilted by 20 degrees and more", came, "tilt it each way")
    bent = np.asarray(distortion, np.float64).reshape(-1)[:5]
    return LensEstimate(focal, matrix[:2, 2], bent, half, float(left_over))


def board_pose(
    seen: SeenBoard,
    focal_px: Sequence[float],
    center_px: Sequence[float],
    distortion: Sequence[float],
    board: CharucoSpec,
) -> FloatArray:
    """(4, 4) the board in the camera's frame. Raises InputError where its corners give no pose."""
    matrix = np.array([[focal_px[0], 0.0, center_px[0]], [0.0, focal_px[1], center_px[1]], [0.0, 0.0, 1.0]])
    bent = np.asarray(distortion if len(distortion) else np.zeros(5), np.float64)
    good, turn, way = cv2.solvePnP(board.corners_m[seen.number], seen.px, matrix, bent, flags=cv2.SOLVEPNP_ITERATIVE)
    if not good:
        raise InputError("corners of the board that give its pose", "none", "the whole board in view")
    return rigid(cv2.Rodrigues(turn)[0], np.asarray(way).reshape(3))
