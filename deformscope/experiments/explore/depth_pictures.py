"""The depth images of looks and dents: gathered during a look or a dwell, and the lens of their camera."""

import contextlib
from collections.abc import Iterator

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.robot.readings import ArmSample
from deformscope.robot.setup import CameraView
from deformscope.robot.touch import PhaseSpan
from deformscope_drivers.device import Device
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.images import DepthImage, Intrinsics
from deformscope_drivers.subscription import Subscription

DENT_PICTURES = 10
"""Largest number of last pictures of a dent that are combined."""
LOOKS = 3
"""Number of pictures of the surface that are combined before any touch."""
OFF_MIDDLE = 0.15
"""Largest distance of the principal point from the image's middle, as a share of width and height. Centres of real
lenses are closer to the middle, those of another resolution are farther."""


class DepthPictures:
    """The pictures that arrive while they are gathered; at other times no caller takes them, and they would count as
    lost."""

    def __init__(self) -> None:
        self._queue: Subscription[DepthImage] | None = None

    @contextlib.contextmanager
    def gathered(self, camera: Device[DepthImage] | None) -> Iterator[None]:
        """New pictures of a camera wait in the queue."""
        if camera is None:
            yield
            return
        with camera.readings() as self._queue:
            yield
        self._queue = None

    def new(self) -> list[DepthImage]:
        """Those since the last call."""
        with contextlib.suppress(DeviceError):  # what becomes of a lost camera, the supervisor decides
            return [] if self._queue is None else self._queue.take()
        return []


def dent_pictures(
    dents: list[tuple[DepthImage, ArmSample]], dwells: list[PhaseSpan]
) -> list[tuple[DepthImage, ArmSample]]:
    """The last pictures, with the arm's pose, of those taken during the last dwell."""
    return [
        (picture, pose)
        for picture, pose in dents
        if any(span.start_s <= picture.stamp.host_ns / 1e9 <= span.end_s for span in dwells[-1:])
    ][-DENT_PICTURES:]


def lens(camera: CameraView, picture: DepthImage) -> tuple[tuple[float, float], tuple[float, float]]:
    """Focal length and centre (x, y) [px]: the rig file's, else those the picture reports."""
    focal_px, center_px = camera.focal_px, camera.center_px
    if focal_px is None or center_px is None:
        focal_px, center_px = reported_lens(picture.intrinsics)
    check_center(center_px, picture.depth.shape)
    return focal_px, center_px


def check_center(center_px: tuple[float, ...], shape: tuple[int, ...]) -> None:
    """Raises InputError for a principal point (x, y) [px] that is not near the middle of images (rows, columns). A
    wrong centre belongs to another resolution, and would displace all measured points."""
    rows, columns = shape[:2]
    off = np.abs(np.asarray(center_px) - (0.5 * columns, 0.5 * rows)) / (columns, rows)
    if (off > OFF_MIDDLE).any():
        came = f"({center_px[0]:g}, {center_px[1]:g}) in images of {columns} x {rows} px"
        try_this = "focal_px and center_px for this resolution, or neither: then the camera's own values are used"
        raise InputError("[camera] center_px near the middle of its images", came, try_this)


def reported_lens(reported: Intrinsics | None) -> tuple[tuple[float, float], tuple[float, float]]:
    """Focal length and centre [px] that pictures report. Raises InputError if the rig file has to state them."""
    if reported is None:
        raise InputError("[camera] focal_px and center_px", "none, and a camera that reports none")
    if any(reported.distortion):
        came = f"none, and a camera whose images have distortion = {list(reported.distortion)}"
        raise InputError("[camera] focal_px, center_px and distortion", came, "deformscope calibrate camera")
    return (reported.fx_px, reported.fy_px), (reported.cx_px, reported.cy_px)


def times_ns(pictures: list[DepthImage]) -> IntArray:
    """When each was taken, on the host's clock (n,) [ns]."""
    return np.array([picture.stamp.host_ns for picture in pictures], np.int64)


def depths_m(pictures: list[DepthImage]) -> dict[int, FloatArray]:
    """Depth (rows, columns) [m] by time."""
    return {picture.stamp.host_ns: picture.depth_m() for picture in pictures}
