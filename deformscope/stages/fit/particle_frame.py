"""The particles of one moment in numbers: where they were seen and simulated, and how the material is strained."""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported as they are first used

from deformscope.arrays import BoolArray, FloatArray
from deformscope.stages.fit.estimate import Comparison, LengthUnit
from deformscope.stages.msm.clusters import spacing

WITHIN = 1.6
"""Spacings within which neighbours show a particle's strain."""


@dataclass(frozen=True, slots=True)
class ParticleFrame:
    """rest, observed, simulated, residual: (K, d) positions, and observed less simulated ones [unit]; observed and what
    follows from it is NaN where a particle was not seen
    strain: (K, d, d) Green-Lagrange strain of the observed positions, 0 = undeformed; seen, held: (K,)"""

    rest: FloatArray
    observed: FloatArray
    simulated: FloatArray
    residual: FloatArray
    strain: FloatArray
    seen: BoolArray
    held: BoolArray
    unit: LengthUnit


def particle_frame(one: Comparison) -> ParticleFrame:
    """The numbers of one comparison."""
    observed = np.where(one.seen[:, None], one.observed, np.nan)
    held = np.isin(np.arange(len(one.rest)), one.held)
    strain = green_strain(one.rest, observed)
    return ParticleFrame(one.rest, observed, one.simulated, observed - one.simulated, strain, one.seen, held, one.unit)


def green_strain(rest: FloatArray, deformed: FloatArray) -> FloatArray:
    """(K, d, d) Green-Lagrange strain at particles, by the least squares gradient over neighbours; NaN where these
    span no volume. rest, deformed: (K, d), NaN where not known"""
    count, d = rest.shape
    tree = scipy.spatial.cKDTree(rest)
    gap, near = tree.query(rest, k=min(3**d, count), distance_upper_bound=WITHIN * spacing(rest))
    near = np.where(np.isfinite(gap), near, np.arange(count)[:, None])
    before, after = rest[near] - rest[:, None], deformed[near] - deformed[:, None]
    known = np.isfinite(after).all(axis=2, keepdims=True)
    before, after = np.where(known, before, 0.0), np.where(known, after, 0.0)
    square = np.einsum("kni,knj->kij", before, before)
    good = np.linalg.cond(square) < 1e6
    gradient = np.full((count, d, d), np.nan)
    gradient[good] = np.einsum("kni,knj->kij", after, before)[good] @ np.linalg.inv(square[good])
    return np.asarray(0.5 * (np.swapaxes(gradient, 1, 2) @ gradient - np.eye(d)))
