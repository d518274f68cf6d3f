"""The field of beta as in the thesis: a process through all dented places, each with its touch's beta (4.1 to 4.4).

    field = ThesisField().with_touch(dented_m, beta)
    found = field.on(grid)                     # mean and deviation (eq. 4.3, 4.4)
    regions = contoured(field, grid)           # cut along isopleths

Unlike `deformscope.stages.map.field` it has mean 0 and fixed hyper-parameters, and treats the places of one dent as
independent measurements. Its variance shows the distance from dents, not the uncertainty of beta.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import ndtr
from threadpoolctl import threadpool_limits

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.gaussian_process import Kernel, ProcessPrediction
from deformscope.stages.map.field import FieldMap
from deformscope.stages.regions.touches import MapGrid

SIGMA_E, SIGMA_W_M, SIGMA_N = 1.0, 0.6, 0.05
"""Parameters of the kernel (eq. 4.5), and the noise. The thesis prints none of them ("empirically estimated based on a
set of experiments"). With this sigma_e, Th = 0.06 is a share of the variance before any touch. sigma_w determines n =
3. It was chosen on tuning seeds (`studies.seeds`) such that 60 x 40 cm of one foam take the 3 touches of its table 4.1,
where a touch dents a circle of 2.3 cm, on a grid of 1 cm. They take 4 to 6 at 0.5 m, 5 to 7 at 0.4 m."""

FINE_SIGMA_W_M = 0.5
"""sigma_w on the thesis's grid of 0.5 cm, on which a dent has four times as many places, each of which counts as a
measurement: 3 touches for 21 of 24 tuning seeds, 4 for the others (0.6 m: 2 for 5 of them; 0.45 m: 4 to 6 for 23)."""

FIRST_SHARE = (0.25, 0.5)
"""Default place of the first touch, in shares of the surface: one is preset (Thesis 4.5)."""

APART = 0.1
"""Touches whose betas are farther apart have an isopleth between them: ten steps of the sweep of Algorithm 3."""


@dataclass(frozen=True, slots=True)
class ThesisField:
    """places_m: (n, 2) dented places of all touches [m]; beta: (n,) beta of their touches
    touches: beta of each touch; dented: number of places dented by each touch; width_m: sigma_w of the kernel"""

    places_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    beta: FloatArray = field(default_factory=lambda: np.zeros(0))
    touches: tuple[float, ...] = ()
    dented: tuple[int, ...] = ()
    width_m: float = SIGMA_W_M

    def with_touch(self, dented_m: FloatArray, beta: float) -> ThesisField:
        """The field after a touch that dented places (m, 2) [m]."""
        return dataclasses.replace(
            self,
            places_m=np.concatenate([self.places_m, dented_m]),
            beta=np.concatenate([self.beta, np.full(len(dented_m), beta)]),
            touches=(*self.touches, beta),
            dented=(*self.dented, len(dented_m)),
        )

    def at(self, places_m: FloatArray) -> ProcessPrediction:
        """Mean (m,) and deviation (m,) at places (m, 2) [m] (Thesis eq. 4.3 and 4.4)."""
        kernel = Kernel(SIGMA_E, self.width_m)
        if not len(self.places_m):
            return ProcessPrediction(np.zeros(len(places_m)), np.full(len(places_m), SIGMA_E))
        with threadpool_limits(1):
            own = kernel.between(self.places_m, self.places_m) + SIGMA_N**2 * np.eye(len(self.places_m))
            factor = cholesky(own, lower=True)
            across = kernel.between(self.places_m, places_m)
            mean = across.T @ cho_solve((factor, True), self.beta)
            variance = SIGMA_E**2 - np.sum(solve_triangular(factor, across, lower=True) ** 2, axis=0)
        return ProcessPrediction(mean, np.sqrt(variance.clip(0.0)))

    def on(self, grid: MapGrid) -> FieldMap:
        """Mean and deviation at the centres of a grid's cells."""
        found = self.at(grid.centres_m)
        return FieldMap(grid, found.mean.reshape(grid.shape), found.deviation.reshape(grid.shape))

    @property
    def isopleths(self) -> FloatArray:
        """(k,) rising levels of beta that divide the field: halfway between touches that are apart."""
        betas = np.sort(self.touches)
        gaps = np.flatnonzero(np.diff(betas) > APART)
        return np.asarray(0.5 * (betas[gaps] + betas[gaps + 1]))


@dataclass(frozen=True, slots=True)
class Contoured:
    """The field cut along its isopleths. labels: (rows, columns) regions, 0 that of the largest beta; probability:
    (rows, columns) probability that beta is between the isopleths of its label, by the field's variance"""

    labels: IntArray
    probability: FloatArray


def contoured(found: FieldMap, isopleths: FloatArray) -> Contoured:
    """The regions between rising isopleths (k,); regions without a cell are left out."""
    band = np.searchsorted(isopleths, found.mean)
    ends = np.concatenate([[-np.inf], isopleths, [np.inf]])
    sd = np.maximum(found.deviation, 1e-12)
    probability = ndtr((ends[band + 1] - found.mean) / sd) - ndtr((ends[band] - found.mean) / sd)
    labels = np.unique(-band, return_inverse=True)[1]
    return Contoured(labels.reshape(band.shape).astype(np.int64), probability)
