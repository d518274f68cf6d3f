"""Planners for comparison, as `ds.TouchPlanner`: the place of maximum variance, and any place above a threshold of it.

Both look at the variance of a field of log stiffness, which depends on where was touched and never on what was found
there. `python -m studies reproduce table41 --planners regions,max-variance,random-above` compares their maps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.experiments.explore.explore import Exploration, TouchPlanner
from deformscope.stages.map.exploration import PlannedTouch
from deformscope.stages.map.plan import FieldKernel, PlanOptions
from deformscope.stages.regions.touches import MapGrid


def variance_of(planned: PlannedTouch, so_far: Exploration, kernel: FieldKernel) -> tuple[FloatArray, FloatArray]:
    """Centres of the planned cells (p, 2) [m], and the field's variance there (p,) after the touches so far, of log
    stiffness (Thesis eq. 4.4)."""
    (rows, columns), surface = planned.excluded.shape, so_far.surface
    assert surface is not None
    width = surface.height_m.shape[1] * surface.cell_m
    places = MapGrid((width, rows * width / columns), width / columns).centres_m
    touched = np.array([one.xyz_m[:2] for one in so_far.touches if one.usable]).reshape(-1, 2)
    own = kernel.covariance(touched, touched) + kernel.noise_sd**2 * np.eye(len(touched))
    across = kernel.covariance(touched, places)
    return places, kernel.sd**2 - (across * np.linalg.solve(own, across)).sum(axis=0)


@dataclass(frozen=True)
class MaximumVariance:
    """The place where the variance is largest."""

    kernel: FieldKernel = field(default_factory=FieldKernel)

    def __call__(self, planned: PlannedTouch, so_far: Exploration) -> Sequence[float] | None:
        places, variance = variance_of(planned, so_far, self.kernel)
        return tuple(places[np.argmax(np.where(planned.excluded.ravel(), -np.inf, variance))])


@dataclass(frozen=True)
class RandomAbove:
    """Any place whose variance is above a share of that before any touch (Thesis 4.2); as planned where there is none.
    seed: seed of the random choice"""

    seed: int = 0
    threshold: float = PlanOptions().threshold
    kernel: FieldKernel = field(default_factory=FieldKernel)

    def __call__(self, planned: PlannedTouch, so_far: Exploration) -> Sequence[float] | None:
        places, variance = variance_of(planned, so_far, self.kernel)
        above = ~planned.excluded.ravel() & (variance > self.threshold * self.kernel.sd**2)
        if not above.any():
            return None
        order = np.random.default_rng((self.seed, len(so_far.touches))).random(len(places))
        return tuple(places[np.argmax(np.where(above, order, -1.0))])


PLANNERS: Mapping[str, Callable[[int], TouchPlanner | None]] = {
    "regions": lambda seed: None,
    "max-variance": lambda seed: MaximumVariance(),
    "random-above": RandomAbove,
}
"""By name, from a seed; None = that of `explore`."""
