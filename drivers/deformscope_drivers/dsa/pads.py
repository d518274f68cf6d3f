"""The SDH's tactile pads: their names, and the feature of the thesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

THUMB = 1
"""The opposing finger. Source: IPA's ROS node, which puts matrices 2 and 3 first and calls them the thumb."""

FEATURE_CELLS = 36
FEATURE_FINGERS = (0, 2)
"""The two fingers that turn on the common base. The thesis does not state which two fingers squeezed."""

TexelValues = npt.NDArray[np.uint16] | npt.NDArray[np.float64]


class Part(IntEnum):
    """A part of a finger. According to Schunk's naming part 0 is the proximal one; this was not checked on a hand."""

    PROXIMAL = 0
    DISTAL = 1


@dataclass(frozen=True, slots=True)
class Pad:
    """One pad, named like the hand's joints. finger: 0 to 2"""

    finger: int
    part: Part

    @classmethod
    def of_matrix(cls, matrix: int) -> Pad:
        """The pad that a matrix of the controller is on."""
        finger, part = divmod(matrix, len(Part))
        return cls(finger, Part(part))

    @property
    def matrix(self) -> int:
        """The controller's number of this pad's matrix."""
        return len(Part) * self.finger + self.part

    @property
    def name(self) -> str:
        """Name such as `finger_0_distal`; finger 1 is the thumb."""
        finger = "thumb" if self.finger == THUMB else f"finger_{self.finger}"
        return f"{finger}_{self.part.name.lower()}"


def thesis_feature(pads: Sequence[TexelValues], fingers: tuple[int, int] = FEATURE_FINGERS) -> npt.NDArray[np.float64]:
    """(72,) the first 36 texels, row by row, of the distal pads of two fingers (thesis ch. 2). pads: (rows, columns)
    layout of each matrix in the controller's order, in counts or Pa"""
    found = []
    for pad in (Pad(finger, Part.DISTAL) for finger in fingers):
        if pad.matrix >= len(pads):
            raise ValueError(f"expected a sensor with a {pad.name} pad (matrix {pad.matrix}); got {len(pads)} matrices")
        cells = np.asarray(pads[pad.matrix], np.float64).ravel()
        if cells.size < FEATURE_CELLS:
            raise ValueError(f"expected {FEATURE_CELLS} texels or more on the {pad.name} pad; got {cells.size}")
        found.append(cells[:FEATURE_CELLS])
    return np.concatenate(found)
