"""Results between the frames of an exploration and its estimates (Thesis chapter 4): the pixels used, the surface under
a touch, the error over beta, and the training data of the fields."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.fit.estimate import Curve
from deformscope.stages.gaussian_process import Kernel
from deformscope.stages.map.force_pose import ForcePose
from deformscope.stages.regions.touches import StiffnessSample
from deformscope.stages.see.pixel_labels import PixelMasks

COARSE_GRID_M = 0.01
"""The grid around a touch of recordings without one."""

DENTED = 0.1
"""Share of the greatest depth from which a place counts as dented."""


@dataclass(frozen=True, slots=True)
class SeenDent:
    """A square of the surface around a touch, on a grid, before it and under it (Thesis 4.4).

    before, after: (p, 3) points at the same places [m]; shape: (rows, columns); cell_m: how far apart they are
    sd_m: (p,) deviation of the heights under it"""

    before: FloatArray
    after: FloatArray
    shape: tuple[int, int]
    cell_m: float = COARSE_GRID_M
    sd_m: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def sunk_m(self) -> FloatArray:
        """(p,) how far the touch lowered the surface [m]."""
        return np.asarray(self.before[:, 2] - self.after[:, 2])

    @property
    def dented_m(self) -> FloatArray:
        """(m, 2) the places that were dented [m]: all that sank by `DENTED` of the deepest."""
        sunk = self.sunk_m
        return np.asarray(self.before[sunk >= DENTED * sunk.max(), :2])


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """kernel; noise_scale: factor of the free points' noise; log_likelihood: marginal log likelihood of all points
    at_bound: those of "sigma_e", "length", "noise_scale" that ended at a bound of the search
    trials: how often the likelihood was computed"""

    kernel: Kernel
    noise_scale: float
    log_likelihood: float
    at_bound: tuple[str, ...]
    trials: int


@dataclass(frozen=True, slots=True)
class TrainedField:
    """Training data of a field of beta.

    kernel: the likeliest one, if several are averaged; noise: standard deviation of a value in addition to its own
    place_m: (n, 2) [m]; value: (n,) beta at these places; weight: (n,) 1 / variance of each"""

    kernel: Kernel
    noise: float
    place_m: FloatArray
    value: FloatArray
    weight: FloatArray


@dataclass(frozen=True, slots=True)
class TouchSurface:
    """The surface under a touch as a process of observed points and of virtual tactile points (Thesis eq. 4.3, 4.4).

    dent: heights before and under it, with deviations; tactile_m: (t, 3) [m]; learned: hyper-parameters that the
    process under touch learned"""

    dent: SeenDent
    tactile_m: FloatArray
    learned: Hyperparameters


@dataclass(frozen=True, slots=True)
class LookPerception:
    """Input of the surface before any touch. masks: None for a robot that gives points, not images
    learned: hyper-parameters of its process, from this number of points without outliers"""

    masks: PixelMasks | None
    learned: Hyperparameters
    points: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchPerception:
    """Input of a touch's estimate, and its training data; each None if missing.

    number: its number, from 1; masks: masks of its depth images, without those that did not show the surface; surface:
    under it; error: error over beta [m]. In the thesis's models it is the mean distance of simulated points from the
    nearest observed one (eq. 4.6), least at its estimate. Else it is that of particles from the points that they
    represent, while the estimate weighs these by their noise; estimate: estimated beta, one of the tried values
    stiffness: value that the map uses, with a weight of 1 / log_sd squared; beta: training data of the field of beta"""

    number: int
    masks: PixelMasks | None
    surface: TouchSurface | None
    error: Curve | None
    estimate: float | None
    stiffness: StiffnessSample | None
    beta: TrainedField | None

    @property
    def error_m(self) -> float:
        """Error at the estimate."""
        assert self.error is not None
        assert self.estimate is not None
        return float(self.error.aee[np.argmin(np.abs(self.error.parameter - self.estimate))])


Perception = LookPerception | TouchPerception | ForcePose
"""What an exploration records between frames and estimates."""
