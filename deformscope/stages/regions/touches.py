"""A touch as the estimators see it, the grid of cells that maps are drawn on, and the error model of a touch, which has
the constants of regions, fields, planner and predictions.

    log k_i = level(place_i) + own_i + scatter_i + gain + arm * arm_i

own: error of each touch alone, its deviation known from its fit (`StiffnessSample.log_sd`); scatter: from place to
place within one material, a part of which neighbours share, and from touch to touch. Its standard deviation is
*unknown*: it has a prior and is estimated from the touches, so that few of them give heavy tails; gain and arm: the
same in all touches of a session. A gain changes all levels by the same factor, and no contrast. An arm whose compliance
differs from its calibration moves touches in proportion to their stiffness (`StiffnessSample.arm_sd`: the change for
one standard deviation of the compliance).

Not modelled: the stated thickness, which affects the modulus but not apparent stiffness; and a camera's tilt, of which
2 deg change the force along the normal by 6e-4. A drifting zero of the force is subtracted in each approach; a gain
that drifts within a session (1 %) is a part of the scatter."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.gaussian_process import gaussian_between

LAW_SD = 0.02
"""Deviation of log stiffness by the error of the law: on a bonded layer the exponent grows with depth. Finite elements
of a foam that a ball sinks into by its radius say 2 to 3 %. This error is part of `own`."""

SCATTER_MEDIAN, SCATTER_SPREAD = 0.05, 0.5
"""Distribution of the scatter: log-normal, so that nine of ten materials lie between 2 and 11 %. Foam of one block
varies by some 2 to 10 % in stiffness over its length [assumed: from makers' tolerances of density, which stiffness
follows squared]. A wider spread holds more of the levels at 10 % (0.6: 0.89, this one 0.88, 0.4: 0.86; eight touches of
known regions, simulated with seeds of `studies.seeds.TUNING`), but mistakes two foams for one that scatters."""

SCATTER_SHARED, SCATTER_LENGTH_M = 0.7, 0.06
"""Share of the scatter's variance that neighbours share, with a squared exponential of this length: a foam's density
varies over some centimetres, and the rest is from touch to touch. Chosen as above, so that intervals hold both for a
scatter that is a field of 4 cm and for one of each touch. With none shared they held 0.83 and 0.84 at 10 %."""

SCATTER_VALUES = 6
SCATTER_SDS = 1.9
"""Values of the scatter in the sum, evenly in logarithms over this number of spreads either way: 2 to 13 %, each 1.5
times the one before. Ten touches determine the scatter to a factor of 1.3 at best."""

GAIN_SD = 0.03
"""Deviation of log stiffness, common to a session, if the rig file has no accuracy of the gain (`[tool] force_gain_sd`,
from `deformscope calibrate force --weight`). The error of a force sensor with its nominal sensitivity is about 3 %. It
changes the stiffness of a touch that ends by its depth, or of a flat tip, by the same share, and that at a set force
under a ball by 2 %."""


@dataclass(frozen=True, slots=True)
class TouchErrorModel:
    """Assumptions on touches. scatter_median, scatter_spread: log-normal prior of the scatter's standard deviation;
    gain_sd: common to all touches; all of log stiffness; noise_n, off_n: deviations of a
    reading and of the force of each touch, of an arm's own force [N]; 0 = those of a force sensor"""

    scatter_median: float = SCATTER_MEDIAN
    scatter_spread: float = SCATTER_SPREAD
    gain_sd: float = GAIN_SD
    noise_n: float = 0.0
    off_n: float = 0.0

    def __post_init__(self) -> None:
        if not (self.scatter_median > 0.0 and self.scatter_spread >= 0.0 and self.gain_sd >= 0.0):
            came = f"{self.scatter_median}, {self.scatter_spread}, {self.gain_sd}"
            raise InputError("a scatter above 0, a spread and a gain's deviation not below it", came)

    def scatters(self) -> tuple[FloatArray, FloatArray]:
        """Scatters (s,) to sum over and their prior probabilities (s,); one alone where its spread is 0."""
        if self.scatter_spread == 0.0:
            return np.array([self.scatter_median]), np.ones(1)
        sds = np.linspace(-SCATTER_SDS, SCATTER_SDS, SCATTER_VALUES)
        weight = np.exp(-0.5 * sds**2)
        return self.scatter_median * np.exp(self.scatter_spread * sds), weight / weight.sum()

    def related(self, xy_m: FloatArray) -> FloatArray:
        """(t, t) correlation of the scatter of touches at places (t, 2) [m]."""
        return np.asarray(self.shared(xy_m, xy_m) + (1.0 - SCATTER_SHARED) * np.eye(len(xy_m)))

    def shared(self, first_m: FloatArray, second_m: FloatArray) -> FloatArray:
        """(n, m) correlation of the part that touches at places (n, 2) and (m, 2) share [m]."""
        return np.asarray(SCATTER_SHARED * gaussian_between(first_m, second_m, SCATTER_LENGTH_M))

    @property
    def touch_sd(self) -> float:
        """Deviation of a touch from its material's level before any was made: law and scatter, the gain left out."""
        scatter, weight = self.scatters()
        return float(np.sqrt(LAW_SD**2 + weight @ scatter**2))


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
