"""View of a body in space: its moved part, and the magnification of its heights."""

from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.pictures.palette import round_down
from deformscope.stages.fit.estimate import Comparison
from deformscope.stages.see.triangulation import is_surface, spacing_of

STIRRED = 0.05
"""Share of the largest motion from which a particle is shown."""

ROOM, LEAST = 1.5, 8.0
"""Side of the picture: a multiple of the moved part, and at least this number of spacings."""

RELIEF = 0.25
"""Share of the picture's side that heights should fill."""

THIN = 0.3
"""If a surface's heights span less than this share of its sides, it is shown from above and its heights may be
magnified."""


@dataclass(frozen=True, slots=True)
class CloseUp:
    """The part of a body that is shown.

    low, high: (3,) its corners [unit]; heights: how many times z is drawn out; surface: a layer seen from above"""

    low: FloatArray
    high: FloatArray
    heights: float = 1.0
    surface: bool = False

    @property
    def middle(self) -> FloatArray:
        """(d,) middle of the region, in the frame and unit of `low` and `high`."""
        return np.asarray(0.5 * (self.low + self.high))

    def holds(self, position: FloatArray) -> IntArray:
        """Which of (K, 3) positions lie next to or inside it, seen from above."""
        grace = 1e-6 * (self.high - self.low)[:2]
        inside = (position[:, :2] >= self.low[:2] - grace) & (position[:, :2] <= self.high[:2] + grace)
        return np.flatnonzero(inside.all(axis=1))


def close_up(comparison: Comparison) -> CloseUp:
    """The whole of a volume; for a surface, the surroundings of the moved part, with magnified heights."""
    rest = comparison.rest
    every = np.concatenate([rest, comparison.observed[comparison.seen], comparison.simulated])
    every = every[np.isfinite(every).all(axis=1)]
    low, high = every.min(axis=0), every.max(axis=0)
    size = float((high - low)[:2].max())
    if high[2] - low[2] > THIN * size or not is_surface(rest):
        return CloseUp(low, high)
    motion = np.linalg.norm(np.where(comparison.seen[:, None], comparison.observed, rest) - rest, axis=1)
    stirred = rest[motion > STIRRED * np.max(motion, initial=0.0)]
    if len(stirred):
        first, last = stirred[:, :2].min(axis=0), stirred[:, :2].max(axis=0)
        side = max(ROOM * float((last - first).max()), LEAST * spacing_of(rest))
        middle = 0.5 * (first + last)
        low[:2], high[:2] = np.maximum(middle - 0.5 * side, low[:2]), np.minimum(middle + 0.5 * side, high[:2])
    inside = every[(every[:, :2] >= low[:2]).all(axis=1) & (every[:, :2] <= high[:2]).all(axis=1)]
    if len(inside):
        low[2], high[2] = inside[:, 2].min(), inside[:, 2].max()
    side, deep = float((high - low)[:2].max()), float(high[2] - low[2])
    return CloseUp(low, high, max(round_down(RELIEF * side / deep), 1.0) if deep > 0.0 else 1.0, surface=True)
