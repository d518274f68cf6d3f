"""Residual of fitted layers on the surface around a tip, by the pokes that they were fitted to.

A lattice of clusters has systematic errors: with any law, the surface around a tip moves inwards too far and rounds off
too little. It is similar at all pokes of a surface, so that it improves predictions of unseen ones: the model's
discrepancy, estimated together with its parameters (Kennedy and O'Hagan 2001)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.msm.poke import Tip

DISTANCES = np.array([0.0, 0.06, 0.12, 0.2, 0.3, 0.4, 0.6, 0.9])
"""Distances from the tip's edge, as shares of the thickness; the residual is linear between them, and 0 beyond the
last."""

PRIOR_SD = 0.05
"""Deviation of the residual, as a share of the depth, that is expected where nothing was seen."""


@dataclass(frozen=True, slots=True)
class SurfaceLeft:
    """A poke whose surface a model followed. middle: (2,) middle of the tip [m]; depth [m]; points: (n, 3) [m]; left:
    (n, 3) seen less simulated displacement [m]"""

    middle: FloatArray
    tip: Tip
    depth: float
    points: FloatArray
    left: FloatArray


@dataclass(frozen=True, slots=True)
class DentResidual:
    """Observed less simulated displacement around a tip, as a share of its depth, at `DISTANCES` of its edge: away from
    the tip's middle, and upwards (k,). thickness: [m]"""

    outward: FloatArray
    upward: FloatArray
    thickness: float

    def at(self, points: FloatArray, middle: FloatArray, tip: Tip, depth: float) -> FloatArray:
        """(n, 3) [m] at points of the surface (n, 3) around a tip at `middle` (2,)."""
        away, basis = _around(points, middle, tip, self.thickness)
        return depth * np.column_stack([away * (basis @ self.outward)[:, None], basis @ self.upward])


def residual_of(seen: Sequence[SurfaceLeft], thickness: float) -> DentResidual | None:
    """The residual that pokes have in common; None under a ball, whose edge moves as it sinks in. Least squares, drawn
    towards 0 by as much as points scatter: few points say little."""
    if any(one.tip.shape == "sphere" for one in seen):
        return None
    gram, right = np.zeros((len(DISTANCES),) * 2), np.zeros((len(DISTANCES), 2))
    square, count = 0.0, 0
    for one in seen:
        away, basis = _around(one.points, one.middle, one.tip, thickness)
        share = one.left / one.depth
        gram += basis.T @ basis
        right += basis.T @ np.column_stack([(share[:, :2] * away).sum(axis=1), share[:, 2]])
        square, count = square + float(np.sum(share**2)), count + share.size
    scatter = square / max(count, 1)
    found = np.linalg.solve(gram + (scatter / PRIOR_SD**2 + 1e-9) * np.eye(len(gram)), right)
    return DentResidual(found[:, 0], found[:, 1], thickness)


def _around(points: FloatArray, middle: FloatArray, tip: Tip, thickness: float) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (n, 2) away from the tip's middle, and the share (n, k) that each distance has of a point's."""
    aside = points[:, :2] - middle
    radius = np.linalg.norm(aside, axis=1)
    if tip.shape == "flat":
        distance = np.linalg.norm(np.maximum(np.abs(aside) - tip.half, 0.0), axis=1)
    else:
        distance = np.maximum(radius - 0.5 * tip.size[0], 0.0)
    share = distance / thickness
    basis = np.stack([np.interp(share, DISTANCES, row) for row in np.eye(len(DISTANCES))], axis=1)
    basis[share > DISTANCES[-1]] = 0.0
    return aside / np.maximum(radius, 1e-12)[:, None], basis
