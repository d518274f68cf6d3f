"""Labels of pixels of depth images: whether each was used, or by which rule it was left out."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from deformscope.arrays import BoolArray, IntArray

LabelArray = npt.NDArray[np.uint8]


class PixelLabel(IntEnum):
    """Each pixel of a depth image has one of these.

    ROBOT_CAPSULE, ROBOT_SOLID: inside the robot's capsules or meshes; HANGING: a mixed depth at the robot's edge
    LONE: a statistical outlier (`cloud.not_alone`); MISFIT: too far from the surface's process (`fit_surface`)"""

    NOTHING_SEEN = 0
    USED = 1
    OUTSIDE_THE_BOX = 2
    ROBOT_CAPSULE = 3
    ROBOT_SOLID = 4
    HANGING = 5
    LONE = 6
    MISFIT = 7


@dataclass(frozen=True, slots=True)
class PixelMasks:
    """The labels of depth images as runs of equal ones, row by row, image after image.

    camera, depth_ns (k,): the images, named as in `LookFrames`; shape: (rows, columns) shape of each
    label, length: (r,) label and length of each run; runs: (k,) number of runs in each image"""

    camera: str
    depth_ns: IntArray
    shape: tuple[int, int]
    label: LabelArray
    length: npt.NDArray[np.int32]
    runs: IntArray

    def decode(self, image: int) -> LabelArray:
        """(rows, columns) the `PixelLabel` of each pixel of one of the images."""
        last = np.cumsum(self.runs)[image]
        some = slice(last - self.runs[image], last)
        return np.repeat(self.label[some], self.length[some]).reshape(self.shape)


@dataclass(frozen=True, slots=True)
class SeenPixels:
    """The labels of depth images, and where their points went.

    camera, depth_ns (k,): as in `PixelMasks`; label: (k, rows, columns) `PixelLabel`
    point: (n,) point of each used pixel in turn, which of the points it is a part of"""

    camera: str
    depth_ns: IntArray
    label: LabelArray
    point: IntArray

    def masks(self, fits: BoolArray | None = None) -> PixelMasks:
        """Labels as runs of equal ones. fits: (m,) points that are no outliers of the surface's process, None = all"""
        label, (_, rows, columns) = self.label.copy(), self.label.shape
        if fits is not None:
            label[label == PixelLabel.USED] = np.where(fits[self.point], PixelLabel.USED, PixelLabel.MISFIT)
        flat = label.reshape(len(label), -1)
        begins = np.ones(flat.shape, dtype=np.bool_)
        begins[:, 1:] = flat[:, 1:] != flat[:, :-1]
        place = np.flatnonzero(begins)
        return PixelMasks(
            camera=self.camera,
            depth_ns=self.depth_ns,
            shape=(rows, columns),
            label=flat.ravel()[place],
            length=np.diff(place, append=flat.size).astype(np.int32),
            runs=begins.sum(axis=1),
        )
