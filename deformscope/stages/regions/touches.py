"""A touch as the estimators see it, and the grid of cells that maps are drawn on."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError

FIRST_REGIONS = 3
"""Largest number of regions of the maps that are followed from the first touch."""


@dataclass(frozen=True, slots=True)
class StiffnessSample:
    """Measurement of one touch at a place.

    xy_m: (2,) place in the surface frame [m]; log_stiffness: natural log of the apparent stiffness at the set force
    [N/mm]; log_sd: its standard deviation due to the errors of this touch alone; rigid: the dent was below the arm's
    resolution: `log_stiffness` is a lower bound; arm_sd: its increase if the arm were stiffer by one deviation of its
    calibration, an error that all touches of a session share
    exponent, exponent_sd: exponent and deviation of the law of force over depth, if it was free, and exponent_related:
    covariance of its error and log_stiffness's; None if it was not"""

    xy_m: FloatArray
    log_stiffness: float
    log_sd: float
    rigid: bool = False
    arm_sd: float = 0.0
    exponent: float | None = None
    exponent_sd: float = 0.0
    exponent_related: float = 0.0

    def __post_init__(self) -> None:
        if np.shape(self.xy_m) != (2,) or not np.isfinite(self.xy_m).all():
            raise InputError("a finite place (x, y) of the touch [m]", f"{np.asarray(self.xy_m).tolist()}")
        if not np.isfinite(self.log_stiffness):
            raise InputError("a finite log stiffness", f"{self.log_stiffness}")
        if not (np.isfinite(self.log_sd) and self.log_sd > 0.0):
            raise InputError("a standard deviation of log stiffness above 0", f"{self.log_sd}")
        if not (np.isfinite(self.arm_sd) and self.arm_sd >= 0.0):
            raise InputError("a shift of log stiffness for the arm's sake, 0 or more", f"{self.arm_sd}")


@dataclass(frozen=True, slots=True)
class MapGrid:
    """Square cells over a surface from (0, 0) to `size_m` [m], 5 mm wide unless set otherwise (Thesis 4.4); arrays
    have a row for each y, a column for each x."""

    size_m: tuple[float, float] = (0.60, 0.40)
    cell_m: float = 0.005

    def __post_init__(self) -> None:
        if not (self.cell_m > 0.0 and all(np.isfinite(side) and side >= 2.0 * self.cell_m for side in self.size_m)):
            raise InputError("a surface of two cells or more a side", f"{self.size_m} m in cells of {self.cell_m} m")

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return round(self.size_m[1] / self.cell_m), round(self.size_m[0] / self.cell_m)

    @property
    def centres_m(self) -> FloatArray:
        """(rows * columns, 2) centres of the cells (x, y), row by row [m]."""
        rows, columns = self.shape
        x, y = np.meshgrid((np.arange(columns) + 0.5) * self.cell_m, (np.arange(rows) + 0.5) * self.cell_m)
        return np.column_stack([x.ravel(), y.ravel()])
