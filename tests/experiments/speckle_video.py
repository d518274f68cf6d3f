"""Images of a speckled lattice that moves as it is said to: what a camera would give of a known motion."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from deformscope.arrays import FloatArray

BORDER_PX = 24


def speckle_images(
    rest_px: FloatArray, shape: tuple[int, int], motion_px: Sequence[FloatArray], *, noise: float = 1.5, seed: int = 0
) -> Iterator[npt.NDArray[np.uint8]]:
    """The lattice at rest, then at each pose. rest_px: (rows * cols, 2), shape: rows, cols; motion_px: (rows * cols, 2)
    positions of each pose, all in image coordinates; noise: of a grey value"""
    rng = np.random.default_rng(seed)
    width, height = (int(one) + BORDER_PX for one in rest_px.max(axis=0))
    soft = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), 1.6)
    pattern = 128.0 + 40.0 * soft / soft.std()
    y, x = np.mgrid[:height, :width].astype(np.float64)
    rows, cols = rest_px[:: shape[1], 1], rest_px[: shape[1], 0]
    order = min(3, shape[0] - 1), min(3, shape[1] - 1)
    for pose in [rest_px, *motion_px]:
        moved = (pose - rest_px).reshape(*shape, 2)
        splines = [RectBivariateSpline(rows, cols, moved[..., axis], kx=order[0], ky=order[1]) for axis in (0, 1)]
        at_x, at_y = x.copy(), y.copy()
        for _ in range(30):  # where at rest that is which is seen at (x, y)
            inside = np.clip(at_y, rows[0], rows[-1]), np.clip(at_x, cols[0], cols[-1])
            at_x, at_y = x - splines[0].ev(*inside), y - splines[1].ev(*inside)
        seen = cv2.remap(pattern.astype(np.float32), at_x.astype(np.float32), at_y.astype(np.float32), cv2.INTER_CUBIC)
        yield np.clip(np.rint(seen + noise * rng.standard_normal(seen.shape)), 0, 255).astype(np.uint8)


def write_images(folder: Path, images: Iterator[npt.NDArray[np.uint8]]) -> None:
    """As files, one a frame."""
    folder.mkdir()
    for index, image in enumerate(images):
        cv2.imwrite(str(folder / f"{index:03d}.png"), image)
