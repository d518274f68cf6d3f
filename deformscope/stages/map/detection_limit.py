"""Detection limit of touches: the largest circle without a touch, and inclusions that the map does not show.

An inclusion is a disc of some radius, twice as stiff or twice as soft as its surroundings. Its centre may be anywhere
with equal probability, if the whole inclusion is below the surface. The touches are taken to read as the map explains
them: the likelihood of an inclusion at a place follows from its effect on them (its share under a contact, as with any
region), in standard deviations of them. Therefore a touch inside excludes it, and a touch at its rim does not. Rigid
parts have no; inclusions: twice as stiff or as soft is as rigid to the arm, and no touch there would show one.
"""

from collections.abc import Iterable
from typing import cast

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.special import ndtr

from deformscope.arrays import FloatArray
from deformscope.stages.map.exploration import DetectionLimit
from deformscope.stages.regions.posterior import RegionPosterior
from deformscope.stages.regions.touches import MapGrid

INCLUSION_PRIOR = 0.5
"""Probability before any touch that there is an inclusion: as likely as not."""

INCLUSION_CONTRAST = 2.0
"""Ratio of the apparent stiffness to that of the surroundings, or its inverse."""

INCLUSION_RADII_M = (0.03, 0.045, 0.06, 0.085, 0.12)
"""Radii of the reported detection limit."""

CENTRE_CELL_M = 0.02


class UnseenInclusions:
    """Undetected inclusions of one radius, after the touches.

    probability: probability that there is one; weight: (c,) probability of each centre, 1 in total"""

    def __init__(self, posterior: RegionPosterior, radius_m: float) -> None:
        self._radius_m, self._blur_m, self._noise_sd = radius_m, posterior.prior.blur_m, posterior.touch_sd
        size = np.asarray(posterior.grid.size_m)
        centres = MapGrid(posterior.grid.size_m, CENTRE_CELL_M).centres_m
        self._centres = centres[(np.minimum(centres, size - centres) >= radius_m).all(axis=1)]
        self.weight = np.full(len(self._centres), 1.0 / max(len(self._centres), 1))
        self.probability = INCLUSION_PRIOR if len(self._centres) else 0.0
        if not len(self._centres) or not posterior.touches:
            return
        places = np.array([touch.xy_m for touch in posterior.touches])
        own = [posterior.prior.rigid_sd if touch.rigid else touch.log_sd for touch in posterior.touches]
        ratio = np.prod(self._unseen(places, np.hypot(own, posterior.scatter)[:, None]), axis=0)
        soft = 1.0 - posterior.rigid_probability(self._centres)
        ratio *= soft
        unseen = float(ratio.sum() / max(soft.sum(), 1.0))  # less than one centre is no place
        self.weight = ratio / max(float(ratio.sum()), 1e-300)  # so many touches may leave nothing at all
        self.probability = INCLUSION_PRIOR * unseen / (INCLUSION_PRIOR * unseen + 1.0 - INCLUSION_PRIOR)

    def gain(self, places_m: FloatArray) -> FloatArray:
        """(p,) probability that a touch at places (p, 2) is the first to show an inclusion."""
        return cast(FloatArray, self.probability * (1.0 - self._unseen(places_m, self._noise_sd)) @ self.weight)

    def _unseen(self, places_m: FloatArray, sd: FloatArray | float) -> FloatArray:
        """(p, c) how likely touches at places (p, 2) are to read as without an inclusion at each centre, if it is
        there."""
        share = ndtr((self._radius_m - cdist(places_m, self._centres)) / self._blur_m)
        return cast(FloatArray, np.exp(-0.5 * (np.log(INCLUSION_CONTRAST) * share / sd) ** 2))


def detection_limit(
    posterior: RegionPosterior, made_m: FloatArray, radii_m: Iterable[float] = INCLUSION_RADII_M
) -> DetectionLimit:
    """Computes the detection limit. made_m: (n, 2) places of all touches, including those without a result [m]"""
    unseen = [(radius, UnseenInclusions(posterior, radius)) for radius in sorted(set(radii_m))]
    fitting = [(radius, one.probability) for radius, one in unseen if len(one.weight)]
    radii, probabilities = np.array(fitting).reshape(-1, 2).T
    circle = largest_circle(posterior.grid, made_m)
    return DetectionLimit(*circle, radii, probabilities, contrast=INCLUSION_CONTRAST, prior=INCLUSION_PRIOR)


def largest_circle(grid: MapGrid, made_m: FloatArray) -> tuple[float, FloatArray]:
    """Radius [m] and centre (2,) [m] of the largest circle on the surface without a touch at places (n, 2) [m]."""
    size, centres = np.asarray(grid.size_m), grid.centres_m
    radius = np.minimum(centres, size - centres).min(axis=1)
    if len(made_m):
        radius = np.minimum(radius, KDTree(made_m).query(centres)[0])
    at = int(radius.argmax())
    return float(radius[at]), centres[at]
