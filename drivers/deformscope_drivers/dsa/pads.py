"""The SDH's tactile pads: their names, pressures, contact areas, forces and centres of pressure from counts, and the
feature of the thesis."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from deformscope_drivers.dsa.messages import MatrixInfo, TexelArray

THUMB = 1
"""The opposing finger. Source: IPA's ROS node, which puts matrices 2 and 3 first and calls them the thumb."""


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
    def of_matrix(cls, matrix: int) -> "Pad":
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


FloatArray = npt.NDArray[np.float64]

SCHUNK_PA_PER_COUNT = 0.000473e6 / 592.1
"""Schunk's default, 0.000473 N/mm2 at 592.1 counts, "for now" by its own word. Full scale is then 3.3 kPa; use your own
calibration where pressures are to be trusted."""

CONTACT_COUNTS = 10
"""Schunk's: a texel above it is in contact."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A texel's pressure by its count, straight between the points and level outside.

    counts: (k,) rising, 2 or more; pressure_pa: (k,) never falling"""

    counts: tuple[float, ...]
    pressure_pa: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.counts) != len(self.pressure_pa) or len(self.counts) < 2:
            raise ValueError(
                f"expected as many counts as pressures, 2 or more; got {len(self.counts)}, {len(self.pressure_pa)}"
            )
        if not np.isfinite([*self.counts, *self.pressure_pa]).all():
            raise ValueError("expected finite counts and pressures; got others")
        if (np.diff(self.counts) <= 0).any() or (np.diff(self.pressure_pa) < 0).any():
            raise ValueError("expected counts that rise, and pressures that never fall; got others")

    def __call__(self, counts: TexelArray) -> FloatArray:
        """Pressures [Pa], of the counts' shape."""
        return np.interp(counts, self.counts, self.pressure_pa)


Calibration = Sequence[float | Curve]
"""For each matrix its scale [Pa per count], or its curve; a single one is used for all."""


def to_pressure(pads: Sequence[TexelArray], calibration: Calibration = (SCHUNK_PA_PER_COUNT,)) -> list[FloatArray]:
    """The pressure on each texel [Pa]. pads: (rows, columns) counts of each matrix"""
    if len(calibration) not in (1, len(pads)):
        raise ValueError(f"expected a calibration for each of {len(pads)} matrices, or one; got {len(calibration)}")
    each = calibration if len(calibration) == len(pads) else [calibration[0]] * len(pads)
    return [
        scale(counts) if isinstance(scale, Curve) else counts.astype(np.float64) * scale
        for counts, scale in zip(pads, each, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class PadContact:
    """The contact of one pad, over its loaded texels.

    area_m2: number of texels in contact times the area of a texel; force_n: along the pad's normal; peak_pa: the
    highest pressure; center_m: (x, y) centre of pressure in the pad's frame, both nan where nothing is in contact. The
    frame's origin is the middle of the pad, x along a row (columns rise), y along a column (rows rise)"""

    area_m2: float
    force_n: float
    peak_pa: float
    center_m: tuple[float, float]


def pad_contact(counts: TexelArray, pressure_pa: FloatArray, matrix: MatrixInfo) -> PadContact:
    """Contact area, force and centre of pressure of one pad.

    counts, pressure_pa: (rows, columns); a texel is in contact above `CONTACT_COUNTS`. Force is the sum of pressure
    times the area of a texel; Schunk's own software multiplies by the number of texels once more."""
    texel_m2 = matrix.texel_width_mm * matrix.texel_height_mm * 1e-6
    held = np.where(counts > CONTACT_COUNTS, pressure_pa, 0.0)
    total_pa = float(held.sum())
    area_m2 = int((counts > CONTACT_COUNTS).sum()) * texel_m2
    if total_pa <= 0.0:
        return PadContact(area_m2, 0.0, 0.0, (float("nan"), float("nan")))
    rows, columns = counts.shape
    x_m = (np.arange(columns) - (columns - 1) / 2) * matrix.texel_width_mm * 1e-3
    y_m = (np.arange(rows) - (rows - 1) / 2) * matrix.texel_height_mm * 1e-3
    center_m = float(held.sum(axis=0) @ x_m) / total_pa, float(held.sum(axis=1) @ y_m) / total_pa
    return PadContact(area_m2, total_pa * texel_m2, float(held.max()), center_m)
